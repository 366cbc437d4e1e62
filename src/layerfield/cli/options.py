"""Options that commands share, and those that say how to read a light field."""

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from layerfield.io import FieldOptions

Field = Annotated[str, typer.Argument(help="folder of views, picture, .npy, .npz or .h5")]
Out = Annotated[Path, typer.Option("--out", help="folder to make")]
Force = Annotated[bool, typer.Option("--force", help="replace an earlier result")]
Bits = Annotated[int, typer.Option("--bits", help="of the images that are written: 8 or 16")]
TargetsBetween = Annotated[
    str | None,
    typer.Option(
        "--targets-between",
        help="make layers for eyes between the viewpoints, too: given or interpolated, perhaps "
        "with a weight, as given:0.5",
    ),
]
DisplayName = Annotated[str, typer.Option("--display", help="a preset or a TOML file")]
Device = Annotated[str, typer.Option("--device", help="cpu or cuda")]
Iterations = Annotated[
    int | None, typer.Option("--iterations", min=0, help="the method's own if not given")
]

_FIELD_OPTIONS = {
    "grid": "rows x columns of the stored views, as 5x5",
    "order": "corner of the first view and what runs first: tl-row, bl-row, tr-column ...",
    "step": "take every n-th view in both directions",
    "views": "take the central views, as 5x5",
    "shift": "subtract this from every disparity, pixels per view",
    "scale": "resize every view by this factor",
    "crop": "WxH (central) or WxH+X+Y, pixels",
    "quilt": "the picture is a quilt: CxR or CxRaA",
    "lenslet": "the picture is seen through lenslets of this many pixels",
}


def with_field_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that say how to read a light field, gathered as `options`."""

    @wraps(command)
    def wrapper(*args: Any, **values: Any) -> None:
        chosen = {name: values.pop(name) for name in _FIELD_OPTIONS}
        command(*args, options=FieldOptions.parse(**chosen), **values)

    own = [p for p in inspect.signature(command).parameters.values() if p.name != "options"]
    shared = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                str | None, typer.Option(f"--{name}", help=text, rich_help_panel="Light field")
            ],
        )
        for name, text in _FIELD_OPTIONS.items()
    ]
    keyword = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    wrapper.__signature__ = inspect.Signature([*keyword, *shared])  # pyright: ignore[reportAttributeAccessIssue]
    wrapper.__annotations__ = {p.name: p.annotation for p in [*keyword, *shared]}
    return wrapper


def with_grouped_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command options of its own for the fields of dataclasses among its parameters."""
    own = inspect.signature(command).parameters
    groups: dict[str, Any] = {
        name: p.annotation for name, p in own.items() if is_dataclass(p.annotation)
    }

    @wraps(command)
    def wrapper(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        command(**values)

    flat: list[inspect.Parameter] = []
    for name, parameter in own.items():
        flat += _as_options(groups[name]) if name in groups else [parameter]
    keyword = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in flat]
    wrapper.__signature__ = inspect.Signature(keyword)  # pyright: ignore[reportAttributeAccessIssue]
    wrapper.__annotations__ = {p.name: p.annotation for p in keyword}
    return wrapper


def _as_options(kind: Any) -> list[inspect.Parameter]:
    only = inspect.Parameter.KEYWORD_ONLY
    return [
        inspect.Parameter(field.name, only, default=field.default, annotation=field.type)
        for field in fields(kind)
    ]


def recorded(
    options: FieldOptions, targets_between: str | None = None, observers: str | None = None
) -> dict[str, Any]:
    """Return the options that say what was read and aimed at, where they are not the default."""
    aims = {} if targets_between is None else {"targets-between": targets_between}
    if observers is not None:
        aims |= {"observers": Path(observers).name}
    return {"options": options.written() | aims}
