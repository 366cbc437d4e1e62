"""Excess error of every frame of a video, warm and cold, and what a frame costs.

    python benchmarks/video.py OUT.json [VIDEO ...] [--views 5x5] [--car FOLDER]

Frames of 96x256 on a display of 1x5 views, or others, at disparities 1, 0, -1: panned crops of a
wide scene, a camera that moves sideways, things that go their own ways, noise, a cut, a fence that
moves by half of its period; with --car, "car" is the first eleven windows of 1x5 that slide over
the 1x25 views of that light field. Every other frame from the sixth on is judged, two of the car.
"""

import argparse
import json
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from outputs import output_file
from torch import Tensor

from layerfield import (
    DisparitySpec,
    Display,
    Geometry,
    LightField,
    excess,
    load_light_field,
    reference,
    synthesize,
    synthesize_frames,
)
from layerfield.clock import Clock
from layerfield.io import whole_file
from layerfield.io.options import parse_grid
from layerfield.motion import block_motion
from layerfield.problem import Problem
from layerfield.provenance import provenance
from layerfield.scenes import animated, make_scene, panned, render, travelled
from layerfield.scenes.scene import EVERYWHERE
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.warm_admm import Left, moved_start
from layerfield.stream import seen_from_the_middle
from layerfield.synthesizer import pose

SIZE, FRAMES, SETTLED = (96, 256), 14, 5
ROW = (1, 5)
LARGE = (480, 640)  # where the parts of a frame are timed
# Frames from one that is judged to the next: two, but for the cut, at frame 8, and what is large.
EVERY = {"cut": 8, "car": 5}
WARM = {"fast": (1, 2, 3, 4, 6), "fourier-admm": (3,)}
COLD = {"fast": (1, 2, 3, 4, 6, 8)}


def display(views: tuple[int, int]) -> Display:
    values = {"name": "shown", "link": "additive", "disparity": (1.0, 0.0, -1.0), "views": views}
    return Display(DisparitySpec.model_validate(values))


def pan(geometry: Geometry, x: int, y: int, seed: int) -> Tensor:
    return panned(geometry, (x, y), FRAMES, size=SIZE, seed=seed)


def travel(geometry: Geometry, step: float, seed: int) -> Tensor:
    return travelled(geometry, step, FRAMES, size=SIZE, seed=seed)


def animation(geometry: Geometry, speed: float, seed: int) -> Tensor:
    return animated(geometry, speed, FRAMES, size=SIZE, seed=seed)


def cut(geometry: Geometry) -> Tensor:
    return torch.cat([pan(geometry, 1, 0, 11)[:8], pan(geometry, 1, 0, 20)[:10]])


def noise(geometry: Geometry, sigma: float, seed: int) -> Tensor:
    views = pan(geometry, 0, 0, seed)
    return views + sigma * torch.randn(views.shape, generator=torch.Generator().manual_seed(seed))


