"""The stage that models are put on: a floor that bends up into a backdrop, and lights.

Seen from the side, with y up and z toward the viewer, the floor is the line

    y cos e + z sin e = floor                    e the elevation of the viewer

and the backdrop the line z = wall; an arc joins them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from layerfield.rendering.model import Material, Surface
from layerfield.rendering.placement import Extent, Placement, Pose
from layerfield.rendering.variant import mitsuba

_FLATTEST = 5.0  # degrees: a floor seen at a smaller elevation is left out
_GAP = 0.15  # between the scene and the backdrop, of the extent of the scene; the arc fills it
_ARC = 48  # pieces of the arc
_WIDE = 8.0  # half the width of the stage, in half widths of the picture
_GREY = Material(colour=(0.55, 0.55, 0.57))

# Half the width of the picture is the unit; the scene is about as large as 1.
_KEY_PLACE, _KEY_RADIUS, _KEY_LIGHT = (-2.0, 3.0, 3.6), 1.1, 22.0
_BEHIND = 0.3  # of the light of the sky comes from behind the backdrop
_SKY, _HORIZON, _GROUND = 0.3, 0.22, 0.1  # light from above, from the sides and from below


@dataclass(frozen=True)
class Stage:
    """The floor and the backdrop of a scene.

    Args:
        floor: height of the floor, in units of the scene, along its vertical axis.
    """

    floor: float

    def shows(self, extents: Sequence[tuple[Pose, Extent]]) -> bool:
        return any(_has_floor(pose) for pose, _ in extents)

    def nearest(self, extents: Sequence[tuple[Pose, Extent]], bottom: float) -> float:
        return max((self._at(p, bottom) for p, _ in extents if _has_floor(p)), default=-math.inf)

    def farthest(self, extents: Sequence[tuple[Pose, Extent]], extent: Extent, top: float) -> float:
        wall = _wall(extent)
        return min(max(wall, self._at(p, top)) if _has_floor(p) else wall for p, _ in extents)

    def _at(self, pose: Pose, y: float) -> float:
        """The z of the floor at a height in the picture."""
        e = math.radians(pose.elevation)
        return (self.floor - y * math.cos(e)) / math.sin(e)

    def surface(self, pose: Pose, placement: Placement) -> Surface:
        """Return floor and backdrop in units of the turned scene."""
        extent = placement.extent
        half = placement.size[1] / 2 / placement.scale
        profile = self._profile(pose, _wall(extent), _GAP * extent.width, _WIDE * half)
        across = placement.centre[0] + _WIDE * half * np.array([-1.0, 1.0])
        y, z = (np.repeat(profile[:, axis], 2) for axis in (0, 1))
        rows = 2 * np.arange(len(profile) - 1)[:, None]
        return Surface(
            vertices=np.stack([np.tile(across, len(profile)), y, z], axis=1),
            faces=(rows + np.array([[0, 1, 3, 0, 3, 2]])).reshape(-1, 3),
            normals=np.repeat(_normals(profile), 2, axis=0),
            material=_GREY,
        )

    def _profile(
        self, pose: Pose, wall: float, gap: float, reach: float
    ) -> Float[np.ndarray, "n 2"]:
        """Points (y, z) from the viewer along the floor to the backdrop and up."""
        e = math.radians(pose.elevation)
        if not _has_floor(pose):
            return np.array([[-reach, wall], [reach, wall]])
        along, up = np.array([math.sin(e), -math.cos(e)]), np.array([1.0, 0.0])
        if math.cos(e) < 1e-3:
            return np.array([[-reach, self.floor], [reach, self.floor]])
        corner = np.array([(self.floor - wall * math.sin(e)) / math.cos(e), wall])
        turn = math.pi / 2 - e
        bend = gap / math.cos(e) / math.tan(turn / 2)
        before = corner - along * gap / math.cos(e)
        angles = np.linspace(0, turn, _ARC + 1)[:, None]
        inward = np.array([math.cos(e), math.sin(e)])
        arc = before + bend * (along * np.sin(angles) + inward * (1 - np.cos(angles)))
        return np.concatenate([[before - along * reach], arc, [arc[-1] + up * reach]])


def _wall(extent: Extent) -> float:
    """Return the z of the backdrop of a scene."""
    return float(extent.low[2] - _GAP * extent.width)


def _has_floor(pose: Pose) -> bool:
    return pose.elevation >= _FLATTEST


def _normals(profile: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Normals across a curve, toward the viewer and up."""
    along = np.gradient(profile, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([np.zeros(len(along)), -along[:, 1], along[:, 0]], axis=1)


def lights(size: tuple[int, int]) -> dict[str, Any]:
    """Return a soft key light from the upper left and a dim sky, for `mitsuba.load_dict`.

    Args:
        size: height and width of the picture; the light hangs above it.
    """
    mi = mitsuba()

    origin = np.array(_KEY_PLACE) * [1, max(1, size[0] / size[1]), 1]
    place = mi.ScalarTransform4f().look_at(origin=origin, target=[0, 0, -0.3], up=[0, 1, 0])
    power = _KEY_LIGHT * (origin @ origin) / np.dot(_KEY_PLACE, _KEY_PLACE)
    strength = {"type": "rgb", "value": [power, 0.96 * power, 0.9 * power]}
    return {
        "key": {
            "type": "disk",
            "to_world": place.scale(_KEY_RADIUS),
            "emitter": {"type": "area", "radiance": strength},
        },
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(_sky()), "sampling_weight": 0.0},
    }


def _sky() -> Float32[np.ndarray, "y x 3"]:
    """Light from all around, brighter above and dim from behind, where the backdrop hides it."""
    upper, lower = np.linspace(_SKY, _HORIZON, 16), np.linspace(_HORIZON, _GROUND, 16)
    height = np.concatenate([upper, lower])[:, None, None]
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)[None, :, None]
    front = _BEHIND + (1 - _BEHIND) * np.clip(0.5 - 1.5 * np.cos(turn), 0, 1)
    return (height * front * [0.95, 0.98, 1.05]).astype(np.float32)
