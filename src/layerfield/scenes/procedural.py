"""Random scenes that look like photographs, and light fields of them."""

import math

import torch
from torch import Tensor

from layerfield.geometry import Geometry, Point, grid_points
from layerfield.light_field import LightField
from layerfield.scenes.draws import Draws
from layerfield.scenes.lighting import develop
from layerfield.scenes.scene import EVERYWHERE, Scene, render
from layerfield.scenes.silhouettes import draw_silhouettes
from layerfield.scenes.textures import draw_textures

_SURFACES = 8
_LARGE = 2  # of the foreground surfaces
_TEXELS = 2  # per pixel: linear interpolation then keeps views equally sharp at any shift
_STEEPEST = 0.3  # of g . s, so that no view sees a surface under too flat an angle


def random_scenes(
    count: int,
    *,
    size: tuple[int, int],
    disparity_range: tuple[float, float] = (-1.0, 1.0),
    reach: float = 2.0,
    seed: int = 0,
    surfaces: int = _SURFACES,
    device: torch.device | str = "cpu",
) -> Scene:
    """Return a batch of random scenes: a background and foreground surfaces that occlude it.

    Element b is the scene of seed + b, whatever the batch it is drawn in (up to rounding). Every
    draw is made on the CPU, so that a seed means the same scene on every device.

    Args:
        count: scenes in the batch.
        size: height and width of the views, in pixels.
        disparity_range: lowest and highest disparity of anything seen, in pixels per unit of slope.
        reach: largest |slope| that will be rendered; how far textures go on around the image.
        seed: of the first scene.
        surfaces: planes in a scene, the background included.
        device: where the scene is made and rendered.

    Raises:
        ValueError: fewer than 1 scene or surface, an image below 8 pixels, or an empty range.
    """
    low, high = disparity_range
    _check(count, size, (low, high), surfaces)
    margin = math.ceil(reach * max(abs(low), abs(high))) + 1
    canvas = (size[0] + 2 * margin, size[1] + 2 * margin)
    draws = Draws(count, seed=seed, device=torch.device(device))
    centres, radii = _places(draws, surfaces - 1, size)
    disparities, gradients = _planes(draws, centres, radii, canvas, (low, high), reach)
    silhouettes = _outlines(draws, centres, radii, canvas)
    fields = draw_textures(draws, surfaces, canvas=canvas, texels=_TEXELS)
    return Scene(
        textures=develop(draws, fields, silhouettes=silhouettes, texels=_TEXELS),
        silhouettes=silhouettes,
        disparities=disparities,
        gradients=gradients,
        canvas=canvas,
        size=size,
    )


