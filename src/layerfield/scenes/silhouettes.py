"""Outlines of surfaces as signed distances in pixels, positive inside.

Outlines that are no distances by construction are divided by the length of their gradient, which
makes them distances near the edge; only there do they matter.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.scenes.draws import Draws
from layerfield.scenes.noise import spectral_noise
from layerfield.scenes.scene import pixel_centres

_SHARES = (0.2, 0.25, 0.2, 0.15, 0.12, 0.08)  # oval, polygon, blob, bar, foliage, fence
_SIDES = 6
_HARMONICS = 6


def draw_silhouettes(
    draws: Draws,
    *,
    centres: Float[Tensor, "batch surface 2"],
    radii: Float[Tensor, "batch surface"],
    canvas: tuple[int, int],
) -> Float[Tensor, "batch surface y x"]:
    """Return outlines that stay within 2 radii of their centres.

    Args:
        draws: where the numbers come from.
        centres: (x, y) in pixels from the centre of the image.
        radii: typical radius in pixels.
        canvas: height and width in pixels.
    """
    y, x = pixel_centres(canvas, draws.device)
    dx, dy = x - centres[..., :1, None], y - centres[..., 1:, None]
    radius = radii[..., None, None]
    count = radii.shape[1]
    kind = draws.choice(_SHARES, count)[..., None, None]
    turn = draws.uniform(count, 1, 1, high=2 * math.pi)
    px, py = _turned(dx, dy, torch.where(draws.chance(0.5, count, 1, 1) > 0, turn, turn * 0.02))
    oval = _oval(draws, px, py, radius)
    outlines = [
        oval,
        _polygon(draws, px, py, radius),
        _blob(draws, dx, dy, radius),
        _bar(draws, px, py, radius),
        _foliage(draws, oval, canvas),
        _fence(draws, px, py, radius),
    ]
    shape = outlines[0]
    for index, outline in enumerate(outlines[1:], start=1):
        shape = torch.where(kind == index, outline, shape)
    shape = torch.minimum(shape, 2 * radius - torch.hypot(dx, dy))
    return torch.where(kind < 3, _pierced(draws, shape, dx, dy, radius), shape)


def _turned(x: Tensor, y: Tensor, angle: Tensor) -> tuple[Tensor, Tensor]:
    cos, sin = angle.cos(), angle.sin()
    return cos * x + sin * y, cos * y - sin * x


def _oval(draws: Draws, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    """Ellipses; a few are superellipses, nearly rectangles with round corners."""
    count = radius.shape[1]
    aspect = draws.log_uniform(count, 1, 1, low=0.4, high=1.0)
    power = torch.where(draws.chance(0.3, count, 1, 1) > 0, 5.0, 2.0)
    level = ((x / radius).abs() ** power + (y / (radius * aspect)).abs() ** power) ** (1 / power)
    return _as_distance(1 - level)


def _polygon(draws: Draws, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    """Convex polygons of 3 to 6 sides: the intersection of half planes."""
    count = radius.shape[1]
    sides = draws.uniform(count, 1, 1, low=3, high=_SIDES + 1).floor()
    wobble = draws.uniform(_SIDES, count, 1, 1, low=-0.25, high=0.25)
    reach = draws.uniform(_SIDES, count, 1, 1, low=0.5, high=1.0)
    shape = torch.full_like(x + y, math.inf)
    for i in range(_SIDES):
        angle = 2 * math.pi * (i + wobble[:, i]) / sides
        half_plane = radius * reach[:, i] - (angle.cos() * x + angle.sin() * y)
        shape = torch.where(i < sides, torch.minimum(shape, half_plane), shape)
    return shape


def _blob(draws: Draws, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    """Closed curves r(angle) with a few harmonics; sometimes a star of one strong harmonic."""
    count = radius.shape[1]
    angle = torch.atan2(y, x)
    star = draws.chance(0.25, count, 1, 1)
    points = draws.uniform(count, 1, 1, low=3, high=10).floor()
    edge = 1 + star * 0.25 * torch.cos(points * angle + draws.uniform(count, 1, 1, high=6.3))
    size = draws.normal(_HARMONICS, count, 1, 1)
    phase = draws.uniform(_HARMONICS, count, 1, 1, high=2 * math.pi)
    for n in range(1, _HARMONICS + 1):
        strength = 0.25 * (1 - star) * size[:, n - 1] / n
        edge = edge + strength * torch.cos((n + 1) * angle + phase[:, n - 1])
    return _as_distance(edge.clamp_min(0.2) - torch.hypot(x, y) / radius)


def _bar(draws: Draws, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    """Long thin rectangles: poles, twigs, beams."""
    thickness = (radius * draws.log_uniform(radius.shape[1], 1, 1, low=0.04, high=0.3)).clamp_min(1)
    return torch.minimum(1.9 * radius - x.abs(), thickness - y.abs())


def _foliage(draws: Draws, oval: Tensor, canvas: tuple[int, int]) -> Tensor:
    """Thresholded noise within an oval: leaves, clouds, torn paper."""
    count = oval.shape[1]
    slope = draws.uniform(count, low=1.6, high=2.3)
    field, _ = spectral_noise(draws, slope, canvas=canvas, texels=1)
    level = draws.uniform(count, 1, 1, low=-0.5, high=0.5)
    return torch.minimum(_as_distance(field - level), oval)


def _fence(draws: Draws, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    """Parallel bars with gaps, within a rectangle."""
    count = radius.shape[1]
    period = (radius * draws.log_uniform(count, 1, 1, low=0.2, high=0.7)).clamp_min(5)
    width = (period * draws.uniform(count, 1, 1, low=0.1, high=0.35)).clamp_min(0.9)
    bars = width - ((x / period).remainder(1) - 0.5).abs() * period
    frame = torch.minimum(1.2 * radius - x.abs(), 1.4 * radius - y.abs())
    return torch.minimum(bars, frame)


def _pierced(draws: Draws, shape: Tensor, dx: Tensor, dy: Tensor, radius: Tensor) -> Tensor:
    """Cut a round hole into some of the shapes."""
    count = radius.shape[1]
    hole = radius * draws.uniform(count, 1, 1, low=0.2, high=0.5) * draws.chance(0.2, count, 1, 1)
    offset = draws.uniform(2, count, 1, 1, low=-0.25, high=0.25) * radius[:, None]
    outside = torch.hypot(dx - offset[:, 0], dy - offset[:, 1]) - hole
    return torch.minimum(shape, outside)


def _as_distance(level: Float[Tensor, "*batch y x"]) -> Float[Tensor, "*batch y x"]:
    along_y, along_x = torch.gradient(level, dim=(-2, -1))
    return level / torch.hypot(along_y, along_x).clamp_min(1e-4)
