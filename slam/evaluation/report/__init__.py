"""`slam report`: errors against truth, as a page and as numbers."""
