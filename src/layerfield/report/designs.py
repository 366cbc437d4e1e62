"""What `layerfield design` leaves: display files, figures in JSON, a map of contrast."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from layerfield.design import LARGEST, USUAL, Design, Suggestion
from layerfield.display_spec import format_spec
from layerfield.metrics import decibels
from layerfield.report.plots import Axes3, Map, maps, save
from layerfield.spectrum import contrast

_COLUMNS, _ROWS = 241, 151  # of a map


def write_design(folder: Path, found: Design) -> None:
    """Write a display file for every suggestion and the map of contrast.

    Args:
        folder: an empty one, or one to make.
        found: the design.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for each in found.suggestions:
        (folder / _file(each)).write_text(format_spec(found.spec(each)), "utf-8")
    save(contrast_figure(found), folder / "contrast.png")


def write_designs(
    folder: Path, together: Design, alone: Sequence[Design], facts: Mapping[str, Any]
) -> None:
    """Write a design for light fields together, and those for each alone into folders.

    Args:
        folder: an empty one.
        together: the design for all of them.
        alone: for each, in order; none if there is only one.
        facts: more that design.json is to hold.
    """
    write_design(folder, together)
    for own in alone:
        write_design(folder / own.fields[0], own)
    record = {"together": as_record(together)} if alone else as_record(together)
    record |= {"alone": [as_record(own) for own in alone]} if alone else {}
    (folder / "design.json").write_text(json.dumps(record | dict(facts), indent=2), "utf-8")


def _file(suggestion: Suggestion) -> str:
    return suggestion.name.replace("design", "display") + ".toml"


def as_record(found: Design) -> dict[str, Any]:
    """Return a design as plain data; ranked, the best first. A perfect figure becomes null."""
    ranked = sorted([*found.suggestions, found.usual], key=lambda each: each.solved)
    return {
        "fields": list(found.fields),
        "link": found.link,
        "views": list(found.grid),
        "solved_on_at_most": [LARGEST, LARGEST],
        "ranking": [
            {
                "name": each.name,
                "file": None if each is found.usual else _file(each),
                "layers": len(each.disparity),
                "disparity": list(each.disparity),
                "predicted_psnr": _finite(decibels(each.predicted)),
                "psnr": _finite(decibels(each.solved)),
                "gain_db": _finite(found.gain(each)),
            }
            for each in ranked
        ],
    }


def _listed(disparities: Sequence[float]) -> str:
    return ", ".join(f"{each:g}" for each in disparities)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def design_lines(found: Design) -> list[list[str]]:
    """Return the table of a design, its heading first."""
    heading = ["display", "layers", "disparities", "predicted dB", "solved dB"]
    lines = [[*heading, f"over {_listed(USUAL)}"]]
    for each in (*found.suggestions, found.usual):
        lines.append(
            [
                _file(each) if each is not found.usual else "",
                str(len(each.disparity)),
                _listed(each.disparity),
                f"{decibels(each.predicted):.2f}",
                f"{decibels(each.solved):.2f}",
                f"{found.gain(each):+.2f}" if math.isfinite(found.gain(each)) else "",
            ]
        )
    return lines


def contrast_figure(found: Design) -> Figure:
    """Return maps of the contrast that each suggested display can show."""
    stacks = [each.disparity for each in found.suggestions]
    near, far = max(map(max, stacks)) + 1, min(map(min, stacks)) - 1
    disparities = torch.linspace(far, near, _COLUMNS, dtype=torch.float64)
    frequencies = torch.linspace(0, 0.5, _ROWS, dtype=torch.float64)
    views = found.grid[1] if found.grid[1] > 1 else found.grid[0]
    panels = [
        Map(
            title=f"{_file(each)}, {decibels(each.solved):.2f} dB\n{_listed(each.disparity)}",
            values=contrast(each.disparity, views, disparities, frequencies).T,
            x_range=(far, near),
            y_range=(0, 0.5),
            marks=each.disparity,
        )
        for each in found.suggestions
    ]
    names = Axes3(
        x="disparity, px per view step",
        y="frequency, cycles per px",
        value="contrast of a grating",
        marks="dashed red: the layers; black: contrast 0.5",
    )
    shown = (
        ", ".join(found.fields) if len(found.fields) < 4 else f"{len(found.fields)} light fields"
    )
    return maps(f"What {found.link} displays suggested for {shown} can show", panels, names)
