"""The options of `render`, in groups, and what is made of them."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import Bits
from layerfield.cli.refusals import depth_asked
from layerfield.display import Display
from layerfield.panels import largest_code
from layerfield.rendering.job import Quality
from layerfield.rendering.opening import is_mitsuba
from layerfield.rendering.placement import Fit, Pose
from layerfield.rendering.poses import read_poses, turntable

_PLACE, _MOVES = "Place", "Animation"
_SAMPLES = 64  # paths for each pixel
_ELEVATION = 20.0  # degrees from which models are looked down upon

Number = float | None


@dataclass(frozen=True, kw_only=True)
class QualityOptions:
    """How views are rendered."""

    size: Annotated[str, typer.Option("--size", help="WxH of a view, pixels")] = "512x384"
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=1, help="paths for each pixel: more take noise away; 64"),
    ] = None
    quick: Annotated[
        bool, typer.Option("--preview", help="only what each pixel sees first, no shadows: seconds")
    ] = False
    maps: Annotated[
        bool, typer.Option("--depth", help="write depth and disparity of every view, too")
    ] = False
    exposure: Annotated[float, typer.Option("--exposure", help="in stops")] = 0.0
    seed: Annotated[int | None, typer.Option("--seed", help="of the noise; 0")] = None
    bits: Bits = 8

    def parsed(self) -> Quality:
        """Return what the renderer takes; raise a ValueError that says what is wrong."""
        largest_code(self.bits)
        if self.quick:
            for name, given in (("--samples", self.samples), ("--seed", self.seed)):
                if given is not None:
                    raise ValueError(
                        f"found {name} {given}, but --preview traces no paths and has no noise; "
                        "leave out either"
                    )
        return Quality(
            size=_parse_size(self.size),
            samples=0 if self.quick else self.samples or _SAMPLES,
            exposure=self.exposure,
            bits=self.bits,
            seed=self.seed or 0,
            maps=self.maps,
        )


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """Where a model stands, and how large and how deep it is."""

    fit: Annotated[
        Number,
        typer.Option(
            "--fit", help="share of the picture for the model; 0.8", rich_help_panel=_PLACE
        ),
    ] = None
    scale: Annotated[
        Number,
        typer.Option(
            "--scale", help="mm (or px) for one unit of the model, instead", rich_help_panel=_PLACE
        ),
    ] = None
    depth_mm: Annotated[
        Number,
        typer.Option(
            "--depth-mm", help="depth of what is seen; that of the display", rich_help_panel=_PLACE
        ),
    ] = None
    depth_px: Annotated[
        Number,
        typer.Option(
            "--depth-px",
            help="the same for displays in pixels of disparity",
            rich_help_panel=_PLACE,
        ),
    ] = None
    up: Annotated[
        str | None,
        typer.Option("--up", help="axis of the model: y, of STL z", rich_help_panel=_PLACE),
    ] = None
    azimuth: Annotated[
        float,
        typer.Option("--azimuth", help="degrees the model is turned by", rich_help_panel=_PLACE),
    ] = 0.0
    elevation: Annotated[
        Number,
        typer.Option(
            "--elevation", help="degrees one looks down; 20, of .xml 0", rich_help_panel=_PLACE
        ),
    ] = None
    ground: Annotated[
        bool,
        typer.Option("--ground/--no-ground", help="floor and backdrop", rich_help_panel=_PLACE),
    ] = True

    def fit_to(self, display: Display) -> Fit:
        """Return size and depth in the unit that a display counts in."""
        depth = depth_asked(display, self.depth_mm, self.depth_px)
        return Fit(share=self.fit, scale=self.scale, depth=depth)

    def pose(self, scene: str) -> Pose:
        """Return how a scene is turned; one of Mitsuba has a camera of its own."""
        own = 0.0 if is_mitsuba(scene) else _ELEVATION
        return Pose(self.azimuth, own if self.elevation is None else self.elevation)


@dataclass(frozen=True, kw_only=True)
class MoveOptions:
    """How a scene is turned from frame to frame."""

    turns: Annotated[
        int | None,
        typer.Option("--turntable", help="frames of one turn", rich_help_panel=_MOVES),
    ] = None
    path: Annotated[
        Path | None,
        typer.Option(
            "--path", help="CSV of azimuth,elevation for each frame", rich_help_panel=_MOVES
        ),
    ] = None

    def poses(self, start: Pose) -> tuple[Pose, ...]:
        """Return the pose of every frame."""
        if self.path is not None and self.turns is not None:
            raise ValueError(
                "--turntable and --path both say how the scene moves; leave out either"
            )
        if self.path is not None:
            return read_poses(self.path)
        return (start,) if self.turns is None else turntable(self.turns, start)


def _parse_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip())
    if match is None:
        raise ValueError(f"size is '{text}', expected WxH in pixels, as 512x384")
    return int(match[2]), int(match[1])
