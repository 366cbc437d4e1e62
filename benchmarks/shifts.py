"""How far layers move alike when the views move: PSNR of one against the other.

    python benchmarks/shifts.py OUT.json [--methods fast,fourier-admm:300]

A procedural scene of 384x512 px in 8 bits is moved by 1, 2, 5, 8 and 15 px down and right, as by
scrolling: what leaves on one side makes room for something new on the other. Layers are moved back
and compared, at least 32 and 64 px from the border: light of low frequency depends on what is there
and that changes. How much of that is right tells a method that goes on to the optimum: NAME:COUNT
makes so many iterations, others make their own number.
"""

import argparse
import json
from pathlib import Path

import torch
from outputs import output_file

from layerfield import Display, LightField, procedural_light_field, synthesize
from layerfield.bench.frontier import unserved
from layerfield.evaluate import parse_methods
from layerfield.io import whole_file
from layerfield.metrics import decibels
from layerfield.provenance import provenance
from layerfield.synthesizer import METHODS

PRESETS = ("additive-3", "multiplicative-3", "polarisation-3")
SIZE, GRID, SEED = (384, 512), (5, 5), 21
SHIFTS = (1, 2, 5, 8, 15)
BORDERS = (32, 64)


def moved(whole: LightField, shift: int) -> LightField:
    """Return views whose contents lie `shift` pixels further up and to the left."""
    height, width = SIZE
    cut = whole.stored[..., shift : shift + height, shift : shift + width]
    return LightField(cut.contiguous(), GRID)


def likeness(first: torch.Tensor, later: torch.Tensor, shift: int, border: int) -> float | None:
    """Return the PSNR of layers against those of moved views; None where they are equal."""
    height, width = first.shape[-2:]
    there = first[..., shift:, shift:][..., border:-border, border:-border]
    here = later[..., : height - shift, : width - shift][..., border:-border, border:-border]
    error = (there - here).square().mean().item()
    return round(decibels(error), 2) if error > 0 else None


def main(out: Path, methods: str) -> None:
    size = (SIZE[0] + max(SHIFTS), SIZE[1] + max(SHIFTS))
    made = procedural_light_field(size=size, grid=GRID, disparity_range=(-1.5, 1.5), seed=SEED)
    whole = LightField((255 * made.views).round().to(torch.uint8), GRID)
    rows = []
    for preset in PRESETS:
        display = Display.load(preset)
        for name, count in parse_methods(methods):
            if unserved(name, display) is not None:
                continue
            views = {n: moved(whole, n) for n in (0, *SHIFTS)}
            options = {"method": name, "iterations": count}
            layers = {n: synthesize(views[n], display, **options).layers for n in views}
            for border in BORDERS:
                psnr = {n: likeness(layers[0], layers[n], n, border) for n in SHIFTS}
                rows.append({"display": preset, **options, "border": border, "psnr": psnr})
                print(preset, name, count, border, psnr, flush=True)
            command = f"python benchmarks/shifts.py OUT.json --methods {methods}"
            facts = {"command": command, "size": SIZE, "seed": SEED}
            record = facts | {"made_with": provenance(torch.device("cpu")), "rows": rows}
            with whole_file(out, force=True) as path:
                path.write_text(json.dumps(record, indent=1), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=output_file)
    parser.add_argument("--methods", default=",".join(METHODS))
    given = parser.parse_args()
    try:
        main(given.out, given.methods)
    except ValueError as error:
        parser.error(str(error))
