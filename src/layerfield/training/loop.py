"""The one training loop: steps, epochs, judging, checkpoints; on Lightning Fabric."""

import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from layerfield.display import Display
from layerfield.networks import Network
from layerfield.toml_model import validated
from layerfield.training.checkpoint import (
    Checkpoint,
    read_checkpoint,
    restore,
    state_of,
    write_checkpoint,
)
from layerfield.training.judging import Judges
from layerfield.training.muon import Muon
from layerfield.training.objective import Objective
from layerfield.training.recipe import Optimiser, Recipe
from layerfield.training.records import CHECKPOINT, History, Records, open_run, read_result
from layerfield.training.sources import Source, source_of
from layerfield.training.start import starting_network

if TYPE_CHECKING:
    from lightning.fabric import Fabric

_WARM_UP = 0.02  # share of all steps in which the cosine schedule rises
_BIAS_RATE = 0.1  # Adam's rate for biases in units of Muon's rate for kernels


@dataclass(frozen=True, kw_only=True)
class Run:
    """A training: a recipe, a place, a device.

    Args:
        recipe: what to do.
        out: folder of the run.
        folder: that paths in the recipe are relative to.
        device: `cpu` or `cuda`.
        devices: how many; more than one share every batch.
        resume: go on where the checkpoint in `out` stands.
        force: replace an earlier training in `out`.
        command: to be recorded.
        initial: a network to start from instead of a new one.
        source: training data instead of the recipe's.
        tick: called with a line and the number of epochs done.
    """

    recipe: Recipe
    out: Path
    folder: Path = Path()
    device: str = "cpu"
    devices: int = 1
    resume: bool = False
    force: bool = False
    command: str = ""
    initial: Network | None = None
    source: Source | None = None
    tick: Callable[[str, int], None] | None = None

    @cached_property
    def display(self) -> Display:
        """The display that is trained for.

        Raises:
            ValueError: there is none, or it has subframes.
        """
        beside = self.folder / self.recipe.display
        found = Display.load(beside if beside.is_file() else self.recipe.display)
        if found.subframes > 1:
            raise ValueError(
                f"display '{found.name}' has {found.subframes} subframes, networks make one "
                "picture of every layer; train for a display without, or take a solver"
            )
        return found


def train(run: Run) -> dict[str, Any]:
    """Train a network; return the facts of `OUT/result.json`. See `records` for what is written.

    Raises:
        ValueError: a recipe that cannot be followed, or a checkpoint of another one.
    """
    from lightning.fabric import Fabric  # noqa: PLC0415, it takes seconds

    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # it repeats the precision
    several = run.devices > 1
    launched = "WORLD_SIZE" in os.environ  # by torchrun or a cluster, a process for each device
    fabric = Fabric(
        accelerator="gpu" if run.device == "cuda" else "cpu",
        devices=run.devices,
        strategy=("ddp" if launched else "ddp_spawn") if several else "auto",
        precision="bf16-mixed" if run.recipe.precision == "bf16" else "32-true",
    )
    if several and not launched:
        fabric.launch(partial(_work, run=replace(run, tick=None)))
    else:
        fabric.launch()
        _work(fabric, run)
    return read_result(run.out)


def _work(fabric: "Fabric", run: Run) -> None:
    """What every process of a training does."""
    Trainer(fabric, run).fit()


