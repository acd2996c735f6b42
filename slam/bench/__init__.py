"""Everything that `slam bench` measures, one module a benchmark."""
