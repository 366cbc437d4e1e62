"""What displays beyond the sum and the product show of the five light fields.

    python benchmarks/displays.py OUT.json [FIELD ...]

polarisation    the method's own ten sweeps beside the best known, whole images
subframes       one and three subframes of a multiplicative display after 20 and 100 iterations

What stands in OUT.json already is not computed again: the best known takes minutes each.
"""

import json
import sys
from pathlib import Path

import torch
from five_fields import five_fields

from layerfield import Display, LightField, reference, solve
from layerfield.display_spec import DisparitySpec
from layerfield.metrics import decibels
from layerfield.provenance import provenance
from layerfield.solvers.fourier_start import FourierStart
from layerfield.synthesizer import pose

ITERATIONS = (20, 100)


def polarisation(field: LightField) -> dict:
    display = Display.load("polarisation-3")
    best = reference(pose(field, display))
    return after(field, display, (10,)) | {"best_known": best.psnr, "reached_by": best.method}


def after(field: LightField, display: Display, iterations: tuple[int, ...]) -> dict:
    """Return the PSNR of the direct solver after each of these numbers of iterations, dB."""
    solver = FourierStart.suited(display.link)
    run = solve(pose(field, display), solver, iterations=max(iterations), history=True)
    return {str(n): decibels(run.history[n - 1].mean_square_error) for n in iterations}


def in_subframes(count: int) -> Display:
    return Display(
        DisparitySpec(
            link="multiplicative", disparity=(1.0, 0.0, -1.0), views=(5, 5), subframes=count
        )
    )


def subframes(field: LightField) -> dict:
    return {str(n): after(field, in_subframes(n), ITERATIONS) for n in (1, 3)}


def main(out: Path, names: list[str]) -> None:
    found = json.loads(out.read_text("utf-8"))["fields"] if out.exists() else {}
    record = {"made_with": provenance(torch.device("cpu")), "fields": found}
    for name, field in five_fields().items():
        for part in (polarisation, subframes):
            own = found.setdefault(name, {})
            if part.__name__ in own or (names and name not in names):
                continue
            own[part.__name__] = part(field)
            print(name, json.dumps(own[part.__name__]), flush=True)
            out.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
