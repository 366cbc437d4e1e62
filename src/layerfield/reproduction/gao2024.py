"""Gao et al. 2024, U-Net for compressive displays: measure, draw, judge, write it all down.

What the paper leaves open, and what was chosen here, is listed in docs/gao2024.md.

Reference:
    Gao, Li, Liu and Tan, "Image Quality, Uniformity and Computation Improvement of Compressive
    Light Field Displays with U-Net", 2024.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from layerfield.display import Display
from layerfield.io import whole_directory
from layerfield.light_field import LightField
from layerfield.networks import NETWORKS
from layerfield.provenance import provenance
from layerfield.report.page import write_page
from layerfield.report.plots import save
from layerfield.reproduction import figures
from layerfield.reproduction.claims import (
    Check,
    Claim,
    judge_computation,
    judge_equivalence,
    judge_quality,
    judge_uniformity,
    lines_beside,
)
from layerfield.reproduction.contenders import (
    CNN,
    RECIPES,
    SOLVERS,
    UNET,
    Contender,
    faithful,
    improved,
)
from layerfield.reproduction.convergence import Trainings, judge_training
from layerfield.reproduction.measures import (
    Effort,
    Measured,
    Tick,
    as_record,
    measure,
    network_cost,
)
from layerfield.reproduction.page import claims_page
from layerfield.reproduction.runs import (
    SHIPPED_RUNS,
    command,
    find_runs,
    find_weights,
)
from layerfield.reproduction.statement import claims_text
from layerfield.scenes import procedural_light_field
from layerfield.synthesizer import pose
from layerfield.weights import kept_weights

DISPLAY = "additive-3"  # "Here, we take the additive type" (section 4)
# Apart from all scenes of training, validation and test (see training.sources); the fourth of six,
# taken for its look before the networks were trained.
TARGET_SEED = 3 * 2**30 + 3
_SIZE = (256, 256)

Judge = Callable[[Sequence[Measured]], list[Check]]
_JUDGES: dict[int, Judge] = {
    2: judge_uniformity,
    3: judge_equivalence,
    4: judge_computation,
    5: judge_quality,
}


@dataclass(frozen=True)
class Reproduction:
    """What to reproduce from.

    Args:
        fields: target light fields; the procedural one if there is none.
        runs: folder of runs; those that ship if not given.
        effort: how much is measured.
    """

    fields: Sequence[LightField] = ()
    runs: Path = SHIPPED_RUNS
    effort: Effort = field(default_factory=Effort)


def target_scene(size: tuple[int, int] = _SIZE) -> LightField:
    """Return the target light field: a scene that no recipe trains or judges on."""
    made = procedural_light_field(size=size, seed=TARGET_SEED)
    return replace(made, name="procedural target scene")


def reproduce(
    out: Path,
    given: Reproduction,
    *,
    more: Callable[[Path], list[Claim]] | None = None,
    force: bool = False,
    tick: Tick = lambda _: None,
) -> list[Claim]:
    """Measure, draw, judge; write figures, claims.md, claims.json, result.json, report.html.

    Args:
        out: folder to make, whole or not at all.
        given: what to reproduce from.
        more: ablations; draws into a folder and returns what it found.
        force: replace an earlier one.
        tick: called with a word on what is being done.

    Returns:
        The claims with their verdicts.

    Raises:
        ValueError: views that are not those of the display, damaged runs or weights.
    """
    display = Display.load(DISPLAY)
    fields = given.fields or [target_scene()]
    for each in fields:
        pose(each, display)
    trainings = {name: _trainings(name, given.runs, display) for name in (CNN, UNET)}
    contenders = _contenders(given.runs, display)
    with whole_directory(out, force=force) as folder:
        measured = [measure(each, display, contenders, given.effort, tick) for each in fields]
        tick("drawing")
        _draw(folder, measured, trainings, display)
        claims = [judge_training(trainings), *_judge(measured)]
        claims += [] if more is None else more(folder)
        record = _record(display, fields, trainings, contenders)
        _write(folder / "claims.json", record | {"claims": [each.as_record() for each in claims]})
        (folder / "claims.md").write_text(claims_text(claims, record), "utf-8")
        write_page(folder / "report.html", claims_page(claims, record, folder))
        _write(folder / "result.json", record | {"measured": [as_record(m) for m in measured]})
    return claims


def _trainings(name: str, folder: Path, display: Display) -> Trainings:
    runs = find_runs(folder, RECIPES[name])
    if not runs:
        return Trainings((), 0.0)
    make = partial(NETWORKS[name], display.view_count, display.layer_count)
    size = (runs[0].patch, runs[0].patch)
    return Trainings(runs, network_cost(make(**runs[0].options), size, display.margin))


def _contenders(folder: Path, display: Display) -> list[Contender]:
    found = {name: find_weights(folder, recipe, display) for name, recipe in RECIPES.items()}
    for path in filter(None, found.values()):
        kept_weights(path).refuse_other(display)
    own = faithful(found)
    return [*own, *improved(display, own), *SOLVERS]


def _draw(
    folder: Path, measured: Sequence[Measured], trainings: dict[str, Trainings], display: Display
) -> None:
    for n, each in enumerate(measured):
        mark = f"-{n + 1}" if len(measured) > 1 else ""
        for name, figure in figures.figures_of_field(each, display):
            save(figure, folder / f"{name}{mark}.png")
    if any(each.runs for each in trainings.values()):
        save(figures.learning_curves(trainings), folder / "figure4.png")
        save(figures.effort_curves(trainings), folder / "figure4-effort.png")


def _judge(measured: Sequence[Measured]) -> list[Claim]:
    beside = lines_beside(measured)
    missing = [name for name in (CNN, UNET) if name not in measured[0].shown]
    if missing:
        commands = " and ".join(f"`{command(RECIPES[name])}`" for name in missing)
        text = f"no weights of {' and '.join(missing)}; make them with {commands}"
        text += ", then give --runs runs"
        return [Claim(n, beside=beside[n], missing=text) for n in _JUDGES]
    return [Claim(n, tuple(judge(measured)), beside[n]) for n, judge in _JUDGES.items()]


def _record(
    display: Display,
    fields: Sequence[LightField],
    trainings: dict[str, Trainings],
    contenders: Sequence[Contender],
) -> dict[str, Any]:
    """Return what everything was made from, without any path."""
    weights = {c.label: kept_weights(c.method) for c in contenders if c.iterations is None}
    return {
        "paper": "gao2024",
        "display": display.name,
        "fields": [each.name for each in fields],
        "target_seed": TARGET_SEED,
        "recipes": dict(RECIPES),
        "seeds": {name: [run.seed for run in each.runs] for name, each in trainings.items()},
        "trained_with": {
            name: [run.facts.get("made_with", {}) for run in each.runs]
            for name, each in trainings.items()
        },
        "weights": {
            label: {"recipe": each.card.recipe, "sha256": each.sha256}
            for label, each in weights.items()
        },
        "solvers": [asdict(c) for c in contenders if c.iterations is not None],
        "made_with": provenance(fields[0].stored.device),
    }


def _write(path: Path, record: dict[str, Any]) -> None:
    path.write_text(json.dumps(record, indent=2, allow_nan=False), "utf-8")
