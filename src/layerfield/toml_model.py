"""TOML files that hold a pydantic model: parsed, validated, every error one line with its key."""

import re
import reprlib
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, Field, ValidationError
from pydantic_core import ErrorDetails

from layerfield.nearest import did_you_mean

Model = TypeVar("Model", bound=BaseModel)

# Strict: no text or truth value passes for a number.
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


def read_toml_text(path: Path, what: str) -> str:
    """Return the text of a file.

    Args:
        path: of the file.
        what: it describes, for the errors.

    Raises:
        ValueError: not there, not readable, or not text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a text file; expected {what} in TOML") from None
    except OSError as error:
        raise ValueError(f"cannot read {what} {path}: {error.strerror}") from None


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML text.

    Raises:
        ValueError: not TOML; one line that names the source.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of numbers that are too long
        raise ValueError(f"{source} is not valid TOML: {error}") from None


def validated(
    model: type[Model], data: dict[str, Any], source: str, folder: Path | None = None
) -> Model:
    """Return the model that the data describe.

    Args:
        model: of the file.
        data: what the file holds.
        source: what an error calls the file.
        folder: where the files that it names are; validators find it in their context.

    Raises:
        ValueError: an unknown or missing key, or a wrong value; one line that names the source,
            the key and the remedy.
    """
    try:
        return model.model_validate(data, context={"folder": folder or Path()})
    except ValidationError as error:
        # A mistyped key is also a missing one; the typo says more.
        first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
        raise ValueError(f"{source}: {_one_line(first, model)}") from None


def _one_line(error: ErrorDetails, model: type[BaseModel]) -> str:
    place, inside = _place(error["loc"], model)
    match error["type"]:
        case "extra_forbidden":
            keys = re.sub(r"\[\d+\]", "", place).split(".")
            known = list((_table(model, keys[:-1]) or model).model_fields)
            return f"unknown key '{place}'{did_you_mean(str(error['loc'][-1]), known)}"
        case "missing" if not inside:
            return f"the key '{place}' is missing"
        case "missing":
            return f"'{place}' holds too few numbers"
        case "value_error":
            message = error["msg"].removeprefix("Value error, ")
            return message if not place else f"'{place}{inside}': {message}"
    expected = error["msg"].lower().replace("tuple", "list")
    return f"'{place}{inside}' is {reprlib.repr(error['input'])}; {expected}"


def _place(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, str]:
    """The key, dotted if it is inside a table or a list of them, and the index into its value.

    A location also names the member of a union that was tried; that is no key and left out.
    """
    keys: list[str] = []
    place = inside = ""
    for part in location:
        if isinstance(part, int):
            inside += f"[{part}]"
        elif _table(model, keys) is not None:
            place, inside = f"{place}{inside}.{part}".removeprefix("."), ""
            keys.append(part)
    return place, inside


def _table(model: type[BaseModel], path: list[str]) -> type[BaseModel] | None:
    """The model of the table that a path of keys leads to; none if it leads to a value."""
    for key in path:
        field = model.model_fields.get(key)
        annotation = field.annotation if field else None
        tables = [m for m in (annotation, *get_args(annotation)) if hasattr(m, "model_fields")]
        if not tables:
            return None
        model = tables[0]  # pyright: ignore[reportAssignmentType]
    return model
