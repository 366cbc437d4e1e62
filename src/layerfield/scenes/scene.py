"""Scenes of planar, textured, occluding surfaces, and their exact views.

A viewpoint is a slope s = (x, y) as in `Geometry.slopes`; the central eye is s = 0. A surface is
a plane whose disparity is linear in the position u where the central eye sees it, and the point
appears in another view at x:

    d(u) = d0 + g . u            (pixels per unit of slope; u = 0 is the centre of the image)
    x = u - s d(u)               hence d = (d0 + g . x) / (1 - g . s) and u = x + s d

Planes of a perspective display are of this form too. The nearest surface, the one of the largest
disparity along a ray, wins in every pixel.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample

from layerfield.geometry import Point

EVERYWHERE = 1e4  # signed distance of a surface without an edge


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """A batch of scenes, each a set of planes with a texture and a silhouette.

    Textures and silhouettes cover a canvas that is centred on the central view; outside it they
    go on as mirror images.

    Args:
        textures: colours, 0 to 1, of the canvas in any resolution.
        silhouettes: signed distance to the edge in pixels, positive inside; any resolution.
        disparities: d0, the disparity of the plane at the centre of the image.
        gradients: g = (x, y), change of disparity per pixel of the central view.
        canvas: height and width of the canvas in pixels of the central view.
        size: height and width of the views, in pixels.
    """

    textures: Float[Tensor, "batch surface c ty tx"]
    silhouettes: Float[Tensor, "batch surface my mx"]
    disparities: Float[Tensor, "batch surface"]
    gradients: Float[Tensor, "batch surface 2"]
    canvas: tuple[int, int]
    size: tuple[int, int]

    @property
    def disparity_map(self) -> Float[Tensor, "batch y x"]:
        """The disparity of what the central eye sees in each pixel."""
        rays = _trace(self, (0.0, 0.0))
        return rays.disparity.masked_fill(rays.coverage < 0.5, -math.inf).amax(1)


def render(
    scene: Scene, positions: Sequence[Point], approaches: Sequence[float] | None = None
) -> Float[Tensor, "batch view c y x"]:
    """Return the views of a scene from a list of viewpoints.

    Edges and creases are anti-aliased over one pixel; what shows through an edge is the nearest
    surface behind that covers at least half of the pixel.

    Args:
        scene: what is seen.
        positions: (x, y) of every viewpoint, as in `Geometry.slopes`.
        approaches: a of every viewpoint, as in `Geometry.approaches`, where distances differ: the
            slope is s + a x in the pixel at x.

    Raises:
        ValueError: no viewpoints, or one so far out that it sees a surface from behind.

    >>> scene = spot_scene([((0, 0), 1.0)], size=(9, 9), radius=1)
    >>> here, right = render(scene, [(0, 0), (1, 0)])[0, :, 0, 4]
    >>> int(here.argmax()), int(right.argmax())
    (4, 3)
    """
    if not positions:
        raise ValueError("there are no viewpoints to render; give at least one (x, y)")
    _check_front(scene, positions)
    batch, _, channels, _, _ = scene.textures.shape
    atlas = scene.textures.transpose(1, 2).flatten(2, 3)
    views = atlas.new_empty(batch, len(positions), channels, *scene.size)
    for i, slope in enumerate(positions):
        views[:, i] = _view(scene, atlas, slope, approaches[i] if approaches else 0.0)
    return views


def make_scene(
    textures: Float[Tensor, "surface c ty tx"],
    disparities: Sequence[float],
    *,
    size: tuple[int, int],
    gradients: Sequence[Point] | None = None,
    silhouettes: Float[Tensor, "surface my mx"] | None = None,
    canvas: tuple[int, int] | None = None,
) -> Scene:
    """Return one scene (batch of 1) of given planes, nothing left to chance.

    Args:
        textures: one picture of the whole canvas for each plane, values 0 to 1.
        disparities: of each plane at the centre of the image, in pixels per unit of slope.
        size: height and width of the views, in pixels.
        gradients: (x, y) change of disparity per pixel; planes face the viewer without it.
        silhouettes: signed distances in pixels, positive inside; planes without edge otherwise.
        canvas: height and width that the textures cover; twice the views' size otherwise.

    Raises:
        ValueError: not as many disparities, gradients or silhouettes as textures.
    """
    count = textures.shape[0]
    gradients = [(0.0, 0.0)] * count if gradients is None else gradients
    if silhouettes is None:
        silhouettes = textures.new_full((count, 2, 2), EVERYWHERE)
    found = {len(disparities), len(gradients), silhouettes.shape[0]}
    if found != {count}:
        raise ValueError(
            f"found {len(disparities)} disparities, {len(gradients)} gradients and "
            f"{silhouettes.shape[0]} silhouettes, expected {count} of each, one for every texture"
        )
    return Scene(
        textures=textures[None],
        silhouettes=silhouettes[None],
        disparities=textures.new_tensor(disparities)[None],
        gradients=textures.new_tensor(gradients)[None],
        canvas=canvas or (2 * size[0], 2 * size[1]),
        size=size,
    )


def spot_scene(
    spots: Sequence[tuple[Point, float]],
    *,
    size: tuple[int, int],
    radius: float = 2.0,
    background: float = 0.0,
) -> Scene:
    """Return one scene of white discs in front of an even grey plane, one disparity farther.

    Args:
        spots: ((x, y), disparity) of every disc; x, y in pixels from the centre of the image, as
            the central eye sees it.
        size: height and width of the views, in pixels.
        radius: of the discs, in pixels.
        background: grey value of the plane behind, 0 to 1.

    Raises:
        ValueError: there are no spots.
    """
    if not spots:
        raise ValueError("there are no spots; give at least one ((x, y), disparity)")
    canvas = (2 * size[0], 2 * size[1])
    y, x = pixel_centres(canvas, torch.device("cpu"))
    discs = [radius - torch.hypot(x - cx, y - cy) for (cx, cy), _ in spots]
    silhouettes = torch.stack([torch.full(canvas, EVERYWHERE), *discs])
    textures = torch.ones(len(silhouettes), 3, 1, 1)
    textures[0] = background
    disparities = [min(d for _, d in spots) - 1, *(d for _, d in spots)]
    return make_scene(textures, disparities, size=size, silhouettes=silhouettes, canvas=canvas)


def pixel_centres(size: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor]:
    """Return y `[y, 1]` and x `[1, x]` of pixel centres, counted from the centre of the image."""
    y, x = (torch.arange(n, device=device) - (n - 1) / 2 for n in size)
    return y[:, None], x[None, :]


def _check_front(scene: Scene, positions: Sequence[Point]) -> None:
    facing = torch.stack([_facing(scene.gradients, slope) for slope in positions])
    if not bool((facing > 0).all()):
        reach = max(math.hypot(*slope) for slope in positions)
        raise ValueError(
            f"a viewpoint {reach:g} from the centre sees a surface from behind, expected g . s < 1 "
            "for gradients g and slopes s; use flatter surfaces or viewpoints nearer the centre"
        )


@dataclass(frozen=True, eq=False)
class _Rays:
    """Where the light paths of one view meet every surface.

    Args:
        disparity: of the surfaces.
        steepness: (x, y) change of that disparity per pixel of this view.
        coverage: share of the pixel that lies inside the silhouette.
        at: (x, y) on the canvas, -1 to 1.
    """

    disparity: Float[Tensor, "batch surface y x"]
    steepness: Float[Tensor, "batch surface 2"]
    coverage: Float[Tensor, "batch surface y x"]
    at: Float[Tensor, "batch surface y x 2"]


def _trace(scene: Scene, slope: Point, approach: float = 0.0) -> _Rays:
    facing = _facing(scene.gradients, slope)
    steepness = scene.gradients / facing[..., None]
    y, x = pixel_centres(scene.size, facing.device)
    along_x, along_y = steepness[..., None, None].unbind(2)
    disparity = torch.addcmul(
        (scene.disparities / facing)[..., None, None] + along_y * y, along_x, x
    )
    if approach != 0:
        disparity = disparity / (1 - approach * (along_x * x + along_y * y))
    at = disparity.new_empty(*disparity.shape, 2)
    for axis, (position, extent) in enumerate(((x, scene.canvas[1]), (y, scene.canvas[0]))):
        scale = 2 / extent
        at[..., axis] = torch.add(position * scale, disparity, alpha=slope[axis] * scale)
        if approach != 0:
            at[..., axis] += disparity * position * (approach * scale)
    outline = scene.silhouettes.flatten(0, 1)[:, None]
    distance = grid_sample(
        outline, at.flatten(0, 1), padding_mode="reflection", align_corners=False
    )
    coverage = distance.view_as(disparity).add_(0.5).clamp_(0, 1)
    return _Rays(disparity, steepness, coverage, at)


def _facing(gradients: Float[Tensor, "*batch 2"], slope: Point) -> Float[Tensor, "*batch"]:
    """Return 1 - g . s; written out, as matrix products may run in reduced precision on GPUs."""
    return 1 - gradients[..., 0] * slope[0] - gradients[..., 1] * slope[1]


def _view(
    scene: Scene, atlas: Tensor, slope: Point, approach: float
) -> Float[Tensor, "batch c y x"]:
    rays = _trace(scene, slope, approach)
    front = _nearest(rays.disparity.masked_fill(rays.coverage <= 0, -math.inf))
    solid = rays.disparity.masked_fill(rays.coverage < 0.5, -math.inf)
    behind = _nearest(solid.scatter_(1, front, -math.inf))
    slots = torch.cat([front, behind], dim=1)
    seen = _colours(atlas, rays.at, slots, scene.textures.shape[1])
    near, far = seen.unflatten(2, (2, -1)).unbind(2)
    opacity = rays.coverage.gather(1, front) * _crease(rays, solid, slots)
    return torch.lerp(far, near, opacity)


def _nearest(disparity: Float[Tensor, "batch surface y x"]) -> Int[Tensor, "batch 1 y x"]:
    return disparity.max(1, keepdim=True).indices  # several times faster than argmax


def _crease(
    rays: _Rays, solid: Tensor, slots: Int[Tensor, "batch 2 y x"]
) -> Float[Tensor, "batch 1 y x"]:
    """Return the share of the pixel on the front surface's side of the line where two planes meet.

    The line is where their disparities are equal; it is (gap / change of the gap per pixel) away.
    """
    front, behind = slots.split(1, dim=1)
    gap = rays.disparity.gather(1, front) - solid.gather(1, behind)
    both = rays.steepness[..., None].expand(-1, -1, -1, slots[0, 0].numel())
    along_x, along_y = (
        both.gather(1, slots.flatten(2)[:, :, None].expand(-1, -1, 2, -1)).diff(dim=1).unbind(2)
    )
    change = torch.hypot(along_x, along_y).view_as(gap)
    return torch.where(change > 0, 0.5 + gap / change, 1.0).clamp_(max=1.0)


def _colours(
    atlas: Float[Tensor, "batch c ay tx"],
    at: Float[Tensor, "batch surface y x 2"],
    slots: Int[Tensor, "batch slot y x"],
    count: int,
) -> Float[Tensor, "batch c slot*y x"]:
    """Sample the texture of one surface per pixel from all textures stacked in one picture."""
    grid = at.gather(1, slots[..., None].expand(-1, -1, -1, -1, 2))
    # mirror at the edges of the canvas, then stay half a texel away from the texture next door
    y = 1 - ((grid[..., 1] + 1).remainder_(4) - 2).abs_()
    edge = 1 - count / atlas.shape[-2]
    grid[..., 1] = (y.clamp_(-edge, edge) + 1 + 2 * slots) / count - 1
    return grid_sample(atlas, grid.flatten(1, 2), padding_mode="reflection", align_corners=False)
