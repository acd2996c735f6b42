"""Whole runs over a log, and the RUN directory that keeps their results."""
