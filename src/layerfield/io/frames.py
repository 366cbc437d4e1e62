"""Frames of an animation on their way to a file."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8
from PIL import Image
from torch import Tensor


@runtime_checkable
class Frames(Protocol):
    """Pictures in turn, grey or RGB, all of one size; each may be made when it is asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> UInt8[Tensor, "c y x"]: ...


@dataclass(frozen=True, eq=False)
class Counted:
    """Frames that tell which of them is asked for.

    Args:
        frames: pictures in turn.
        tick: called with a word and the number of the frame, from 1.
    """

    frames: Frames
    tick: Callable[[str, int], None]

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> UInt8[Tensor, "c y x"]:
        self.tick("frames", index + 1)
        return self.frames[index]


def pixels(frame: UInt8[Tensor, "c y x"]) -> UInt8[np.ndarray, "y x 3"]:
    """Return a frame as encoders take it: RGB, channels last."""
    planes = frame.expand(3, -1, -1).cpu().numpy()
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1))


def picture(frame: UInt8[Tensor, "c y x"]) -> Image.Image:
    """Return a frame as a picture of Pillow, RGB."""
    return Image.fromarray(pixels(frame))


def durations(count: int, fps: float, ticks: int) -> list[int]:
    """Return how long each frame is shown, in whole ticks; rounding does not add up.

    Args:
        count: number of frames.
        fps: frames a second.
        ticks: a second.

    >>> durations(6, 30, 100)
    [3, 4, 3, 3, 4, 3]
    """
    ends = [round(ticks * i / fps) for i in range(count + 1)]
    return [end - start for start, end in pairwise(ends)]
