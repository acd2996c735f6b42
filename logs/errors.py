"""Errors of logs, one class for each different reaction, and how to show foreign text."""

from __future__ import annotations

_SHOWN_LENGTH = 80  # characters: enough to recognise a name, too few to flood a terminal


class LogError(Exception):
    """A log cannot be read or written; the message says what, where, and what to do."""

    explains_itself = True  # the command line shows it as one line


class TruncatedLog(LogError):  # noqa: N818 - says what happened, as LinkLost does
    """The recording was cut off before it was closed: `slam recover` saves what is intact."""


class NewerSchema(LogError):  # noqa: N818
    """The log was written by a newer version of this program: upgrade to read it."""


def shown(text: str) -> str:
    """Return text out of a file made safe to show: no control characters, not too long.

    A log is often somebody else's; a topic name may hold terminal escape sequences.
    """
    safe = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return safe if len(safe) <= _SHOWN_LENGTH else safe[: _SHOWN_LENGTH - 3] + "..."


def missing_extra(what: str, extra: str) -> str:
    """Say in one form that something needs an optional part of this program, and how to get it."""
    return f"{what} needs the extra {extra}: pip install 'sdp-slam[{extra}]'"
