"""Cameras at the viewpoints of a display, off axis: their pictures share the display plane.

A viewpoint at (X, Y, Z) looks straight along -z, with its picture moved by (-X, -Y), so that every
point of the display plane stays in its pixel. From infinity light paths are parallel to
(X/Z, Y/Z, 1).
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from layerfield.rendering.placement import Placement
from layerfield.rendering.variant import mitsuba

_NEAR = 0.01  # of the distance to the display plane: nothing nearer is seen


def camera(
    placement: Placement, view: int, frame: Float[np.ndarray, "4 4"], film: dict[str, Any]
) -> dict[str, Any]:
    """Return a camera for `mitsuba.load_dict`.

    Args:
        placement: of the scene in the picture.
        view: number of the viewpoint.
        frame: from picture coordinates to those of the scene; turns, moves and scales.
        film: the film, for `mitsuba.load_dict`.
    """
    x, y = (c * placement.slant for c in placement.geometry.slopes[view])
    distance = placement.distance(view)
    if math.isinf(distance):
        return _parallel(placement, (x, -y), frame) | {"film": film}
    return _perspective(placement, (x * distance, -y * distance, distance), frame) | {"film": film}


def _perspective(
    placement: Placement, eye: tuple[float, float, float], frame: Float[np.ndarray, "4 4"]
) -> dict[str, Any]:
    mi = mitsuba()

    height, width = placement.size
    unit = float(np.linalg.norm(frame[:3, 0]))
    # cameras look along their own +z with x to the left
    pose = np.eye(4)
    pose[:3, :3] = frame[:3, :3] / unit @ np.diag([-1.0, 1.0, -1.0])
    pose[:3, 3] = (frame @ [*eye, 1])[:3]
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(pose),
        "fov_axis": "x",
        "fov": math.degrees(2 * math.atan(width / 2 / eye[2])),
        "principal_point_offset_x": -eye[0] / width,
        "principal_point_offset_y": eye[1] / height,
        "near_clip": _NEAR * eye[2] * unit,
        "far_clip": 1e4 * eye[2] * unit,
    }


def _parallel(
    placement: Placement, slope: tuple[float, float], frame: Float[np.ndarray, "4 4"]
) -> dict[str, Any]:
    mi = mitsuba()

    _, width = placement.size
    start = placement.seen[1] + width  # rays set out from there, in front of all that is seen
    x, y = slope
    half = width / 2
    pose = np.array(
        [[-half, 0, -x, x * start], [0, half, -y, y * start], [0, 0, -1, start], [0, 0, 0, 1]]
    )
    return {
        "type": "orthographic",
        "to_world": mi.ScalarTransform4f(frame @ pose),
        "near_clip": 1e-6 * width,
        "far_clip": 1e4 * width,
    }
