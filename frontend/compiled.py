"""How kernels are compiled: once, kept on disk, and free of the interpreter's lock.

No fastmath, so that equal inputs give equal bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher
from numba.core.runtime.nrt import rtsys
from slam.frontend.kernel_cache import NUMBA, cache_folder

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,  # for C callbacks: nothing here makes any, and it takes time
}
_BARE = {**_OPTIONS, "_nrt": False}  # without the run time that owns arrays


class _Part(CPUDispatcher):
    """A function that only kernels call: compiled with each of them, and not kept by itself.

    The code that unpacks the arguments of a call from Python takes longer to compile than most
    functions themselves, so it is left out: with it the matcher takes 32.3 s of CPU to compile,
    without it 28.7 s.  A plain `njit` without that code ends the process with a segmentation
    fault when Python calls it; here Python gets the Python function.

    Of numba this uses what is not public: `CPUDispatcher`, and the option `_nrt`.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        options = {**options, "nopython": True, "no_cpython_wrapper": True}
        super().__init__(function, targetoptions=options)

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*args)


class _KernelCache(FunctionCache):
    """Finds compiled kernels on disk, without all that would be needed to compile one.

    Numba loads its implementations of Python and numpy first, 190 modules: 0.5 s of CPU and 23 MB
    that a run does not use whose kernels are all there.  The compiler loads them if it is called.
    Of numba this uses what is not public: this class, and `rtsys`, which owns arrays.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for these types, None if it has not been kept."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls; it may allocate arrays."""
    return _kept(function, _OPTIONS)


def addressed_kernel(function: Callable[..., Any]) -> Any:
    """Compile a `kernel` that others may call by its `kernel_address.Address`."""
    return _kept(function, {**_OPTIONS, "no_cfunc_wrapper": False})


def bare_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls and that only works on the arrays it is given.

    Without numba's run time no array is counted as used and released again: two atomic
    operations an array and call, which cost more than the search for a correspondence.
    """
    return _kept(function, _BARE)


def part(function: Callable[..., Any]) -> Any:
    """Compile a function that kernels call; it allocates nothing."""
    return _Part(function, _BARE)


def allocating_part(function: Callable[..., Any]) -> Any:
    """Compile as a `part` what allocates arrays."""
    return _Part(function, _OPTIONS)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a `part` into each of its callers: for what is called once a beam."""
    return _Part(function, {**_BARE, "forceinline": True})


def merged(function: Callable[..., Any]) -> Any:
    """Merge a function into its caller before that is compiled: no call, no arguments.

    Worth it for a long function with one caller: as a `part` its machine code is made once for
    itself and once more for every function above it.
    """
    return _Part(function, {**_BARE, "inline": "always"})


def _kept(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Compile a function and keep it in the folder for the sources as they are, if there is one."""
    folder = cache_folder()
    if folder is None:
        return njit(**options)(function)
    before, NUMBA.CACHE_DIR = NUMBA.CACHE_DIR, str(folder)
    try:
        cache = _KernelCache(function)
    except RuntimeError:  # the folder was there a moment ago
        return njit(**options)(function)
    finally:
        NUMBA.CACHE_DIR = before
    made: Any = njit(**options)(function)
    if str(cache.cache_path).startswith(str(folder)):
        made._cache = cache  # as `cache=True` does with numba's own
    return made
