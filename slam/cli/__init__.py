"""The command line: each command only connects parts that live elsewhere."""
