"""A display as it is written down: validated data, one TOML file, no arithmetic beyond units."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from layerfield.geometry import Geometry, Point, grid_points
from layerfield.panel_spec import PanelSpec
from layerfield.toml_model import Number, parse_toml, read_toml_text, validated
from layerfield.transfer import NONE, WrittenTransfer

# Strict: no text or truth value passes for a number.
Count = Annotated[int, Field(strict=True, ge=1)]
Grid = tuple[Count, Count]
Viewpoints = tuple[tuple[Number, Number], ...]
PlacedViewpoints = tuple[tuple[Number, Number, Number], ...]
Depths = Annotated[tuple[Number, ...], Field(min_length=1, max_length=8)]

_MOST_VIEWS = 10_000
_MOST_SUBFRAMES = 64
_WIDEST_MARGIN = 4096  # pixels; wider ones come from mistaken units


class _Spec(BaseModel):
    """What all displays say.

    Args:
        name: in tables and results.
        description: one sentence.
        link: how a light path combines the layers.
        views: rows and columns of the view grid.
        subframes: pictures that every layer shows one after the other, too fast for the eye,
            which sees their mean.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    name: str = "display"
    description: str = ""
    link: Literal["additive", "multiplicative", "polarisation"]
    views: Grid | None = None
    subframes: Annotated[int, Field(strict=True, ge=1, le=_MOST_SUBFRAMES)] = 1
    transfer: WrittenTransfer = NONE

    @model_validator(mode="after")
    def _geometry_holds(self):
        if self.views is not None and math.prod(self.views) > _MOST_VIEWS:
            raise ValueError(
                f"'views' is {list(self.views)}, expected at most {_MOST_VIEWS} in all"
            )
        if self.link == "additive" and self.subframes > 1:
            raise ValueError(
                f"'subframes' is {self.subframes}, but a mean of sums is a sum: time multiplexing "
                "adds nothing to additive layers; leave it out"
            )
        _refuse_far_shifts(self.geometry())
        return self

    def geometry(self) -> Geometry:
        """Return the geometry in metres (or pixels, for displays in pixel disparities)."""
        raise NotImplementedError

    def eye(self, position: Sequence[float]) -> tuple[Point, float | None]:
        """Return slope and distance of an eye for `Display.look`, from the units of the file.

        Args:
            position: X, Y, and perhaps how far the eye is.

        Raises:
            ValueError: the eye is at or behind a layer, or its distance is missing.
        """
        raise NotImplementedError


class DisparitySpec(_Spec):
    """A display in pixel disparities: layer k shifts by `disparity[k]` pixels from view to view.

    Args:
        disparity: shift per view step, pixels, front to back (strictly decreasing).
        views: rows and columns of the view grid, or else
        viewpoints: (x, y) of every viewpoint in view steps.
    """

    disparity: Depths
    viewpoints: Viewpoints | None = None

    def geometry(self) -> Geometry:
        points = _one_of(self.views, self.viewpoints, "viewpoints", (1.0, 1.0))
        return Geometry(slopes=points, depths=self.disparity, grid=self.views)

    def eye(self, position: Sequence[float]) -> tuple[Point, float | None]:
        x, y, *distance = position
        if distance:
            _refuse_near(distance[0], self.disparity[0], "px from viewpoint to viewpoint")
        return (x, y), distance[0] if distance else None


