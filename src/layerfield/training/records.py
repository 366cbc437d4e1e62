"""What a training leaves behind; every file is whole at any time.

OUT/checkpoint.safetensors   all state after the last epoch, to resume from
OUT/weights.safetensors      the network that was best on the validation scenes
OUT/history.csv              a row for every epoch
OUT/result.json              figures, data, recipe, versions
OUT/tensorboard/             the same history for TensorBoard, if it is installed
"""

import csv
import json
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch

from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.io import whole_file
from layerfield.networks import Network
from layerfield.provenance import provenance
from layerfield.training.recipe import Recipe
from layerfield.weights import WeightsCard, write_weights

CHECKPOINT = "checkpoint.safetensors"
WEIGHTS = "weights.safetensors"
RESULT = "result.json"
HISTORY = "history.csv"
BOARD = "tensorboard"

History = list[dict[str, float]]


class Records:
    """Writes the files of a run, but for its checkpoint.

    Args:
        out: folder of the run.
        recipe: of the run.
        display: that is trained for.
        facts: what is known before the first step: data, command, figures of the solver.
        step: that the run begins or resumes at.
    """

    def __init__(
        self, out: Path, recipe: Recipe, display: Display, facts: dict[str, Any], step: int
    ) -> None:
        self.out, self.recipe, self.display, self.facts = out, recipe, display, facts
        self.board = None
        if find_spec("tensorboard") is not None:
            from layerfield.training.board import Board  # noqa: PLC0415, optional

            self.board = Board(out / BOARD, step)

    def write(self, history: History, notes: list[str], device: torch.device) -> None:
        """Write history and result after an epoch."""
        last = history[-1]
        with whole_file(self.out / HISTORY, force=True) as path, path.open("w", newline="") as file:
            table = csv.DictWriter(file, last.keys())
            table.writeheader()
            table.writerows(history)
        best = max(history, key=lambda row: row["validation_psnr"])
        seen = max(history, key=lambda row: row["test_psnr"])
        facts = self.facts | {
            "recipe": self.recipe.model_dump(mode="json", exclude_none=True),
            "notes": notes,
            "epochs": last["epoch"],
            "steps": last["step"],
            "seconds": last["seconds"],
            "best": best,
            "best_if_chosen_on_test": seen,  # as the paper does; no fair figure
            "made_with": provenance(device),
        }
        with whole_file(self.out / RESULT, force=True) as path:
            path.write_text(json.dumps(facts, indent=2), "utf-8")
        if self.board is not None:
            scalars = {key: last[key] for key in last if key not in ("epoch", "step")}
            self.board.add(scalars, int(last["step"]))

    def write_weights(self, network: Network, row: dict[str, float], device: torch.device) -> None:
        """Write the network, with the row of history that it earned."""
        card = WeightsCard(
            network=self.recipe.network,
            options=dict(self.recipe.options),
            display=format_spec(self.display.spec),
            recipe=self.recipe.name,
            training=self.facts | {"row": row, "made_with": provenance(device)},
        )
        write_weights(self.out / WEIGHTS, network, card)


def refuse_run(out: Path, *, resume: bool, force: bool) -> None:
    """Refuse a folder that a run cannot be made or resumed in; change nothing.

    Raises:
        ValueError: nothing to resume from, or a folder that may not be replaced.
    """
    if resume:
        if not (out / CHECKPOINT).is_file():
            raise ValueError(f"{out} holds no {CHECKPOINT} to resume from; leave out --resume")
    elif out.is_dir() and any(out.iterdir()):
        if not force:
            raise ValueError(f"{out} exists; go on with --resume, replace it with --force")
        if not any((out / name).exists() for name in (CHECKPOINT, RESULT, WEIGHTS, BOARD)):
            raise ValueError(
                f"{out} holds no training and will not be replaced; give another --out"
            )


def open_run(out: Path, *, resume: bool, force: bool) -> None:
    """Make the folder of a run, or find it as it was left.

    Raises:
        ValueError: as `refuse_run`, or the folder cannot be made.
    """
    refuse_run(out, resume=resume, force=force)
    if resume:
        return
    try:
        if out.is_dir():
            shutil.rmtree(out)
        out.mkdir(parents=True)
    except OSError as error:
        raise ValueError(f"cannot make {out}: {error.strerror}") from None


def read_history(out: Path) -> History:
    """Return the rows of a run's history."""
    with (out / HISTORY).open(newline="") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def read_result(out: Path) -> dict[str, Any]:
    """Return the facts of a run."""
    return json.loads((out / RESULT).read_text("utf-8"))
