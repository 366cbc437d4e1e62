"""The command `evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

from layerfield.cli.fields import read_around, read_field
from layerfield.cli.options import (
    Bits,
    Force,
    Iterations,
    TargetsBetween,
    with_field_options,
)
from layerfield.cli.outputs import file_or_nothing
from layerfield.cli.refusals import (
    keep_inputs,
    own_file,
    refuse_lists,
    refuse_repeats,
    refuse_targets,
    told_apart,
)
from layerfield.cli.terminal import print_tables, say, status
from layerfield.display import Display
from layerfield.evaluate import Row, evaluate, parse_methods, write_rows
from layerfield.io import FieldOptions
from layerfield.panels import largest_code
from layerfield.remarks import values_taken_for_light
from layerfield.synthesizer import find_method, pose

_METHODS = "such names, as a,b:100 (iterations),c+b:3"


@with_field_options
def evaluate_command(
    paths: Annotated[list[str], typer.Argument(metavar="FIELD...", help="light fields")],
    names: Annotated[list[str], typer.Option("--display", help="preset or file; repeatable")],
    wanted: Annotated[str, typer.Option("--methods", help=_METHODS)],
    options: FieldOptions,
    iterations: Iterations = None,
    bits: Bits = 16,
    json: Annotated[Path | None, typer.Option("--json", help="file for the rows")] = None,
    between: Annotated[
        bool, typer.Option("--between", help="judge eyes between the viewpoints, too (--step 2)")
    ] = False,
    eye_map_file: Annotated[
        Path | None, typer.Option("--eye-map", help="PNG: PSNR against the position of the eye")
    ] = None,
    report_file: Annotated[
        Path | None, typer.Option("--report", help="HTML page of the rows")
    ] = None,
    targets_between: TargetsBetween = None,
    force: Force = False,
) -> None:
    """Compare methods on light fields and displays, the reference beside them."""
    chosen = parse_methods(wanted, iterations)
    largest_code(bits)
    models = [Display.load(name) for name in names]
    refuse_repeats("displays", [model.name for model in models])
    found = [find_method(name) for name, _ in chosen]
    outputs = [out for out in (json, eye_map_file, report_file) if out is not None]
    refuse_repeats("files to write", [str(out) for out in outputs])
    for out in outputs:
        keep_inputs(out, *paths, *map(own_file, names), *(method.file for method in found))
    if between or eye_map_file is not None:
        refuse_lists(models, "--between and --eye-map")
    refuse_targets(targets_between, models)
    for model in models:
        for method in found:
            method.refuse_unserved(model)
    loaded = told_apart([read_field(field, options, targets_between) for field in paths], paths)
    for field in loaded:
        for model in models:
            pose(field, model)
    around = [
        read_around(path, options, field, between=between)
        for path, field in zip(paths, loaded, strict=True)
        if between or eye_map_file is not None
    ]
    with (
        file_or_nothing(json, force=force) as path,
        file_or_nothing(eye_map_file, force=force) as picture,
        file_or_nothing(report_file, force=force) as page,
    ):
        with status(total=len(loaded) * len(models) * (len(chosen) + 1)) as tick:
            rows = evaluate(
                loaded, models, chosen, bits=bits, isolate=True, around=around, tick=tick
            )
        if path is not None:
            write_rows(path, rows)
        if picture is not None:
            from layerfield.report.eye_map import write_eye_map  # noqa: PLC0415  slow to import

            write_eye_map(picture, rows)
        if page is not None:
            _write_page(page, rows)
    for remark in [note for f in loaded for d in models for note in values_taken_for_light(f, d)]:
        say(remark)
    print_tables(rows)


def _write_page(path: Path, rows: list[Row]) -> None:
    from layerfield.report.evaluation_page import evaluation_page  # noqa: PLC0415  slow to import
    from layerfield.report.facts import facts_of_rows  # noqa: PLC0415  slow to import
    from layerfield.report.page import write_page  # noqa: PLC0415  slow to import

    write_page(path, evaluation_page(facts_of_rows(rows)))
