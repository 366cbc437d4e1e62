"""How much layers change from frame to frame, warm and cold, against how much the input does.

    python benchmarks/video_flicker.py OUT.json

Frames of 96x160 on a 1x5 display at disparities 1, 0, -1: a scene that stands still, the same with
noise of 1/255 that is new in every frame, a pan of one pixel a frame, whose frames are compared
where the picture has moved to, and viewpoints that move sideways. Changes are root mean squares in
codes of 1/255: of the input, of what its viewers and an eye between two of them see, of the layers,
and of layers rounded to 8 bits, the mean of frames after the sixth, and the largest where a batch
begins. "excess" is that of the last frame before the first border and of some behind it over their
optimum.

"warm": batches of 32 frames as `video` makes them, with its run-in and without; "unbroken": in one
run.
"cold": every frame by itself, in about as much time (fast:5), and in as many iterations as others
take (fourier-admm:10).
"""

import argparse
import json
from collections.abc import Callable, Iterator
from itertools import islice, pairwise
from pathlib import Path

import torch
from outputs import output_file
from torch import Tensor

from layerfield import (
    DisparitySpec,
    Display,
    LightField,
    Solution,
    excess,
    reference,
    synthesize,
    synthesize_frames,
)
from layerfield.io import whole_file
from layerfield.panels import dequantise
from layerfield.provenance import provenance
from layerfield.scenes import panned, travelled
from layerfield.solvers.rounding import ROUNDINGS, panel_codes
from layerfield.stream import run_in
from layerfield.synthesizer import find_method, pose
from layerfield.video.job import BATCH

GRID, SIZE, FRAMES, SETTLED = (1, 5), (96, 160), 72, 6
SHOWN = Display(
    DisparitySpec.model_validate(
        {"name": "row", "link": "additive", "disparity": (1.0, 0.0, -1.0), "views": GRID}
    )
)
JUDGED = [BATCH + t for t in (-1, 0, 1, 4, 8)]
EYE = (0.5, 0.0)  # between the middle viewpoint and the next, in view steps
RUN_IN = run_in(find_method("fast"), SHOWN)


def still(noise: float) -> Tensor:
    views = panned(SHOWN.geometry, (0, 0), 1, size=SIZE, seed=5).expand(FRAMES, -1, -1, -1, -1)
    return views + noise * torch.randn(views.shape, generator=torch.Generator().manual_seed(1))


VIDEOS: dict[str, tuple[Callable[[], Tensor], int]] = {  # with how far the picture moves
    "still": (lambda: still(0.0), 0),
    "still, noise 1/255": (lambda: still(1 / 255), 0),
    "travel 0.4 views": (
        lambda: travelled(SHOWN.geometry, 0.4, FRAMES, size=SIZE, seed=14),
        0,
    ),
    "pan 1 px": (lambda: panned(SHOWN.geometry, (1, 0), FRAMES, size=SIZE, seed=11), 1),
}


def warm(fields: list[LightField], before: int, length: int = BATCH) -> Iterator[Solution]:
    for first in range(0, len(fields), length):
        begin = max(0, first - before)
        made = synthesize_frames(fields[begin : first + length], SHOWN)
        yield from islice(made, first - begin, None)


def cold(fields: list[LightField], method: str, iterations: int) -> Iterator[Solution]:
    for field in fields:
        yield synthesize(field, SHOWN, method=method, iterations=iterations)


WAYS: dict[str, Callable[[list[LightField]], Iterator[Solution]]] = {
    "warm": lambda fields: warm(fields, RUN_IN),
    "warm, no run-in": lambda fields: warm(fields, 0),
    "warm, unbroken": lambda fields: warm(fields, 0, FRAMES),
    "cold fast:5": lambda fields: cold(fields, "fast", 5),
    "cold fourier-admm:10": lambda fields: cold(fields, "fourier-admm", 10),
}


def pictures(fields: list[LightField], solution: Solution, number: int) -> dict[str, Tensor]:
    """Return what may flicker in a frame."""
    layers = solution.layers
    found = {
        "input": fields[number].views,
        "seen": SHOWN(layers),
        "eye between": SHOWN.look(layers, EYE),
        "layers": layers,
    }
    problem = solution.problem or pose(fields[number], SHOWN)
    for rounding in ROUNDINGS:
        codes = panel_codes(problem, layers, bits=8, rounding=rounding)
        found[f"rounded {rounding}"] = dequantise(codes)
    return found


def change(new: Tensor, old: Tensor, step: int) -> float:
    """Root mean square, in codes, where a picture has moved `step` pixels to the left."""
    width = new.shape[-1] - step
    return 255 * (new[..., :width] - old[..., step:]).square().mean().sqrt().item()


def changes(fields: list[LightField], step: int, way: str, optima: dict[int, float]) -> dict:
    left: dict[int, float] = {}

    def shown() -> Iterator[dict[str, Tensor]]:
        for t, made in enumerate(WAYS[way](fields)):
            if t in optima:
                error = pose(fields[t], SHOWN).mean_square_error(made.layers)
                left[t] = excess(error, optima[t])
            yield pictures(fields, made, t)

    rows = [
        {name: change(new[name], old[name], step) for name in new} for old, new in pairwise(shown())
    ]
    borders = [row for t, row in enumerate(rows, 1) if t % BATCH == 0]
    settled = rows[SETTLED:]
    return {
        "mean": {name: sum(row[name] for row in settled) / len(settled) for name in rows[0]},
        "at borders": {name: max(row[name] for row in borders) for name in rows[0]},
        "excess": left,
    }


def main(out: Path) -> None:
    torch.set_num_threads(1)
    found: dict[str, dict] = {}
    record = {
        "command": f"python benchmarks/video_flicker.py {out.name}",
        "made_with": provenance(torch.device("cpu")),
        "frames": FRAMES,
        "size": SIZE,
        "batch": BATCH,
        "run_in": RUN_IN,
        "videos": found,
    }
    for name, (make, step) in VIDEOS.items():
        codes = make().clamp(0, 1).mul(255).round().to(torch.uint8)
        fields = [LightField(frame, GRID) for frame in codes]
        optima = {t: reference(pose(fields[t], SHOWN)).mean_square_error for t in JUDGED}
        found[name] = {way: changes(fields, step, way, optima) for way in WAYS}
        for way, row in found[name].items():
            told = ", ".join(
                f"{what} {value:.2f} ({row['at borders'][what]:.2f})"
                for what, value in row["mean"].items()
            )
            over = ", ".join(f"{value:.1%}" for value in row["excess"].values())
            print(f"{name}: {way}: {told}; excess {over}", flush=True)
        with whole_file(out, force=True) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="flicker of layers")
    parser.add_argument("out", type=output_file)
    main(parser.parse_args().out)
