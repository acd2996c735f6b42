"""Exporters: our logs in formats that other programs read."""
