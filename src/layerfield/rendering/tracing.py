"""One view: paths traced through the scene, or only what each pixel sees first."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from layerfield.rendering.cameras import camera
from layerfield.rendering.placement import Placement
from layerfield.rendering.takes import Take
from layerfield.rendering.variant import FAST, mitsuba

_BOUNCES = 6
_MOST_SAMPLES_AT_ONCE = 2**24  # of a picture, for the sake of memory
_PORTIONS = 4  # of the samples, at least; the fewer, the less can be told of sparks
_SPARK, _DIM = 2.0, 0.05  # times the median of the portions, plus that, is still no spark

# The preview: a light from the upper left, and one from all around that is brighter above.
_LIGHT = np.array([-0.45, 0.6, 0.66], np.float32)  # as long as 1
_DIRECT, _ABOVE, _BELOW = 0.75, 0.5, 0.25


class Hits(NamedTuple):
    """What rays through pixel centres see first.

    Args:
        z: in picture coordinates, pixels; NaN where they see nothing.
        normal: toward the viewer, in picture coordinates.
        colour: share of the light that comes back there.
    """

    z: Float[np.ndarray, "y x"]
    normal: Float[np.ndarray, "y x 3"]
    colour: Float[np.ndarray, "y x 3"]


def trace(
    take: Take, placement: Placement, view: int, *, samples: int, seed: tuple[int, ...]
) -> Float[np.ndarray, "y x 3"]:
    """Return the light of a view, path-traced, the mean over each pixel's square.

    Args:
        take: what is rendered.
        placement: of it in the display.
        view: number of the viewpoint.
        samples: paths for each pixel.
        seed: the same numbers make the same picture.
    """
    mi = mitsuba()

    integrator = take.integrator or mi.load_dict(
        {"type": "path", "max_depth": _BOUNCES, "hide_emitters": True}
    )
    portions = _portions(samples, placement.size)
    found = []
    for turn, count in enumerate(portions):
        sampler = {"type": "multijitter", "sample_count": count}
        film = _film(placement.size, "rgba")
        sensor = mi.load_dict(camera(placement, view, take.frame, film) | {"sampler": sampler})
        number = int(np.random.SeedSequence([*seed, turn]).generate_state(1)[0])
        picture = mi.render(
            take.scene, sensor=sensor, integrator=integrator, spp=count, seed=number
        )
        found.append(np.nan_to_num(np.asarray(picture)[..., :4]))
    total = np.average(_without_sparks(np.stack(found)), axis=0, weights=portions)
    return total[..., :3] + (1 - total[..., 3:]) * take.behind


def _portions(samples: int, size: tuple[int, int]) -> list[int]:
    """Several, to compare; powers of four, which are spread evenly over a pixel.

    One thread adds up what belongs to a pixel then, so that its sum does not depend on the threads.
    """
    most = max(1, min(samples // _PORTIONS, _MOST_SAMPLES_AT_ONCE // (size[0] * size[1])))
    portions = []
    while samples > 0:
        portions.append(4 ** ((min(samples, most).bit_length() - 1) // 2))
        samples -= portions[-1]
    return portions


def _without_sparks(
    pictures: Float[np.ndarray, "portion y x 4"],
) -> Float[np.ndarray, "portion y x 4"]:
    """Dim pixels that are far brighter than in the other portions: a rare path met a light."""
    brightness = pictures[..., :3].mean(-1, keepdims=True)
    limit = _SPARK * np.median(brightness, axis=0) + _DIM
    dimmed = pictures * np.minimum(1, limit / brightness.clip(_DIM))
    return np.concatenate([dimmed[..., :3], pictures[..., 3:]], axis=-1)


def first_hits(
    take: Take, placement: Placement, view: int, *, fine: int = 1, centred: bool = True
) -> Hits:
    """Return what a view sees first in each pixel.

    Args:
        take: what is rendered.
        placement: of it in the display.
        view: number of the viewpoint.
        fine: rays along each side of a pixel.
        centred: whether rays go through the centre of their share of it, or anywhere in there.
    """
    mi = mitsuba()

    height, width = placement.size
    film = _film((fine * height, fine * width), "rgb")
    centres = {"type": "stratified", "sample_count": 1, "jitter": not centred}
    sensor = mi.load_dict(camera(placement, view, take.frame, film) | {"sampler": centres})
    found = _aov(take.scene, sensor)
    to_picture = np.linalg.inv(take.frame).astype(np.float32)
    turn = to_picture[:3, :3] / np.linalg.norm(to_picture[:3, 0])
    z = found["position"] @ to_picture[2, :3] + to_picture[2, 3]
    normal = found["normal"] @ turn.T
    return Hits(
        z=np.where(found["hit"], z, np.nan),
        normal=np.where(normal[..., 2:] < 0, -normal, normal),
        colour=found["albedo"],
    )


def preview(take: Take, placement: Placement, view: int) -> Float[np.ndarray, "y x 3"]:
    """Return the light of a view without shadows, quickly; arguments as in `first_hits`."""
    fine = 2 if mitsuba().variant() == FAST else 1  # rays along each side of a pixel
    hits = first_hits(take, placement, view, fine=fine, centred=fine == 1)
    facing = (hits.normal @ _LIGHT).clip(0)
    around = _BELOW + (_ABOVE - _BELOW) * (hits.normal[..., 1] + 1) / 2
    light = hits.colour * (_DIRECT * facing + around)[..., None]
    light = np.where(np.isnan(hits.z)[..., None], take.behind, light)
    height, width = placement.size
    return light.reshape(height, fine, width, fine, 3).mean((1, 3))


def visible_points(scene: Any, sensor: Any) -> Float[np.ndarray, "point 3"]:
    """Return points of a scene that a camera sees."""
    found = _aov(scene, sensor)
    return found["position"][found["hit"]]


def _film(size: tuple[int, int], pixels: str) -> dict[str, Any]:
    """Without a filter across pixels, so that a pixel is the mean over its square."""
    return {
        "type": "hdrfilm",
        "height": size[0],
        "width": size[1],
        "rfilter": {"type": "box"},
        "pixel_format": pixels,
        "component_format": "float32",
    }


def _aov(scene: Any, sensor: Any) -> dict[str, np.ndarray]:
    mi = mitsuba()

    integrator = mi.load_dict(
        {"type": "aov", "aovs": "depth:depth,position:position,normal:sh_normal,albedo:albedo"}
    )
    found = np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=1))
    depth, position, normal, albedo = np.split(found[..., -10:], [1, 4, 7], axis=-1)
    return {"hit": depth[..., 0] > 0, "position": position, "normal": normal, "albedo": albedo}
