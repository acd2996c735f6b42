"""Errors against ground truth, and the report that shows them."""
