"""Transforms of frequencies to real planes by the cuFFT inside PyTorch, in one pass less.

cuFFT writes on what it transforms, so that PyTorch copies every spectrum first: nine planes of
1120 x 2048 pixels there and back take 0.31 ms on an H200, without that copy 0.27. So cuFFT is
called past it: the same library and results.
"""

import ctypes
from functools import cache

import torch
from jaxtyping import Complex, Float
from torch import Tensor

_COMPLEX_TO_REAL = 0x2C  # as cuFFT numbers it


def to_planes_(
    spectrum: Complex[Tensor, "*batch fy fx"], width: int, *, by_row: bool
) -> Float[Tensor, "*batch ty tx"] | None:
    """Return the planes of a spectrum, without any factor; None where cuFFT is not found.

    Args:
        spectrum: of both directions, or of every row; single precision, contiguous, written on.
        width: of the planes.
        by_row: every row by itself.

    Raises:
        RuntimeError: cuFFT cannot do it.
    """
    if library() is None:
        return None
    height = spectrum.shape[-2]
    lengths = (width,) if by_row else (height, width)
    planes = spectrum.real.new_empty(*spectrum.shape[:-1], width)
    if planes.numel():
        count = planes.numel() // (width if by_row else height * width)
        _plan(lengths, count, spectrum.get_device())(spectrum, planes)
    return planes


class _Plan:
    """Transforms of so many planes or rows, as cuFFT prepares them for a device."""

    def __init__(self, lengths: tuple[int, ...], count: int, device: int) -> None:
        known = library()
        assert known is not None
        self._library, self._handle, size = known, ctypes.c_int(), ctypes.c_size_t()
        with torch.cuda.device(device):
            _succeed(known.cufftCreate(ctypes.byref(self._handle)))
            _succeed(known.cufftSetAutoAllocation(self._handle, 0))
            extents = (ctypes.c_int * len(lengths))(*lengths)
            close = None, 1, 0  # one after the other
            what = len(lengths), extents, *close, *close, _COMPLEX_TO_REAL, count
            _succeed(known.cufftMakePlanMany(self._handle, *what, ctypes.byref(size)))
        self._room = size.value

    def __call__(self, spectrum: Tensor, planes: Tensor) -> None:
        room = torch.empty(self._room, dtype=torch.uint8, device=spectrum.device)
        stream = torch.cuda.current_stream(spectrum.device).cuda_stream
        known, handle = self._library, self._handle
        _succeed(known.cufftSetStream(handle, ctypes.c_void_p(stream)))
        _succeed(known.cufftSetWorkArea(handle, ctypes.c_void_p(room.data_ptr())))
        given = (ctypes.c_void_p(each.data_ptr()) for each in (spectrum, planes))
        _succeed(known.cufftExecC2R(handle, *given))


@cache
def _plan(lengths: tuple[int, ...], count: int, device: int) -> _Plan:
    """Kept for good: what is recorded relies on it."""
    return _Plan(lengths, count, device)


@cache
def library() -> ctypes.CDLL | None:
    """Return PyTorch's cuFFT, or None where it has none that is found."""
    if torch.version.cuda is None:
        return None
    try:
        # Of CUDA 12 it is version 11, of CUDA 13 version 12.
        return ctypes.CDLL(f"libcufft.so.{int(torch.version.cuda.partition('.')[0]) - 1}")
    except OSError:
        return None


def _succeed(error: int) -> None:
    if error:
        raise RuntimeError(f"cuFFT makes no transform: error {error}")
