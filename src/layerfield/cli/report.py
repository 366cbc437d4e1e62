"""The command `report`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from layerfield.cli.fields import read_as_recorded
from layerfield.cli.options import Force
from layerfield.cli.outputs import folder_or_nothing
from layerfield.cli.refusals import keep_inputs
from layerfield.cli.terminal import say
from layerfield.io import whole_file
from layerfield.stored_result import open_result

if TYPE_CHECKING:
    from layerfield.report.page import Page


def report_command(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="a result of synth, or rows of evaluate --json")
    ],
    out: Annotated[Path, typer.Option("--out", help="HTML file to make")],
    field: Annotated[
        str | None,
        typer.Option("--field", help="the light field of a result that holds no targets"),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="folder to make: the figures as PNG and SVG")
    ] = None,
    force: Force = False,
) -> None:
    """Write a page on a result, or on an evaluation: one HTML file that holds all it shows."""
    keep_inputs(out, source, field)
    if figures is not None:
        keep_inputs(figures, source, field)
        _keep_apart(out, figures)
    with (
        whole_file(out, force=force) as temporary,
        folder_or_nothing(figures, force=force) as folder,
    ):
        page = _page(source, field)
        from layerfield.report.page import write_page  # noqa: PLC0415  slow to import

        write_page(temporary, page, folder)
    say(f"the page is {out}" + ("" if figures is None else f", its figures are in {figures}"))


def _keep_apart(out: Path, figures: Path) -> None:
    if out.resolve().is_relative_to(figures.resolve()):
        raise ValueError(f"{out} is or lies in {figures}, the folder of figures; give another name")


def _page(source: Path, field: str | None) -> "Page":
    if source.is_dir():
        return _result_page(source, field)
    if field is not None:
        raise ValueError(
            f"{source} holds rows of an evaluation, which need no light field; leave out --field"
        )
    from layerfield.report.evaluation_page import evaluation_page  # noqa: PLC0415  slow to import
    from layerfield.report.facts import read_rows  # noqa: PLC0415  slow to import

    return evaluation_page(read_rows(source))


def _result_page(folder: Path, field: str | None) -> "Page":
    if not (folder / "display.toml").is_file() or not (folder / "result.json").is_file():
        raise ValueError(
            f"{folder} holds no display.toml with a result.json; give a folder that synth made, or "
            "the file of evaluate --json"
        )
    from layerfield.report.result_page import result_page  # noqa: PLC0415  slow to import

    result = open_result(folder)
    if field is not None:
        result = open_result(folder, read_as_recorded(field, result.facts))
    return result_page(result)
