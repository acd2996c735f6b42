"""Everything around logs and runs: imports, exports, `slam info`, `slam doctor`, `slam demo`."""
