"""How many times as long as `fast` other methods take to arrive, each with it by turns.

    python benchmarks/frontier.py ARRIVAL --arrival
    python benchmarks/turns.py OUT.json ARRIVAL/bench.json

Machines become slower and faster by a third within minutes, which lie between two methods of one
run. Here what `fast` needs to come within 0.1 dB of the optimum, several times over, and what
another method needs follow each other again and again; the ratio is the median of those of
neighbours.
"""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import torch
from five_fields import OPTIONS, five_fields
from outputs import output_file

from layerfield import Display
from layerfield.bench.reaching import Reached, reached
from layerfield.bench.road import EightBitViews, views_to_panels
from layerfield.bench.rows import BenchRow
from layerfield.bench.timing import timed_by_turns
from layerfield.io import whole_file
from layerfield.provenance import provenance

FAST = "fast"
TURNS = 7
SHARE = 0.2  # of another method's time that runs of `fast` take together
CPU = torch.device("cpu")


def arrivals(path: Path) -> list[Reached]:
    """Return when methods came near enough.

    Raises:
        ValueError: the file is no record of a benchmark, or `fast` does not arrive in it.
    """
    try:
        rows = [*map(BenchRow.of_record, json.loads(path.read_text("utf-8"))["rows"])]
    except (OSError, ValueError, TypeError, KeyError):
        raise ValueError(f"{path} is no bench.json; make one with frontier.py --arrival") from None
    found = [each for each in reached(rows) if each.seconds and each.field in OPTIONS]
    if not any(each.method == FAST for each in found):
        raise ValueError(f"{path} has no arrival of {FAST}; make one with frontier.py --arrival")
    return found


def turns_of(found: list[Reached], views: EightBitViews, display: Display) -> list[dict]:
    """Return how the others stand to the first that is `fast`; none where it did not arrive."""

    def runs(each: Reached, times: int = 1) -> Callable[[], None]:
        def run() -> None:
            for _ in range(times):  # each lets its panels go, as pictures that follow each other do
                views_to_panels(views, display, each.method, each.iterations or 0)

        return run

    own = next((each for each in found if each.method == FAST), None)
    made = list[dict]()
    for each in found if own is not None else []:
        if each is own or own is None or own.seconds is None or each.seconds is None:
            continue
        times = max(1, math.ceil(SHARE * each.seconds / own.seconds))
        several = runs(own, times)
        seconds, ratio = timed_by_turns(runs(each), several, CPU, repeats=TURNS)
        facts = {"field": each.field, "display": each.display, "fast": own.iterations}
        facts |= {"method": each.method, "iterations": each.iterations}
        made.append(facts | {"seconds": asdict(seconds), "times_as_long": ratio * times})
        line = f"{each.field}: {each.method}:{each.iterations} takes {ratio * times:.1f} times"
        print(line, f"as long as {FAST}:{own.iterations}", flush=True)
    return made


def main(out: Path, bench: Path) -> None:
    found = arrivals(bench)
    results = list[dict]()
    for name, field in five_fields(*dict.fromkeys(each.field for each in found)).items():
        views = EightBitViews.of(field)
        for display in dict.fromkeys(each.display for each in found):
            here = [each for each in found if (each.field, each.display) == (name, display)]
            results += turns_of(here, views, Display.load(display))
    facts = {"command": "python benchmarks/turns.py OUT.json ARRIVAL/bench.json", "turns": results}
    with whole_file(out, force=True) as path:
        path.write_text(json.dumps(facts | provenance(CPU), indent=1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=output_file)
    parser.add_argument("bench", type=Path)
    given = parser.parse_args()
    try:
        main(given.out, given.bench)
    except ValueError as error:
        parser.error(str(error))
