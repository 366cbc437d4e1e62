"""Where views stand in a row: rows as systems of their own against steps in the Fourier domain.

    python benchmarks/rows.py OUT.json [--link multiplicative]

A procedural scene of 240x640 px in three colours on displays whose matrix of a row reaches further
and further. For every number of iterations: excess error over thirty steps of `row-newton`, before
rounding, and seconds from posed views to layers, the least of five by turns.
"""

import argparse
import json
from pathlib import Path

import torch
from outputs import output_file

from layerfield import DisparitySpec, Display, LightField, excess, solve
from layerfield.fast import steps_for
from layerfield.io import whole_file
from layerfield.problem import Problem
from layerfield.provenance import provenance
from layerfield.row_system import row_reach
from layerfield.scenes import panned
from layerfield.solve import Solver
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.row_gauss_newton import RowGaussNewton
from layerfield.solvers.row_newton import RowNewton
from layerfield.solvers.sweeps import Sweeps
from layerfield.synthesizer import pose

SIZE, SEED, REPEATS, BEST = (240, 640), 777, 5, 30
DISPLAYS = {
    "additive": (
        ((1, 3), (2.0, -2.0)),
        ((1, 5), (1.0, 0.0, -1.0)),
        ((1, 7), (0.7, 0.0, -0.7)),
        ((1, 9), (0.8, 0.2, -0.3, -0.8)),
        ((1, 7), (1.5, 0.9, 0.2, -0.6, -1.5)),
    ),
    "multiplicative": (
        ((1, 3), (2.0, -2.0)),
        ((1, 5), (1.0, 0.0, -1.0)),
        ((1, 7), (1.0, 0.0, -1.0)),
        ((1, 9), (1.0, 0.0, -1.0)),
        ((1, 5), (2.0, 1.0, -1.0, -2.0)),
    ),
}
LEARNED, ROWS, OTHERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 20), (1, 2, 3, 4, 5), (10, 20, 40)


def solvers(problem: Problem) -> dict[str, tuple[Solver, int]]:
    """Return what is compared, and its iterations."""
    steps, is_sum = steps_for(problem), problem.link.is_sum
    learned = {f"learned steps:{n}": (steps.solver(n), n) for n in LEARNED}
    rows = {f"row-newton:{n}": (RowNewton() if is_sum else RowGaussNewton(), n) for n in ROWS}
    name, other = ("fourier-admm", FourierAdmm()) if is_sum else ("sweeps", Sweeps())
    return learned | rows | {f"{name}:{n}": (other, n) for n in OTHERS}


def posed(link: str, views: tuple[int, int], disparity: tuple[float, ...]) -> Problem:
    values = {"name": "row", "link": link, "disparity": disparity, "views": views}
    shown = Display(DisparitySpec.model_validate(values))
    scene = panned(shown.geometry, (0, 0), 1, size=SIZE, seed=SEED)[0]
    codes = scene.clamp(0, 1).mul(255).round().to(torch.uint8)
    return pose(LightField(codes, views), shown)


def measured(problem: Problem) -> dict[str, dict[str, float]]:
    """Return the excess error and the seconds of every contender."""
    rows = RowNewton() if problem.link.is_sum else RowGaussNewton()
    best = solve(problem, rows, iterations=BEST)
    least = problem.mean_square_error(best.layers)
    runs: dict[str, dict[str, float]] = {}
    for _ in range(REPEATS + 1):  # the first warms up
        for name, (solver, count) in solvers(problem).items():
            made = solve(problem, solver, iterations=count)
            known = runs.setdefault(name, {"excess": 0.0, "seconds": float("inf")})
            known["excess"] = excess(problem.mean_square_error(made.layers), least)
            known["seconds"] = min(known["seconds"], made.seconds)
    return runs


def main(out: Path, link: str) -> None:
    rows = []
    for views, disparity in DISPLAYS[link]:
        problem = posed(link, views, disparity)
        reach = row_reach(problem.projection)
        rows.append({"views": views, "disparity": disparity, "reach": reach})
        rows[-1]["runs"] = measured(problem)
        print(f"{views} {disparity}, reach {reach}")
        for name, run in rows[-1]["runs"].items():
            print(f"  {name:18} {run['excess']:8.2%} {run['seconds'] * 1e3:8.1f} ms", flush=True)
        record = {
            "command": f"python benchmarks/rows.py {out.name} --link {link}",
            "made_with": provenance(torch.device("cpu")),
            "threads": torch.get_num_threads(),
            "size": SIZE,
            "seed": SEED,
            "rows": rows,
        }
        with whole_file(out, force=True) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="rows as systems of their own")
    parser.add_argument("out", type=output_file)
    parser.add_argument("--link", choices=[*DISPLAYS], default="additive")
    given = parser.parse_args()
    main(given.out, given.link)
