"""How far points move from view to view, and whether the views are in the right order."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from layerfield.io.options import Order
from layerfield.light_field import LightField
from layerfield.plane_sweep import Line, Sweep, contour_votes, hidden_point_votes, sweep

Range = tuple[float, float]

_NEIGHBOURS = 4  # views on either side of the reference
_COARSE, _FINE = 60_000, 250_000  # pixels of a view
_FIRST_RANGE, _LAST_RANGE = 8.0, 64.0  # disparities searched: up to this, and at most to that
_CANDIDATES = 40
_ENOUGH_PIXELS = 100  # fewer textured ones say nothing
_ENOUGH_VOTES = 200  # with fewer, further lines of views are asked
_LINES = 3
_DOUBT = 30  # votes that say nothing, added so that a handful of real ones is no certainty
_GUESS = 0.05  # evidence that is none
_LIKELY = 0.25  # evidence worth reporting against a light field that otherwise looks sound
_DEFAULT = Order()


@dataclass(frozen=True, kw_only=True)
class DisparityReport:
    """What the views say about their disparities and their order.

    Args:
        grid: (rows, columns) of the views.
        horizontal: range of disparities along rows, 1 to 99 % of the textured pixels, in pixels
            between neighbouring views; None if it cannot be measured.
        vertical: the same along columns.
        agree: whether both have the same sign, as they must; None if that cannot be told.
        order: how the views were read.
        repair: how to read them instead; None if nothing speaks against the order.
        confidence: of the repair, or of the order where there is none, 0 (a guess) to 1.
        shift: that puts the zero plane into the middle of the scene; 0 if it is about there.
    """

    grid: tuple[int, int]
    horizontal: Range | None
    vertical: Range | None
    agree: bool | None
    order: Order
    repair: Order | None
    confidence: float
    shift: float

    def lines(self) -> list[str]:
        """Return sentences for a terminal."""
        ranges = [
            f"{name} {low:.2f} to {high:.2f}"
            for name, found in (("horizontal", self.horizontal), ("vertical", self.vertical))
            if found is not None
            for low, high in (found,)
        ]
        if not ranges:
            return ["disparity: cannot be measured (a single view, or too little texture)"]
        lines = [f"disparity: {', '.join(ranges)} px between neighbouring views", *self._verdict()]
        if self.shift:
            lines.append(f"suggested shift: {self.shift:g} px, to put the display into the scene")
        return lines

    def _verdict(self) -> list[str]:
        if self.agree is False:
            rows, columns = _rows_reversed(self.order), _columns_reversed(self.order)
            verdict = [
                "order: rows and columns contradict each other (opposite signs of disparity); "
                f"reverse the rows (order {rows}) or the columns (order {columns})"
            ]
            if self.repair is None:
                return [*verdict, "occlusion does not tell which"]
            confidence = f"(confidence {self.confidence:.2f})"
            return [*verdict, f"occlusion speaks for order {self.repair} {confidence}"]
        verdict = "order: rows and columns agree in the sign of disparity"
        if self.agree is None:
            single = "a single line of views" if 1 in self.grid else "too little texture"
            verdict = f"order: {single}, which cannot tell whether the order of the views is right"
        if self.repair is not None:
            hint = f"occlusion speaks for order {self.repair}, near and far being swapped now"
            return [verdict, f"{hint} (confidence {self.confidence:.2f})"]
        if self.confidence > _LIKELY:
            return [verdict, f"occlusion supports the order (confidence {self.confidence:.2f})"]
        return [verdict, "occlusion does not tell whether near and far are swapped"]


def estimate_disparity(field: LightField, *, order: Order = _DEFAULT) -> DisparityReport:
    """Measure the disparities of a light field and judge the order of its views.

    Args:
        field: one light field, no batch.
        order: how it was read; repairs are named relative to it.

    Returns:
        Ranges, the verdict on the order, and the shift that would centre the scene.
    """
    with torch.no_grad():
        axes = [_survey(field, vertical) for vertical in (False, True)]
    horizontal, vertical = (None if axis is None else axis.range for axis in axes)
    agree = None if None in axes else _agreement(*axes)  # pyright: ignore[reportArgumentType]
    evidence = [0.0 if axis is None else axis.evidence for axis in axes]
    repair, confidence = _judge(agree, evidence, order, axes[1] is not None)
    signs = _signs(order, repair)
    return DisparityReport(
        grid=field.grid,
        horizontal=horizontal,
        vertical=vertical,
        agree=agree,
        order=order,
        repair=repair,
        confidence=confidence,
        shift=_centre([horizontal, vertical], signs),
    )


@dataclass(frozen=True, eq=False)
class _Axis:
    """What one direction says: a map with x to the right and y down, and the occlusion there."""

    disparity: Float[Tensor, "y x"]
    textured: Bool[Tensor, "y x"]
    range: Range
    evidence: float


def _survey(field: LightField, vertical: bool) -> _Axis | None:
    lines = _lines(field, vertical, _FINE)
    if not lines:
        return None
    found = _search(_lines(field, vertical, _COARSE)[0])
    if found is None:
        return None
    step = max((found[1] - found[0]) / _CANDIDATES, 0.05)
    first_step, last_step = math.floor(found[0] / step) - 2, math.ceil(found[1] / step) + 2
    first, evidence = _ask(lines, torch.arange(first_step, last_step + 1) * step)
    bounds = _bounds(first)
    if bounds is None:
        return None
    maps = (first.disparity, first.textured)
    disparity, textured = (m.T if vertical else m for m in maps)
    return _Axis(disparity, textured, bounds, evidence)


def _lines(field: LightField, vertical: bool, pixels: int) -> list[Line]:
    """Return the central line of views and others beside it, as horizontal ones."""
    rows, columns = field.grid
    views = field.views.detach().to("cpu", torch.float32).unflatten(0, (rows, columns))
    if vertical:
        views = views.transpose(0, 1).transpose(-1, -2)
    count, length = views.shape[:2]
    if length < 2:
        return []
    reference = (length - 1) // 2
    first = max(0, reference - _NEIGHBOURS)
    end = reference + _NEIGHBOURS + 1
    scale = min(1.0, math.sqrt(pixels / (views.shape[-1] * views.shape[-2])))
    middle = (count - 1) // 2
    chosen = sorted(range(count), key=lambda n: abs(n - middle))[:_LINES]
    return [Line(_resized(views[n, first:end], scale), reference - first, scale) for n in chosen]


def _resized(views: Float[Tensor, "view c y x"], scale: float) -> Float[Tensor, "view c y2 x2"]:
    if scale == 1:
        return views
    size = [max(1, round(length * scale)) for length in views.shape[-2:]]
    return functional.interpolate(views, size, mode="bilinear", antialias=True)


def _search(line: Line) -> Range | None:
    """Find the range of disparities on small views; widen it while matches lie at its border."""
    limit = _FIRST_RANGE
    while True:
        step = 0.25 / line.scale
        reach = math.ceil(limit / step)
        swept = sweep(line, torch.arange(-reach, reach + 1) * step)
        found = _bounds(swept, outside=0.005)
        wide = found is None or max(-found[0], found[1]) > limit - 2 * step
        room = line.views.shape[-1] / line.scale / 4
        if not wide or limit >= min(_LAST_RANGE, room):
            return found and (found[0] - step, found[1] + step)
        limit *= 2


def _bounds(swept: Sweep, outside: float = 0.01) -> Range | None:
    found = swept.disparity[swept.textured]
    if len(found) < _ENOUGH_PIXELS:
        return None
    ordered = found.sort().values
    last = len(ordered) - 1
    return float(ordered[round(outside * last)]), float(ordered[round((1 - outside) * last)])


def _ask(lines: list[Line], candidates: Float[Tensor, " d"]) -> tuple[Sweep, float]:
    """Sweep the central line, and vote; ask the lines beside it if there is little to go by."""
    first: Sweep | None = None
    hidden, contours = [0, 0], [0, 0]
    for line in lines:
        swept = sweep(line, candidates)
        first = first or swept
        for total, votes in (
            (hidden, hidden_point_votes(line, swept)),
            (contours, contour_votes(line, swept)),
        ):
            total[0] += votes[0]
            total[1] += votes[1]
        if sum(hidden) + sum(contours) >= _ENOUGH_VOTES:
            break
    assert first is not None  # there is at least one line
    return first, (_balance(hidden) + _balance(contours)) / 2


def _balance(votes: list[int]) -> float:
    return (votes[0] - votes[1]) / (sum(votes) + _DOUBT)


def _agreement(across: _Axis, down: _Axis) -> bool | None:
    """Compare both maps where both are known: do they rise together?"""
    both = across.textured & down.textured
    if int(both.sum()) < _ENOUGH_PIXELS:
        return None
    pair = torch.stack([across.disparity[both], down.disparity[both]])
    if float(pair.std(1).min()) > 0.1:
        correlation = float(torch.corrcoef(pair)[0, 1])
        return None if abs(correlation) < 0.2 else correlation > 0
    middle = pair.median(1).values
    return None if float(middle.abs().min()) < 0.1 else bool(middle.prod() > 0)


def _judge(
    agree: bool | None, evidence: list[float], order: Order, two_axes: bool
) -> tuple[Order | None, float]:
    if agree is False:
        balance = evidence[0] - evidence[1]  # one of the two is inverted
        repair = _rows_reversed(order) if balance > 0 else _columns_reversed(order)
        confidence = min(1.0, abs(balance))
        return (repair, confidence) if confidence >= _GUESS else (None, 0.0)
    total = min(1.0, max(-1.0, sum(evidence)))
    if total > -_LIKELY:
        return None, max(0.0, total)
    repair = order
    if evidence[0]:
        repair = _columns_reversed(repair)
    if two_axes and evidence[1]:
        repair = _rows_reversed(repair)
    return repair, -total


def _rows_reversed(order: Order) -> Order:
    return replace(order, bottom=not order.bottom)


def _columns_reversed(order: Order) -> Order:
    return replace(order, right=not order.right)


def _signs(order: Order, repair: Order | None) -> tuple[int, int]:
    """Return what the repair does to the sign of horizontal and vertical disparities."""
    if repair is None:
        return 1, 1
    return (1 if repair.right == order.right else -1), (1 if repair.bottom == order.bottom else -1)


def _centre(ranges: list[Range | None], signs: tuple[int, int]) -> float:
    ends = [sign * end for found, sign in zip(ranges, signs, strict=True) for end in found or ()]
    middle = (min(ends) + max(ends)) / 2 if ends else 0.0
    return round(middle * 4) / 4 if abs(middle) >= 0.5 else 0.0
