"""One view: paths traced through the scene, or only what each pixel sees first."""

from typing import Any

import numpy as np
from jaxtyping import Float

from layerfield.rendering.cameras import camera
from layerfield.rendering.placement import Placement
from layerfield.rendering.takes import Take
from layerfield.rendering.variant import mitsuba

_BOUNCES = 6
_MOST_SAMPLES_AT_ONCE = 2**24  # of a picture, for the sake of memory
_PORTIONS = 4  # of the samples, at least; the fewer, the less can be told of sparks
_SPARK, _DIM = 2.0, 0.05  # times the median of the portions, plus that, is still no spark


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
        {"type": "path", "max_depth": _BOUNCES, "hide_emitters": take.lamps_hidden}
    )
    portions = _portions(samples, placement.size)
    found = []
    for turn, count in enumerate(portions):
        sampler = {"type": "multijitter", "sample_count": count}
        film = film_of(placement.size, "rgba")
        sensor = mi.load_dict(camera(placement, view, take.frame, film) | {"sampler": sampler})
        number = int(np.random.SeedSequence([*seed, turn]).generate_state(1)[0])
        picture = integrator.render(take.scene, sensor=sensor, seed=number, spp=count)
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
    take: Take, placement: Placement, view: int, *, fine: int = 1
) -> Float[np.ndarray, "y x"]:
    """Return the z of what is first met through the centre of each pixel; NaN where nothing is.

    In picture coordinates (see `placement`), in pixels.

    Args:
        take: what is rendered.
        placement: of it in the display.
        view: number of the viewpoint.
        fine: rays along each side of a pixel.
    """
    film = film_of((fine * placement.size[0], fine * placement.size[1]), "rgb")
    found = aov(take.scene, sensor_of(take, placement, view, film), "position")
    toward = np.linalg.inv(take.frame)[2]
    z = found["position"] @ toward[:3].astype(np.float32) + np.float32(toward[3])
    return np.where(found["hit"], z, np.nan)


def visible_points(scene: Any, sensor: Any) -> Float[np.ndarray, "point 3"]:
    """Return points of a scene that a camera sees."""
    found = aov(scene, sensor, "position")
    return found["position"][found["hit"]]


def film_of(size: tuple[int, int], pixels: str) -> dict[str, Any]:
    """Without a filter across pixels, so that a pixel is the mean over its square."""
    return {
        "type": "hdrfilm",
        "height": size[0],
        "width": size[1],
        "rfilter": {"type": "box"},
        "pixel_format": pixels,
        "component_format": "float32",
    }


def sensor_of(take: Take, placement: Placement, view: int, film: dict[str, Any]) -> Any:
    """Return a camera with one ray through the centre of each pixel of the film."""
    sampler = {"type": "stratified", "sample_count": 1, "jitter": False}
    return mitsuba().load_dict(camera(placement, view, take.frame, film) | {"sampler": sampler})


def aov(scene: Any, sensor: Any, *wanted: str) -> dict[str, np.ndarray]:
    """Return what rays meet first: three numbers of each kind, and whether there is anything.

    Args:
        scene: of Mitsuba.
        sensor: a camera.
        wanted: kinds, as Mitsuba's integrator of this name calls them.
    """
    asked = ",".join(["depth:depth", *(f"{name}:{name}" for name in wanted)])
    integrator = mitsuba().load_dict({"type": "aov", "aovs": asked})
    found = np.asarray(integrator.render(scene, sensor=sensor, seed=0, spp=1))
    found = found[..., -1 - 3 * len(wanted) :]
    kinds = {name: found[..., 1 + 3 * i : 4 + 3 * i] for i, name in enumerate(wanted)}
    return {"hit": found[..., 0] > 0, **kinds}