class Trainer:
    """Networks, optimisers and data of one process.

    Args:
        fabric: devices, precision and processes.
        run: what to do.
    """

    def __init__(self, fabric: "Fabric", run: Run) -> None:
        self.fabric, self.run, self.recipe = fabric, run, run.recipe
        self.source = run.source or source_of(run.recipe, run.display, run.folder, fabric.device)
        self.steps = self.source.steps(self.recipe.batch)
        self.total = self.steps * self.recipe.epochs
        self.network, self.notes = starting_network(
            self.recipe, run.display, self.source, run.folder, run.initial
        )
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        objective = Objective(self.network, run.display, self.recipe.loss)
        self.objective = fabric.setup_module(objective)
        self.optimisers = optimisers_for(self.network, self.recipe.optimiser)
        self.wrapped: list[Any] = [fabric.setup_optimizers(each) for each in self.optimisers]
        self.judges = Judges.of(self.recipe, run.display, self.source)
        self.step, self.seconds = 0, 0.0
        self.history: History = []
        if run.resume:
            self._resume()

    def fit(self) -> None:
        """Make all steps that are left; judge and save after every epoch."""
        if self.fabric.is_global_zero:
            open_run(self.run.out, resume=self.run.resume, force=self.run.force)
        records = self._records() if self.fabric.is_global_zero else None
        while self.step < self.total:
            row = self._epoch()
            if records is not None:
                self._judge_and_save(row, records)
            self.fabric.barrier()

    def _records(self) -> Records:
        facts = {
            "command": self.run.command,
            "data": self.source.facts(),
            "reference": self.judges.reference(),
        }
        return Records(self.run.out, self.recipe, self.run.display, facts, self.step)

    def _epoch(self) -> dict[str, float]:
        done = self.step // self.steps
        if self.run.tick is not None:
            self.run.tick(f"{self.recipe.name}, epoch {done + 1} of {self.recipe.epochs}", done)
        began, losses = time.monotonic(), 0.0
        for _ in range(self.steps):
            losses += self._one_step()
        self.seconds += time.monotonic() - began
        return {"epoch": done + 1, "step": self.step, "seconds": self.seconds} | {
            "loss": losses / self.steps
        }

    def _one_step(self) -> float:
        rate = schedule(self.recipe.optimiser, self.step, self.total)
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = group["share"] * rate
        batch = self.source.batch(self.step, self.recipe.batch)
        own = batch[self.fabric.global_rank :: self.fabric.world_size].to(self.fabric.device)
        loss = self.objective(own)
        self.fabric.backward(loss)
        for optimiser in self.wrapped:
            optimiser.step()
            optimiser.zero_grad()
        self.step += 1
        return loss.item()

    def _judge_and_save(self, row: dict[str, float], records: Records) -> None:
        device = self.fabric.device
        with self.fabric.autocast():
            row |= self.judges.psnr(self.network, device)
        best = max((each["validation_psnr"] for each in self.history), default=-math.inf)
        self.history.append(row)
        if row["validation_psnr"] > best:
            records.write_weights(self.network, row, device)
        records.write(self.history, self.notes, device)
        # Last, so that what a resumed training lacks it makes again.
        tensors = state_of(self.network, self.optimisers)
        facts = {
            "recipe": self.recipe.model_dump(mode="json"),
            "history": self.history,
            "notes": self.notes,
        }
        write_checkpoint(self.run.out / CHECKPOINT, Checkpoint(tensors, facts))

    def _resume(self) -> None:
        found = read_checkpoint(self.run.out / CHECKPOINT)
        given = self.recipe
        stored = validated(Recipe, found.facts["recipe"], f"the recipe in {self.run.out}")
        for key in Recipe.model_fields:
            then, now = getattr(stored, key), getattr(given, key)
            if key != "epochs" and then != now:
                raise ValueError(
                    f"{self.run.out} was trained with another recipe: '{key}' was {then}, now it "
                    f"is {now}; give another --out"
                )
        restore(found.tensors, self.network, self.optimisers)
        self.history, self.notes = found.facts["history"], found.facts["notes"]
        self.step = int(self.history[-1]["step"])
        self.seconds = self.history[-1]["seconds"]


def optimisers_for(network: Network, chosen: Optimiser) -> list[torch.optim.Optimizer]:
    """Return Adam for everything, or Muon for kernels and Adam for biases."""
    if chosen.name == "adam":
        return [_with_share(torch.optim.Adam(network.parameters(), lr=chosen.rate), 1.0)]
    kernels = [p for p in network.parameters() if p.ndim > 1]
    biases = [p for p in network.parameters() if p.ndim == 1]
    return [_with_share(Muon(kernels), 1.0), _with_share(torch.optim.Adam(biases), _BIAS_RATE)]


def _with_share(optimiser: torch.optim.Optimizer, share: float) -> torch.optim.Optimizer:
    for group in optimiser.param_groups:
        group["share"] = share
    return optimiser


def schedule(chosen: Optimiser, step: int, total: int) -> float:
    """Return the learning rate of a step.

    >>> schedule(Optimiser(rate=1.0, schedule="cosine"), 51, 100)
    0.5
    """
    if chosen.schedule == "constant":
        return chosen.rate
    rising = max(_WARM_UP * total, 1)
    if step < rising:
        return chosen.rate * (step + 1) / rising
    return chosen.rate * 0.5 * (1 + math.cos(math.pi * (step - rising) / (total - rising)))
