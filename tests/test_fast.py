"""The method `fast`: learned steps, their file, their training, and what they are worth."""

import json
import math
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from test_cli import run

from layerfield import Display, Problem, procedural_light_field, solve, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import read_learned, shipped_steps, write_learned
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.synthesizer import pose
from layerfield.training.learned_steps import LearnedSteps
from layerfield.training.records import CHECKPOINT, RESULT, WEIGHTS

LINKS = ("additive", "multiplicative")
SHIPPED = (*LINKS, "multiplicative-rows", "additive-warm")
TINY = """
name = "tiny"
solver = "fast"
link = "additive"
steps = [1, 2]
coarse = 2
displays = [
    { views = [3, 3], disparity = [1.0, -1.0] },
    { views = [1, 5], disparity = [1.2, 0.0, -0.7] },
]
scenes = 2
size = 48
iterations = 6
[[then]]
size = 64
scenes = 1
iterations = 2
rate = 0.01
"""


def display(text: str) -> Display:
    return Display(parse_spec(f'name = "d"\n{text}', "a test"))


UNSEEN = {
    "many views": "views = [7, 7]\ndisparity = [1.5, 0.5, -0.5, -1.5]",
    "few views": "views = [3, 3]\ndisparity = [0.5, -0.5]",
    "perspective, linear light": """
        depth_mm = [12, 0, -12]
        pitch_um = 400
        viewing_distance_mm = 500
        viewing_angle_deg = 8
        views = [5, 5]
        transfer = "srgb"
    """,
}


@pytest.mark.parametrize("size", [(40, 57), (20, 21), (3, 64)])
@pytest.mark.parametrize("steps", [1, 3])
def test_the_fast_steps_are_those_of_the_formula(size, steps):
    """What runs in place equals what is trained; small pictures go without coarse steps."""
    torch.manual_seed(0)
    model = LearnedSteps(steps, 3)
    with torch.no_grad():
        for rows in model.parameters():
            rows.add_(torch.randn_like(rows), alpha=0.1)
    problem = Problem.of(Display.load("additive-3"), torch.rand(25, 2, *size))
    made = solve(problem, model.rows().direct, iterations=steps)
    assert torch.allclose(made.layers, model(problem), atol=2e-5)


MANY = "link = 'additive'\nviews = [3, 3]\ndisparity = [1, 0.75, 0.5, 0.25, 0, -0.25, -0.5, -1]"


def test_the_steps_of_many_layers_are_those_of_the_formula():
    """In single precision, too, but for what such steps make of rounding."""
    problem = Problem.of(display(MANY), torch.rand(9, 1, 40, 44, dtype=torch.float64))
    model = LearnedSteps(3, 2)
    with torch.no_grad():
        model.full[:, 1], model.full[:, 4] = 2.4, 0.4
    steps = model.rows().direct
    made = solve(problem, steps, iterations=3)
    assert torch.allclose(made.layers, model(problem), atol=1e-6)
    single = Problem.of(display(MANY), problem.target.float())
    found = solve(single, steps, iterations=3).layers.double()
    assert torch.allclose(found, made.layers, atol=5e-5)
    few = model.rows().full[1]
    assert few.among(4) == few
    assert few.among(8).relaxation == pytest.approx(1.8)
    assert few.among(8).momentum == pytest.approx(0.2)


def test_more_steps_of_many_layers_are_better():
    """As bold as those of few, twelve are worse than eight."""
    field = procedural_light_field(grid=(3, 3), size=(64, 80), seed=2001)
    problem = pose(field, display(MANY))
    known, errors = shipped_steps("additive"), []
    for n in (2, 4, 8, 12):
        run = solve(problem, known.solver(n), iterations=n)
        errors.append(problem.mean_square_error(run.layers))
    assert errors == sorted(errors, reverse=True)


def test_gradients_of_the_formula_are_right():
    """Also through the resolvent, by the penalty, and through the band around the views."""
    problem = Problem.of(Display.load("additive-3"), torch.rand(25, 1, 36, 40).double())
    torch.manual_seed(0)
    model = LearnedSteps(2, 2).double()

    def loss() -> torch.Tensor:
        seen = problem.projection.forward(model(problem).squeeze(-5))
        return (seen - problem.target).square().mean().log()

    loss().backward()
    for rows in (model.full, model.coarse):
        for place in ((0, 0), (1, 0), (1, 1), (1, 2), (0, 3)):
            slopes = []
            with torch.no_grad():
                for move in (1e-5, -2e-5):
                    rows[place] += move
                    slopes.append(loss())
                rows[place] += 1e-5
            assert rows.grad is not None
            found = (slopes[0] - slopes[1]) / 2e-5
            assert torch.isclose(found, rows.grad[place], rtol=1e-4, atol=1e-8)


