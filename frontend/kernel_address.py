"""Compiled kernels as arguments of others.

Apart from `compiled`: whoever imports that counts among the sources of kernels.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from numba import typeof, types


class Address(types.WrapperAddressProtocol):
    """An `addressed_kernel`, for arguments like those given, as an argument of other kernels.

    They call it where it is.  What they name instead is compiled into them once more: the match
    would take its half minute twice.
    """

    def __init__(self, called: Any, arguments: tuple[Any, ...]) -> None:
        # Tells numba what an address is: without `_KernelCache` it would know by now.
        import_module("numba.experimental.function_type")
        kinds = tuple(typeof(argument) for argument in arguments)
        called.compile(kinds)
        self._made = called.overloads[kinds]

    def __wrapper_address__(self) -> int:
        name = self._made.fndesc.llvm_cfunc_wrapper_name
        return int(self._made.library.get_pointer_to_function(name))

    def signature(self) -> Any:
        """Its types."""
        return self._made.signature
