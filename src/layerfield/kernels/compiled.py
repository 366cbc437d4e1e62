"""Functions compiled by Numba when they are first called, and kept on disk for the next process."""

import hashlib
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, cached_property, partial, update_wrapper
from importlib import import_module
from inspect import signature, unwrap
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from layerfield.kernels.preparation import PREPARATION, listen_to_compiler
from layerfield.kernels.threads import FEW, SPANS, in_threads, parallel_address

# As C compilers have it: sums may be reordered, and nothing infinite comes in.
_FREE = {"contract", "reassoc", "nsz", "arcp", "nnan", "ninf"}
_LOOPS = {"nogil": True, "fastmath": _FREE, "error_model": "numpy"}
# Loops that are functions of their own are put where they are called: calls cost as much as rows.
_PUT_IN = {"inline": "always"}
# What is called by name all the same: each that calls it holds a copy, and these do not round
# alike. Which of one name a process takes would depend on which it has read first.
_WHOLE = {"forceinline": True}
_SPAN = ["begin", "end"]  # the last parameters of passes
_SINGLE = (torch.float32, torch.complex64)
_NO_NEEDS = np.zeros(0, np.int64)
# Numba's own switch leaves loops to the interpreter, which would take minutes: PyTorch does not.
_PLAIN = ContextVar("plain", default=os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"})


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

    def in_spans(
        self, *arguments: Any, count: int, numbers: int, needs: np.ndarray | None = None
    ) -> None:
        """Call the function for spans that come to 0 .. count, a few for every thread.

        Whoever is free takes the next one, so that a thread whose core others use holds nobody up.
        What is done for one of them must not depend on how they are divided. One thread calls what
        several would: copies of a function do not round alike.

        Args:
            arguments: all but the last two, which are from where and to where.
            count: of what is divided.
            numbers: that are gone over in all. Where they are few, threads cost more than they
                bring.
            needs: for each of the count how many, from the first on, have to be done before it; no
                more than there are. Spans are of one then: passes that need each other are one
                call, and the last of one does not hold up the first of the next.

        Raises:
            MemoryError: there was none for what the function keeps to itself.
        """
        threads = torch.get_num_threads() if numbers >= FEW and count > 1 else 1
        if (address := parallel_address()) is not None:
            listed = _NO_NEEDS if needs is None else needs
            done = np.zeros(len(listed), np.int32)
            given = arguments, count, listed, done, threads, address
            if not self.region.overloads:
                self._prepare_region(given)
            if self.region(*given):
                raise MemoryError("there is not enough memory for a compiled loop")
        elif threads == 1 or needs is not None:
            self(*arguments, 0, count)
        else:
            length = math.ceil(count / (SPANS * threads))
            spans = math.ceil(count / length)
            in_threads(lambda n: self(*arguments, n * length, min(count, (n + 1) * length)), spans)

    def _prepare_region(self, given: tuple[Any, ...]) -> None:
        """Compile it for such arguments, or read what was compiled of it."""
        with PREPARATION.going_on():
            self.region.compile(tuple(map(self.region.typeof_pyval, given)))

    @cached_property
    @PREPARATION.going_on()
    def dispatcher(self) -> Callable[..., Any]:
        """Numba's own."""
        import numba  # noqa: PLC0415

        # Calls of passes over spans cost nothing, and to compile those once takes a third of it.
        put_in = {} if [*signature(self._function).parameters][-2:] == _SPAN else _PUT_IN
        return _kept(numba.njit, self._resolved, **_LOOPS, **put_in, **_WHOLE)

    @cached_property
    @PREPARATION.going_on()
    def address(self) -> int:
        """Where C, and compiled functions, call it as `long (*)(void *, void *)`.

        What is called is compiled once, and not inside of each that calls it.
        """
        import numba  # noqa: PLC0415

        compile_for = partial(numba.cfunc, "int64(voidptr, voidptr)")
        options = {name: _LOOPS[name] for name in ("fastmath", "error_model")}
        return _kept(compile_for, self._resolved, nopython=True, **options, **_WHOLE).address

    @property
    def _resolved(self) -> FunctionType:
        """The function, with those of Numba in the place of others that it calls."""
        code, known = self._function.__code__, {**self._function.__globals__}
        for name in code.co_names:
            if isinstance(each := known.get(name), compiled | native):
                known[name] = each.dispatcher
        return FunctionType(code, known, self._function.__name__)

    @cached_property
    @PREPARATION.going_on()
    def region(self) -> Any:
        """What calls it for spans, on all threads; see `region_of`."""
        import numba  # noqa: PLC0415

        from layerfield.kernels.regions import region_of  # noqa: PLC0415

        made = region_of(self._function, self.dispatcher)
        return _kept(numba.njit, made, nogil=True, **_WHOLE)


@dataclass(frozen=True)
class native:  # noqa: N801 - beside `compiled`
    """What compiled functions may call although it is none of them.

    Args:
        module: that has it; it may import Numba.
        name: its name there.
    """

    module: str
    name: str

    def __call__(self, *arguments: Any) -> Any:
        """Return what it does; outside of compiled functions most of these do nothing."""
        return self.dispatcher(*arguments)

    @property
    def dispatcher(self) -> Callable[..., Any]:
        """Numba's own."""
        return getattr(import_module(self.module), self.name)


def _kept(compile_for: Callable[..., Any], function: FunctionType, **options: Any) -> Any:
    """Return what Numba makes of a function, kept on disk where there is a place for it."""
    listen_to_compiler()
    function.__qualname__ = f"{function.__name__}_{_fingerprint()}"  # names what is kept on disk
    try:
        return compile_for(cache=True, **options)(function)
    except RuntimeError:  # neither beside the source nor in the user's cache can it be kept
        return compile_for(**options)(function)


@cache
def _fingerprint() -> str:
    """Return that of all compiled functions: one has others of other files inside.

    Numba looks at the file of a function alone when it reads what was kept.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(each.read_bytes() for each in files)).hexdigest()[:12]
