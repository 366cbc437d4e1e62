"""Pictures a second of 5x5 views at 1920x1080 on a GPU, beside the floor that memory sets.

    python benchmarks/gpu.py OUT.json [--device cpu] [--size 96x64] [--methods fourier-admm]

RGB, 3 layers, additive and multiplicative, values as they are and linear light; 8-bit views on the
device to 8-bit layers on the device, with other views for every picture. Of every method the fewest
iterations that come within 5 % excess of the reference on the first picture are timed. References
take minutes, and are kept for the next run.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from layerfield.bench.benchmark import made_on
from layerfield.bench.records import write_record
from layerfield.bench.throughput import (
    Stream,
    StreamRow,
    copy_bandwidth,
    displays,
    pictures,
    references,
    run_stream,
    stream_lines,
)
from layerfield.provenance import provenance
from layerfield.synthesizer import METHODS

DEFAULT = [name for name in ("fast", "fourier-admm") if name in METHODS]


def main(out: Path, stream: Stream, methods: Sequence[str], device: torch.device) -> None:
    (height, width), names = stream.size, ",".join(methods)
    views, bandwidth = pictures(stream, device), copy_bandwidth(device)
    facts = {
        "made_with": provenance(device),
        "command": f"python benchmarks/gpu.py {out.name} --device {device} "
        f"--size {width}x{height} --methods {names}",
        "stream": asdict(stream),
        "views": [25, 3, *stream.size],
        "copy_bandwidth_gb_s": bandwidth / 1e9,
    }
    rows: list[StreamRow] = []
    for display in displays():
        best = references(views[: stream.judged], display)
        for name in methods:
            rows.append(run_stream(views, display, best, (name, stream.budgets), stream, bandwidth))
            write_record(out, facts | {"rows": [row.as_record() for row in rows]})
            print(json.dumps(rows[-1].as_record()), flush=True)
    print(f"{made_on(device)}, {bandwidth / 1e9:.0f} GB/s; floor: bytes that must move over that")
    for line in stream_lines(rows):
        print("  ".join(f"{cell:>14}" for cell in line))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--methods", default=",".join(DEFAULT))
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    chosen = given.methods.split(",")
    main(given.out, Stream(size=(height, width)), chosen, torch.device(given.device))
