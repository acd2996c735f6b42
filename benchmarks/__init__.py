"""Everything that `slam bench` measures; not part of the wheel."""
