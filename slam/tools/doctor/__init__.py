"""What `slam doctor` finds out with the scan matcher."""
