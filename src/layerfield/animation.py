"""What an eye sees that moves in front of a display and comes back: a film without an end."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

from layerfield.display import Display
from layerfield.geometry import Geometry, Point
from layerfield.nearest import did_you_mean
from layerfield.panels import quantise

PATHS: dict[str, Point] = {"horizontal": (1.0, 0.0), "circle": (1.0, 1.0)}
"""Paths of the eye: the share of the range of the viewpoints that each uses in x and in y."""

_FEWEST, _MOST = 2, 10_000  # frames


@dataclass(frozen=True)
class Sweep:
    """How an eye moves; its path ends where it began.

    From the centre of the range of the viewpoints, whose half is (a, b), the slope of the eye is

        -(a cos 2 pi t, b sin 2 pi t)       t from 0 to 1

    the largest ellipse in that range, clockwise from the left; or to and fro along the middle row,
    b = 0, slow at both ends.

    Args:
        path: a name in `PATHS`.
        seconds: once around, or to and fro.
        fps: frames a second.

    Raises:
        ValueError: an unknown path, or times that do not make 2 to 10 000 frames.
    """

    path: str = "horizontal"
    seconds: float = 4.0
    fps: float = 30.0

    def __post_init__(self) -> None:
        if self.path not in PATHS:
            raise ValueError(f"unknown sweep '{self.path}'{did_you_mean(self.path, PATHS)}")
        for what, number in (("seconds", self.seconds), ("frames a second", self.fps)):
            if not 0 < number < math.inf:
                raise ValueError(f"the {what} are {number:g}, expected a number above 0")
        if not _FEWEST <= self.seconds * self.fps <= _MOST:
            raise ValueError(
                f"{self.seconds:g} s at {self.fps:g} frames a second are "
                f"{self.seconds * self.fps:.4g} frames, expected {_FEWEST} to {_MOST}; change "
                "either"
            )

    @property
    def frame_count(self) -> int:
        """Number of frames; the one after the last would be the first again."""
        return round(self.seconds * self.fps)

    def slopes(self, geometry: Geometry) -> tuple[Point, ...]:
        """Return where the eye is in each frame, as slopes X / Z (see `Display.look`).

        Raises:
            ValueError: the viewpoints have no extent along this path.
        """
        ranges = [_middle(numbers) for numbers in zip(*geometry.slopes, strict=True)]
        (x, half_width), (y, half_height) = ranges
        a, b = half_width * PATHS[self.path][0], half_height * PATHS[self.path][1]
        if not max(a, b) > 0:
            lie = "above each other; try the circle" if half_height > 0 else "at one place"
            raise ValueError(f"no eye moves along '{self.path}': the viewpoints lie {lie}")
        turns = (2 * math.pi * i / self.frame_count for i in range(self.frame_count))
        return tuple((x - a * math.cos(t), y - b * math.sin(t)) for t in turns)


@dataclass(frozen=True, eq=False)
class Animation:
    """What an eye sees on a sweep; `animation[i]` is made when it is asked for.

    Args:
        layers: light, 0 to 1, with the margin of the display.
        display: what shows them.
        slopes: where the eye is in each frame.
        size: height and width of the frames in pixels.
    """

    layers: Float[Tensor, "subframe layer c ly lx"]
    display: Display
    slopes: tuple[Point, ...]
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.slopes)

    def __getitem__(self, index: int) -> UInt8[Tensor, "c y x"]:
        geometry = self.display.geometry
        light = self.display.look(self.layers, self.slopes[index], _distance(geometry))
        return quantise(_resized(self.display.transfer.encode(light), self.size), 8)


def animate(
    layers: Float[Tensor, "subframe layer c ly lx"],
    display: Display,
    sweep: Sweep,
    width: int | None = None,
) -> Animation:
    """Return what an eye sees of layers that moves in front of them.

    Args:
        layers: light, 0 to 1, with the margin of the display.
        display: what shows them.
        sweep: how the eye moves, as far as the viewpoints; where these differ in their distances,
            at the one whose inverse is the mean of their inverses.
        width: of the frames in pixels, at most that of the views; as wide as these if not given.

    Raises:
        ValueError: the viewpoints have no extent along the path, or views that are not as wide.
    """
    height, full = display.projection.view_size(layers)
    if width is not None and not 1 <= width <= full:
        raise ValueError(f"the width is {width} px, expected 1 to {full}, the width of the views")
    scale = 1 if width is None else width / full
    size = max(1, round(height * scale)), max(1, round(full * scale))
    return Animation(layers, display, sweep.slopes(display.geometry), size)


def _middle(numbers: tuple[float, ...]) -> tuple[float, float]:
    """Return the centre and half the extent of a range."""
    low, high = min(numbers), max(numbers)
    return (low + high) / 2, (high - low) / 2


def _distance(geometry: Geometry) -> float | None:
    if geometry.is_regular:
        return None
    return len(geometry.distances) / sum(1 / distance for distance in geometry.distances)


def _resized(view: Float[Tensor, "c y x"], size: tuple[int, int]) -> Float[Tensor, "c y2 x2"]:
    if view.shape[-2:] == torch.Size(size):
        return view
    return functional.interpolate(view[None], size, mode="bicubic", antialias=True)[0]
