"""`slam bench online-faults`: drives with device faults against fault-free ones."""
