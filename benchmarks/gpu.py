"""Pictures a second of 5x5 views at 1920x1080 on a GPU, beside the floor that memory sets.

    python benchmarks/gpu.py OUT.json [--device cpu] [--size 96x64] [--methods fourier-admm]

RGB, 3 layers, additive and multiplicative, values as they are and linear light; 8-bit views on the
device to 8-bit layers on the device, with other views for every picture, two of which are under way
at a time (`--at-once`). Of every method the fewest iterations that come within 5 % excess of the
reference on the first picture are timed. References take minutes, and are kept for the next run.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path

import torch

from layerfield.bench.benchmark import made_on
from layerfield.bench.recorded_road import refuse_unrecorded
from layerfield.bench.records import write_record
from layerfield.bench.road import EightBitViews
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
from layerfield.cli.refusals import DEVICES, refuse_device
from layerfield.provenance import provenance
from layerfield.synthesizer import find_method

DEFAULT = ("fast", "fourier-admm")


def main(out: Path, stream: Stream, methods: Sequence[str], views: list[EightBitViews]) -> None:
    (height, width), names, device = stream.size, ",".join(methods), views[0].codes.device
    bandwidth = copy_bandwidth(device)
    facts = {
        "made_with": provenance(device),
        "command": f"python benchmarks/gpu.py {out.name} --device {device.type} "
        f"--size {width}x{height} --methods {names} --at-once {stream.at_once}",
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


def refuse(out: Path, methods: Sequence[str], device: torch.device) -> None:
    """Refuse what cannot be measured or written, before minutes of work.

    Raises:
        ValueError: a device that is not there, an unknown method or one that is not recorded, a
            place where no file can be.
    """
    refuse_device(device.type)
    for name, display in product(methods, displays()):
        find_method(name)
        if device.type == "cuda":
            refuse_unrecorded(name, display)
    if out.is_dir() or not out.parent.is_dir():
        raise ValueError(f"{out} is a folder, or there is none for it; expected a file to write")


def _size(written: str) -> tuple[int, int]:
    """Return height and width of WIDTHxHEIGHT."""
    width, x, height = written.partition("x")
    if not (x and width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"found '{written}', expected WIDTHxHEIGHT, as 1920x1080")
    return int(height), int(width)


def _count(written: str) -> int:
    """Return a number of pictures."""
    if not (written.isdecimal() and int(written)):
        raise argparse.ArgumentTypeError(f"found '{written}', expected a number from 1 on")
    return int(written)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", choices=DEVICES, default="cuda")
    parser.add_argument("--size", type=_size, default="1920x1080", metavar="WIDTHxHEIGHT")
    parser.add_argument("--methods", default=",".join(DEFAULT))
    parser.add_argument("--at-once", type=_count, default=Stream.at_once, metavar="N")
    given = parser.parse_args()
    chosen, device = given.methods.split(","), torch.device(given.device)
    stream = Stream(size=given.size, at_once=given.at_once)
    try:
        refuse(given.out, chosen, device)
        views = pictures(stream, device)
    except ValueError as error:
        parser.error(str(error))
    main(given.out, stream, chosen, views)
