"""The command `view`."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.fields import read_as_recorded
from layerfield.cli.options import Force
from layerfield.cli.process import until_interrupted
from layerfield.cli.refusals import keep_inputs, own_file
from layerfield.cli.terminal import say, status
from layerfield.display import Display
from layerfield.io import whole_file
from layerfield.stored_result import StoredResult, facts_of, open_result
from layerfield.viewer.exhibit import exhibit
from layerfield.viewer.page import data_address, page_alone, served_page
from layerfield.viewer.server import Server

_LARGE = 30_000_000  # bytes of a page that mail and browsers take badly


def view_command(
    folders: Annotated[list[Path], typer.Argument(metavar="OUT...", help="results of synth")],
    display: Annotated[
        str | None, typer.Option("--display", help="a preset or a TOML file; the results' own")
    ] = None,
    field: Annotated[
        str | None, typer.Option("--field", help="the light field they were made of, to compare")
    ] = None,
    margin: Annotated[
        int | None, typer.Option("--margin", help="pixels by which layers exceed the views")
    ] = None,
    port: Annotated[int, typer.Option("--port", help="to listen on; 0: a free one")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open a browser")] = True,
    export: Annotated[
        Path | None, typer.Option("--export", help="write one HTML file instead of serving")
    ] = None,
    force: Force = False,
) -> None:
    """Look around simulated displays in the browser."""
    shown_on = None if display is None else Display.load(display)
    if export is not None:
        keep_inputs(export, *folders, own_file(display), field)
    fields = [
        None if field is None else read_as_recorded(field, facts_of(folder)) for folder in folders
    ]
    results = [
        open_result(folder, made_of, shown_on, margin)
        for folder, made_of in zip(folders, fields, strict=True)
    ]
    title = " and ".join(result.name for result in results)
    if export is None:
        _serve(results, title, port, browser)
    else:
        _export(export, results, title, force)


def _serve(results: list[StoredResult], title: str, port: int, browser: bool) -> None:
    offered: dict[str, tuple[str, bytes]] = {}

    def publish(name: str, content: bytes) -> str:
        offered[f"/pictures/{name}"] = "image/png", content
        return f"/pictures/{name}"

    with status() as tick:
        tick("preparing pictures")
        offered |= served_page(exhibit(results, publish), title)
    with Server(offered, port) as server:
        say(f"{server.address} shows {title}; Ctrl-C ends it")
        if browser:
            webbrowser.open(server.address)
        with until_interrupted():
            server.serve_forever()


def _export(path: Path, results: list[StoredResult], title: str, force: bool) -> None:
    with whole_file(path, force=force) as temporary:
        described = exhibit(results, lambda _, content: data_address("image/png", content))
        page = page_alone(described, title)
        temporary.write_bytes(page)
    say(f"{path} holds {title}, {len(page) / 1e6:.1f} MB; it opens without a server or network")
    if len(page) > _LARGE:
        say("note: that is large for a page; browsers may take long, and mail may refuse it")