class PhysicalSpec(_Spec):
    """A display in millimetres.

    Args:
        depth_mm: distance of every layer from the display plane toward the viewer, front to back.
        pitch_um: pixel pitch on the display plane, micrometres.
        viewing_distance_mm: from the display plane to the viewpoints; `inf` for orthographic. Left
            out where `viewpoints_mm` holds distances.
        views: rows and columns of the view grid, spread over
        viewing_angle_deg: the angle between its outermost viewpoints seen from the centre of the
            display, along its longer side (the step is the same along both) or [horizontal,
            vertical]; or else
        viewpoints_mm: (x, y) of every viewpoint on its plane, at a finite distance; or (x, y, z),
            where z, its own distance, is that from the display plane.
        panels: what shows the layers, front to back; none if that does not matter yet.
    """

    depth_mm: Depths
    pitch_um: Annotated[Number, Field(gt=0)]
    viewing_distance_mm: Annotated[float, Field(strict=True, gt=0)] | None = None
    viewing_angle_deg: Number | tuple[Number, Number] | None = None
    viewpoints_mm: Viewpoints | PlacedViewpoints | None = None
    panels: tuple[PanelSpec, ...] = ()

    @model_validator(mode="after")
    def _panel_for_every_layer(self):
        if self.panels and len(self.panels) != len(self.depth_mm):
            raise ValueError(
                f"found {len(self.panels)} panels for {len(self.depth_mm)} layers; write one "
                "[[panels]] table for each number of 'depth_mm', front to back"
            )
        return self

    def geometry(self) -> Geometry:
        if self.views is not None and self.viewing_angle_deg is None:
            raise ValueError("'viewing_angle_deg' is missing; it says how far apart the views are")
        placed = self._placed()
        distances = tuple(z * 1e-3 for _, _, z in placed)
        return Geometry(
            slopes=_one_of(
                self.views,
                tuple((x / z, y / z) for x, y, z in placed) or None,
                "viewpoints_mm",
                self._step(),
            ),
            depths=tuple(z * 1e-3 for z in self.depth_mm),
            pitch=self.pitch_um * 1e-6,
            distance=distances if len(set(distances)) > 1 else self._distance() * 1e-3,
            grid=self.views,
        )

    def _distance(self) -> float:
        """Where the viewpoints are, unless they have distances of their own that differ."""
        own = {point[2] for point in self.viewpoints_mm or () if len(point) == 3}
        if self.viewing_distance_mm is None and not own:
            raise ValueError("the key 'viewing_distance_mm' is missing")
        if self.viewing_distance_mm is not None and own:
            raise ValueError(
                "'viewpoints_mm' holds distances, and there is a 'viewing_distance_mm'; leave out "
                "either"
            )
        return own.pop() if len(own) == 1 else self.viewing_distance_mm or math.nan

    def _placed(self) -> PlacedViewpoints:
        """The viewpoints listed, each with its distance."""
        common = self._distance()
        if self.viewpoints_mm is not None and math.isinf(common):
            raise ValueError("'viewpoints_mm' needs a finite 'viewing_distance_mm'")
        placed = tuple(p if len(p) == 3 else (*p, common) for p in self.viewpoints_mm or ())
        nearest = min((z for _, _, z in placed), default=math.inf)
        if not nearest > max(self.depth_mm[0], 0):
            raise ValueError(
                f"a viewpoint is {nearest:g} mm away, at or behind the front layer at "
                f"{self.depth_mm[0]:g} mm; move it away from the display"
            )
        return placed

    def eye(self, position: Sequence[float]) -> tuple[Point, float | None]:
        x, y, *rest = position
        distance = rest[0] if rest else self._distance()
        if not math.isfinite(distance):
            paths = "are parallel" if math.isinf(distance) else "come from different distances"
            raise ValueError(
                f"light paths of display '{self.name}' {paths}; say where the eye is as X,Y,Z, in "
                "millimetres"
            )
        _refuse_near(distance, self.depth_mm[0], "mm")
        return (x / distance, y / distance), distance * 1e-3

    def _step(self) -> Point:
        if self.views is None or self.viewing_angle_deg is None:
            return (0.0, 0.0)
        rows, columns = self.views
        angles = self.viewing_angle_deg
        pair = angles if isinstance(angles, tuple) else (angles, angles)
        if not all(0 < angle < 180 for angle in pair):
            raise ValueError(f"'viewing_angle_deg' is {angles}, expected between 0 and 180")
        spread = [2 * math.tan(math.radians(angle) / 2) for angle in pair]
        if isinstance(angles, tuple):
            return (spread[0] / max(columns - 1, 1), spread[1] / max(rows - 1, 1))
        step = spread[0] / max(columns - 1, rows - 1, 1)
        return (step, step)


def _refuse_far_shifts(geometry: Geometry) -> None:
    slope = max(abs(c) for point in geometry.slopes for c in point)
    shift = slope * max(map(abs, geometry.parallax))
    if not shift <= _WIDEST_MARGIN:
        raise ValueError(
            f"the outermost views shift the layers by up to {shift:.0f} px, expected at most "
            f"{_WIDEST_MARGIN}; check the numbers and their units"
        )


def _refuse_near(distance: float, front: float, unit: str) -> None:
    if not distance > max(front, 0):
        raise ValueError(
            f"the eye is at a distance of {distance:g} {unit}, at or behind the front layer at "
            f"{front:g}; expected more than {max(front, 0):g}"
        )


Spec = DisparitySpec | PhysicalSpec


def _one_of(
    grid: tuple[int, int] | None, listed: tuple[Point, ...] | None, key: str, step: Point
) -> tuple[Point, ...]:
    if (grid is None) == (listed is None):
        raise ValueError(f"expected either 'views' or '{key}', found both or neither")
    return listed if grid is None else grid_points(grid, step)  # pyright: ignore[reportReturnType]


def parse_spec(text: str, source: str, folder: Path | None = None) -> Spec:
    """Parse the TOML text of a display.

    Args:
        text: of the file.
        source: what an error calls it.
        folder: where the files that it names are; the working folder if not given.

    Raises:
        ValueError: not TOML, an unknown or missing key, or values that make no display; one line
            that names the source, the key and the remedy.
    """
    data = parse_toml(text, source)
    model = PhysicalSpec if any(key in data for key in _PHYSICAL_KEYS) else DisparitySpec
    return validated(model, data, source, folder)


def format_spec(spec: Spec) -> str:
    """Return the TOML text from which `parse_spec` makes the same display."""
    data = spec.model_dump(mode="python", exclude_none=True, exclude_defaults=True)
    panels = data.pop("panels", ())
    return _lines(data) + "".join(f"\n[[panels]]\n{_lines(panel)}" for panel in panels)


def _lines(data: dict[str, Any]) -> str:
    return "".join(f"{key} = {_toml(value)}\n" for key, value in data.items())


def read_spec(path: Path) -> Spec:
    """Read a display from a TOML file."""
    return parse_spec(read_toml_text(path, "a display"), str(path), path.parent)


_PHYSICAL_KEYS = set(PhysicalSpec.model_fields) - set(DisparitySpec.model_fields)


def _toml(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + " }"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)  # numbers: repr is exact, and inf is TOML
