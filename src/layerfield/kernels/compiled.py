"""Functions compiled by Numba when they are first called, and kept on disk for the next process."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property, update_wrapper
from inspect import unwrap
from types import FunctionType
from typing import Any

import torch
from torch import Tensor

# As C compilers have it: sums may be reordered, and nothing infinite comes in.
_FREE = {"contract", "reassoc", "nsz", "arcp", "nnan", "ninf"}
# Loops that are functions of their own are put where they are called: calls cost as much as rows.
_OPTIONS = {"nogil": True, "inline": "always", "fastmath": _FREE, "error_model": "numpy"}
_SINGLE = (torch.float32, torch.complex64)
_PLAIN = ContextVar("plain", default=False)


@contextmanager
def plain() -> Iterator[None]:
    """Leave everything to PyTorch inside a `with`: to compare with it, or to watch what it does."""
    before = _PLAIN.set(True)
    try:
        yield
    finally:
        _PLAIN.reset(before)


def is_plain() -> bool:
    """Whether everything is left to PyTorch."""
    return _PLAIN.get()


def serve(*values: Tensor | None) -> bool:
    """Whether loops for single precision serve all of these: on a processor, no derivatives."""
    known = [each for each in values if each is not None]
    if is_plain() or (torch.is_grad_enabled() and any(each.requires_grad for each in known)):
        return False
    return all(each.dtype in _SINGLE and each.device.type == "cpu" for each in known)


class compiled:  # noqa: N801 - a decorator
    """A function of arrays and numbers, compiled; threads may call it side by side.

    It may call others of its module that are. Numba is imported at the first call: that takes as
    long as many a command does.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function: Any = unwrap(function)  # without what tests wrap around it
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Return what the function does."""
        return self.dispatcher(*arguments)

    @cached_property
    def dispatcher(self) -> Callable[..., Any]:
        """Numba's own."""
        import numba  # noqa: PLC0415

        code, known = self._function.__code__, {**self._function.__globals__}
        for name in code.co_names:
            if isinstance(each := known.get(name), compiled):
                known[name] = each.dispatcher
        function = FunctionType(code, known, self._function.__name__)
        try:
            return numba.njit(function, cache=True, **_OPTIONS)  # pyright: ignore[reportReturnType]
        except RuntimeError:  # neither beside the source nor in the user's cache can it be kept
            return numba.njit(function, **_OPTIONS)  # pyright: ignore[reportReturnType]
