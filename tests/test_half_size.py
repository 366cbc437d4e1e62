"""Problems at half size: which displays have them, what they ask for, and the way back."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from layerfield import Display, Problem, procedural_light_field, solve, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import solver_for
from layerfield.half_size import Enlarged, HalfState, at_half_size, floor_of, half_of
from layerfield.kept_views import KeptViews
from layerfield.kernels import word_sweeps
from layerfield.kernels.compiled import plain
from layerfield.kernels.gray_words import gray_words
from layerfield.solvers.learned_sweeps import LearnedSweeps
from layerfield.synthesizer import pose

SIZES = [(64, 96), (65, 97), (50, 33)]


def display(text: str) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "additive"\n{text}', "a test"))


FIVE = display("views = [5, 5]\ndisparity = [1, 0, -1]")


def posed(shown: Display, size: tuple[int, int], **others: Any) -> Problem:
    views = torch.zeros(shown.view_count, 1, *size, dtype=torch.uint8)
    return Problem.of(shown, views, **others)


def noise(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    ("text", "views", "before"),
    [
        ("views = [5, 5]\ndisparity = [1, 0, -1]", 9, (0, 0)),
        ("views = [5, 5]\ndisparity = [2, 1]", 9, (0, 0)),
        ("views = [7, 3]\ndisparity = [2, 0, -2]", 21, (0, 0)),
        ("views = [7, 7]\ndisparity = [1, 0]", 9, (1, 1)),
        ("views = [5, 1]\ndisparity = [1, 0, -1]", 3, (0, 0)),
        ("views = [3, 3]\ndisparity = [1, 0, -1]", None, None),
        ("views = [4, 4]\ndisparity = [2, 0]", None, None),
        ("views = [4, 4]\ndisparity = [1, -1]", None, None),
        ("views = [5, 5]\ndisparity = [1.5, 0]", None, None),
        ("views = [2, 2]\ndisparity = [1, 0]", None, None),
    ],
)
def test_views_are_those_whose_paths_are_even(text, views, before):
    half = half_of(posed(display(text), (64, 64)))
    assert (None if half is None else len(half.views)) == views
    if half is not None:
        assert half.before == before
        assert half.projection.is_whole
    assert half_of(posed(display(text), (31, 64))) is None


def test_views_that_do_not_count_are_not_asked_for():
    """Of 5x5 views without those whose paths are even, without all but 3x3, and of a column."""
    odd = [float(y % 2 or x % 2) for y in range(5) for x in range(5)]
    inner = [float(max(abs(y - 2), abs(x - 2)) < 2) for y in range(5) for x in range(5)]
    column = [float(x == 2) for _ in range(5) for x in range(5)]
    asked = [half_of(posed(FIVE, (64, 64), weights=each)) for each in (odd, inner, column)]
    found = [None if half is None else half.views for half in asked]
    assert found == [None, None, (2, 12, 22)]


@pytest.mark.parametrize("kind", ["codes", "long codes", "light", "values"])
@pytest.mark.parametrize("size", SIZES)
def test_means_of_pixels_and_the_way_back_are_what_pytorch_makes(kind, size):
    views = noise(2, 25, 3, *size)
    kept = {
        "codes": KeptViews((views * 255).to(torch.uint8)),
        "long codes": KeptViews((views * 65535).to(torch.uint16)),
        "light": KeptViews((views * 255).to(torch.uint8)).then(lambda codes: codes**2.2),
        "values": KeptViews(views),
    }[kind]
    problem = Problem.of(FIVE, kept)
    half = half_of(problem)
    assert half is not None
    small = at_half_size(problem, half)
    layers = noise(*small.layer_shape)
    with plain():
        known = at_half_size(problem, half)
        expected = Enlarged(replace(problem), half, replace(small), layers).layers
    code = 1e-5 if kind == "codes" else 0  # half of one of 16 bits
    torch.testing.assert_close(small.views.all(), known.views.all(), atol=1e-6 + code, rtol=1e-5)
    assert expected.shape == problem.layer_shape
    words, own = problem.constants.words, small.constants.words
    assert words is not None
    assert own is not None
    known = torch.zeros(*layers.shape[:-1], own.width, dtype=torch.int32)
    known[..., : layers.shape[-1]] = (layers * own.most).round().int()
    begun = Enlarged(problem, half, small, layers, known.to(torch.uint16)).words
    assert begun is not None
    _, made = word_sweeps.swept(words, problem.back_projected_words, begun, [0.0])
    found = made.ago[..., : expected.shape[-1]].float() / words.most
    torch.testing.assert_close(found, expected.clamp(0, 1), atol=5 / words.most, rtol=0)
    assert abs(found - expected.clamp(0, 1)).mean() < 0.6 / words.most


@pytest.mark.parametrize(
    "text",
    ["views = [5, 5]\ndisparity = [1, 0, -1]", "views = [7, 7]\ndisparity = [1, 0]"],
)
@pytest.mark.parametrize("size", [(40, 56), (41, 57)])
def test_layers_of_half_size_lie_where_those_of_whole_size_do(text, size):
    """Ramps, of each layer another, show the same at both sizes, wherever layers begin."""
    shown = display(text)
    number, (my, mx) = shown.layer_count, shown.projection.margin

    def ramps(y: torch.Tensor, x: torch.Tensor, k: int) -> torch.Tensor:
        return (0.2 + 0.002 * (k + 1) * (y[:, None] - my) + 0.001 * (2 - k) * (x - mx)) / number

    blank = posed(shown, size)
    rows, columns = (torch.arange(n).float() for n in blank.layer_shape[-2:])
    layers = torch.stack([ramps(rows, columns, k).unsqueeze(0) for k in range(number)])[None]
    views = torch.stack([blank.view(layers, i) for i in range(shown.view_count)])
    problem = Problem.of(shown, views)
    half = half_of(problem)
    assert half is not None
    small = at_half_size(problem, half)
    rows, columns = (torch.arange(n).float() for n in small.layer_shape[-2:])
    top, left = half.before
    place = 2 * rows + 0.5 - top, 2 * columns + 0.5 - left
    known = torch.stack([ramps(*place, k).unsqueeze(0) for k in range(number)])[None]
    for i, view in enumerate(small.views):
        inside = (small.view(known, i) - view)[..., 1:-1, 1:-1]
        torch.testing.assert_close(inside, torch.zeros_like(inside), atol=1e-6, rtol=0)
    raised = Enlarged(problem, half, small, 9 * known * small.even_start()).layers
    inside = (raised / problem.even_start() - 9 * layers)[..., 3:-3, 3:-3]
    torch.testing.assert_close(inside, torch.zeros_like(inside), atol=2e-3, rtol=0)


@pytest.mark.parametrize("is_on_floor", [False, True])
@pytest.mark.parametrize(
    "text",
    ["views = [5, 5]\ndisparity = [1, 0, -1]", "views = [7, 7]\ndisparity = [1, 0]"],
)
def test_no_pixel_of_whole_size_is_below_its_floor(text, is_on_floor):
    """Even if all of half size that are seen are as dark as they may be, wherever they begin."""
    shown = display(text)
    views = (noise(2, shown.view_count, 3, 65, 97) ** 3 * 255).to(torch.uint8)
    problem = Problem.of(shown, views)
    half, words = half_of(problem), problem.constants.words
    assert half is not None
    assert words is not None
    small, start = at_half_size(problem, half), problem.even_start()
    light = 0.3 * start if is_on_floor else torch.zeros_like(start)
    given = torch.zeros(*light.shape[:-1], words.width, dtype=torch.int32)
    given[..., : light.shape[-1]] = (light * words.most).int()
    found = floor_of(problem, half, small, given.to(torch.uint16) if is_on_floor else None)
    with plain():
        floor = floor_of(problem, half, small, light if is_on_floor else None)
    fewer = small.constants.words
    assert fewer is not None
    known = found[..., : floor.shape[-1]].float() / fewer.most
    torch.testing.assert_close(known, floor, atol=3 / words.most, rtol=0)
    change = (floor - small.even_start()).flatten(0, -4)
    wide = torch.nn.functional.interpolate(change, scale_factor=2, mode="bilinear")
    (top, left), (height, width) = half.before, start.shape[-2:]
    wide = wide[..., top : top + height, left : left + width].reshape(start.shape)
    assert (start + wide - light)[..., 7:-7, 7:-7].min() > -1e-6
    assert floor.mean() > 0.1 * start.mean()


def test_gray_is_the_mean_of_all_colours():
    colours = (noise(2, 1, 3, 4, 5, 32) * (2**15 - 1)).long()
    found = gray_words(colours.to(torch.uint16)).long()
    expected = colours.sum(dim=-3, keepdim=True) // 4
    torch.testing.assert_close(found, expected, atol=1, rtol=0)


@pytest.mark.parametrize("views", [5, 9])
def test_half_size_is_a_better_start_than_steps_of_whole_size(views, monkeypatch):
    """Four iterations from half size take less time than two behind a step of whole size."""
    shown = display(f"views = [{views}, {views}]\ndisparity = [1, 0, -1]")
    field = procedural_light_field(
        grid=(views, views), size=(128, 160), disparity_range=(-1.5, 1.5), seed=4
    )
    field = replace(field, stored=(1.3 * field.stored - 0.15).clamp(0, 1))
    problem = pose(field, shown)
    best = problem.mean_square_error(solve(problem, solver_for(problem, 60), iterations=60).layers)
    found = problem.mean_square_error(synthesize(field, shown, method="fast", iterations=4).layers)
    monkeypatch.setattr("layerfield.solvers.learned_sweeps.half_of", lambda *_: None)
    known = problem.mean_square_error(synthesize(field, shown, method="fast", iterations=2).layers)
    assert found < 1.02 * best
    assert found - best < 0.8 * (known - best)


def test_states_at_half_size_serve_other_views():
    field = procedural_light_field(size=(96, 100), seed=4)
    problem = pose(field, FIVE)
    solver = solver_for(problem, 2)
    assert isinstance(solver, LearnedSweeps)
    begun = solver.init(problem, None)
    assert isinstance(begun, HalfState)
    torch.testing.assert_close(solver.layers(problem, begun), problem.even_start().clamp(0, 1))
    other = pose(replace(field, stored=0.5 * field.stored), FIVE)
    known = solve(problem, solver, iterations=2)
    assert isinstance(known.state, HalfState)
    cold = solver.layers(other, solver.steps(other, solver.init(other, None), 2))
    gone_on = solve(other, solver, iterations=3, init=known).layers
    best = solve(other, solver, iterations=40).layers
    errors = [other.mean_square_error(each) for each in (best, gone_on, cold)]
    assert errors[1] < 1.1 * errors[0]
    assert errors[2] < 1.1 * errors[0]
