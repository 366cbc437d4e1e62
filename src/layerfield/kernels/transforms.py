"""Fourier transforms of complex planes, in place: by MKL, by compiled loops, or by PyTorch."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Complex
from torch import Tensor

from layerfield.kernels import mkl
from layerfield.kernels.compiled import compiled, is_plain, native
from layerfield.kernels.fourier import FourierTransform, plane_transform_of
from layerfield.kernels.mkl import MklTransform

_TORCH = {
    (False, False): torch.fft.fft2,
    (False, True): torch.fft.ifft2,
    (True, False): torch.fft.fft,
    (True, True): torch.fft.ifft,
}


PlaneTransform = MklTransform | FourierTransform


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
    note_transform((*values.shape,), by_row, back)
    planes = values.view(-1, *values.shape[-2:])
    if (transform := _transform_of(values.shape, by_row, back)) is None:
        norm = "forward" if back else "backward"
        planes.copy_(_TORCH[by_row, back](planes, norm=norm))
    elif _is_for_each(transform, len(planes)):
        made = torch.view_as_real(planes).flatten(-2).numpy()
        _transform_each.in_spans(made, call_of(transform), count=len(made), numbers=made.size)
    else:
        transform(planes)


class Call(NamedTuple):
    """Of a function that transforms a plane in place: its address, and what it is called with."""

    address: int
    handle: int


def plane_transform(shape: tuple[int, ...], by_row: bool, back: bool) -> PlaneTransform | None:
    """Return what transforms planes of such values one by one, in compiled loops.

    Each is done by one thread: that pays where all threads have some, but for huge planes. There is
    None otherwise.
    """
    transform = _for_each_of(shape, by_row, back)
    if transform is not None:
        note_transform(shape, by_row, back)
    return transform


@dataclass(frozen=True)
class ForthAndBack:
    """What compiled loops transform planes one by one with, and back, in turns.

    Args:
        shape: of all values.
        by_row: every row by itself, or both directions.
        forth: the transform.
        back: the same from frequencies to pixels.
    """

    shape: tuple[int, ...]
    by_row: bool
    forth: PlaneTransform
    back: PlaneTransform

    def calls(self, times: int) -> tuple[Call, Call]:
        """Return what those take that call each so many times, as long as this lives."""
        for back in (False, True) * times:
            note_transform(self.shape, self.by_row, back)
        return call_of(self.forth), call_of(self.back)


def forth_and_back(shape: tuple[int, ...], by_row: bool) -> ForthAndBack | None:
    """Return both transforms of planes of such values, where `plane_transform` returns each."""
    forth, back = (_for_each_of(shape, by_row, each) for each in (False, True))
    return None if forth is None or back is None else ForthAndBack(shape, by_row, forth, back)


def _for_each_of(shape: tuple[int, ...], by_row: bool, back: bool) -> PlaneTransform | None:
    transform = _transform_of(shape, by_row, back)
    if transform is None or not _is_for_each(transform, math.prod(shape[:-2])):
        return None
    return transform


@compiled
def transform_one(plane, call):
    """Transform a plane in place, by a `Call`."""
    if _call(call.address, call.handle, plane) != 0:
        raise MemoryError("there is not enough memory for a Fourier transform")


@compiled
def _transform_each(planes, call, begin, end):
    """Planes from and to."""
    for plane in range(begin, end):
        transform_one(planes[plane], call)


_call = native("layerfield.kernels.calls", "call")


def call_of(transform: PlaneTransform) -> Call:
    """Return what compiled loops take, as long as the transform lives."""
    return Call(transform.address, transform.handle)


def _is_for_each(transform: PlaneTransform, count: int) -> bool:
    return transform.is_for_one_thread and count >= torch.get_num_threads()


def note_transform(shape: tuple[int, ...], by_row: bool, back: bool) -> None:
    """Add one to `transforms_made`."""
    if (made := _MADE.get()) is not None:
        made.append(Transform(shape, by_row, back))


def _transform_of(shape: tuple[int, ...], by_row: bool, back: bool) -> PlaneTransform | None:
    """Return MKL's, or compiled loops; None leaves transforms to PyTorch."""
    if (make := _maker()) is None:
        return None
    return make(shape[-2], shape[-1], by_row, back)


def _maker() -> Callable[[int, int, bool, bool], PlaneTransform | None] | None:
    if mkl.library() is not None:
        return _mkl_transform
    return None if is_plain() else plane_transform_of


_mkl_transform = lru_cache(maxsize=64)(MklTransform)
