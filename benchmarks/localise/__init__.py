"""`slam bench localise`: a finished map is for use."""
