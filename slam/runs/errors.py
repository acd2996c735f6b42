"""Errors that a person can act on: the command line shows each as one line.

Such a class has `explains_itself`: its message says what is wrong, where, and what to do.  The
command line asks for that name, so that it need not load the modules of all of them.
"""

from __future__ import annotations


class SlamError(Exception):
    """A run cannot give a result; the message says what is missing and what to do."""

    explains_itself = True


class ConfigError(Exception):
    """A setting is unknown or out of range; the message names it and the nearest known one."""

    explains_itself = True


class ReportError(Exception):
    """A run, its truth or a trajectory cannot be evaluated; the message says where and why."""

    explains_itself = True


class RunError(Exception):
    """A RUN directory cannot be made or read; the message says which and what to do."""

    explains_itself = True


class ViewError(Exception):
    """A live view cannot be served; the message says where and what to do."""

    explains_itself = True