def procedural_light_field(
    *,
    grid: tuple[int, int] = (5, 5),
    size: tuple[int, int] = (384, 512),
    disparity_range: tuple[float, float] = (-1.0, 1.0),
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> LightField:
    """Return the light field of one random scene, viewpoints one view step apart.

    Args:
        grid: rows and columns of viewpoints.
        size: height and width of a view, in pixels.
        disparity_range: lowest and highest disparity, in pixels between neighbouring views.
        seed: of the scene.
        device: where it is rendered.
    """
    positions = grid_points(grid)
    scene = random_scenes(
        1,
        size=size,
        disparity_range=disparity_range,
        reach=_reach(positions),
        seed=seed,
        device=device,
    )
    return LightField(render(scene, positions)[0], grid, name=f"procedural {seed}")


def scenes_for(
    geometry: Geometry,
    count: int,
    *,
    size: tuple[int, int],
    seed: int = 0,
    stretch: float = 1.0,
    reach: float | None = None,
    device: torch.device | str = "cpu",
) -> Scene:
    """Return random scenes that fill the depth of a display, for `render(scene, geometry.slopes)`.

    Disparities range from the parallax of the last layer to that of the first.

    Args:
        geometry: of the display; `display.geometry`.
        count: scenes in the batch.
        size: height and width of the views, in pixels.
        seed: of the first scene.
        stretch: widens (above 1) or narrows the range of disparities about its middle.
        reach: largest |slope| that will be rendered, if not the display's own.
        device: where the scene is made and rendered.
    """
    high, low = geometry.parallax[0], geometry.parallax[-1]
    middle, half = (high + low) / 2, stretch * (high - low) / 2
    return random_scenes(
        count,
        size=size,
        disparity_range=(middle - half, middle + half),
        reach=_reach(geometry.slopes) if reach is None else reach,
        seed=seed,
        device=device,
    )


def _reach(positions: tuple[Point, ...]) -> float:
    return max(max(abs(x), abs(y)) for x, y in positions)


def _check(count: int, size: tuple[int, int], span: tuple[float, float], surfaces: int) -> None:
    if count < 1 or surfaces < 1:
        raise ValueError(f"found {count} scenes of {surfaces} surfaces, expected at least 1 of 1")
    if min(size) < 8:
        raise ValueError(f"views of {size[0]}x{size[1]} pixels are too small, expected 8x8 or more")
    if not span[0] <= span[1]:
        raise ValueError(
            f"the disparity range goes from {span[0]:g} to {span[1]:g}, expected the lowest "
            "(farthest) disparity first"
        )


def _places(draws: Draws, count: int, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Centres (x, y) and radii of the foreground surfaces in pixels."""
    extent = torch.tensor([float(size[1]), float(size[0])], device=draws.device)
    centres = draws.uniform(count, 2, low=-0.55, high=0.55) * extent
    radii = draws.log_uniform(count, low=0.06, high=0.35) * min(size)
    large = draws.uniform(count, low=0.4, high=0.8) * min(size)
    is_large = torch.arange(count, device=draws.device) < _LARGE
    return centres, torch.where(is_large, large, radii)


def _planes(
    draws: Draws,
    centres: Tensor,
    radii: Tensor,
    canvas: tuple[int, int],
    span: tuple[float, float],
    reach: float,
) -> tuple[Tensor, Tensor]:
    """Disparities at the centre of the image and gradients, the background first.

    A surface that extends e pixels from its centre, where its disparity is d, varies by v = |g| e;
    v is limited so that d - v and d + v stay within the range.
    """
    low, high = span
    width = high - low
    steepest = _STEEPEST / max(reach, 1e-6)
    # the background: mostly a wall at the back, otherwise a floor that comes nearer downwards
    floor = draws.chance(0.4, 1)
    turn = draws.normal(1) * torch.where(floor > 0, 0.25, 2.0) + math.pi / 2
    direction = torch.stack([turn.cos(), turn.sin()], dim=-1)
    half = direction.new_tensor([canvas[1] / 2, canvas[0] / 2])
    extent = (direction.abs() * half).sum(-1)
    vary = torch.where(floor > 0, draws.uniform(1, low=0.2, high=0.45), draws.uniform(1, high=0.15))
    vary = torch.minimum(vary * width, steepest * extent)
    back = low + vary + draws.uniform(1) * torch.where(floor > 0, 0.05, 0.3) * width
    slant = direction * (vary / extent)[..., None]
    # the foreground: anywhere between the background and the viewer
    behind = back + (slant * centres).sum(-1)
    nearness = draws.uniform(radii.shape[1], low=0.05)
    nearness[:, :_LARGE] *= 0.5  # large things stand at the back, not to hide everything
    distance = behind + nearness * (high - behind)
    distance = distance.clamp(low, high)
    turn = draws.uniform(radii.shape[1], high=2 * math.pi)
    direction = torch.stack([turn.cos(), turn.sin()], dim=-1)
    room = torch.minimum(distance - low, high - distance)
    vary = draws.uniform(radii.shape[1]) ** 2 * torch.minimum(
        room, 0.3 * width * torch.ones_like(room)
    )
    vary = torch.minimum(vary, steepest * 2 * radii)
    tilt = direction * (vary / (2 * radii))[..., None]
    at_centre = distance - (tilt * centres).sum(-1)
    return torch.cat([back, at_centre], dim=1), torch.cat([slant, tilt], dim=1)


def _outlines(draws: Draws, centres: Tensor, radii: Tensor, canvas: tuple[int, int]) -> Tensor:
    everywhere = torch.full((draws.count, 1, *canvas), EVERYWHERE, device=draws.device)
    if radii.shape[1] == 0:
        return everywhere
    outlines = draw_silhouettes(draws, centres=centres, radii=radii, canvas=canvas)
    return torch.cat([everywhere, outlines], dim=1)
