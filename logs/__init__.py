"""Logs: the shared message vocabulary, MCAP reading and writing, importers and exporters."""
