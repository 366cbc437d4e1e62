"""The command `design`."""

from time import perf_counter
from typing import Annotated

import typer

from layerfield.cli.options import Force, Out, recorded, with_field_options
from layerfield.cli.refusals import keep_inputs, refuse_small, refuse_unknown, told_apart
from layerfield.cli.terminal import print_lines, say, status
from layerfield.design import LARGEST, design, parse_layers
from layerfield.io import FieldOptions, load_light_field, refuse_existing, whole_directory
from layerfield.light_field import LightField
from layerfield.links import LINKS
from layerfield.provenance import provenance

_SMALLEST = 16  # pixels of a view; smaller ones have hardly any frequencies


@with_field_options
def design_command(
    paths: Annotated[list[str], typer.Argument(metavar="FIELD...", help="light fields")],
    out: Out,
    options: FieldOptions,
    layers: Annotated[str, typer.Option("--layers", help="counts to design for")] = "1,2,3,4",
    link: Annotated[str, typer.Option("--link", help=" or ".join(LINKS))] = "additive",
    force: Force = False,
) -> None:
    """Suggest layer counts and depths that suit light fields, and verify them."""
    from layerfield.report.designs import design_lines, write_designs  # noqa: PLC0415  slow

    started = perf_counter()
    counts = parse_layers(layers)
    refuse_unknown("link", link, list(LINKS))
    refuse_existing(out, force=force)
    keep_inputs(out, *paths)
    with whole_directory(out, force=force) as temporary, status() as tick:
        tick("reading")
        fields = told_apart([_load(path, options) for path in paths], paths)
        found = design(fields, link, counts, tick=tick)
        alone = [design([f], link, counts, tick=tick) for f in fields] if len(fields) > 1 else []
        facts = recorded(options) | {"made_with": provenance(fields[0].stored.device)}
        seconds = perf_counter() - started
        write_designs(temporary, found, alone, facts | {"seconds": seconds})
    for each in (found, *alone):
        say(f"{', '.join(each.fields)}: {link}, {'x'.join(map(str, each.grid))} views")
        print_lines(design_lines(each))
        say("")
    if any(max(field.size) > LARGEST for field in fields):
        say(f"solved on the middle of the views, at most {LARGEST}x{LARGEST} px")
    say(f"display files, design.json and contrast.png are in {out}")


def _load(path: str, options: FieldOptions) -> LightField:
    loaded = load_light_field(path, options)
    refuse_small(loaded, _SMALLEST)
    return loaded
