"""`slam bench paper` and `weights`: the seed paper's experiment."""
