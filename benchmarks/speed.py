"""Time of the direct solver against its floor, a stacked CNN and the classical solvers.

    python benchmarks/speed.py OUT.json [FIELD ...]

All ratios are taken in one run, on all fields; the time that every method takes to a quality is
measured on the fields that are named, or on all. Floors: the FFT pairs of ten iterations alone, on
arrays of the solver's own size; each pair moves 9 planes (3 layers, 3 channels) of 4 bytes a pixel
forth and back. The network is the one published for this task: 25 views of one colour channel in,
19 modules of 3x3 convolution to 64 channels and ReLU, 3 layers out, run once for each channel.
"""

import json
import math
import statistics
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import torch
from five_fields import five_fields
from torch import nn

from layerfield import METHODS, Display, LightField, Problem, reference, solve
from layerfield.methods import SolverMethod
from layerfield.provenance import provenance
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.synthesizer import pose

REPEATS = 5
MARGINS_DB = (0.5, 0.1)
CAP_SECONDS = 10.0
CAP_ITERATIONS = 400


def median_seconds(run: Callable[[], object], repeats: int = REPEATS) -> float:
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def stacked_cnn() -> nn.Module:
    widths = [25] + [64] * 19
    modules = [
        part
        for inputs, outputs in pairwise(widths)
        for part in (nn.Conv2d(inputs, outputs, 3, padding=1), nn.ReLU())
    ]
    return nn.Sequential(*modules, nn.Conv2d(64, 3, 3, padding=1), nn.ReLU())


@torch.no_grad()
def direct_against_floor_and_network(field: LightField, display: Display) -> dict:
    solver = FourierAdmm()
    ten = median_seconds(lambda: solve(pose(field, display), solver, iterations=10))
    shape = (3 * field.views.shape[-3], *pose(field, display).gram.torus)
    planes = torch.rand(shape)
    pair = median_seconds(
        lambda: [torch.fft.irfft2(torch.fft.rfft2(planes), s=shape[1:]) for _ in range(10)]
    )
    network, channels = stacked_cnn(), field.views.transpose(0, 1).contiguous()
    forward = median_seconds(lambda: [network(c[None]) for c in channels], repeats=2)
    return {
        "ten_iterations_s": ten,
        "ten_fft_pairs_s": pair,
        "network_forward_s": forward,
        "solver_over_floor": ten / pair,
        "network_over_solver": forward / ten,
    }


def time_to_quality(field: LightField, display: Display) -> dict:
    """Seconds and iterations until each method is within 0.5 and 0.1 dB of the reference."""
    best = reference(pose(field, display)).psnr
    result = {}
    for method in METHODS.values():
        if isinstance(method, SolverMethod) and display.link.name in method.links:
            result[method.name] = _times(pose(field, display), method.make(display.link), best)
    return {"reference_psnr": best, "methods": result}


def _times(problem: Problem, solver, best: float) -> dict:
    run = solve(problem, solver, iterations=CAP_ITERATIONS, time_limit=CAP_SECONDS, history=True)
    curve = [(p.iteration, p.seconds, -10 * math.log10(p.mean_square_error)) for p in run.history]
    found: dict = {"cap": None if len(curve) == CAP_ITERATIONS else f"{CAP_SECONDS:g} s"}
    for margin in MARGINS_DB:
        hits = [entry for entry in curve if entry[2] >= best - margin]
        found[f"{margin:g} dB"] = (
            {"iterations": hits[0][0], "seconds": hits[0][1]} if hits else None
        )
    return found


def main(out: Path, names: list[str]) -> None:
    displays = [Display.load(preset) for preset in ("additive-3", "multiplicative-3")]
    fields = five_fields()
    found: dict[str, dict] = {name: {"size": field.size} for name, field in fields.items()}
    record = {"made_with": provenance(torch.device("cpu")), "fields": found}

    def keep(name: str, figures: dict) -> None:
        found[name] |= figures
        print(name, json.dumps(figures), flush=True)
        out.write_text(json.dumps(record, indent=1) + "\n", "utf-8")

    for name, field in fields.items():
        keep(name, direct_against_floor_and_network(field, displays[0]))
    for name in names or fields:
        for display in displays:
            keep(name, {display.name: time_to_quality(fields[name], display)})


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
