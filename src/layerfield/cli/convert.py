"""The command `convert`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from layerfield.cli.options import Field, Force, recorded, with_field_options
from layerfield.cli.refusals import keep_inputs
from layerfield.cli.terminal import say, status
from layerfield.io import FieldOptions, load_light_field, refuse_existing
from layerfield.io.forms import ATLAS, FORMS, QUILT, Form, form_of, write_light_field
from layerfield.io.quilt import quilt_in_name
from layerfield.light_field import LightField
from layerfield.panels import largest_code
from layerfield.simulation import field_in_line, is_result, shown_field
from layerfield.version import __version__

_OUT = "file or folder to make; .npy, .h5, NAME_qs8x6.png a quilt, without an ending a folder"


@with_field_options
def convert_command(
    field: Field,
    out: Annotated[Path, typer.Option("--out", help=_OUT)],
    options: FieldOptions,
    form: Annotated[
        str | None, typer.Option("--as", help=f"if the name does not tell: {', '.join(FORMS)}")
    ] = None,
    bits: Annotated[
        int | None, typer.Option("--bits", help="8 or 16; those of the light field")
    ] = None,
    force: Force = False,
) -> None:
    """Write a light field, or what the layers of a result show, in another form."""
    made_as = form_of(out, form)
    if bits is not None:
        largest_code(bits)
    keep_inputs(out, field, *Path(field).glob("**/"))  # pictures there would pass for views
    if not made_as.suffixes:
        refuse_existing(out, force=force)
    with status() as tick:
        tick("reading")
        loaded = _read(Path(field), made_as, out, options)
        tick("writing")
        facts = _facts(loaded, options)
        written = write_light_field(out, loaded, made_as, facts=facts, bits=bits, force=force)
    for line in [*loaded.notes, *_said(loaded, made_as, written)]:
        say(line)


def _read(path: Path, form: Form, out: Path, options: FieldOptions) -> LightField:
    """A light field; or what a result shows, to eyes side by side where a quilt is made."""
    if not is_result(path):
        simulated = (path / "display.toml").is_file() and (path / "views").is_dir()
        return load_light_field(path / "views" if simulated else path, options)
    if options != FieldOptions():
        given = " ".join(f"--{name}" for name in options.written())
        raise ValueError(f"{path} is a result, {given} are for light fields; leave them out")
    if form is not QUILT:
        return shown_field(path)
    layout = quilt_in_name(out)
    return field_in_line(path, layout and layout.columns * layout.rows)


def _facts(field: LightField, options: FieldOptions) -> dict[str, Any]:
    found = {"name": field.name, "grid": field.grid, "size": field.size}
    return {"field": found | recorded(options), "layerfield": __version__}


def _said(field: LightField, form: Form, written: Path) -> list[str]:
    rows, columns = field.grid
    again = f"; read it with --grid {rows}x{columns}" if form is ATLAS else ""
    where = "from the bottom left, left to right" if form is QUILT else f"{rows}x{columns}"
    height, width = field.size
    return [f"{len(field)} views of {width}x{height} px, {where}, are in {written}{again}"]
