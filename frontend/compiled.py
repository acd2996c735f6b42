"""How kernels are compiled: once, kept on disk, and free of the interpreter's lock.

No fastmath, so that equal inputs give equal bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,  # for C callbacks: nothing here makes any, and it takes time
}
_BARE = {**_OPTIONS, "_nrt": False}  # without the run time that owns arrays


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that may allocate arrays."""
    return njit(**_OPTIONS)(function)


def part(function: Callable[..., Any]) -> Any:
    """Compile a function that only works on the arrays it is given.

    Without numba's run time no array is counted as used and released again: two atomic
    operations an array and call, which cost more than the search for a partner.
    """
    return njit(**_BARE)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a `part` into each of its callers: for what is called once a beam."""
    return njit(forceinline=True, **_BARE)(function)
