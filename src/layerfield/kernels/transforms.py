"""Fourier transforms of complex planes, in place."""

import ctypes
import math
import platform
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Complex
from torch import Tensor

from layerfield.kernels.compiled import native

_LARGE = 1 << 19  # pixels of a plane from which on it is transformed by itself
_HUGE = 1 << 21  # from which on all threads transform it together
# As MKL numbers them.
_COMPLEX, _COUNT, _INPUT_DISTANCE, _OUTPUT_DISTANCE, _THREADS = 32, 7, 14, 15, 27
_TORCH = {
    (False, False): torch.fft.fft2,
    (False, True): torch.fft.ifft2,
    (True, False): torch.fft.fft,
    (True, True): torch.fft.ifft,
}


class Transform(NamedTuple):
    """One that was made, of values of such a shape."""

    shape: tuple[int, ...]
    by_row: bool
    back: bool


_MADE: ContextVar[list[Transform] | None] = ContextVar("made", default=None)


@contextmanager
def transforms_made() -> Iterator[list[Transform]]:
    """Keep a list of all transforms made inside a `with`."""
    made = list[Transform]()
    before = _MADE.set(made)
    try:
        yield made
    finally:
        _MADE.reset(before)


def transform_(
    values: Complex[Tensor, "*batch y x"], *, by_row: bool = False, back: bool = False
) -> None:
    """Transform planes in place, without any factor: there and back they are n times as large.

    PyTorch makes a new array for what comes out. Its blocks move on through memory, so that they
    are in no cache, and writing takes longer than computing. So where PyTorch computes with MKL,
    that is called past it: the same library, threads and results.

    Args:
        values: of single precision, on a processor, contiguous.
        by_row: every row by itself, or both directions.
        back: from frequencies to pixels.

    Raises:
        ValueError: other values.
    """
    if not values.is_contiguous() or values.dtype != torch.complex64 or values.is_conj():
        found = f"{values.dtype}, strides {values.stride()}"
        raise ValueError(f"found {found}, expected contiguous complex64 values")
    _note((*values.shape,), by_row, back)
    planes = values.view(-1, *values.shape[-2:])
    for some in planes.split(1) if planes[0].numel() >= _LARGE else (planes,):
        if _library() is None:
            norm = "forward" if back else "backward"
            some.copy_(_TORCH[by_row, back](some, norm=norm))
        else:
            _plan((*some.shape,), by_row, torch.get_num_threads())(some, back)


class Call(NamedTuple):
    """Of a function that transforms a plane in place: its address, and what it is called with."""

    address: int
    handle: int


def plane_transform(
    shape: tuple[int, ...], by_row: bool, back: bool, times: int = 1
) -> "_PlaneTransform | None":
    """Return what transforms planes of such values one by one, so many times, in compiled loops.

    Each is done by one thread: that pays where all threads have some, but for huge planes. There is
    None otherwise.
    """
    *batch, height, width = shape
    threads, library = torch.get_num_threads(), _library()
    if library is None or math.prod(batch) < threads or height * width >= _HUGE:
        return None
    for _ in range(times):
        _note(shape, by_row, back)
    return _PlaneTransform(_plan((1, height, width), by_row, 1), back)


@native
def transform_plane() -> Any:
    """Compiled loops give it address, handle and plane; what it returns is 0, or an error."""
    from layerfield.kernels.calls import call  # noqa: PLC0415

    return call


def _note(shape: tuple[int, ...], by_row: bool, back: bool) -> None:
    if (made := _MADE.get()) is not None:
        made.append(Transform(shape, by_row, back))


class _Plan:
    """Transforms of so many planes, as MKL prepares them for a number of threads."""

    def __init__(self, shape: tuple[int, int, int], by_row: bool, threads: int) -> None:
        library, (count, height, width) = _library(), shape
        assert library is not None
        self._library, self.handle = library, ctypes.c_void_p()
        there = ctypes.byref(self.handle)
        if by_row:
            count, points = count * height, width
            failed = library.DftiCreateDescriptor_s_1d(there, _COMPLEX, ctypes.c_long(width))
        else:
            points, lengths = height * width, (ctypes.c_long * 2)(height, width)
            failed = library.DftiCreateDescriptor_s_md(there, _COMPLEX, ctypes.c_long(2), lengths)
        weakref.finalize(self, library.DftiFreeDescriptor, there)
        for name, value in (
            (_COUNT, count),
            (_INPUT_DISTANCE, points),
            (_OUTPUT_DISTANCE, points),
            (_THREADS, threads),
        ):
            failed = failed or library.DftiSetValue(self.handle, name, ctypes.c_long(value))
        failed = failed or library.DftiCommitDescriptor(self.handle)
        if failed:
            raise RuntimeError(f"MKL prepares no transforms of {shape}: error {failed}")

    def function(self, back: bool) -> Any:
        """Return MKL's."""
        return self._library.DftiComputeBackward if back else self._library.DftiComputeForward

    def __call__(self, planes: Tensor, back: bool) -> None:
        if failed := self.function(back)(self.handle, ctypes.c_void_p(planes.data_ptr())):
            raise RuntimeError(f"MKL makes no transforms of {tuple(planes.shape)}: error {failed}")


class _PlaneTransform:
    """Keeps a plan as long as its call is in use."""

    def __init__(self, plan: _Plan, back: bool) -> None:
        self._plan = plan
        address = ctypes.cast(plan.function(back), ctypes.c_void_p).value
        assert address is not None
        assert plan.handle.value is not None
        self.call = Call(address, plan.handle.value)


@lru_cache(maxsize=32)
def _plan(shape: tuple[int, int, int], by_row: bool, threads: int) -> _Plan:
    return _Plan(shape, by_row, threads)


@cache
def _library() -> ctypes.CDLL | None:
    """Return PyTorch's MKL, or None where it computes with something else."""
    if platform.system() != "Linux" or not torch.backends.mkl.is_available():
        return None
    try:
        library = ctypes.CDLL(str(Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"))
        for name in (
            "DftiCreateDescriptor_s_1d",
            "DftiCreateDescriptor_s_md",
            "DftiSetValue",
            "DftiCommitDescriptor",
            "DftiComputeForward",
            "DftiComputeBackward",
            "DftiFreeDescriptor",
        ):
            getattr(library, name).restype = ctypes.c_long
    except (AttributeError, OSError):
        return None
    return library
