"""Where viewpoints and layers are, and how far each layer is shifted in each view.

Coordinates: x to the right, y down, z toward the viewer; the display plane is z = 0. A viewpoint
(X, Y, Z) is stored as its slope (X / Z, Y / Z), the tangent of the angle under which the centre of
the display sees it, and the common distance Z. At infinity the slope is the direction itself.

With layer k on the scaled grid x_k / (1 - z_k / Z), the light path from viewpoint i through the
point x of the display plane meets the layer at x + d_ik, a pure shift:

    d_ik = slope_i * z_k / (1 - z_k / Z) / pitch        (pixels)

Any other eye (X, Y, Z') meets layer k at m_k x + d_k, with x counted from the centre and

    m_k = (1 - z_k / Z') / (1 - z_k / Z),  d_k = X / Z' * z_k / (1 - z_k / Z) / pitch

Where viewpoints lie at different distances no grid makes all m equal to 1. The grid of layer k then
is that of the viewpoint that sees most of it, 1 - z_k / Z at its largest, so that m <= 1.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

Point = tuple[float, float]

_WHOLE = 1e-6  # shifts closer to a whole pixel than this are whole


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Viewpoints in a plane parallel to the display, and the depths of its layers.

    Args:
        slopes: (x, y) of every viewpoint, row by row from the top left; X / Z, no unit.
        depths: z of every layer, front (nearest to the viewer) to back, in metres.
        pitch: pixel pitch on the display plane, in metres.
        distance: Z of the viewpoints in metres; infinite for an orthographic display. One for
            every viewpoint where they differ.
        grid: (rows, columns) if the viewpoints form a grid.

    A display in pixel disparities is the orthographic one whose unit of length is the pixel:
    `pitch = 1`, depths are disparities, and slopes count view steps. A distance then is the number
    of pixels of the display plane that neighbouring viewpoints are apart at that distance.

    Raises:
        ValueError: depths not strictly decreasing, a layer at or behind a viewer, a grid that
            does not hold as many viewpoints as there are, or not as many distances.
    """

    slopes: tuple[Point, ...]
    depths: tuple[float, ...]
    pitch: float = 1.0
    distance: float | tuple[float, ...] = math.inf
    grid: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        numbers = [*self.depths, *(c for slope in self.slopes for c in slope)]
        if not all(map(math.isfinite, numbers)):
            raise ValueError("a viewpoint or layer depth is not a finite number")
        if not self.slopes:
            raise ValueError("there are no viewpoints; a display needs at least one")
        if not 1 <= len(self.depths) <= 8:
            raise ValueError(f"found {len(self.depths)} layers, expected 1 to 8")
        for front, back in pairwise(self.depths):
            if front <= back:
                raise ValueError(
                    f"layer depths must decrease from front to back, found {front:g} before "
                    f"{back:g}; list the layer nearest to the viewer first"
                )
        if not self.pitch > 0:
            raise ValueError(f"the pixel pitch is {self.pitch:g}, expected more than 0")
        if len(self.distances) != len(self.slopes):
            raise ValueError(
                f"found {len(self.distances)} distances, expected one for each of "
                f"{len(self.slopes)} viewpoints"
            )
        for distance in set(self.distances):
            self._refuse_near(distance)
        if self.grid is not None and math.prod(self.grid) != len(self.slopes):
            raise ValueError(f"a {self.grid} view grid does not hold {len(self.slopes)} viewpoints")

    @property
    def distances(self) -> tuple[float, ...]:
        """The distance Z of every viewpoint, in metres."""
        if isinstance(self.distance, tuple):
            return self.distance
        return (self.distance,) * len(self.slopes)

    @property
    def is_regular(self) -> bool:
        """Whether all viewpoints lie at one distance, so that layers are only shifted."""
        return len(set(self.distances)) == 1

    @property
    def approaches(self) -> tuple[float, ...]:
        """How much the slope of light paths grows per pixel of each view, (1/Z_0 - 1/Z) pitch.

        1/Z_0 is the mean over the viewpoints. An eye at another distance sees every pixel as an
        eye at Z_0 would that is elsewhere; it is how `scenes.render` takes distances.
        """
        inverse = [1 / distance for distance in self.distances]
        return tuple((sum(inverse) / len(inverse) - near) * self.pitch for near in inverse)

    @property
    def parallax(self) -> tuple[float, ...]:
        """Pixels by which each layer shifts for a slope of one, front to back."""
        return tuple(
            z / scale / self.pitch for z, scale in zip(self.depths, self.scales, strict=True)
        )

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of each layer's pixel relative to the pitch of the display plane, 1 - z / Z."""
        nearest, farthest = min(self.distances), max(self.distances)
        return tuple(1 - z / (farthest if z > 0 else nearest) for z in self.depths)

    @property
    def magnifications(self) -> tuple[tuple[float, ...], ...]:
        """The magnification m of every view and layer, `[view][layer]`; 1 for one distance."""
        return tuple(self.magnifications_from(distance) for distance in self.distances)

    def magnifications_from(self, distance: float) -> tuple[float, ...]:
        """The magnification of every layer for an eye at any distance, in metres.

        Raises:
            ValueError: the eye is at or behind the front layer or the display plane.
        """
        self._refuse_near(distance)
        layers = zip(self.depths, self.scales, strict=True)
        return tuple((1 - z / distance) / scale for z, scale in layers)

    def _refuse_near(self, distance: float) -> None:
        if not distance > max(self.depths[0], 0):
            raise ValueError(
                f"the front layer at {self.depths[0]:g} m is at or behind the viewer at "
                f"{distance:g} m; move the viewer back or the layer toward the display plane"
            )

    @property
    def shifts(self) -> tuple[tuple[Point, ...], ...]:
        """The shift d of every view and layer, `[view][layer] = (x, y)`, in pixels."""
        return tuple(self.shifts_toward(slope) for slope in self.slopes)

    def shifts_toward(self, slope: Point) -> tuple[Point, ...]:
        """The shift of every layer for an eye anywhere, whose slope is (X / Z, Y / Z)."""
        return tuple((_snap(slope[0] * p), _snap(slope[1] * p)) for p in self.parallax)

    def slope_at(self, position: Point) -> Point:
        """Return the slope of an eye at (x, y) view steps from the centre of the view grid.

        Raises:
            ValueError: the viewpoints form no grid.
        """
        if self.grid is None:
            raise ValueError(
                "the viewpoints are a list; view steps between them need a grid ('views')"
            )
        (left, top), (right, bottom) = self.slopes[0], self.slopes[-1]
        rows, columns = self.grid
        step = (right - left) / max(columns - 1, 1), (bottom - top) / max(rows - 1, 1)
        return (left + right) / 2 + position[0] * step[0], (top + bottom) / 2 + position[1] * step[
            1
        ]

    @property
    def margin(self) -> tuple[int, int]:
        """Pixels (y, x) by which layers exceed the views on each side: ceil(max |d|)."""
        flat = [shift for view in self.shifts for shift in view]
        return math.ceil(max(abs(y) for _, y in flat)), math.ceil(max(abs(x) for x, _ in flat))


def grid_points(grid: tuple[int, int], step: Point = (1.0, 1.0)) -> tuple[Point, ...]:
    """Return the (x, y) of a centred grid of viewpoints, row by row from the top left.

    >>> grid_points((1, 3), (0.5, 0.5))
    ((-0.5, 0.0), (0.0, 0.0), (0.5, 0.0))
    """
    rows, columns = grid
    return tuple(
        ((column - (columns - 1) / 2) * step[0], (row - (rows - 1) / 2) * step[1])
        for row in range(rows)
        for column in range(columns)
    )


def _snap(shift: float) -> float:
    whole = float(round(shift))
    return whole if abs(shift - whole) < _WHOLE else shift
