"""Errors of the application that a person can act on; `slam.command` turns them into one line."""

from __future__ import annotations


class ReportError(Exception):
    """A run, its truth or a trajectory cannot be evaluated; the message says where and why."""


class RunError(Exception):
    """A RUN directory cannot be made or read; the message says which and what to do."""


class ViewError(Exception):
    """A live view cannot be served; the message says where and what to do."""
