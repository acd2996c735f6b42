"""Locks that tell whether a program still writes somewhere; they end with that program.

They are advisory (`flock`): nothing is kept from reading or removing.  On Windows there are none,
and none are needed: the system refuses to remove what is open.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def hold(descriptor: int) -> bool:
    """Lock an open file or folder until it is closed; False if another program holds it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def hold_folder(path: Path) -> int | None:
    """Lock a folder; close the descriptor to release it.  None where folders have no locks.

    Raises:
        BlockingIOError: another program holds it.
    """
    if fcntl is None:
        return None
    descriptor = os.open(path, os.O_RDONLY)
    if not hold(descriptor):
        os.close(descriptor)
        raise BlockingIOError(f"{path} is locked")
    return descriptor


def is_held(path: Path) -> bool:
    """Whether a program that still runs holds the lock of a file or folder."""
    if fcntl is None:
        return False
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False
