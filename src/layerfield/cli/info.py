"""The command `info`."""

from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.options import Field, Force, with_field_options
from layerfield.cli.refusals import keep_inputs
from layerfield.cli.terminal import say, status
from layerfield.disparity import estimate_disparity
from layerfield.io import (
    FieldOptions,
    field_name,
    is_contact_sheet,
    load_light_field,
    whole_file,
    write_contact_sheet,
)


@with_field_options
def info_command(
    field: Field,
    options: FieldOptions,
    contact: Annotated[
        Path | None, typer.Option("--contact-sheet", help="where to write it; FIELD-views.png")
    ] = None,
    force: Force = False,
) -> None:
    """Say what a light field holds, and draw a contact sheet of its views."""
    path = contact or Path(f"{field_name(field)}-views.png")
    keep_inputs(path, field)
    with whole_file(path, force=force or is_contact_sheet(path)) as temporary, status() as tick:
        tick("reading")
        loaded = load_light_field(field, options)
        tick("estimating disparity")
        report = estimate_disparity(loaded, order=options.order)
        write_contact_sheet(temporary, loaded)
    height, width = loaded.size
    views = loaded.views
    low, high = views.min().item(), views.max().item()
    kind = "grey" if views.shape[-3] == 1 else "colour"
    say(f"views      {loaded.grid[0]}x{loaded.grid[1]}, {width}x{height} px, {kind}")
    say(f"values     {low:.3f} to {high:.3f}, mean {views.mean().item():.3f}")
    for line in [*report.lines(), *loaded.notes]:
        say(line)
    say(f"contact sheet: {path}")
