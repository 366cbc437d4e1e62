"""Layers to the pictures of their panels, and from those to what viewers see.

Interpolating a layer on the pixels of its panel would blur it. So each panel is first fitted: its
pixels are those that, interpolated linearly in turn, come nearest to the layer,

    min ||S_k Q_k - P_k||^2  over  0 <= Q_k <= 1,    (S_k Q)(x) = Q(M_k x)

Where a panel is coarser than its layer, that is what it can show without aliasing. Then all panels
are corrected together against the views, which meet them between the pixels of the layers, too, and
in the end rounded together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt
from torch import Tensor
from torch.nn.functional import pad

from layerfield.composition import compose_views
from layerfield.display import Display
from layerfield.kept_views import KeptViews
from layerfield.links import Additive
from layerfield.panel_projection import (
    Matrix,
    PanelProjection,
    as_matrix,
    as_rows,
    moved,
    sampled,
)
from layerfield.panels import Response
from layerfield.problem import Problem
from layerfield.projection import Projection, sum_of
from layerfield.solve import solve
from layerfield.solvers.rounding import ROUNDING_SWEEPS, JointRounding
from layerfield.solvers.sweeps import Sweeps
from layerfield.warped_projection import WarpedProjection

_FITTING_SWEEPS = 10
_CORRECTING_SWEEPS = 4
_EDGE = 0.5  # pixels from the centre of a pixel to its edge
_ALLOWED = 0.5  # pixels by which views may reach past a panel: at the least half of theirs is seen


def panel_projection(display: Display, view_size: tuple[int, int]) -> PanelProjection:
    """Return the map from the panels of a display to its views.

    Raises:
        ValueError: a panel that is smaller than the views on its layer.
    """
    geometry = display.geometry
    layer_size = (view_size[0] + 2 * geometry.margin[0], view_size[1] + 2 * geometry.margin[1])
    projection = PanelProjection(
        geometry.shifts,
        geometry.margin,
        tuple(
            panel.mapping(geometry.pitch * scale, layer_size)
            for panel, scale in zip(display.panels, geometry.scales, strict=True)
        ),
        tuple(panel.size for panel in display.panels),
        view_size,
    )
    for k in range(len(display.panels)):
        _refuse_small(projection, k)
    return _seen_along(display.projection, projection)


def _seen_along(paths: Projection, panels: PanelProjection) -> PanelProjection:
    """Return the map from panels to the views of a projection from their layers."""
    magnifications = paths.magnifications if isinstance(paths, WarpedProjection) else ()
    return replace(panels, shifts=paths.shifts, magnifications=magnifications)


def _refuse_small(projection: PanelProjection, index: int) -> None:
    (height, width), (my, mx) = projection.views, projection.margin
    left, top = mx - _EDGE, my - _EDGE
    rows, columns = projection.sizes[index]
    x, y = _corners(projection.mappings[index], (left, top, left + width, top + height))
    beyond = [-_EDGE - x, x - columns + _EDGE, -_EDGE - y, y - rows + _EDGE]
    past = torch.cat(beyond).max().item()
    if past > _ALLOWED:
        raise ValueError(
            f"panel {index} ({columns}x{rows} px) is smaller than the views ({width}x{height} px): "
            f"on its layer they reach past it by {past:.1f} of its pixels; take smaller views "
            "(--crop, --scale), or check its pitch, offset, rotation and homography"
        )


def _corners(mapping: Matrix, box: tuple[float, float, float, float]) -> tuple[Tensor, Tensor]:
    """Where the corners of a box (left, top, right, bottom) are mapped to, x and y.

    Infinite if the horizon, where a homography goes to infinity, crosses the box.
    """
    left, top, right, bottom = box
    corners = torch.tensor([(x, y, 1.0) for x in (left, right) for y in (top, bottom)])
    found = corners.double() @ as_matrix(mapping).T
    if not bool((found[:, 2] * found[0, 2] > 0).all()):
        return torch.full((4,), math.inf), torch.full((4,), math.inf)
    x, y = (found[:, :2] / found[:, 2:]).T
    return x, y


@dataclass(frozen=True, eq=False)
class PanelImages:
    """The pictures of the panels of a display, and how much light they cannot reach.

    Args:
        codes: one picture a panel, front to back.
        missed: share of light paths that miss a panel, front to back; they are dark.
    """

    codes: tuple[UInt[Tensor, "subframe c _ _"], ...]
    missed: tuple[float, ...]


def panel_images(
    problem: Problem, layers: Float[Tensor, "subframe layer c ly lx"], display: Display
) -> PanelImages:
    """Return the pictures of the panels that show layers.

    Args:
        problem: what the layers are to show.
        layers: light, 0 to 1, on their scaled grids.
        display: with panels.

    Raises:
        ValueError: a panel is smaller than the views.
    """
    whole = panel_projection(display, problem.view_size)
    regions = [_reached(whole, k) for k in range(len(whole.sizes))]
    # the problem may have more eyes than the display has views
    projection = _seen_along(problem.projection, _cut(whole, regions))
    through = replace(problem, projection=projection)
    responses = panel_responses(display)
    start = corrected(through, fitted(layers, projection))
    light = solve(through, JointRounding(responses), iterations=ROUNDING_SWEEPS, init=start).layers
    return PanelImages(
        tuple(
            pad(response.codes(light[..., k, :, :rows, :columns]), region.around(whole.sizes[k]))
            for k, (response, region, (rows, columns)) in enumerate(
                zip(responses, regions, projection.sizes, strict=True)
            )
        ),
        _missed(whole),
    )


class _Region(NamedTuple):
    """A rectangle of panel pixels."""

    top: int
    left: int
    height: int
    width: int

    def around(self, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """How many pixels of a panel are left, right, above and below."""
        right, below = size[1] - self.left - self.width, size[0] - self.top - self.height
        return self.left, right, self.top, below


def _reached(projection: PanelProjection, index: int) -> _Region:
    """The part of a panel that light paths meet; the rest is dark and costs no time."""
    (height, width), (my, mx) = projection.views, projection.margin
    rows, columns = projection.sizes[index]
    x, y = _corners(projection.mappings[index], (-1, -1, width + 2 * mx + 1, height + 2 * my + 1))
    if not bool(x.isfinite().all()):
        return _Region(0, 0, rows, columns)
    left, right = (int(min(max(edge, 0), columns)) for edge in (x.min().floor(), x.max() + 2))
    top, below = (int(min(max(edge, 0), rows)) for edge in (y.min().floor(), y.max() + 2))
    return _Region(top, left, below - top, right - left)


def _cut(projection: PanelProjection, regions: Sequence[_Region]) -> PanelProjection:
    """Return the projection from parts of the panels."""
    mappings = tuple(
        as_rows(moved(-region.left, -region.top) @ as_matrix(mapping))
        for mapping, region in zip(projection.mappings, regions, strict=True)
    )
    sizes = tuple((region.height, region.width) for region in regions)
    return replace(projection, mappings=mappings, sizes=sizes)


def corrected(
    through: Problem, panels: Float[Tensor, "*batch layer c py px"]
) -> Float[Tensor, "*batch layer c py px"]:
    """Return panels, not yet rounded, that show the views better than these.

    Args:
        through: the problem of showing the views through the panels.
        panels: light, 0 to 1.
    """
    return solve(through, Sweeps(), iterations=_CORRECTING_SWEEPS, init=panels).layers


def panel_responses(display: Display) -> tuple[Response, ...]:
    """Return what the codes of every panel make of light, front to back."""
    return tuple(
        Response(panel.bits, panel.transfer or display.transfer) for panel in display.panels
    )


def fitted(
    layers: Float[Tensor, "*batch layer c ly lx"], projection: PanelProjection
) -> Float[Tensor, "*batch layer c py px"]:
    """Return the panels, as light and not yet rounded, that come nearest to layers."""
    size = projection.layer_size(layers)
    panels = layers.new_zeros(*layers.shape[:-2], *size)
    for k in range(layers.shape[-4]):
        rows, columns = projection.sizes[k]
        panels[..., k, :, :rows, :columns] = _fitted(layers[..., k : k + 1, :, :, :], projection, k)
    return panels


def _fitted(layer: Tensor, projection: PanelProjection, index: int) -> Tensor:
    """One panel: a problem whose one view is the layer, seen straight on."""
    mapping, size = projection.mappings[index], projection.sizes[index]
    layer_size = (layer.shape[-2], layer.shape[-1])
    alone = PanelProjection((((0.0, 0.0),),), (0, 0), (mapping,), (size,), layer_size)
    problem = Problem(alone, Additive(), KeptViews(layer), (1.0,))
    start = _area_mean(layer, mapping, size).unsqueeze(-5)
    run = solve(problem, Sweeps(), iterations=_FITTING_SWEEPS, init=start)
    return run.layers.squeeze(-5).squeeze(-4)


def _area_mean(
    picture: Float[Tensor, "*batch ly lx"], mapping: Matrix, size: tuple[int, int]
) -> Float[Tensor, "*batch y x"]:
    """Return a picture on other pixels: the mean over n x n places in each.

    Args:
        picture: outside it all is dark.
        mapping: from the pixels of the picture to those of what is returned; n is as many of the
            former as fall into one of the latter along an axis, 1 where the latter are finer.
        size: height and width of what is returned.
    """
    back = torch.linalg.inv(as_matrix(mapping))
    middle = torch.tensor([[0.0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=torch.float64)
    middle[:2] += torch.tensor([[size[1] / 2], [size[0] / 2]])
    x, y = (back @ middle)[:2] / (back @ middle)[2]
    steps = torch.hypot(x[1:] - x[0], y[1:] - y[0])  # along a row and a column, picture pixels
    count = max(1, math.ceil(steps.max().item() - 1e-3))
    places = [(2 * i + 1 - count) / (2 * count) for i in range(count)]
    parts = [sampled(picture, back @ moved(u, v), size) for v in places for u in places]
    return sum_of(parts) / len(parts)


def _missed(projection: PanelProjection) -> tuple[float, ...]:
    """Count what falls past the middle between the last pixels and the dark around them."""
    views = range(len(projection.shifts))
    missing = [
        [projection.window(torch.ones(size), i, k).lt(0.5).double().mean().item() for i in views]
        for k, size in enumerate(projection.sizes)
    ]
    return tuple(sum(shares) / len(shares) for shares in missing)


def views_through_panels(
    pictures: Sequence[Float[Tensor, "subframe c _ _"]],
    display: Display,
    view_size: tuple[int, int],
) -> Float[Tensor, "view c height width"]:
    """Return the light that the pictures of panels show, unclipped.

    Args:
        pictures: values, 0 to 1, one for every panel, front to back.
        display: with panels.
        view_size: height and width of the views.

    Raises:
        ValueError: not as many pictures as panels, of another size, or smaller than the views.
    """
    _refuse_misfits(pictures, display)
    projection = panel_projection(display, view_size)
    responses = panel_responses(display)
    light = [r.transfer.decode(p) for r, p in zip(responses, pictures, strict=True)]
    rows, columns = projection.layer_size(light[0])
    even = [pad(p, (0, columns - p.shape[-1], 0, rows - p.shape[-2])) for p in light]
    layers = torch.stack(even, dim=-4)
    return compose_views(layers, projection, display.link)


def _refuse_misfits(pictures: Sequence[Tensor], display: Display) -> None:
    if len(pictures) != len(display.panels):
        raise ValueError(
            f"found {len(pictures)} pictures of panels, display '{display.name}' has "
            f"{len(display.panels)} panels"
        )
    for k, (picture, panel) in enumerate(zip(pictures, display.panels, strict=True)):
        if (picture.shape[-2], picture.shape[-1]) != panel.size:
            raise ValueError(
                f"the picture of panel {k} is {picture.shape[-1]}x{picture.shape[-2]} px, its "
                f"resolution on display '{display.name}' is {panel.size[1]}x{panel.size[0]}"
            )
