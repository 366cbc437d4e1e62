"""What result.json and the rows of `evaluate --json` say, checked before a page is made of it."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from layerfield.evaluate import Row
from layerfield.metrics import finite
from layerfield.stored_result import StoredResult
from layerfield.synthesizer import spelled
from layerfield.toml_model import Model, validated

# Charts have axes: numbers that no measurement gives are refused here. None stands for exact.
Decibels = Annotated[float, Field(ge=-300, le=300)] | None
Seconds = Annotated[float, Field(ge=0, le=1e9)]
Share = Annotated[float, Field(ge=-1e6, le=1e6)]
Count = Annotated[int, Field(ge=0, le=10**9)]
Side = Annotated[int, Field(ge=1, le=10_000)]

_LARGEST = 64 * 2**20  # bytes of a file; a row is a few kilobytes
_MOST_ROWS = 1000


class _Facts(BaseModel):
    """Keys that a page does not show are left alone."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class LayerFacts(_Facts):
    """The figures of one layer, of light from 0 to 1."""

    mean: Share
    std: Share


class _Quality(_Facts):
    psnr: Decibels
    psnr_linear: Decibels
    psnr_interior: Decibels
    ssim: Share
    psnr_view_min: Decibels
    psnr_view_max: Decibels
    psnr_view_std: Decibels
    psnr_by_view: list[Decibels] = []
    layers: list[LayerFacts]
    method: str
    iterations: Count
    seconds: Seconds
    display: str
    bits: int
    made_with: dict[str, str | int]

    @property
    def in_light(self) -> bool:
        """Whether figures of light are others than those of the values in the files."""
        return self.psnr != self.psnr_linear


class Progress(_Facts):
    """The error after an iteration, of light."""

    iteration: Count
    mean_square_error: Annotated[float, Field(ge=0, le=1e6)]


class FieldFacts(_Facts):
    """What the layers were made of."""

    name: str
    grid: tuple[Side, Side]
    size: tuple[Side, Side]
    options: dict[str, str] = {}


class ReferenceFacts(_Facts):
    """The error that the result is compared with, of light."""

    psnr: Decibels
    kind: str
    method: str
    gap_db: Annotated[float, Field(ge=0, le=300)] | None = None


class PanelFacts(_Facts):
    """What the pictures of the panels show."""

    psnr: Decibels
    psnr_linear: Decibels
    missed: list[Share] = []


class ResultFacts(_Quality):
    """What result.json holds."""

    status: str = ""
    history: list[Progress] = []
    field: FieldFacts
    rounding: str = ""
    reference: ReferenceFacts | None = None
    excess: Share | None = None
    panels: PanelFacts | None = None
    psnr_observers: Decibels = None


class RowFacts(_Quality):
    """A row of `evaluate --json`."""

    field: str
    grid: tuple[Side, Side] | None = None
    peak_mb: Share | None = None
    psnr_between: Decibels = None
    excess: Share | None = None
    reference_psnr: Decibels = None
    reference_kind: str = ""
    reference_method: str = ""
    reference_gap_db: Annotated[float, Field(ge=0, le=300)] | None = None

    @property
    def title(self) -> str:
        """The method, with its iterations if it makes any."""
        return spelled(self.method, self.iterations)


def checked_facts(result: StoredResult) -> ResultFacts:
    """Return the facts of a result.

    Raises:
        ValueError: there are none, or they are not those that synth writes.
    """
    if not result.facts:
        raise ValueError(
            f"'{result.name}' holds no result.json, so nothing is known of it; give a folder that "
            "synth made"
        )
    return _checked(ResultFacts, result.facts, f"'{result.name}', result.json")


def facts_of_rows(rows: Sequence[Row]) -> list[RowFacts]:
    """Return the rows of an evaluation as their file holds them."""
    return _rows([finite(row.as_record()) for row in rows], "evaluate")


def read_rows(path: Path) -> list[RowFacts]:
    """Read the file that `evaluate --json` writes.

    Raises:
        ValueError: no such file, or one that evaluate does not write; one line.
    """
    return _rows(_read_json(path), str(path))


def _rows(found: Any, source: str) -> list[RowFacts]:
    match found:
        case [dict(), *_] if len(found) <= _MOST_ROWS:
            return [
                _checked(RowFacts, row, f"{source}, row {number}")
                for number, row in enumerate(found, start=1)
            ]
        case [dict(), *_]:
            raise ValueError(
                f"{source} holds {len(found)} rows, expected at most {_MOST_ROWS}; evaluate fewer "
                "methods or light fields at a time"
            )
        case []:
            raise ValueError(f"{source} holds no rows; write it anew with evaluate --json")
    raise ValueError(
        f"{source} is not what evaluate writes: found {_kind(found)}, expected a list of rows; "
        "write it with evaluate --json"
    )


def _checked(model: type[Model], data: Any, source: str) -> Model:
    """Return what the data say; the remedy is the same whatever is wrong."""
    try:
        return validated(model, data, source)
    except ValueError as error:
        raise ValueError(f"{error}; make it anew with this version of layerfield") from None


def _read_json(path: Path) -> Any:
    try:
        if path.stat().st_size > _LARGEST:
            raise ValueError(
                f"{path} has more than {_LARGEST // 2**20} MB, the most we read; expected what "
                "evaluate --json writes"
            )
        text = path.read_text("utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is no text; expected what evaluate --json writes") from None
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        found = "it is empty" if not text.strip() else str(error)
        raise ValueError(
            f"{path} is not valid JSON ({found}); expected what evaluate --json writes"
        ) from None


def _kind(found: Any) -> str:
    return {dict: "one object", list: "a list of other things"}.get(type(found), "a single value")
