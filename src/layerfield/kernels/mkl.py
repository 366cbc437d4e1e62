"""Fourier transforms of complex planes by the MKL inside PyTorch, in place.

PyTorch makes a new array for what comes out. Its blocks move on through memory, so that they are
in no cache, and writing takes longer than computing. So MKL is called past it: the same library,
threads and results.
"""

import ctypes
import platform
import weakref
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Complex
from torch import Tensor

_LARGE = 1 << 19  # pixels of a plane from which on it is transformed by itself
_HUGE = 1 << 21  # from which on all threads transform it together
# As MKL numbers them.
_COMPLEX, _COUNT, _INPUT_DISTANCE, _OUTPUT_DISTANCE, _THREADS = 32, 7, 14, 15, 27


class MklTransform:
    """Transforms planes of one size in place, without any factor.

    Args:
        height: of the planes.
        width: in complex numbers.
        by_row: every row by itself, or both directions.
        back: from frequencies to pixels.
    """

    def __init__(self, height: int, width: int, by_row: bool, back: bool) -> None:
        self.is_for_one_thread = height * width < _HUGE  # where one is as good as all
        self._shape, self._by_row, self._back = (height, width), by_row, back

    @property
    def address(self) -> int:
        """Where `long (*)(void *handle, void *plane, ...)` is, which transforms one."""
        address = ctypes.cast(self._one.function(self._back), ctypes.c_void_p).value
        assert address is not None
        return address

    @property
    def handle(self) -> int:
        """What it is called with, as long as this lives."""
        handle = self._one.handle.value
        assert handle is not None
        return handle

    def __call__(self, planes: Complex[Tensor, "plane y x"]) -> None:
        """Transform contiguous planes by all threads together."""
        for some in planes.split(1) if planes[0].numel() >= _LARGE else (planes,):
            _plan((*some.shape,), self._by_row, torch.get_num_threads())(some, self._back)

    @cached_property
    def _one(self) -> "_Plan":
        return _Plan((1, *self._shape), self._by_row, 1)


class _Plan:
    """Transforms of so many planes, as MKL prepares them for a number of threads."""

    def __init__(self, shape: tuple[int, int, int], by_row: bool, threads: int) -> None:
        known, (count, height, width) = library(), shape
        assert known is not None
        self._library, self.handle = known, ctypes.c_void_p()
        there = ctypes.byref(self.handle)
        if by_row:
            count, points = count * height, width
            failed = known.DftiCreateDescriptor_s_1d(there, _COMPLEX, ctypes.c_long(width))
        else:
            points, lengths = height * width, (ctypes.c_long * 2)(height, width)
            failed = known.DftiCreateDescriptor_s_md(there, _COMPLEX, ctypes.c_long(2), lengths)
        weakref.finalize(self, known.DftiFreeDescriptor, there)
        for name, value in (
            (_COUNT, count),
            (_INPUT_DISTANCE, points),
            (_OUTPUT_DISTANCE, points),
            (_THREADS, threads),
        ):
            failed = failed or known.DftiSetValue(self.handle, name, ctypes.c_long(value))
        failed = failed or known.DftiCommitDescriptor(self.handle)
        if failed:
            raise RuntimeError(f"MKL prepares no transforms of {shape}: error {failed}")

    def function(self, back: bool) -> Any:
        """Return MKL's."""
        return self._library.DftiComputeBackward if back else self._library.DftiComputeForward

    def __call__(self, planes: Tensor, back: bool) -> None:
        if failed := self.function(back)(self.handle, ctypes.c_void_p(planes.data_ptr())):
            raise RuntimeError(f"MKL makes no transforms of {tuple(planes.shape)}: error {failed}")


@lru_cache(maxsize=32)
def _plan(shape: tuple[int, int, int], by_row: bool, threads: int) -> _Plan:
    return _Plan(shape, by_row, threads)


@cache
def library() -> ctypes.CDLL | None:
    """Return PyTorch's MKL, or None where it computes with something else.

    None on processors of other makers, too: MKL keeps its vector instructions to Intel's.
    """
    if platform.system() != "Linux" or not torch.backends.mkl.is_available() or not is_intel():
        return None
    try:
        found = ctypes.CDLL(str(Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"))
        for name in (
            "DftiCreateDescriptor_s_1d",
            "DftiCreateDescriptor_s_md",
            "DftiSetValue",
            "DftiCommitDescriptor",
            "DftiComputeForward",
            "DftiComputeBackward",
            "DftiFreeDescriptor",
        ):
            getattr(found, name).restype = ctypes.c_long
    except (AttributeError, OSError):
        return None
    return found


def is_intel() -> bool:
    """Whether this processor is one of Intel's."""
    try:
        return "GenuineIntel" in Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return False