def test_more_steps_are_better_and_more_than_learned_go_on():
    field = procedural_light_field(size=(96, 120), disparity_range=(-2, 2), seed=3)
    shown = Display.load("additive-3")
    problem = pose(field, shown)
    errors = [
        problem.mean_square_error(synthesize(field, shown, method="fast", iterations=n).layers)
        for n in (0, 1, 2, 3, 4, 5, 6, 7, 9, 14)
    ]
    assert all(after < before for before, after in pairwise(errors))


@pytest.mark.parametrize(
    ("link", "counts", "worse"), [("additive", (3, 5), 1.005), ("multiplicative", (1, 1), 1.1)]
)
@pytest.mark.parametrize("kind", UNSEEN)
def test_learned_steps_hold_on_displays_they_were_not_learned_on(kind, link, counts, worse):
    """Three are as good as five of the direct solver; a Newton step as a sweep behind twenty."""
    shown = display(f'link = "{link}"\n{UNSEEN[kind]}')
    grid = shown.geometry.grid
    assert grid is not None
    field = procedural_light_field(grid=grid, size=(96, 120), disparity_range=(-2, 2), seed=5)
    problem = pose(field, shown)
    learned, direct = (
        problem.mean_square_error(synthesize(field, shown, method=name, iterations=count).layers)
        for name, count in zip(("fast", "fourier-admm"), counts, strict=True)
    )
    assert learned <= direct * worse


def test_layers_to_start_from_are_taken_up():
    field = procedural_light_field(size=(64, 64), seed=1)
    shown = Display.load("additive-3")
    known = synthesize(field, shown, iterations=30)
    problem = pose(field, shown)
    again = synthesize(field, shown, method="fast", iterations=2, init=known.layers)
    assert problem.mean_square_error(again.layers) <= problem.mean_square_error(known.layers) * 1.01
    for count in (1, 2, 3):  # as many learned steps as before, or fewer, or more
        twice = synthesize(field, shown, method="fast", iterations=count, init=again)
        error = problem.mean_square_error(twice.layers)
        assert error <= problem.mean_square_error(known.layers) * 1.01


def test_what_does_not_serve_is_one_line():
    field = procedural_light_field(size=(32, 32), seed=1)
    with pytest.raises(ValueError, match="serves additive and multiplicative displays"):
        synthesize(field, Display.load("polarisation-3"), method="fast")


@pytest.mark.parametrize("name", SHIPPED)
def test_the_steps_that_ship_are_small_and_say_what_they_are(name):
    found = shipped_steps(name)
    assert found.card.link == name.split("-")[0]
    assert found.card.training["command"] == f"layerfield train fast-{name}"


def test_products_of_views_in_a_row_have_steps_of_their_own():
    field = procedural_light_field(grid=(1, 9), size=(48, 200), disparity_range=(-2, 2), seed=4)
    shown = display('link = "multiplicative"\nviews = [1, 9]\ndisparity = [1, 0.3, -0.5, -1]')
    problem = pose(field, shown)
    own = synthesize(field, shown, method="fast", iterations=2)
    others = solve(problem, shipped_steps("multiplicative").solver(2), iterations=2)
    assert problem.mean_square_error(own.layers) < problem.mean_square_error(others.layers)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_file_of_learned_steps_is_read_as_it_was_written(tmp_path, name):
    known = shipped_steps(name)
    write_learned(tmp_path / "a.safetensors", known)
    again = read_learned(tmp_path / "a.safetensors")
    assert again.card == known.card
    assert again.steps.keys() == known.steps.keys()
    for count, rows in known.steps.items():
        tensors = again.steps[count].tensors()
        assert tensors.keys() == rows.tensors().keys()
        assert all(torch.equal(each, tensors[name]) for name, each in rows.tensors().items())


