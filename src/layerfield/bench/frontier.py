"""Every method with every number of iterations on every light field and display."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch

from layerfield.bench.records import Subjects
from layerfield.bench.road import EightBitViews
from layerfield.bench.rows import BenchRow, Effort, Key, measured, with_peak
from layerfield.display import Display
from layerfield.evaluate import parse_methods
from layerfield.light_field import LightField
from layerfield.reference import Reference, reference, store_reference
from layerfield.synthesizer import find_method, pose, spelled

BUDGETS = (1, 2, 3, 5, 10, 20, 50, 100)


@dataclass(frozen=True)
class Contest:
    """What is run on every light field.

    Args:
        displays: that layers are made for.
        methods: name and numbers of iterations, increasing; those that do not serve a display
            are left out there.
        effort: how carefully runs are measured.
        device: that all is done on.

    Raises:
        ValueError: a method that serves none of the displays.
    """

    displays: Sequence[Display]
    methods: Sequence[tuple[str, Sequence[int]]]
    effort: Effort
    device: torch.device

    def __post_init__(self) -> None:
        for name, _ in self.methods:
            reasons = [why for each in self.displays if (why := unserved(name, each))]
            if len(reasons) == len(self.displays):
                raise ValueError(reasons[0])


def unserved(method: str, display: Display) -> str | None:
    """Return why a method does not serve a display, if so."""
    try:
        find_method(method).refuse_unserved(display)
    except ValueError as error:
        return str(error)
    return None


def parse_budgets(text: str) -> tuple[int, ...]:
    """Parse `1,2,5` into increasing numbers of iterations.

    Raises:
        ValueError: anything else.

    >>> parse_budgets("1,2,5")
    (1, 2, 5)
    """
    entries = [entry.strip() for entry in text.split(",")]
    if not all(entry.isdecimal() for entry in entries):
        raise ValueError(f"found budgets '{text}', expected numbers of iterations, as 1,2,5,10")
    return tuple(sorted({int(entry) for entry in entries}))


def parse_contenders(text: str, budgets: Sequence[int]) -> list[tuple[str, tuple[int, ...]]]:
    """Parse `a,b:10,c` into methods and their numbers of iterations.

    A method with a number has that one, a network none, all others have the budgets. A method may
    be named several times.

    Raises:
        ValueError: an unknown method or not a number of iterations.

    >>> parse_contenders("nmf,fourier-admm:10,unet", (1, 5))
    [('nmf', (1, 5)), ('fourier-admm', (10,)), ('unet', (0,))]
    """
    found: dict[str, set[int]] = {}
    for entry in text.split(","):
        for budget in budgets:
            ((name, iterations),) = parse_methods(entry, budget)
            found.setdefault(name, set()).add(iterations)
    return [(name, tuple(sorted(counts))) for name, counts in found.items()]


def subjects_of(fields: Sequence[LightField], contest: Contest) -> Subjects:
    """Return what names stand for: rows of one name compare only if that is the same."""
    methods = [find_method(name) for name, _ in contest.methods]
    return {
        "light field": {field.name: _fingerprint(EightBitViews.of(field)) for field in fields},
        "display": {
            each.name: each.spec.model_dump(mode="json", exclude_defaults=True)
            for each in contest.displays
        },
        "method": {
            method.title: hashlib.sha256(file.read_bytes()).hexdigest()
            for method in methods
            if (file := method.file)
        },
    }


def _fingerprint(views: EightBitViews) -> str:
    """Return the sha256 of 8-bit views, their shape and their grid."""
    digest = hashlib.sha256(repr((tuple(views.codes.shape), views.grid)).encode())
    digest.update(views.codes.contiguous().numpy().tobytes())
    return digest.hexdigest()


def run_contest(
    fields: Sequence[LightField],
    contest: Contest,
    *,
    known: Sequence[BenchRow] = (),
    keep: Callable[[Sequence[BenchRow]], None] = lambda _: None,
    tick: Callable[[str], None] = lambda _: None,
) -> list[BenchRow]:
    """Measure everything that is not known yet.

    Args:
        fields: light fields, with the views of the displays.
        contest: methods and displays.
        known: rows of an earlier run, which stay as they are.
        keep: called with all rows after each.
        tick: called with a word on what is being done.

    Raises:
        ValueError: views that are not those of a display.
    """
    given = [EightBitViews.of(field, contest.device) for field in fields]
    for views in given:
        for display in contest.displays:
            pose(views.light_field(), display)
    rows = {row.key: row for row in known}
    for views in given:
        for display in contest.displays:
            _run_pair(views, display, contest, rows, keep, tick)
    return list(rows.values())


def _run_pair(
    views: EightBitViews,
    display: Display,
    contest: Contest,
    rows: dict[Key, BenchRow],
    keep: Callable[[Sequence[BenchRow]], None],
    tick: Callable[[str], None],
) -> None:
    problem = pose(views.light_field(), display)
    tick(f"{views.name}, {display.name}: reference")
    best = reference(problem)
    for row in rows.values():
        if row.key[:2] == (views.name, display.name):
            best = best.improved_by(row.least, row.label)
    for method, budgets in contest.methods:
        if unserved(method, display):
            continue
        for n in budgets:
            key = (views.name, display.name, find_method(method).title, n)
            if key not in rows:
                tick(f"{views.name}, {display.name}: {spelled(method, n)}")
                row = measured(views, display, method, n, contest.effort)
                if contest.effort.memory and (row.capped or n == budgets[-1]):
                    row = with_peak(row, views, display, method)
                best = best.improved_by(row.least, row.label)
                rows[key] = replace(row, reference=best)
                _share(rows, views.name, display.name, best)
                keep(list(rows.values()))
            if rows[key].capped:
                break
    store_reference(problem, best)


def _share(rows: dict[Key, BenchRow], field: str, display: str, best: Reference) -> None:
    """Compare all rows of a field and display with the same, latest reference."""
    for key, row in rows.items():
        if key[:2] == (field, display):
            rows[key] = replace(row, reference=best)
