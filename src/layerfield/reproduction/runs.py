"""Where the paper's two networks come from: runs of their recipes, and weight files.

A folder of runs holds `RECIPE/` and, for other seeds, `RECIPE-seedN/`, each as `layerfield train`
leaves it: `history.csv`, `result.json` and, unless the registry of shipped weights has them,
`weights.safetensors`.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from layerfield.display import Display
from layerfield.reproduction.contenders import RECIPES
from layerfield.shipped import TRAINED, shipped
from layerfield.training.loop import Run, train
from layerfield.training.recipe import read_recipe
from layerfield.training.records import (
    CHECKPOINT,
    HISTORY,
    RESULT,
    WEIGHTS,
    History,
    read_history,
    read_result,
)
from layerfield.weights import same_light_paths

SHIPPED_RUNS = TRAINED / "runs"


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A training that has ended.

    Args:
        seed: of the recipe.
        history: a row for every epoch.
        facts: of its result.json.
    """

    seed: int
    history: History
    facts: dict[str, Any]

    @property
    def patch(self) -> int:
        """Height and width of what a step is made on, pixels."""
        recipe = self.facts["recipe"]
        return int((recipe.get("stored") or recipe.get("drawn") or recipe["fields"])["patch"])

    @property
    def pixels_of_a_step(self) -> int:
        """Pixels of one colour channel that a step is made on."""
        return int(self.facts["recipe"]["batch"]) * self.patch**2

    @property
    def options(self) -> dict[str, int | bool]:
        """Constructor options of the network."""
        return dict(self.facts["recipe"]["options"])

    @property
    def made_on(self) -> str:
        """Processor and threads; seconds compare only where these are the same."""
        made = self.facts.get("made_with", {})
        return f"{made.get('processor', 'unknown')}, {made.get('threads', 'unknown')} threads"

    @property
    def optimum(self) -> dict[str, float]:
        """What the solver reaches on the same scenes, dB, by name of the column."""
        return {k: v for k, v in self.facts["reference"].items() if k.endswith("_psnr")}

    def selected(self, column: str, limit: float) -> dict[str, float] | None:
        """Return the row that validation chooses among those within a budget, if there is one.

        Args:
            column: of the budget: epoch, step or seconds.
            limit: the most of it.
        """
        within = [row for row in self.history if row[column] <= limit]
        return max(within, key=lambda row: row["validation_psnr"], default=None)


def find_runs(folder: Path, recipe: str) -> list[TrainedRun]:
    """Return the runs of a recipe, by seed.

    Raises:
        ValueError: a run whose files are damaged.
    """
    found = [folder / recipe, *sorted(folder.glob(f"{recipe}-seed*"))]
    runs = [_read(run) for run in found if (run / RESULT).is_file()]
    return sorted(runs, key=lambda run: run.seed)


def _read(folder: Path) -> TrainedRun:
    try:
        history, facts = read_history(folder), read_result(folder)
        run = TrainedRun(int(facts["recipe"]["seed"]), history, facts)
        complete = {"epoch", "step", "seconds", "validation_psnr", "test_psnr"} <= set(history[0])
        if not (complete and run.optimum and run.pixels_of_a_step and run.options):
            raise ValueError("a column is missing")
    except (OSError, ValueError, KeyError, IndexError, TypeError, json.JSONDecodeError):
        raise ValueError(
            f"{folder.name}/{RESULT} or {folder.name}/{HISTORY} is damaged or was not written by "
            "layerfield train; train it again"
        ) from None
    return run


def find_weights(folder: Path, recipe: str, display: Display) -> Path | None:
    """Return the weight file of a recipe: of its run, or of those that ship beside the runs.

    Args:
        folder: of runs.
        recipe: its name.
        display: that the weights must be for.
    """
    own = folder / recipe / WEIGHTS
    if own.is_file():
        return own
    if folder != SHIPPED_RUNS:
        return None
    for entry in shipped():
        if recipe in (entry.name, entry.recipe) and same_light_paths(entry.trained_for, display):
            return TRAINED / entry.file
    return None


def command(recipe: str) -> str:
    """Return the command that makes what is missing."""
    return f"layerfield train {recipe}"


def train_both(folder: Path, tick: Callable[[str], None]) -> None:
    """Train the paper's two recipes, or go on where their checkpoints stand."""
    for name in RECIPES.values():
        out = folder / name
        resume = (out / CHECKPOINT).is_file()
        train(
            Run(
                recipe=read_recipe(name),
                out=out,
                resume=resume,
                command=command(name),
                tick=lambda what, _: tick(what),
            )
        )