@pytest.mark.parametrize("what", ["nothing", "other", "text", "short"])
def test_a_file_that_holds_no_learned_steps_is_one_line(tmp_path, what):
    path = tmp_path / "x.safetensors"
    if what == "other":
        save_file({"1.full": torch.zeros(1, 5)}, path)
    if what == "short":
        metadata = {"layerfield": json.dumps(asdict(shipped_steps("additive").card))}
        save_file({"1.full": torch.zeros(1, 4)}, path, metadata)
    if what == "text":
        path.write_text("no tensors")
    with pytest.raises(ValueError, match=r"there is no file|holds no learned steps"):
        read_learned(path)


def test_steps_are_trained_by_a_command_that_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.toml").write_text(TINY)
    done = run("train", "tiny.toml", "--out", "whole")
    assert done.status == 0, done.err
    assert "dB on test scenes" in done.out
    facts = json.loads(Path("whole", RESULT).read_text())
    assert set(facts["figures"]) == {"validation", "test"}
    Path("first.toml").write_text(TINY.replace("[1, 2]", "[1]"))
    assert run("train", "first.toml", "--out", "parts").status == 0
    text = Path("parts", CHECKPOINT).read_bytes()
    assert run("train", "tiny.toml", "--out", "parts", "--resume").status == 2  # another recipe
    assert Path("parts", CHECKPOINT).read_bytes() == text
    whole = read_learned(Path("whole", WEIGHTS))
    Path("whole", WEIGHTS).unlink()
    assert run("train", "tiny.toml", "--out", "whole", "--resume").status == 0
    again = read_learned(Path("whole", WEIGHTS))
    assert [again.steps[n].full for n in (1, 2)] == [whole.steps[n].full for n in (1, 2)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('solver = "fast"', 'solver = "slow"'), "solver"),
        (("steps = [1, 2]", "steps = []"), "steps"),
        (("scenes = 2", "scenes = 2\nwidth = 3"), "width"),
        (("iterations = 6", "iterations = 6\ngammas = [2.0, 1.0]"), "lower one first"),
        (("steps = [1, 2]", "steps = [2, 2]"), "every number once"),
        (("[1.0, -1.0]", "[-1.0, 1.0]"), "layer depths must decrease"),
        (("[1.0, -1.0]", "[nan, 1.0]"), "finite"),
        (("[1.0, -1.0]", "[]"), "disparity"),
        (("size = 64", "size = 6"), "then[0].size"),
        (("coarse = 2", "coarse = 2\nbefore = 3"), "expected 0 where light is additive"),
        (('link = "additive"', 'link = "multiplicative"'), "expected 1 or more"),
    ],
)
def test_a_wrong_recipe_of_steps_is_one_line(tmp_path, monkeypatch, change, said):
    monkeypatch.chdir(tmp_path)
    Path("wrong.toml").write_text(TINY.replace(*change))
    done = run("train", "wrong.toml")
    assert (done.status, len(done.err.strip().splitlines())) == (2, 1)
    assert said in done.err
    assert "pydantic" not in done.err
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    "option", [("--epochs", "3"), ("--adapt", "views"), ("--device", "cuda"), ("--devices", "2")]
)
def test_what_only_networks_know_is_refused(tmp_path, monkeypatch, option):
    monkeypatch.chdir(tmp_path)
    Path("tiny.toml").write_text(TINY)
    done = run("train", "tiny.toml", *option)
    assert (done.status, len(done.err.strip().splitlines())) == (2, 1)


def test_the_direct_solver_behind_the_last_step_is_the_plain_one():
    field = procedural_light_field(size=(48, 48), seed=2)
    shown = Display.load("additive-3")
    problem = pose(field, shown)
    one = shipped_steps("additive").solver(1)
    layers = solve(problem, one, iterations=1).layers
    expected = solve(problem, FourierAdmm(), iterations=2, init=layers).layers
    assert torch.allclose(solve(problem, one, iterations=3).layers, expected, atol=1e-6)


def test_six_learned_steps_are_as_good_as_ten_of_the_direct_solver():
    """In the mean of a few scenes, large enough for light of low frequency."""
    shown, decibels = Display.load("additive-3"), {"fast": 0.0, "fourier-admm": 0.0}
    for seed in range(4):
        field = procedural_light_field(size=(256, 288), disparity_range=(-2, 2), seed=seed)
        problem = pose(field, shown)
        for method, count in (("fast", 6), ("fourier-admm", 10)):
            made = synthesize(field, shown, method=method, iterations=count).layers
            decibels[method] -= 10 * math.log10(problem.mean_square_error(made))
    assert decibels["fast"] >= decibels["fourier-admm"]
