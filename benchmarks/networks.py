"""How near the shipped networks come to the reference, on the five light fields.

    python benchmarks/networks.py OUT.json [DISPLAY...]

Every network beside the iterations that it is to equal, and followed by three iterations of each of
three solvers, which stand there alone, too. Then the excess error (mean square error over that of
the reference, minus 1) on the light fields and on procedural test scenes. All figures are those of
light. Where displays are named, rows of others in OUT.json stay.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import mean

import torch
from five_fields import five_fields

from layerfield import Display, LightField, evaluate
from layerfield.evaluate import Row
from layerfield.metrics import excess
from layerfield.shipped import shipped_networks
from layerfield.training.sources import scenes

PRESETS = ("additive-3", "multiplicative-3", "perspective-3", "tabletop-additive")
RIVALS = {"additive": [("nmf", 50), ("nmf", 10)], "multiplicative": [("sweeps", 5)]}
FOLLOWERS = ("fourier-admm", "fast", "sweeps")  # three iterations of each
_TEST = 2**31  # the seed of procedural test scenes
_SCENES, _SIZE = 8, 128


def main(out: Path, presets: Sequence[str]) -> None:
    kept = json.loads(out.read_text("utf-8")) if out.exists() else []
    records = [record for record in kept if record["display"] not in presets]
    for preset in presets:
        display = Display.load(preset)
        networks = shipped_networks(display)
        if not networks:
            continue
        methods = [(name, 0) for name in networks]
        methods += [(f"{name}+{solver}", 3) for name in networks for solver in FOLLOWERS]
        methods += [*((solver, 3) for solver in FOLLOWERS), *RIVALS[display.link.name]]
        rows = evaluate(list(five_fields().values()), [display], methods)
        table(preset, rows)
        test = evaluate(procedural(display), [display], [(name, 0) for name in networks])
        for name in networks:
            photographs, drawn = (excesses(found, name) for found in (rows, test))
            print(
                f"{name}: excess {mean(photographs):.3f} on the light fields, "
                f"{mean(drawn):.3f} on procedural test scenes"
            )
        records += [row.as_record() for row in [*rows, *test]]
    out.write_text(json.dumps(records, indent=1), "utf-8")


def table(title: str, rows: list[Row]) -> None:
    fields = list(dict.fromkeys(row.field for row in rows))
    print(title, *fields, "mean", sep="\t")
    references = {row.field: row.reference.psnr for row in rows if row.reference}
    print("reference", *(f"{references[f]:.2f}" for f in fields), sep="\t", end="\t")
    print(f"{mean(references.values()):.2f}")
    for label in dict.fromkeys(row.label for row in rows):
        found = {row.field: row.figures.psnr_linear for row in rows if row.label == label}
        print(label, *(f"{found[f]:.2f}" for f in fields), f"{mean(found.values()):.2f}", sep="\t")
    print(flush=True)


def excesses(rows: list[Row], method: str) -> list[float]:
    return [
        excess(row.mean_square_error, row.reference.mean_square_error)
        for row in rows
        if row.method == method and row.reference
    ]


def procedural(display: Display) -> list[LightField]:
    """Test scenes of every training, as deep as the display."""
    views = scenes(display, _SCENES, _SIZE, seed=_TEST, stretch=1.0, device=torch.device("cpu"))
    grid = display.geometry.grid or (1, display.view_count)
    return [LightField(each.float() / 255, grid, name=f"test {n}") for n, each in enumerate(views)]


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or PRESETS)
