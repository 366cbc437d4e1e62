"""One view without shadows, quickly: what rays meet first, in a fixed light.

The light comes from the upper left, and from all around, where it is brighter above.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from layerfield.rendering.cameras import camera
from layerfield.rendering.placement import Placement
from layerfield.rendering.takes import Take
from layerfield.rendering.tracing import aov, film_of, sensor_of
from layerfield.rendering.variant import FAST, mitsuba

# Columns: the direction of the lamp, that of what is above, and that of the viewer.
_SHADING = np.array([[-0.45, 0.6, 0.66], [0, 1, 0], [0, 0, 1]]).T
_DIRECT, _ABOVE, _BELOW = 0.75, 0.5, 0.25
_RAYS, _STRIDE = 8, 3  # the rays of a pixel lie on a lattice: no two in one row or column


def preview(take: Take, placement: Placement, view: int) -> Float[np.ndarray, "y x 3"]:
    """Return the light of a view without shadows.

    With LLVM the mean over a pixel, so that edges are smooth; otherwise of its centre.

    Args:
        take: what is rendered.
        placement: of it in the display.
        view: number of the viewpoint.
    """
    way = _mean if mitsuba().variant() == FAST else _centres
    return way(take, placement, view)


def _mean(take: Take, placement: Placement, view: int) -> Float[np.ndarray, "y x 3"]:
    """An edge along an axis is off by 1 / (2 rays) of a pixel at most."""
    import drjit as dr  # noqa: PLC0415  an extra

    mi = mitsuba()
    height, width = placement.size
    sensor = mi.load_dict(camera(placement, view, take.frame, film_of(placement.size, "rgb")))
    ray = dr.arange(mi.UInt32, height * width * _RAYS)
    number, pixel = ray % _RAYS, ray // _RAYS
    x = mi.Float(pixel % width) + (mi.Float(number) + 0.5) / _RAYS
    y = mi.Float(pixel // width) + (mi.Float(number * _STRIDE % _RAYS) + 0.5) / _RAYS
    place = mi.Point2f(x / width, y / height)
    rays, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    met = take.scene.ray_intersect(rays, mi.RayFlags.All, True)  # neighbours meet the same
    albedo = met.bsdf(rays).eval_diffuse_reflectance(met, met.is_valid())
    lit, up, front = (dr.dot(met.sh_frame.n, mi.Vector3f(axis)) for axis in _axes(take).T)
    side = dr.select(front < 0, -1.0, 1.0)
    light = _light(dr.maximum(side * lit, 0), side * up)
    seen = dr.select(met.is_valid(), albedo * light, take.behind)
    dr.eval(seen)  # once, not for each sum anew
    sums = [np.asarray(dr.block_sum(channel, _RAYS)) for channel in (seen.x, seen.y, seen.z)]
    return np.stack(sums, -1).reshape(height, width, 3) / _RAYS


def _centres(take: Take, placement: Placement, view: int) -> Float[np.ndarray, "y x 3"]:
    sensor = sensor_of(take, placement, view, film_of(placement.size, "rgb"))
    found = aov(take.scene, sensor, "sh_normal", "albedo")
    lit, up, front = np.moveaxis(found["sh_normal"] @ _axes(take), -1, 0)
    side = np.where(front < 0, np.float32(-1), np.float32(1))  # surfaces face the viewer
    seen = found["albedo"] * _light((side * lit).clip(0), side * up)[..., None]
    seen[~found["hit"]] = take.behind
    return seen


def _axes(take: Take) -> Float[np.ndarray, "3 3"]:
    """The directions of the light in the coordinates of the scene, one in each column."""
    unit = np.linalg.norm(take.frame[:3, 0])
    return (take.frame[:3, :3] / unit @ _SHADING).astype(np.float32)


def _light(lit: Any, up: Any) -> Any:
    """Light on a surface whose normal is that far toward the lamp and upward."""
    return _DIRECT * lit + (_ABOVE - _BELOW) / 2 * up + (_ABOVE + _BELOW) / 2
