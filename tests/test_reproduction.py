"""The paper's figures and claims: equivalents, rules of verdicts, operations, the command."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_cli import fails, run, succeed
from test_training import TINY

from layerfield import Display, LightField, procedural_light_field
from layerfield.display_spec import format_spec
from layerfield.io import load_light_field, write_png
from layerfield.metrics import LayerFigures
from layerfield.networks import StackedCnn, UNet
from layerfield.reference import Reference
from layerfield.report.plots import Level, Panel, chart
from layerfield.reproduction import convergence, gao2024
from layerfield.reproduction import runs as reproduction_runs
from layerfield.reproduction.ablations import Scale, ablate, contrast, rotated, scaled
from layerfield.reproduction.claims import (
    Check,
    Claim,
    front_heavy,
    judge_computation,
    judge_equivalence,
    judge_quality,
    judge_uniformity,
    lines_beside,
)
from layerfield.reproduction.contenders import CNN, RECIPES, UNET, Contender
from layerfield.reproduction.convergence import Trainings, judge_training
from layerfield.reproduction.gao2024 import Reproduction, reproduce, target_scene
from layerfield.reproduction.measures import (
    Cost,
    Course,
    Effort,
    Measured,
    Shown,
    follow,
    network_cost,
    solver_cost,
)
from layerfield.reproduction.memory import peak_memory
from layerfield.reproduction.runs import TrainedRun, find_runs, find_weights, train_both
from layerfield.reproduction.statement import claim_lines
from layerfield.result import write_views
from layerfield.synthesizer import pose
from layerfield.training import sources
from layerfield.training.recipe import Recipe, read_recipe
from layerfield.weights import WeightsCard, write_weights

DISPLAY = Display.load("additive-3")
FAST = Effort(iterations=6, repeats=1, memory=False)

DOT = np.zeros((1, 1, 1), np.uint8)  # in place of figures, where drawing is not the point


# ------------------------------------------------------------------------------------- measures


def course(*psnr: float, each: float = 10.0, seconds: float = 0.1) -> Course:
    return Course("nmf", psnr, [seconds * n for n in range(len(psnr))], Cost(5.0, each))


def test_equivalent_iterations_are_interpolated():
    found = course(10.0, 20.0, 30.0, 30.5)
    assert found.reaching(5.0) == 0
    assert found.reaching(20.0) == 1
    assert found.reaching(25.0) == pytest.approx(1.5)
    assert found.reaching(30.25) == pytest.approx(2.5)
    assert found.reaching(30.5) == 3
    assert found.reaching(30.6) is None
    assert found.seconds_at(1.5) == pytest.approx(0.15)
    assert found.seconds_at(3) == pytest.approx(0.3)
    assert found.cost.of(3) == 35


def test_the_first_iteration_counts_where_a_course_turns_back():
    assert course(10.0, 30.0, 20.0, 40.0).reaching(25.0) == pytest.approx(0.75)


def test_a_course_is_what_the_solver_does():
    field = procedural_light_field(size=(32, 40), seed=3)
    found = follow("nmf", field, DISPLAY, FAST)
    assert found.most == 6
    assert list(found.psnr) == sorted(found.psnr)


def test_operations_of_networks_are_those_counted_by_hand():
    stack = StackedCnn(25, 3, width=8, modules=4)
    by_hand = 9 * (25 * 8 + 3 * 8 * 8 + 8 * 3)
    assert network_cost(stack, (32, 32), (0, 0)) == by_hand
    assert network_cost(stack, (32, 32), (2, 2)) == pytest.approx(by_hand * 36**2 / 32**2)
    unet = UNet(25, 3, width=4, depth=1)
    entry, below = 9 * (25 * 4 + 4 * 4), 9 * (4 * 8 + 8 * 8) / 4
    up, merge, last = 8 * 4, 9 * (8 * 4 + 4 * 4), 4 * 3
    assert network_cost(unet, (32, 32), (0, 0)) == entry + below + up + merge + last


def test_the_papers_networks_cost_what_their_layers_say():
    """At full width, on pixels of any large picture."""
    stack, unet = StackedCnn(25, 3), UNet(25, 3, depth=3)
    assert network_cost(stack, (64, 64), (0, 0)) == 9 * (25 * 64 + 18 * 64 * 64 + 64 * 3)
    assert network_cost(unet, (64, 64), (0, 0)) == 573_696


def test_operations_of_solvers_are_those_counted_by_hand():
    field = procedural_light_field(size=(32, 40), seed=3)
    problem, pixels = pose(field, DISPLAY), 32 * 40
    torus = 36 * 44  # just the layer pixels
    layers = 3 * torus
    assert solver_cost("sart", problem) == Cost(0.0, 2 * 75 + 25)
    bands = 2 * (1 + 5 + 5)  # of a layer, down and across: its own, and five for each other
    descent = solver_cost("gradient", problem)
    assert descent.once == 75
    assert descent.each == pytest.approx((bands + 4) * layers / pixels)
    transform = 1.25 * torus * math.log2(torus)
    direct = 6 * transform + 9 * torus + 150 * (torus - pixels)
    nmf, admm = solver_cost("nmf", problem), solver_cost("fourier-admm", problem)
    assert (nmf.once, admm.once) == (75, 75)
    assert nmf.each == pytest.approx((direct + 2 * layers) / pixels)
    assert admm.each == pytest.approx((direct + 12 * torus) / pixels)


def test_memory_is_not_that_of_the_process_that_measures_it():
    """A process inherits the largest size of its parent, where that is read naively."""
    ballast = b"1" * (1200 * 2**20)
    field = procedural_light_field(size=(32, 40), seed=3)
    found = peak_memory("nmf", 1, field, DISPLAY)
    assert found is not None and 50 < found < 1000 < len(ballast) / 2**20


# --------------------------------------------------------------------------------------- verdicts


def layer(mean: float, std: float = 0.1, energy: float = 0.1) -> LayerFigures:
    return LayerFigures(mean, std, energy, 1.0)


EVEN = (layer(0.3), layer(0.3), layer(0.3))
FRONT = (layer(0.7, 0.3, 0.5), layer(0.2, 0.2, 0.3), layer(0.1, 0.1, 0.1))


def shown(key: str, psnr: float, figures=EVEN, spread: float = 1.0, **more: Any) -> Shown:
    facts: dict[str, Any] = {"seconds": 1.0, "cost": 1000.0, "megabytes": 500.0} | more
    views = [psnr - spread, psnr + spread]
    who = Contender(key, key, key)
    return Shown(who, torch.zeros(1, 3, 1, 4, 4), psnr, views, figures, **facts)


def measured(unet: Shown, cnn: Shown, nmf: Course, name: str = "scene") -> Measured:
    field = LightField(torch.zeros(25, 1, 4, 4), (5, 5), name=name)
    optimum = Reference(1e-4, "optimum", "fourier-admm")
    return Measured(field, optimum, {UNET: unet, CNN: cnn}, {"nmf": nmf})


RISING = course(*[20 + 0.1 * n for n in range(121)])  # 30 dB at 100, 32 dB at 120


@pytest.mark.parametrize(
    ("held", "verdict"),
    [
        ([], "not measured"),
        ([True, True], "holds"),
        ([False], "does not hold"),
        ([True, False], "holds in part"),
    ],
)
def test_verdicts_follow_from_checks(held, verdict):
    claim = Claim(1, tuple(Check("so", each, "1") for each in held), missing="no runs")
    assert claim.verdict == verdict
    assert claim.as_record()["verdict"] == verdict
    assert ("no runs" in claim.figures) == (not held)


def verdict(checks: list[Check]) -> list[bool]:
    return [check.holds for check in checks]


def test_quality_is_judged_against_the_cnn_and_the_solver():
    scene = measured(shown(UNET, 31.0), shown(CNN, 30.0), RISING)
    assert verdict(judge_quality([scene])) == [True, True]
    scene = measured(shown(UNET, 30.05), shown(CNN, 30.0), RISING)
    assert verdict(judge_quality([scene])) == [False, False]  # within 0.1 dB is no better


def test_equivalence_needs_25_iterations():
    for psnr, held in ((22.4, False), (22.6, True), (40.0, True)):
        (check,) = judge_equivalence([measured(shown(UNET, psnr), shown(CNN, 20.0), RISING)])
        assert check.holds is held
    assert "more than 120" in check.figures


def test_uniformity_is_judged_by_views_light_and_detail():
    even, front = shown(UNET, 30.0, spread=0.5), shown(CNN, 30.0, FRONT, spread=1.0)
    assert verdict(judge_uniformity([measured(even, front, RISING)])) == [True] * 4
    swapped = measured(shown(UNET, 30.0, FRONT), shown(CNN, 30.0, spread=0.5), RISING)
    assert verdict(judge_uniformity([swapped])) == [False] * 4
    assert front_heavy(front) and not front_heavy(even)


def test_computation_is_judged_at_equal_quality():
    cheap = shown(UNET, 30.0, cost=100.0, seconds=1.0, megabytes=400.0)
    scene = measured(cheap, shown(CNN, 30.0), replace(RISING, megabytes=300.0))
    says = {check.says: check.holds for check in judge_computation([scene])}
    assert list(says.values()) == [True, False, True, True, True, False]  # 100 iterations: 1005
    costly = shown(UNET, 30.0, cost=2000.0, seconds=20.0, megabytes=900.0)
    assert not any(verdict(judge_computation([measured(costly, shown(CNN, 30.0), RISING)])))


def test_a_solver_that_never_gets_there_counts_as_more():
    checks = judge_computation([measured(shown(UNET, 40.0), shown(CNN, 30.0), RISING)])
    assert checks[-1].holds and "does not get there in 120" in checks[-1].figures


def test_seconds_of_a_busy_machine_decide_nothing():
    """Whatever they would have said, for or against."""
    for seconds in (0.001, 100.0):
        unet = shown(UNET, 30.0, seconds=seconds, unsteady=3.0)
        scene = measured(unet, shown(CNN, 30.0), RISING)
        assert not [c for c in judge_computation([scene]) if "time" in c.says]
        assert any("time is not judged" in line for line in lines_beside([scene])[4])


def test_a_training_that_was_cut_short_is_named():
    run = trained_run([20.0], [20.0])
    run.facts["recipe"]["epochs"] = 100
    each = Trainings([run], 1.0)
    claim = judge_training({CNN: each, UNET: each})
    assert any("cut short: 1 of 100 epochs" in line for line in claim.beside)
    assert any("cut short" in line for line in claim_lines([claim]))


def test_every_field_is_judged_and_named():
    good, bad = shown(UNET, 31.0), shown(UNET, 29.0)
    scenes = [measured(u, shown(CNN, 30.0), RISING, n) for u, n in ((good, "one"), (bad, "two"))]
    checks = judge_quality(scenes)
    assert [check.says[-3:] for check in checks] == ["one", "one", "two", "two"]
    assert Claim(5, tuple(checks)).verdict == "holds in part"


# --------------------------------------------------------------------------------------- training


def trained_run(test: list[float], train: list[float], seed: int = 0, **made) -> TrainedRun:
    history = [
        {
            "epoch": n + 1.0, "step": 20.0 * (n + 1), "seconds": 10.0 * (n + 1),
            "train_psnr": t, "validation_psnr": s, "test_psnr": s,
        }
        for n, (s, t) in enumerate(zip(test, train, strict=True))
    ]  # fmt: skip
    facts = {
        "recipe": {"seed": seed, "batch": 15, "stored": {"patch": 64}, "options": {"width": 64}},
        "reference": {"method": "x", "train_psnr": 33.0, "test_psnr": 33.0},
        "made_with": made,
    }
    return TrainedRun(seed, history, facts)


def test_training_is_judged_at_equal_effort():
    fast = trained_run([25.0, 30.0, 31.0], [25.0, 30.0, 31.2])
    slow = trained_run([20.0, 24.0, 26.0], [21.0, 27.0, 29.0])
    claim = judge_training({CNN: Trainings([slow], 120.0), UNET: Trainings([fast], 100.0)})
    assert claim.verdict == "holds", claim.figures
    worse = judge_training({CNN: Trainings([fast], 100.0), UNET: Trainings([slow], 120.0)})
    assert worse.verdict == "does not hold", worse.figures
    assert len(worse.checks) == 6


def test_equal_operations_are_fewer_steps_of_the_costlier():
    each = Trainings([trained_run([20.0, 25.0, 30.0], [20.0, 25.0, 30.0])], 100.0)
    assert each.at("step", 40) == [25.0]
    assert each.at("operations", 60 * 15 * 64**2 * 100 * convergence.BACKWARD) == [30.0]
    assert each.at("operations", 45 * 15 * 64**2 * 100 * convergence.BACKWARD) == [25.0]
    assert each.at("seconds", 5) == [-math.inf]


def test_seconds_of_different_processors_are_not_compared():
    one = trained_run([20.0, 25.0], [20.0, 25.0], processor="a", threads=2)
    other = trained_run([20.0, 25.0], [20.0, 25.0], processor="b", threads=2)
    claim = judge_training({CNN: Trainings([one], 1.0), UNET: Trainings([other], 1.0)})
    assert not [check for check in claim.checks if "seconds" in check.says]
    assert "hence no comparison at equal seconds" in claim.beside[0]


def test_only_seeds_that_both_have_are_compared():
    runs = [trained_run([30.0], [30.0], seed) for seed in (0, 1)]
    weak = trained_run([10.0], [10.0], 2)
    claim = judge_training({CNN: Trainings([*runs, weak], 1.0), UNET: Trainings(runs, 1.0)})
    assert "10.00" not in claim.figures
    assert "2 of the U-Net, 2 of the stacked CNN" in claim.beside[0]


def test_the_target_scene_is_apart_from_all_others():
    seeds = (sources._TRAINING + 256 * sources._ROOM, sources._VALIDATION, sources._TEST)
    assert all(gao2024.TARGET_SEED - seed >= 2**30 for seed in seeds)
    assert gao2024.TARGET_SEED < 2**32
    assert target_scene((32, 32)).grid == (5, 5)


# ---------------------------------------------------------------------------------- runs, command


def tiny(recipe: str, folder: Path) -> Recipe:
    path = folder / "tiny.toml"
    network = "stacked-cnn" if "cnn" in recipe else "unet"
    options = "modules = 2" if "cnn" in recipe else "depth = 1"
    path.write_text(TINY.replace('"unet"', f'"{network}"').replace("depth = 1", options))
    return read_recipe(path).model_copy(update={"epochs": 2})


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """A folder of tiny runs under the names of the paper's recipes."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduction_runs, "read_recipe", lambda name: tiny(name, folder))
        train_both(folder, lambda _: None)
    return folder


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Files instead of figures, which take most of the time."""
    monkeypatch.setattr(
        gao2024.figures, "figures_of_field", lambda *_: [("figure5", None), ("figure6", None)]
    )
    monkeypatch.setattr(gao2024, "save", lambda figure, path: write_png(path, DOT))


@pytest.fixture
def views(tmp_path) -> Path:
    field = procedural_light_field(size=(32, 40), seed=5)
    write_views(tmp_path / "views", field.views, DISPLAY, 8)
    return tmp_path / "views"


FIGURES = {
    "figure3.png", "figure4.png", "figure4-effort.png", "figure5.png", "figure5-shares.png",
    "figure6.png", "figure6-views.png", "figure6-iterations.png",
}  # fmt: skip


def test_the_command_rebuilds_everything(tmp_path, monkeypatch, runs, views):
    monkeypatch.setattr("layerfield.cli.reproduce.REPEATS", 1)
    monkeypatch.setattr("layerfield.cli.reproduce.MEMORY", False)
    out = tmp_path / "out"
    command = ["reproduce", "gao2024", "--out", out, "--runs", runs, "--field", views]
    said = succeed(*command, "--iterations", "6")
    assert "claims.md" in said
    written = {"claims.md", "claims.json", "result.json", "report.html"}
    assert {p.name for p in out.iterdir()} == FIGURES | written
    assert (out / "report.html").read_text().count("<img ") == len(FIGURES)
    found = json.loads((out / "claims.json").read_text())
    assert [claim["number"] for claim in found["claims"]] == [1, 2, 3, 4, 5]
    assert all(claim["verdict"] != "not measured" for claim in found["claims"])
    assert found["seeds"] == {CNN: [0], UNET: [0]}
    for name in ("claims.json", "claims.md", "result.json", "report.html"):
        assert str(tmp_path) not in (out / name).read_text()
        assert str(runs) not in (out / name).read_text()
    fails(run(*command), "exists")
    monkeypatch.setattr(gao2024, "save", lambda figure, path: write_png(path, DOT))
    succeed(*command, "--iterations", "3", "--force")
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_what_is_missing_is_said_with_the_command_that_makes_it(tmp_path, views, undrawn):
    (tmp_path / "empty").mkdir()
    given = Reproduction([load_light_field(str(views))], tmp_path / "empty", FAST)
    claims = reproduce(tmp_path / "out", given)
    assert [claim.verdict for claim in claims] == ["not measured"] * 5
    assert all("layerfield train gao2024-unet" in claim.missing for claim in claims)
    assert not (tmp_path / "out" / "figure4.png").exists()
    assert (tmp_path / "out" / "figure6.png").exists()


def test_fields_have_figures_of_their_own(tmp_path, runs, views, undrawn):
    field = load_light_field(str(views))
    fields = [replace(field, name=name) for name in ("one", "two")]
    claims = reproduce(tmp_path / "out", Reproduction(fields, runs, FAST))
    assert {"figure5-1.png", "figure5-2.png"} <= {p.name for p in (tmp_path / "out").iterdir()}
    assert any("two" in check.says for check in claims[4].checks)


def test_other_seeds_count(tmp_path, runs):
    for name in RECIPES.values():
        for mark in ("", "-seed1"):
            shutil.copytree(runs / name, tmp_path / f"{name}{mark}")
        path = tmp_path / f"{name}-seed1" / "result.json"
        facts = json.loads(path.read_text())
        facts["recipe"]["seed"] = 1
        path.write_text(json.dumps(facts))
    assert [found.seed for found in find_runs(tmp_path, RECIPES[UNET])] == [0, 1]


def test_trainings_that_have_ended_are_not_made_again(tmp_path, monkeypatch, runs):
    copied = tmp_path / "runs"
    shutil.copytree(runs, copied)
    before = {p: p.read_bytes() for p in copied.glob("*/weights.safetensors")}
    monkeypatch.setattr(reproduction_runs, "read_recipe", lambda name: tiny(name, tmp_path))
    train_both(copied, lambda _: None)
    assert before == {p: p.read_bytes() for p in copied.glob("*/weights.safetensors")}
    assert all(find_weights(copied, name, DISPLAY) for name in RECIPES.values())


def test_wrong_requests_are_one_line(tmp_path, runs, views):
    out = tmp_path / "out"
    fails(run("reproduce", "gao2025", "--out", out), "unknown paper 'gao2025'", "gao2024")
    fails(run("reproduce", "gao2024", "--out", out, "--runs", tmp_path / "no"), "no folder")
    small = procedural_light_field(grid=(3, 3), size=(40, 40), seed=1)
    write_array(tmp_path / "small.npy", small)
    fails(
        run("reproduce", "gao2024", "--out", out, "--field", tmp_path / "small.npy"),
        "3x3 views", "expects 5x5",
    )  # fmt: skip
    taken = ["reproduce", "gao2024", "--out", views, "--field", views, "--force"]
    fails(run(*taken), "give another name")
    assert not out.exists()


def write_array(path: Path, field: LightField) -> None:
    views = field.views.permute(0, 2, 3, 1).unflatten(0, field.grid)
    np.save(path, (views * 255).round().byte().numpy())


def test_damaged_runs_and_other_weights_are_one_line(tmp_path, runs):
    copied = tmp_path / "runs"
    shutil.copytree(runs, copied)
    (copied / RECIPES[UNET] / "history.csv").write_text("epoch\n1\n")
    fails(
        run("reproduce", "gao2024", "--out", tmp_path / "out", "--runs", copied),
        "damaged", RECIPES[UNET],
    )  # fmt: skip
    other = Display.load("multiplicative-3")
    card = WeightsCard("unet", {"width": 4, "depth": 1}, format_spec(other.spec), "x", {})
    shutil.copy(runs / RECIPES[UNET] / "history.csv", copied / RECIPES[UNET] / "history.csv")
    write_weights(
        copied / RECIPES[UNET] / "weights.safetensors", UNet(25, 3, width=4, depth=1), card
    )
    fails(
        run("reproduce", "gao2024", "--out", tmp_path / "out", "--runs", copied),
        "were trained for", "multiplicative",
    )  # fmt: skip
    assert not (tmp_path / "out").exists()


# -------------------------------------------------------------------------------------- ablations


def test_ablations_are_judged_and_drawn(tmp_path):
    scale = Scale(
        steps=1, width=4, scenes=2, patch=24, large=32, large_batch=2, stacks=(2, 3), rate=1e-3
    )
    claims = ablate(tmp_path, scale)
    assert [claim.number for claim in claims] == ["A", "B", "C", "D"]
    assert all(claim.verdict != "not measured" for claim in claims)
    names = {f"ablation-{each}.png" for each in ("skips", "modules", "pixels", "augmentation")}
    assert {p.name for p in tmp_path.iterdir()} == names


def test_images_are_changed_and_the_view_grid_is_not():
    samples = torch.rand(2, 25, 16, 16)
    quarter = rotated(samples, torch.Generator().manual_seed(0))
    assert any(torch.equal(quarter, samples.rot90(k, (-2, -1))) for k in range(4))
    larger = scaled(samples, torch.Generator().manual_seed(0))
    assert larger.shape == samples.shape


def test_a_legend_is_as_wide_as_its_figure_at_most():
    levels = [Level(f"stacked CNN, better trained: 31.4{n} dB", n, "#000000") for n in range(6)]
    figure = chart("title", [Panel("panel", "iterations", "dB", [], levels)])
    (legend,) = figure.legends
    assert legend.get_window_extent().x0 > 0
    assert legend.get_window_extent().x1 < figure.bbox.width
    assert [text.get_text() for text in legend.get_texts()] == [each.label for each in levels]


def test_contrast_is_what_is_left_of_the_deviation():
    target = torch.rand(2, 25, 3, 16, 16)
    assert contrast(target, target) == pytest.approx(1)
    assert contrast(target * 0.25 + 0.3, target) == pytest.approx(0.25, rel=1e-4)
    assert contrast(torch.full_like(target, 0.5), target) == pytest.approx(0, abs=1e-6)
