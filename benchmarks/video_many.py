"""How often frames of a video come near their optimum: many videos of every kind.

    python benchmarks/video_many.py OUT.json

`video.py` follows a few videos frame by frame. Here are sixteen of every kind, other scenes each,
on the same display; the twelfth frame is judged. Displays show some scenes so well, or light takes
so long to find its layer, that a small error is a large share of what the optimum leaves: one video
says little.
"""

import argparse
import json
import statistics
from pathlib import Path

import torch
from outputs import output_file
from video import ROW, SIZE, Judged, display, fields

from layerfield.io import whole_file
from layerfield.provenance import provenance
from layerfield.scenes import animated, panned, travelled

FRAMES, FIRST_SEED, MANY = 12, 1000, 16
SHOWN = display(ROW)
GEOMETRY = SHOWN.geometry
ASKED = 0.035
KINDS = {
    "pan 1 px": lambda seed: panned(GEOMETRY, (1, 0), FRAMES, size=SIZE, seed=seed),
    "pan 4, 2 px": lambda seed: panned(GEOMETRY, (4, 2), FRAMES, size=SIZE, seed=seed),
    "travel 0.4 views": lambda seed: travelled(GEOMETRY, 0.4, FRAMES, size=SIZE, seed=seed),
    "travel 1 view": lambda seed: travelled(GEOMETRY, 1.0, FRAMES, size=SIZE, seed=seed),
    "travel 3 views": lambda seed: travelled(GEOMETRY, 3.0, FRAMES, size=SIZE, seed=seed),
    "things to 3 px": lambda seed: animated(GEOMETRY, 3.0, FRAMES, size=SIZE, seed=seed),
}
RUNS = (("warm", 1), ("warm", 2), ("warm", 3), ("cold", 1), ("cold", 2), ("cold", 3))


def main(out: Path) -> None:
    torch.set_num_threads(1)
    found: dict[str, dict] = {}
    record = {
        "command": f"python benchmarks/video_many.py {out.name}",
        "made_with": provenance(torch.device("cpu")),
        "seeds": [FIRST_SEED, FIRST_SEED + MANY - 1],
        "size": SIZE,
        "kinds": found,
    }
    for kind, make in KINDS.items():
        excess: dict[str, list[float]] = {f"{how} fast:{count}": [] for how, count in RUNS}
        for seed in range(FIRST_SEED, FIRST_SEED + MANY):
            judged = Judged.of(fields(make(seed), ROW), SHOWN, FRAMES, FRAMES - 1)
            for how, count in RUNS:
                row = getattr(judged, how)("fast", count)
                excess[f"{how} fast:{count}"].append(row["max"])
        found[kind] = {run: summary(values) for run, values in excess.items()}
        print(kind, {run: told(row) for run, row in found[kind].items()}, flush=True)
        with whole_file(out, force=True) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")


def summary(values: list[float]) -> dict:
    return {
        "median": statistics.median(values),
        "max": max(values),
        "within": sum(value <= ASKED for value in values),
        "excess": [round(value, 4) for value in values],
    }


def told(row: dict) -> str:
    return f"{row['median']:.1%}, to {row['max']:.1%}; {row['within']} of {MANY} within {ASKED:.1%}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="excess error of many videos")
    parser.add_argument("out", type=output_file)
    main(parser.parse_args().out)
