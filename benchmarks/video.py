"""Excess error of every frame of a video, warm and cold, after the same iterations.

    python benchmarks/video.py OUT.json [VIDEO ...]

Frames of 96x256 on a 1x5 display at disparities 1, 0, -1: panned crops of a wide scene, a camera
that moves sideways, noise, a cut; "car", if named: windows of 1x5 that slide over its 25 views.
"""

import json
import statistics
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from layerfield import (
    DisparitySpec,
    Display,
    LightField,
    excess,
    load_light_field,
    procedural_light_field,
    reference,
    synthesize,
    synthesize_frames,
)
from layerfield.geometry import grid_points
from layerfield.provenance import provenance
from layerfield.scenes import render
from layerfield.scenes.procedural import random_scenes
from layerfield.synthesizer import pose

GRID, SIZE, FRAMES, SETTLED = (1, 5), (96, 256), 14, 5
ITERATIONS = 3


def pan(x: int, y: int, seed: int) -> list[LightField]:
    size = (SIZE[0] + FRAMES * y, SIZE[1] + FRAMES * x)
    whole = procedural_light_field(grid=GRID, size=size, seed=seed)
    corners = [(t * y, t * x) for t in range(FRAMES)]
    return [
        replace(whole, views=whole.views[..., top : top + SIZE[0], left : left + SIZE[1]])
        for top, left in corners
    ]


def travel(step: float, seed: int) -> list[LightField]:
    """The viewpoints move by `step` view steps a frame: things by `step` times their disparity."""
    scene = random_scenes(1, size=SIZE, reach=2 + FRAMES * step, seed=seed)
    places = grid_points(GRID)
    return [
        LightField(render(scene, [(x + step * t, y) for x, y in places])[0], GRID)
        for t in range(FRAMES)
    ]


def noise(sigma: float, seed: int) -> list[LightField]:
    field, generator = pan(0, 0, seed)[0], torch.Generator().manual_seed(seed)
    grain = [sigma * torch.randn(field.views.shape, generator=generator) for _ in range(FRAMES)]
    return [replace(field, views=(field.views + g).clamp(0, 1)) for g in grain]


def car(folder: Path) -> list[LightField]:
    views = load_light_field(folder).views
    return [LightField(views[i : i + 5], GRID) for i in range(len(views) - 4)]


VIDEOS: dict[str, Callable[[], list[LightField]]] = {
    "pan 1 px": lambda: pan(1, 0, 11),
    "pan 3 px": lambda: pan(3, 0, 12),
    "pan 4, 2 px": lambda: pan(4, 2, 13),
    "travel 0.4 views": lambda: travel(0.4, 14),
    "travel 1 view": lambda: travel(1.0, 16),
    "travel 3 views": lambda: travel(3.0, 17),
    "noise 0.01": lambda: noise(0.01, 19),
    "cut": lambda: pan(1, 0, 11)[:9] + pan(1, 0, 20)[:9],
    "car": lambda: car(Path(__file__).parents[2] / "shared" / "lightfields" / "mpi_car_hpo"),
}


def figures(fields: list[LightField], display: Display) -> dict:
    warm, cold, seconds, starts = [], [], [], []
    for field, made in zip(fields, synthesize_frames(fields, display), strict=True):
        problem = pose(field, display)
        best = reference(problem).mean_square_error
        anew = synthesize(field, display, iterations=ITERATIONS)
        warm.append(excess(problem.mean_square_error(made.layers), best))
        cold.append(excess(problem.mean_square_error(anew.layers), best))
        seconds.append(made.seconds)
        starts.append(made.details["start"])
    return {
        "starts": starts,
        "warm": {"excess": warm, **_settled(warm)},
        "cold": {"excess": cold, **_settled(cold)},
        "seconds_median": statistics.median(seconds[SETTLED:]),
    }


def _settled(values: list[float]) -> dict[str, float]:
    later = values[SETTLED:]
    return {"max": max(later), "median": statistics.median(later)}


def main(out: Path, names: list[str]) -> None:
    chosen = names or [name for name in VIDEOS if name != "car"]
    found: dict[str, dict] = {}
    record = {
        "command": " ".join(["python benchmarks/video.py", out.name, *names]),
        "made_with": provenance(torch.device("cpu")),
        "iterations": ITERATIONS,
        "videos": found,
    }
    for link in ("additive", "multiplicative"):
        spec = DisparitySpec(name=link, link=link, disparity=(1.0, 0.0, -1.0), views=GRID)
        for name in chosen:
            made = figures(VIDEOS[name](), Display(spec))
            found.setdefault(name, {})[link] = made
            print(f"{name}, {link}: {made['warm']['max']:.1%}, cold {made['cold']['max']:.1%}")
            out.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
