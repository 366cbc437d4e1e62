"""Light fields in motion: frames of procedural scenes.

A video is `[frame, view, c, y, x]`, values 0 to 1.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.geometry import Geometry
from layerfield.scenes.procedural import scenes_for
from layerfield.scenes.scene import Scene, render

Video = Float[Tensor, "frame view c y x"]


def panned(
    geometry: Geometry,
    step: tuple[int, int],
    frames: int,
    *,
    size: tuple[int, int],
    seed: int,
    stretch: float = 1.0,
) -> Video:
    """Return crops of one wide light field, each `step` = (x, y) pixels further.

    Args:
        geometry: of the display.
        step: either way.
        frames: how many.
        size: height and width of the views, in pixels.
        seed: of the scene.
        stretch: as in `scenes_for`.
    """
    (x, y), (height, width) = step, size
    whole = (height + frames * abs(y), width + frames * abs(x))
    scene = scenes_for(geometry, 1, size=whole, seed=seed, stretch=stretch)
    views = render(scene, geometry.slopes)[0]
    corners = [(y * t + frames * max(-y, 0), x * t + frames * max(-x, 0)) for t in range(frames)]
    return torch.stack([views[..., v : v + height, u : u + width] for v, u in corners])


def travelled(
    geometry: Geometry,
    step: float,
    frames: int,
    *,
    size: tuple[int, int],
    seed: int,
    stretch: float = 1.0,
) -> Video:
    """Return what viewpoints see that move sideways: things move by `step` times their disparity.

    Args:
        geometry: of the display.
        step: per frame, in units of slope.
        frames: how many.
        size: height and width of the views, in pixels.
        seed: of the scene.
        stretch: as in `scenes_for`.
    """
    reach = max(max(abs(x), abs(y)) for x, y in geometry.slopes) + frames * abs(step)
    scene = scenes_for(geometry, 1, size=size, seed=seed, stretch=stretch, reach=reach)
    places = [[(x + step * t, y) for x, y in geometry.slopes] for t in range(frames)]
    return torch.stack([render(scene, place)[0] for place in places])


def animated(
    geometry: Geometry,
    speed: float,
    frames: int,
    *,
    size: tuple[int, int],
    seed: int,
    stretch: float = 1.0,
) -> Video:
    """Return a scene whose things go their own ways in front of a background that stays.

    Args:
        geometry: of the display.
        speed: the highest along x and along y, pixels per frame.
        frames: how many.
        size: height and width of the views, in pixels.
        seed: of the scene.
        stretch: as in `scenes_for`.
    """
    scene = scenes_for(geometry, 1, size=size, seed=seed, stretch=stretch)
    generator = torch.Generator().manual_seed(seed)
    pace = torch.rand(scene.disparities.shape[1], 2, generator=generator) * 2 - 1
    pace[0] = 0
    at = [_shifted(scene, speed * t * pace) for t in range(frames)]
    return torch.stack([render(moved, geometry.slopes)[0] for moved in at])


def _shifted(scene: Scene, by: Float[Tensor, "surface 2"]) -> Scene:
    """Move surfaces across their canvas by (x, y) pixels, nearly; what leaves it comes back."""
    pictures = {"textures": scene.textures.clone(), "silhouettes": scene.silhouettes.clone()}
    for picture in pictures.values():
        fine = [picture.shape[axis] / scene.canvas[axis] for axis in (-2, -1)]
        for k, (x, y) in enumerate(by.tolist()):
            shifts = (round(y * fine[0]), round(x * fine[1]))
            picture[:, k] = torch.roll(picture[:, k], shifts, (-2, -1))
    return replace(scene, **pictures)
