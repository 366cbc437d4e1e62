"""How commands read light fields, with the eyes between and around their viewpoints."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from layerfield.between import given_between, interpolated_between, parse_targets
from layerfield.cli.refusals import refuse_small
from layerfield.io import FieldOptions, load_eye_views, load_light_field
from layerfield.light_field import EyeViews, LightField

_SMALLEST = 11  # pixels of a view, the window of SSIM


def read_field(path: str, options: FieldOptions, targets: str | None = None) -> LightField:
    """Read a light field, with targets between its viewpoints if they are asked for.

    Args:
        path: of it.
        options: how to read it.
        targets: as `parse_targets` takes them.

    Raises:
        ValueError: it cannot be read, is too small, or has no views between those taken.
    """
    loaded = load_light_field(path, options)
    refuse_small(loaded, _SMALLEST)
    if targets is None:
        return loaded
    kind, weight = parse_targets(targets)
    if kind == "given":
        between = given_between(load_eye_views(path, options, reach=1), loaded)
    else:
        between = interpolated_between(loaded)
    return replace(loaded, between=replace(between, weight=weight))


def read_as_recorded(path: str, facts: Mapping[str, Any]) -> LightField:
    """Read a light field in the way that the facts of a result record.

    Raises:
        ValueError: as `read_field` does, or what is recorded are no options.
    """
    match facts:
        case {"field": {"options": dict(options)}}:
            return read_field(path, FieldOptions.as_recorded(options))
    return read_field(path, FieldOptions())


def read_around(path: str, options: FieldOptions, field: LightField, *, between: bool) -> EyeViews:
    """Read what eyes in and around the viewpoints of a light field see.

    Args:
        path: of the light field.
        options: how it was read.
        field: what was read.
        between: whether there must be views between those taken.

    Raises:
        ValueError: there are no others, or none between.
    """
    around = load_eye_views(path, options)
    if between:
        given_between(around, field)
    if len(around.positions) <= len(field):
        raise ValueError(
            f"'{field.name}' has no views in or around those that are taken; take fewer, with "
            "--views or --step"
        )
    return around
