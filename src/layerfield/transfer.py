"""How the values of pictures and panels become light, and back.

none     light = value
srgb     light = value / 12.92 up to 0.04045, then ((value + 0.055) / 1.055) ** 2.4
gamma    light = value ** gamma
curve    measured points, linear in between

Values and light run from 0 to 1. Beyond both go on, so that views need not be clipped.

Reference: IEC 61966-2-1:1999, equations 5 to 9.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import torch
from pydantic import PlainSerializer, PlainValidator
from torch import Tensor

from layerfield.geometry import Point
from layerfield.nearest import did_you_mean

_KINDS = 'expected "none", "srgb", { gamma = 2.2 } or { curve = "panel.csv" }'
_MOST_POINTS = 65536


@runtime_checkable
class Transfer(Protocol):
    """The law between encoded values and light."""

    def decode(self, values: Tensor) -> Tensor:
        """Return the light that encoded values stand for."""
        ...

    def encode(self, light: Tensor) -> Tensor:
        """Return the values that make this light; the inverse of `decode`."""
        ...

    def written(self) -> Any:
        """Return what a display file says, as plain data."""
        ...


@dataclass(frozen=True)
class Identity:
    """Values are light."""

    def decode(self, values: Tensor) -> Tensor:
        return values

    def encode(self, light: Tensor) -> Tensor:
        return light

    def written(self) -> str:
        return "none"


@dataclass(frozen=True)
class Srgb:
    """The standard of pictures and monitors."""

    def decode(self, values: Tensor) -> Tensor:
        bright = ((values.clamp(min=0.04045) + 0.055) / 1.055).pow(2.4)
        return torch.where(values <= 0.04045, values / 12.92, bright)

    def encode(self, light: Tensor) -> Tensor:
        knee = 0.04045 / 12.92
        bright = 1.055 * light.clamp(min=knee).pow(1 / 2.4) - 0.055
        return torch.where(light <= knee, light * 12.92, bright)

    def written(self) -> str:
        return "srgb"


@dataclass(frozen=True)
class Gamma:
    """A power of the value.

    Args:
        gamma: the exponent, more than 0.

    Raises:
        ValueError: not more than 0, or not finite.
    """

    gamma: float

    def __post_init__(self) -> None:
        if not 0 < self.gamma < math.inf:
            raise ValueError(f"found a gamma of {self.gamma:g}, expected more than 0, as 2.2")

    def decode(self, values: Tensor) -> Tensor:
        return values.clamp(min=0).pow(self.gamma)

    def encode(self, light: Tensor) -> Tensor:
        return light.clamp(min=0).pow(1 / self.gamma)

    def written(self) -> dict[str, float]:
        return {"gamma": self.gamma}


@dataclass(frozen=True)
class Curve:
    """A measured curve, linear between its points and on beyond its ends.

    A black that is not quite dark stays: less light than the first point has no value in 0..1,
    codes end there, and what they show is what was measured.

    Args:
        points: (value, light), both strictly increasing; values from 0 to 1, light at least 0 and
            1 in the last point (see `measured`).

    Raises:
        ValueError: points that are no such curve.
    """

    points: tuple[Point, ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.points) <= _MOST_POINTS:
            raise ValueError(f"found {len(self.points)} points, expected 2 to {_MOST_POINTS}")
        if not all(math.isfinite(number) for point in self.points for number in point):
            raise ValueError("found a point that is not finite")
        for one, following in pairwise(self.points):
            if not (one[0] < following[0] and one[1] < following[1]):
                raise ValueError(
                    f"the curve is not strictly increasing: {_pair(following)} follows "
                    f"{_pair(one)}; sort the points, or smooth the measurement"
                )
        first, last = self.points[0], self.points[-1]
        if (first[0], last[0]) != (0, 1):
            raise ValueError(
                f"the values run from {first[0]:g} to {last[0]:g}, expected 0 to 1; divide codes "
                "by the largest, 255 or 65535"
            )
        if first[1] < 0 or last[1] != 1:
            raise ValueError(f"the light runs from {first[1]:g} to {last[1]:g}, expected 0 to 1")

    @classmethod
    def measured(cls, points: Sequence[Point]) -> "Curve":
        """Return the curve of measured light in any unit; the last point becomes 1."""
        brightest = points[-1][1] if points else 0.0
        if not brightest > 0:
            raise ValueError(f"the light of the last point is {brightest:g}, expected more than 0")
        return cls(tuple((value, light / brightest) for value, light in points))

    def decode(self, values: Tensor) -> Tensor:
        return _interpolated(values, *zip(*self.points, strict=True))

    def encode(self, light: Tensor) -> Tensor:
        value, measured = zip(*self.points, strict=True)
        return _interpolated(light, measured, value)

    def written(self) -> dict[str, tuple[Point, ...]]:
        return {"curve": self.points}


NONE = Identity()
_NAMED: dict[str, Transfer] = {"none": NONE, "srgb": Srgb()}


def transfer_of(written: Any, folder: Path) -> Transfer:
    """Return the transfer that a display file describes.

    Args:
        written: "none", "srgb", {"gamma": number}, {"curve": name of a CSV file, or points}.
        folder: where such a file is looked for.

    Raises:
        ValueError: none of these.
    """
    match written:
        case str():
            if written not in _NAMED:
                raise ValueError(
                    f"unknown transfer '{written}'{did_you_mean(written, _NAMED)}; {_KINDS}"
                )
            return _NAMED[written]
        case {"gamma": int() | float() as gamma, **rest} if not rest and gamma is not True:
            return Gamma(float(gamma))
        case {"curve": str() as name, **rest} if not rest:
            return _read_curve(folder / name)
        case {"curve": list() | tuple() as points, **rest} if not rest:
            return Curve.measured([_point(point) for point in points])
    raise ValueError(f"found {written!r:.60}, {_KINDS}")


def _validated(written: Any, info: Any) -> Transfer:
    """Validate; `info` is a ValidationInfo, a protocol that cannot be checked at run time."""
    if isinstance(written, Transfer):
        return written
    return transfer_of(written, (info.context or {}).get("folder", Path()))


WrittenTransfer = Annotated[
    Transfer, PlainValidator(_validated), PlainSerializer(lambda transfer: transfer.written())
]


def named(transfer: Transfer) -> str:
    """Return a transfer in a word or two.

    >>> named(Gamma(2.2))
    'gamma 2.2'
    """
    match transfer.written():
        case str() as name:
            return name
        case {"gamma": gamma}:
            return f"gamma {gamma:g}"
    return "curve"


def _read_curve(path: Path) -> Curve:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path} is no text file; {_CSV}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"cannot read the curve {path}: {reason}") from None
    points = []
    for number, line in enumerate(lines, start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                points.append(_point(line.split(",")))
            except ValueError:
                raise ValueError(f"{path}, line {number}: found '{line:.40}'; {_CSV}") from None
    try:
        return Curve.measured(points)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


_CSV = "expected lines of two numbers, value and light, as 0.5, 0.21 (# starts a comment)"


def _point(written: Any) -> Point:
    if not isinstance(written, list | tuple) or len(written) != 2:
        raise ValueError(f"found {written!r:.60} in a curve, expected [value, light]")
    try:
        return float(written[0]), float(written[1])
    except (TypeError, ValueError):
        raise ValueError(f"found {written!r:.60} in a curve, expected two numbers") from None


def _pair(point: Point) -> str:
    return f"{point[0]:g}, {point[1]:g}"


def _interpolated(at: Tensor, x: Sequence[float], y: Sequence[float]) -> Tensor:
    """Interpolate linearly; the first and last pieces go on beyond the ends."""
    known, levels = (torch.tensor(n, dtype=torch.float64, device=at.device) for n in (x, y))
    slopes = levels.diff() / known.diff()
    exact = at.double().contiguous()
    piece = (torch.searchsorted(known, exact, right=True) - 1).clamp(0, len(slopes) - 1)
    return (levels[piece] + (exact - known[piece]) * slopes[piece]).to(at.dtype)
