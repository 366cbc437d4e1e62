"""Where a scene stands in the picture and in the depth of a display.

Picture coordinates: x to the right, y up, z toward the viewer, in pixels of the display plane; the
plane is z = 0 and its centre the origin. A point v of the scene, turned to face the viewer, is at

    p = scale (R v - centre)                         pixels

and appears at the depth gain * p_z: in metres, or on a display in pixel disparities in pixels from
view to view. A smaller gain than the pitch flattens the scene like a relief. That is a matter of
the viewpoints: seen from slopes that are gain / pitch times as large and from distances that are
1 / gain as large, in pixels, the scene itself has the parallax and the light of the flattened one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from layerfield.display import Display
from layerfield.display_spec import DisparitySpec
from layerfield.geometry import Geometry

_FLAT = 1e-4  # of its extent: thinner scenes have no depth to fit
_UNDER = 0.12  # of the picture's height: room below a scene that stands on a ground


@dataclass(frozen=True)
class Pose:
    """How a scene is turned before it is seen from the front.

    Args:
        azimuth: degrees about the vertical axis, counterclockwise from above.
        elevation: degrees by which the viewer looks down on it, -90 to 90.
    """

    azimuth: float = 0.0
    elevation: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.azimuth) or not -90 <= self.elevation <= 90:
            raise ValueError(
                f"the pose is azimuth {self.azimuth:g}, elevation {self.elevation:g}; expected "
                "degrees, the elevation from -90 to 90"
            )

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """R, from an upright scene to what the viewer faces."""
        a, e = math.radians(self.azimuth), math.radians(self.elevation)
        turn = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
        tilt = np.array([[1, 0, 0], [0, math.cos(e), -math.sin(e)], [0, math.sin(e), math.cos(e)]])
        return tilt @ turn


@dataclass(frozen=True, eq=False)
class Extent:
    """The box around what is seen of a turned scene, in its own units.

    Args:
        low: smallest x, y and z.
        high: largest.
    """

    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        if not np.isfinite([self.low, self.high]).all() or not self.width > 0:
            raise ValueError(
                "all points of the scene are at one place; expected a model with an extent"
            )

    @property
    def width(self) -> float:
        """The largest of width, height and depth."""
        return float((self.high - self.low).max())

    def united(self, other: "Extent") -> "Extent":
        """Return the box around both."""
        return Extent(np.minimum(self.low, other.low), np.maximum(self.high, other.high))


def extent_of(
    vertices: Float[np.ndarray, "vertex 3"], rotation: Float[np.ndarray, "3 3"]
) -> Extent:
    """Return the box around turned vertices."""
    turned = vertices @ rotation.T
    return Extent(turned.min(0), turned.max(0))


@dataclass(frozen=True, kw_only=True)
class Fit:
    """How large and how deep a scene is to appear.

    Args:
        share: of the width or height of the picture that it takes, whichever is reached first.
        scale: millimetres (pixels, on a display in pixel disparities) of the picture for one unit
            of the model, instead of a share.
        depth: from its nearest to its farthest point, in millimetres (pixels of disparity); the
            depth of the display, from the front layer to the back one, if not given.
    """

    share: float | None = None
    scale: float | None = None
    depth: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("fit", self.share), ("scale", self.scale), ("depth", self.depth)):
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"the {name} is {value:g}, expected a number above 0")
        if self.share is not None and self.scale is not None:
            raise ValueError("fit and scale both say how large the model is; leave out either")


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    """See the head of this module.

    Args:
        geometry: of the display.
        size: height and width of the views, in pixels.
        scale: pixels of the picture for one unit of the scene.
        gain: depth for one pixel, in metres or in pixels of disparity.
        centre: the point of the turned scene that lies in the centre of the display plane.
        front: z of the nearest point of the scene, in pixels.
        back: z of the farthest.
        seen: z of the farthest and of the nearest visible point, those of the ground among them.
        extent: of the turned scene in all its poses.
    """

    geometry: Geometry
    size: tuple[int, int]
    scale: float
    gain: float
    centre: Float[np.ndarray, " 3"]
    front: float
    back: float
    seen: tuple[float, float]
    extent: Extent

    def to_picture(self, pose: Pose) -> Float[np.ndarray, "4 4"]:
        """Return the map from an upright scene to picture coordinates."""
        made = np.eye(4)
        made[:3, :3] = self.scale * pose.rotation
        made[:3, 3] = -self.scale * self.centre
        return made

    @property
    def depths(self) -> tuple[float, float]:
        """Depth of the farthest and the nearest point of the scene, as the geometry counts it."""
        return self.gain * self.back, self.gain * self.front

    @property
    def slant(self) -> float:
        """Shift in pixels of a point at z = 1 for a slope of one, without perspective."""
        return self.gain / self.geometry.pitch

    def distance(self, view: int) -> float:
        """Return how far a viewpoint is, in pixels."""
        return self.geometry.distances[view] / self.gain

    def disparities(self) -> tuple[float, float]:
        """Return the disparity of the farthest and the nearest point of the scene.

        In pixels between neighbouring views; for a slope of one where these form no grid.
        """
        low, high = self.disparity(np.array([self.back, self.front]))
        return float(low), float(high)

    def disparity(self, z: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
        """Return the disparity of points at z, step * slant z / (1 - z / Z), as `disparities`."""
        mean = np.mean([1 / self.distance(i) for i in range(len(self.geometry.slopes))])
        return view_step(self.geometry) * self.slant * z / (1 - z * mean)


def view_step(geometry: Geometry) -> float:
    """Return the slope between neighbouring views of a row, or of a column if there is but one.

    1 where the viewpoints form no grid, or there is a single one.
    """
    if geometry.grid is None or len(geometry.slopes) == 1:
        return 1.0
    rows, columns = geometry.grid
    (left, top), (right, bottom) = geometry.slopes[0], geometry.slopes[-1]
    return (right - left) / (columns - 1) if columns > 1 else (bottom - top) / (rows - 1)


@runtime_checkable
class Ground(Protocol):
    """What a scene stands on, as far as it takes room in depth; y and z of the turned scene."""

    def shows(self, extents: Sequence[tuple[Pose, Extent]]) -> bool:
        """Whether it is seen from above in any pose."""
        ...

    def nearest(self, extents: Sequence[tuple[Pose, Extent]], bottom: float) -> float:
        """Return the z of its nearest point that is not below the picture, whose edge is there."""
        ...

    def farthest(self, extents: Sequence[tuple[Pose, Extent]], extent: Extent, top: float) -> float:
        """Return the z of its farthest point below the upper edge of the picture."""
        ...


def in_disparities(display: Display) -> bool:
    """Whether a display counts depth in pixels of disparity, not in millimetres."""
    return isinstance(display.spec, DisparitySpec)


def place(
    extents: Sequence[tuple[Pose, Extent]],
    display: Display,
    size: tuple[int, int],
    fit: Fit,
    *,
    share: float,
    ground: Ground | None = None,
) -> Placement:
    """Place a scene: its width and height in the picture, its depth in that of the display.

    Its nearest point comes to the depth of the front layer, the farthest to that of the back one,
    and those between linearly; the ground, which is plain, goes on beyond both. On a physical
    display a scene keeps its proportions where they take less than this, about the middle of the
    layers; `fit.depth` is obeyed in any case.

    Args:
        extents: of the scene in all poses that it takes; the place is one for all.
        display: that is to show it.
        size: height and width of the views, in pixels.
        fit: what is asked for.
        share: of the picture that the scene takes if nothing is asked for.
        ground: what it stands on.

    Raises:
        ValueError: a display without depth and none asked for, or a scene that reaches a viewer.
    """
    geometry = display.geometry
    extent = reduce(Extent.united, (each for _, each in extents))
    front, back = depth_range(display, fit)
    # what the front layer shows looks this much larger than on the display plane
    height, width = (side * (1 - front / min(geometry.distances)) for side in size)
    scale = _scale(extent, (height, width), display, fit, share)
    middle = (extent.low + extent.high) / 2
    near, far = extent.high[2], extent.low[2]
    deep = near - far if near - far > _FLAT * extent.width else extent.width
    gain = (front - back) / (scale * deep)
    if fit.depth is None and not in_disparities(display):
        gain = min(gain, geometry.pitch)
    middle[2] -= (front + back) / 2 / (gain * scale)
    seen = far, near
    if ground is not None:
        sunk = extent.low[1] + (0.5 - _UNDER) * height / scale
        middle[1] = min(middle[1], sunk) if ground.shows(extents) else middle[1]
        edge = height / 2 / scale
        seen = (
            ground.farthest(extents, extent, middle[1] + edge),
            max(near, ground.nearest(extents, middle[1] - edge)),
        )
    return Placement(
        geometry=geometry,
        size=size,
        scale=float(scale),
        gain=float(gain),
        centre=middle,
        front=float(scale * (near - middle[2])),
        back=float(scale * (far - middle[2])),
        seen=(float(scale * (seen[0] - middle[2])), float(scale * (seen[1] - middle[2]))),
        extent=extent,
    )


def depth_range(display: Display, fit: Fit) -> tuple[float, float]:
    """Return the depth of the nearest and the farthest point, as the geometry counts it.

    Raises:
        ValueError: a display without depth and none asked for, or one that reaches a viewer.
    """
    unit, name = (1.0, "px of disparity") if in_disparities(display) else (1e-3, "mm")
    depths, nearest = display.geometry.depths, min(display.geometry.distances)
    front, back = depths[0], depths[-1]
    if fit.depth is not None:
        middle, half = (front + back) / 2, fit.depth * unit / 2
        front, back = middle + half, middle - half
    if front == back:
        raise ValueError(
            f"the layer of display '{display.name}' has no depth to fit the scene into; say how "
            f"deep it is to appear, in {name}"
        )
    if not front < nearest:
        raise ValueError(
            f"the scene would reach to {front / unit:g} {name} in front of the display, where the "
            f"nearest viewer is at {nearest / unit:g}; make it less deep"
        )
    return front, back


def _scale(
    extent: Extent, room: tuple[float, float], display: Display, fit: Fit, share: float
) -> float:
    """Pixels for one unit of the scene."""
    if fit.scale is not None:
        return fit.scale * (1.0 if in_disparities(display) else 1e-3) / display.geometry.pitch
    across, up, _ = extent.high - extent.low
    most = [side / extend for side, extend in zip(room, (up, across), strict=True) if extend > 0]
    return (fit.share or share) * min(most, default=room[1] / extent.width)
