"""Eyes between the viewpoints: what they should see, and layers that are made for them, too.

Eyes are seldom at a viewpoint. Between two of them, what a display shows is in the best case the
mean of what it shows at both: finer detail off the display plane fades. Layers may give up a little
at the viewpoints to gain between them:

    minimise  sum_i w_i ||A_i P - L_i||^2 + w sum_h w_h ||A_h P - L_h||^2

over the eyes h between them. L_h is given, or interpolated between neighbouring views; w_h is how
much the viewpoints around count (1 unless observers say so).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from layerfield.display import Display
from layerfield.geometry import Geometry, Point
from layerfield.kept_views import KeptViews
from layerfield.light_field import EyeViews, LightField
from layerfield.problem import Problem
from layerfield.warped_projection import project

WEIGHTS = {"given": 0.5, "interpolated": 1.0}  # where the targets come from, and their weight


def parse_targets(text: str) -> tuple[str, float]:
    """Parse `given`, `interpolated`, or either with a weight, as `given:0.25`.

    Raises:
        ValueError: another word, or a weight that is no number above 0.
    """
    kind, colon, number = text.partition(":")
    try:
        weight = float(number) if colon else WEIGHTS[kind]
    except (ValueError, KeyError):
        weight = 0.0
    if kind not in WEIGHTS or not 0 < weight < 1e6:
        raise ValueError(
            f"targets between views are '{text}', expected given or interpolated, with a weight "
            "above 0 if you like, as given:0.25"
        )
    return kind, weight


def given_between(around: EyeViews, field: LightField) -> EyeViews:
    """Return the eyes that are within the grid of a light field, but not at its viewpoints.

    Args:
        around: what eyes in and around the grid see.
        field: the light field with that grid.

    Raises:
        ValueError: there are none.
    """
    wanted = set(positions_between(around.positions, field.grid))
    found = around.chosen(wanted.__contains__)
    if not found.positions:
        raise ValueError(
            f"'{field.name}' has no views between those that are taken; take every second of more "
            "views, with --step 2"
        )
    return found


def positions_between(
    positions: Sequence[Point], grid: tuple[int, int] | None
) -> tuple[Point, ...]:
    """Return the positions within a view grid that are at no viewpoint; none without a grid."""
    rows, columns = ((count - 1) / 2 for count in grid or (0, 0))
    return tuple(
        (x, y)
        for x, y in positions
        if abs(x) <= columns
        and abs(y) <= rows
        and not ((x + columns).is_integer() and (y + rows).is_integer())
    )


def interpolated_between(field: LightField) -> EyeViews:
    """Return what eyes half-way between viewpoints see, interpolated along rows and columns.

    L(1/2) = (9 (L(0) + L(1)) - L(-1) - L(2)) / 16, clipped to 0..1. Past the last view of a line
    stands the parabola through the last three; of two views the mean is taken.

    Raises:
        ValueError: there is only one view.
    """
    rows, columns = field.grid
    if rows == columns == 1:
        raise ValueError(f"'{field.name}' has one view; there is nothing between its viewpoints")
    dense = _halved(_halved(field.views.unflatten(-4, field.grid), -5), -4)
    eyes = [
        (x / 2 - (columns - 1) / 2, y / 2 - (rows - 1) / 2)
        for y in range(2 * rows - 1)
        for x in range(2 * columns - 1)
    ]
    all_eyes = EyeViews(dense.flatten(-5, -4).clamp(0, 1), tuple(eyes))
    return given_between(all_eyes, field)


def _halved(views: Tensor, dim: int) -> Tensor:
    """Put a view between each two along a dimension."""
    line = views.unbind(dim)
    if len(line) == 1:
        return views
    if len(line) == 2:
        return torch.stack([line[0], (line[0] + line[1]) / 2, line[1]], dim)
    before, after = _beyond(*line[:3]), _beyond(*line[:-4:-1])
    wide = [before, *line, after]
    result = [line[0]]
    for i in range(len(line) - 1):
        middle = (9 * (wide[i + 1] + wide[i + 2]) - wide[i] - wide[i + 3]) / 16
        result += [middle, line[i + 1]]
    return torch.stack(result, dim)


def _beyond(last: Tensor, second: Tensor, third: Tensor) -> Tensor:
    """The next value of a parabola."""
    return 3 * (last - second) + third


def with_eyes(problem: Problem, display: Display, eyes: EyeViews) -> Problem:
    """Return the problem with eyes within the view grid as further light paths.

    Args:
        problem: of showing views on the display.
        display: one with a grid of views.
        eyes: what they are to see, and how much they count.

    Raises:
        ValueError: the viewpoints of the display form no grid.
    """
    geometry = display.geometry
    shifts = tuple(geometry.shifts_toward(geometry.slope_at(eye)) for eye in eyes.positions)
    magnifications = (geometry.magnifications_from(geometry.distances[0]),) * len(shifts)
    light = display.transfer.decode(eyes.views)
    return replace(
        problem,
        projection=project(
            geometry.shifts + shifts, geometry.magnifications + magnifications, display.margin
        ),
        views=KeptViews(torch.cat([problem.target, light.to(problem.target)], dim=-4)),
        weights=problem.weights
        + tuple(eyes.weight * _weight_at(eye, problem.weights, geometry) for eye in eyes.positions),
    )


def _weight_at(eye: Point, weights: Sequence[float], geometry: Geometry) -> float:
    """Return how much viewpoints around an eye count, interpolated linearly."""
    rows, columns = geometry.grid or (1, 1)
    (left, right, across), (top, bottom, down) = (
        _neighbours(place, count) for place, count in zip(eye, (columns, rows), strict=True)
    )
    upper, lower = (
        (1 - across) * weights[row * columns + left] + across * weights[row * columns + right]
        for row in (top, bottom)
    )
    return (1 - down) * upper + down * lower


def _neighbours(place: float, count: int) -> tuple[int, int, float]:
    """Return the viewpoints on both sides of a place along an axis, and the share of the second."""
    at = place + (count - 1) / 2
    first = min(max(math.floor(at), 0), count - 1)
    return first, min(first + 1, count - 1), at - first
