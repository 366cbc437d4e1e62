"""Claim 1: how the two networks learn, and what they make of scenes they have not seen."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from layerfield.reproduction.claims import ALIKE_DB, Check, Claim, better, mean_and_range
from layerfield.reproduction.contenders import CNN, RECIPES, UNET
from layerfield.reproduction.runs import TrainedRun, command

BACKWARD = 3  # a training step costs a forward pass and twice that back


@dataclass(frozen=True, eq=False)
class Trainings:
    """Runs of one network.

    Args:
        runs: by seed.
        cost: of a forward pass at the size of the patches, multiply-adds per pixel.
    """

    runs: Sequence[TrainedRun]
    cost: float

    @property
    def final(self) -> list[dict[str, float]]:
        """The last row of every run."""
        return [run.history[-1] for run in self.runs]

    @property
    def chosen(self) -> list[dict[str, float]]:
        """The row of every run that validation chooses."""
        return [max(run.history, key=lambda row: row["validation_psnr"]) for run in self.runs]

    def operations(self, run: TrainedRun, row: Mapping[str, float]) -> float:
        """Return the multiply-adds of training up to a row."""
        return row["step"] * run.pixels_of_a_step * self.cost * BACKWARD

    def at(self, measure: str, limit: float) -> list[float]:
        """Return the test PSNR of what validation chooses within a budget, of every run.

        Args:
            measure: step, seconds or operations.
            limit: the most of it.
        """
        found = []
        for run in self.runs:
            column, most = measure, limit
            if measure == "operations":
                column, most = "step", limit / self.operations(run, {"step": 1.0})
            row = run.selected(column, most * (1 + 1e-9))
            found.append(-float("inf") if row is None else row["test_psnr"])
        return found

    def spent(self, measure: str) -> float:
        """Return the least that a run of this network has spent in the end."""
        if measure == "operations":
            return min(self.operations(run, run.history[-1]) for run in self.runs)
        return min(run.history[-1][measure] for run in self.runs)


def judge_training(trainings: Mapping[str, Trainings]) -> Claim:
    """Claim 1, from the runs of both networks."""
    missing = [name for name in (CNN, UNET) if not trainings[name].runs]
    if missing:
        commands = " and ".join(f"`{command(RECIPES[name])}`" for name in missing)
        return Claim(1, missing=f"no runs of {' and '.join(missing)}; make them with {commands}")
    unet, cnn = _same_seeds(trainings[UNET], trainings[CNN])
    checks = [*_convergence(unet, cnn), *_generalisation(unet, cnn), *_budgets(unet, cnn)]
    beside = (_seeds(unet, cnn), *_cut_short(trainings), *_all_figures(trainings))
    return Claim(1, tuple(checks), beside)


def _same_seeds(unet: Trainings, cnn: Trainings) -> tuple[Trainings, Trainings]:
    """Return the runs whose seed both have; all runs if there is none such."""
    common = {run.seed for run in unet.runs} & {run.seed for run in cnn.runs}
    if not common:
        return unet, cnn
    chosen = [[run for run in each.runs if run.seed in common] for each in (unet, cnn)]
    return replace(unet, runs=chosen[0]), replace(cnn, runs=chosen[1])


def _convergence(unet: Trainings, cnn: Trainings) -> list[Check]:
    if not _has_train(unet, cnn):
        return []
    reached = [[row["train_psnr"] for row in each.final] for each in (unet, cnn)]
    return [
        Check(
            "higher PSNR on training scenes after the last epoch",
            better(*map(statistics.mean, reached)),
            _named(*reached),
        )
    ]


def _generalisation(unet: Trainings, cnn: Trainings) -> list[Check]:
    tested = [[row["test_psnr"] for row in each.chosen] for each in (unet, cnn)]
    checks = [
        Check(
            "higher PSNR on test scenes, of the epoch that validation chooses",
            better(*map(statistics.mean, tested)),
            _named(*tested),
        )
    ]
    if _has_train(unet, cnn):
        gaps = [[gap(run) for run in each.runs] for each in (unet, cnn)]
        smaller = statistics.mean(gaps[1]) - statistics.mean(gaps[0]) > ALIKE_DB
        says = "training less test PSNR is smaller, each below the solver's on its scenes"
        checks.append(Check(says, smaller, _named(*gaps)))
    return checks


def gap(run: TrainedRun) -> float:
    """Return how much farther test scenes are below the solver than training scenes are, dB.

    Scenes differ in difficulty, so that training less test PSNR says little by itself.
    """
    last, optimum = run.history[-1], run.optimum
    below = {name: optimum[name] - last[name] for name in ("train_psnr", "test_psnr")}
    return below["test_psnr"] - below["train_psnr"]


def _budgets(unet: Trainings, cnn: Trainings) -> list[Check]:
    units = {"step": "{:.0f} steps", "seconds": "{:.0f} s", "operations": "{:.2e} multiply-adds"}
    checks = []
    if len(_processors(unet, cnn)) > 1:
        del units["seconds"]
    for measure, how in units.items():
        limit = min(unet.spent(measure), cnn.spent(measure))
        reached = [each.at(measure, limit) for each in (unet, cnn)]
        name = measure.removesuffix("s") + "s"
        checks.append(
            Check(
                f"higher test PSNR at equal {name}",
                better(*map(statistics.mean, reached)),
                f"{_named(*reached)} within {how.format(limit)}",
            )
        )
    return checks


def _has_train(*each: Trainings) -> bool:
    return all("train_psnr" in run.history[-1] for one in each for run in one.runs)


def _named(unet: list[float], cnn: list[float]) -> str:
    return f"U-Net {mean_and_range(unet)}, stacked CNN {mean_and_range(cnn)} dB"


def _seeds(unet: Trainings, cnn: Trainings) -> str:
    line = f"seeds: {len(unet.runs)} of the U-Net, {len(cnn.runs)} of the stacked CNN"
    made = _processors(unet, cnn)
    if len(made) == 1:
        return f"{line}; trained on {made[0]}"
    return f"{line}; trained on {' and '.join(made)}, hence no comparison at equal seconds"


def _processors(unet: Trainings, cnn: Trainings) -> list[str]:
    return sorted({run.made_on for each in (unet, cnn) for run in each.runs})


def _cut_short(trainings: Mapping[str, Trainings]) -> list[str]:
    """Say which runs did not make the epochs of their recipe."""
    lines = []
    for name, each in trainings.items():
        for run in each.runs:
            made, wanted = run.history[-1]["epoch"], run.facts["recipe"].get("epochs", 0)
            if made < wanted:
                lines.append(
                    f"{name}, seed {run.seed} was cut short: {made:.0f} of {wanted} epochs; "
                    "whether it has converged is not known"
                )
    return lines


def _all_figures(trainings: Mapping[str, Trainings]) -> list[str]:
    lines = []
    for name, each in trainings.items():
        for run in each.runs:
            best = max(run.history, key=lambda row: row["validation_psnr"])
            seen = max(run.history, key=lambda row: row["test_psnr"])
            lines.append(
                f"{name}, seed {run.seed}: last epoch ({run.history[-1]['epoch']:.0f}) "
                f"{_row(run.history[-1])}; chosen on validation ({best['epoch']:.0f}) "
                f"{_row(best)}; chosen on test scenes, as the paper does ({seen['epoch']:.0f}) "
                f"{seen['test_psnr']:.2f}; solver {_row(run.optimum)}"
            )
    return lines


def _row(row: Mapping[str, float]) -> str:
    names = [name for name in ("train", "validation", "test") if f"{name}_psnr" in row]
    return ", ".join(f"{name} {row[f'{name}_psnr']:.2f}" for name in names)