def fence(geometry: Geometry, seed: int) -> Tensor:
    """Bars 8 px apart, 1 view step nearer than what is behind them, panned by 4 px a frame."""
    generator = torch.Generator().manual_seed(seed)
    height, width = SIZE[0], SIZE[1] + 4 * FRAMES
    bars = 2 - (torch.arange(2 * width) % 8 - 3.5).abs()
    outlines = torch.stack([torch.full_like(bars, EVERYWHERE), bars])[:, None]
    behind = torch.nn.functional.interpolate(
        torch.rand(1, 3, height // 4, width // 4, generator=generator), size=(height, width)
    )[0]
    scene = make_scene(
        torch.stack([behind, torch.full_like(behind, 0.15)]),
        [-0.5, 0.5],
        size=(height, width),
        silhouettes=outlines.expand(2, 2 * height, 2 * width),
    )
    views = render(scene, geometry.slopes)[0]
    return torch.stack([views[..., 4 * t : 4 * t + SIZE[1]] for t in range(FRAMES)])


VIDEOS: dict[str, Callable[[Geometry], Tensor]] = {
    "pan 1 px": lambda g: pan(g, 1, 0, 11),
    "pan 3 px": lambda g: pan(g, 3, 0, 12),
    "pan 4, 2 px": lambda g: pan(g, 4, 2, 13),
    "travel 0.4 views": lambda g: travel(g, 0.4, 14),
    "travel 1 view": lambda g: travel(g, 1.0, 16),
    "travel 3 views": lambda g: travel(g, 3.0, 17),
    "things to 3 px": lambda g: animation(g, 3.0, 18),
    "noise 0.01": lambda g: noise(g, 0.01, 19),
    "cut": cut,
    "fence": lambda g: fence(g, 21),
}


def fields(views: Tensor, grid: tuple[int, int]) -> list[LightField]:
    codes = views.clamp(0, 1).mul(255).round().to(torch.uint8)
    return [LightField(frame, grid) for frame in codes]


def car(folder: Path) -> list[LightField]:
    stored = load_light_field(folder).stored
    return [LightField(stored[i : i + 5], ROW) for i in range(11)]


@dataclass(frozen=True)
class Judged:
    """The frames of a video whose optimum is known: number -> problem and its error."""

    fields: list[LightField]
    shown: Display
    frames: dict[int, tuple[Problem, float]]

    @classmethod
    def of(
        cls, given: list[LightField], shown: Display, every: int, first: int = SETTLED
    ) -> "Judged":
        posed = {t: pose(given[t], shown) for t in range(first, len(given), every)}
        known = {t: (p, reference(p).mean_square_error) for t, p in posed.items()}
        return cls(given, shown, known)

    def excess(self, frame: int, layers: Tensor) -> float:
        problem, best = self.frames[frame]
        return excess(problem.mean_square_error(layers), best)

    def warm(self, method: str, iterations: int) -> dict:
        made = synthesize_frames(self.fields, self.shown, method=method, iterations=iterations)
        rows, starts = [], []
        for t, solution in enumerate(made):
            starts.append(solution.details["start"])
            if t in self.frames:
                rows.append((self.excess(t, solution.layers), solution.seconds))
        return summary(rows) | {"starts": starts}

    def cold(self, method: str, iterations: int) -> dict:
        rows = []
        for t in self.frames:
            made = synthesize(self.fields[t], self.shown, method=method, iterations=iterations)
            rows.append((self.excess(t, made.layers), made.seconds))
        return summary(rows)


def summary(rows: list[tuple[float, float]]) -> dict:
    values, seconds = [value for value, _ in rows], [second for _, second in rows]
    return {
        "excess": values,
        "max": max(values),
        "median": statistics.median(values),
        "seconds": statistics.median(seconds),
    }


def figures(judged: Judged) -> dict:
    found = {
        f"{kind} {method}:{count}": getattr(judged, kind)(method, count)
        for kind, methods in (("warm", WARM), ("cold", COLD))
        for method, counts in methods.items()
        for count in counts
    }
    return {"frames": list(judged.frames), "size": judged.fields[0].size, "runs": found}


def share_of_a_step(shown: Display, given: LightField) -> dict[str, float]:
    """Seconds of the parts of a frame, medians of nine, and of a step of the direct solver."""
    problem = pose(given, shown)
    picture, even = seen_from_the_middle(problem), problem.even_start()
    motion, left = block_motion(picture, picture), Left(even, even, even)
    state = FourierAdmm().init(problem, None)
    parts = {
        "views to even start": lambda: pose(given, shown).even_start(),
        "motion": lambda: block_motion(picture, picture),
        "moving": lambda: moved_start(even, left, motion, again=0.5),
        "step": lambda: FourierAdmm().step(problem, state),
    }
    return {name: median_seconds(part) for name, part in parts.items()}


def median_seconds(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(10):  # the first warms up
        clock = Clock(torch.device("cpu"))
        with clock:
            work()
        seconds.append(clock.seconds)
    return statistics.median(seconds[1:])


def told(name: str, made: dict) -> str:
    runs = made["runs"].items()
    return f"{name}: " + ", ".join(f"{run} {row['max']:.1%}" for run, row in runs)


def main(
    out: Path, names: list[str], views: tuple[int, int], of_car: list[LightField] | None
) -> None:
    torch.set_num_threads(1)
    shown = display(views)
    parts = {
        name: lambda make=make: fields(make(shown.geometry), views) for name, make in VIDEOS.items()
    }
    parts |= {"car": lambda: of_car} if of_car else {}
    found: dict[str, dict] = {}
    record = {
        "command": " ".join(
            [
                "python benchmarks/video.py",
                out.name,
                *names,
                *(["--views {}x{}".format(*views)] if views != ROW else []),
                *(["--car FOLDER"] if of_car else []),
            ]
        ),
        "made_with": provenance(torch.device("cpu")),
        "threads": 1,
        "seconds": {},
        "videos": found,
    }
    large = panned(shown.geometry, (0, 0), 1, size=LARGE, seed=11)
    record["seconds"] = {"size": LARGE} | share_of_a_step(shown, fields(large, views)[0])
    for name in names or parts:
        judged = Judged.of(parts[name](), shown, EVERY.get(name, 2))
        found[name] = figures(judged)
        print(told(name, found[name]), flush=True)
        with whole_file(out, force=True) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="excess error of videos")
    parser.add_argument("out", type=output_file)
    parser.add_argument("videos", nargs="*", metavar="VIDEO", help=", ".join(VIDEOS))
    parser.add_argument("--views", default="{}x{}".format(*ROW), metavar="ROWSxCOLUMNS")
    parser.add_argument("--car", type=Path, help="views in a row; for those of 1x5")
    given = parser.parse_intermixed_args()
    known = [*VIDEOS, *(["car"] if given.car else [])]
    if unknown := [name for name in given.videos if name not in known]:
        parser.error(f"found video '{unknown[0]}', expected any of: {', '.join(known)}")
    try:
        views = parse_grid("--views", given.views)
        if given.car and views != ROW:
            parser.error("the car has views in a row; leave out --car or --views")
        frames = car(given.car) if given.car else None
    except ValueError as error:
        parser.error(str(error))
    main(given.out, given.videos, views, frames)
