"""What the command line refuses before any work is done."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from layerfield.between import parse_targets
from layerfield.display import Display, preset_names
from layerfield.io.images import SUFFIXES
from layerfield.light_field import LightField
from layerfield.nearest import did_you_mean
from layerfield.rendering.placement import in_disparities

DEVICES = ("cpu", "cuda")


def refuse_unknown(what: str, name: str, known: Sequence[str]) -> None:
    """Refuse a name that is none of those known, with the nearest one."""
    if name not in known:
        raise ValueError(f"unknown {what} '{name}'{did_you_mean(name, known)}")


def refuse_without(option: str, given: object, others: dict[str, object]) -> None:
    """Refuse options, by their names, that say nothing unless another one is given."""
    for name, value in others.items():
        if given is None and value is not None:
            raise ValueError(f"--{name} is about what {option} makes; give that, too")


def refuse_device(name: str) -> None:
    """Refuse a processor that is not there."""
    refuse_unknown("device", name, DEVICES)
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("there is no CUDA device here; use --device cpu")


def refuse_repeats(what: str, names: list[str]) -> None:
    """Refuse two things of one name."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(
                f"found {count} {what} called '{name}'; give each once, by a name of its own"
            )


def keep_inputs(out: Path, *inputs: str | Path | None) -> None:
    """Refuse to replace what is read, even by force, or to put a picture among the views."""
    for given in (Path(name) for name in inputs if name and Path(name).exists()):
        source, place = given.resolve(), out.resolve()
        among = place.parent == source and place.suffix.lower() in SUFFIXES
        if among or (out.exists() and source.is_relative_to(place)):
            raise ValueError(f"{out} is, holds or lies among the input {given}; give another name")


def own_file(display: str | None) -> str | None:
    """Return the file that a display is read from; None for presets."""
    return None if display in preset_names() else display


def depth_asked(display: Display, millimetres: float | None, pixels: float | None) -> float | None:
    """Return the depth in the unit that a display counts in; refuse the other one."""
    counts_pixels = in_disparities(display)
    wrong = millimetres if counts_pixels else pixels
    if wrong is not None:
        kind, right = ("px of disparity", "px") if counts_pixels else ("mm", "mm")
        raise ValueError(
            f"the depth of display '{display.name}' is in {kind}; give --depth-{right} instead"
        )
    return pixels if counts_pixels else millimetres


def told_apart(loaded: list[LightField], paths: list[str]) -> list[LightField]:
    """Name light fields by their folder, too, where their names are the same."""
    names = Counter(field.name for field in loaded)
    apart = [
        replace(field, name=f"{Path(path).resolve().parent.name}/{field.name}")
        if names[field.name] > 1
        else field
        for field, path in zip(loaded, paths, strict=True)
    ]
    refuse_repeats("light fields", [field.name for field in apart])
    return apart


def refuse_small(field: LightField, smallest: int) -> None:
    """Refuse views with fewer pixels than this along an axis.

    Raises:
        ValueError: they are smaller.
    """
    if min(field.size) < smallest:
        height, width = field.size
        raise ValueError(
            f"the views of '{field.name}' are {width}x{height} px, expected at least "
            f"{smallest}x{smallest}; take larger ones"
        )


def refuse_targets(targets: str | None, displays: list[Display]) -> None:
    """Refuse targets between viewpoints that make no sense, or displays that have none."""
    if targets is not None:
        parse_targets(targets)
        refuse_lists(displays, "--targets-between")


def refuse_lists(displays: list[Display], option: str) -> None:
    """Refuse displays whose viewpoints are no grid, for an option that needs one."""
    for display in displays:
        if display.geometry.grid is None:
            raise ValueError(
                f"the viewpoints of display '{display.name}' are a list; {option} needs a grid of "
                "them ('views')"
            )
