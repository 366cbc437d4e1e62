"""Sweeps in 16-bit words behind learned steps: what they come to, and which displays they serve."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from layerfield import Display, LightField, Problem, procedural_light_field, psnr, solve, synthesize
from layerfield.display_spec import parse_spec
from layerfield.fast import solver_for
from layerfield.kept_views import KeptViews
from layerfield.kernels import word_sweeps
from layerfield.kernels.compiled import plain
from layerfield.kernels.words import WORDS, _quotients
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.solvers.learned_sweeps import LearnedSweeps, SweptState, serves_words
from layerfield.solvers.sweeps import Sweeps
from layerfield.synthesizer import pose

KINDS = {
    "three layers": "views = [3, 3]\ndisparity = [1, 0, -1]",
    "far apart": "views = [5, 3]\ndisparity = [9, -8]",  # no column that all views see
    "one layer": "views = [2, 2]\ndisparity = [2]",
    "six layers": "views = [2, 3]\ndisparity = [6, 4, 2, 0, -2, -4]",
    "one column": "views = [4, 1]\ndisparity = [2, -2]",
    "linear light": 'views = [3, 3]\ndisparity = [1, -1]\ntransfer = "srgb"',
}


def display(text: str, link: str = "additive") -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "{link}"\n{text}', "a test"))


def posed(text: str, size: tuple[int, int] = (75, 21), batch: tuple[int, ...] = ()) -> Problem:
    shown = display(text)
    codes = torch.rand(
        *batch, shown.view_count, 2, *size, generator=torch.Generator().manual_seed(5)
    )
    return Problem.of(shown, KeptViews((codes * 255).to(torch.uint8)))


@pytest.fixture(scope="module")
def field() -> LightField:
    made = procedural_light_field(size=(150, 170), disparity_range=(-1.5, 1.5), seed=4)
    return replace(made, stored=(1.3 * made.stored - 0.15).clamp(0, 1))  # bounds become active


@pytest.mark.parametrize("size", [(75, 21), (2, 200), (210, 1)])
@pytest.mark.parametrize("kind", KINDS)
def test_words_do_what_floats_do(kind, size):
    """Through momentum and bounds, in parts and in one, seen and not; but for their rounding."""
    problem = posed(KINDS[kind], size, batch=(2,))
    assert serves_words(problem)
    generator = torch.Generator().manual_seed(3)
    layers = 1.5 * torch.rand(problem.layer_shape, generator=generator) - 0.25
    words, direct = problem.constants.words, solver_for(problem, 2)
    assert words is not None
    assert isinstance(direct, LearnedSweeps)
    found = direct.layers(problem, direct.steps(problem, SweptState(layers), 2))
    with plain():
        expected = direct.layers(problem, direct.steps(problem, SweptState(layers), 2))
    assert (found - expected).abs().max() < 30 / words.most
    error, least = map(problem.mean_square_error, (found, expected))
    assert abs(error - least) < 3e-3 * least + 1 / words.most**2
    assert 0 <= found.min() <= found.max() <= 1


@pytest.mark.parametrize("threads", [1, 3])
def test_iterations_one_by_one_are_those_all_at_once(field, threads):
    """Whoever looks in between; whatever starts of others are in memory."""
    torch.set_num_threads(threads)
    problem = pose(field, Display.load("additive-3"))
    found = {
        count: solve(problem, solver_for(problem, count), iterations=count).layers
        for count in (0, 1, 2, 3, 5, 11)
    }
    solver = solver_for(problem, 5)
    state = solver.init(problem, None)
    for count in range(1, 12):
        state = solver.step(problem, state)
        if count != 1:  # a single step has constants of its own
            known = found.get(count)
            assert known is None or torch.equal(solver.layers(problem, state), known)
    errors = [problem.mean_square_error(found[count]) for count in found]
    assert errors == sorted(errors, reverse=True)


def test_states_are_values_and_serve_other_views(field):
    problem = pose(field, Display.load("additive-3"))
    solver = solver_for(problem, 3)
    state = solver.init(problem, None)
    for _ in range(3):
        state = solver.step(problem, state)
    for _ in range(2):
        once, twice = (solver.layers(problem, solver.step(problem, state)) for _ in range(2))
        assert torch.equal(once, twice)
        state = solver.step(problem, state)
    darker = replace(field, stored=0.5 * field.stored)
    other = pose(darker, Display.load("additive-3"))
    known = solve(problem, solver, iterations=3)
    gone_on = solve(other, solver, iterations=3, init=known).layers
    best = solve(other, FourierAdmm(), iterations=100).layers
    assert other.mean_square_error(gone_on) < 1.3 * other.mean_square_error(best)


def test_fast_comes_to_the_optimum(field):
    shown = Display.load("additive-3")
    problem = pose(field, shown)
    best = problem.mean_square_error(solve(problem, FourierAdmm(), iterations=300).layers)
    excess = [
        problem.mean_square_error(synthesize(field, shown, method="fast", iterations=n).layers)
        / best
        - 1
        for n in (2, 4, 12, 30)
    ]
    assert excess[0] < 0.05
    assert excess[1] < 0.02
    assert excess[2] < 0.003
    assert excess[3] < 0  # nearer to it than three hundred iterations


def test_rounding_does_not_add_up(field, monkeypatch):
    """What views hardly see neither grows nor fades, and the last 1 of a change comes to rest."""
    monkeypatch.setattr("layerfield.solvers.learned_sweeps._ROUNDING", 1)
    problem = pose(field, Display.load("additive-3"))
    best = solve(problem, Sweeps(), iterations=150).layers
    words = problem.constants.words
    assert words is not None
    solver = solver_for(problem, 2)
    state = solver.init(problem, best)
    for _ in range(75):
        state = solver.step(problem, state)
    layers = solver.layers(problem, state)
    assert problem.mean_square_error(layers) < 1.001 * problem.mean_square_error(best)
    assert (layers - best).abs().mean() < 4 / words.most


def test_quotients_are_exact():
    """Of all numbers of 15 bits over as many views as words serve; over none they stay."""
    views = np.arange(1, 129, dtype=np.uint16)
    number = np.arange(2**15)[:, None]
    half, gain, power = (each.astype(np.int64) for each in _quotients(views))
    found = ((number + half) * gain >> 16) * power >> 16
    np.testing.assert_array_equal(found, (2 * number + views) // (2 * views.astype(np.int64)))
    half, gain, power = (each.astype(np.int64) for each in _quotients(np.zeros(1, np.uint16)))
    assert gain == 0
    np.testing.assert_array_equal((number + 1) * power >> 16, number)


def test_coarse_words_come_to_the_optimum_too():
    """Of many layers and views the largest pixel is 524."""
    shown = display("views = [5, 5]\ndisparity = [3, 2, 1, 0, -1, -2]")
    problem = pose(procedural_light_field(size=(64, 80), disparity_range=(-3, 3), seed=7), shown)
    best = problem.mean_square_error(solve(problem, FourierAdmm(), iterations=200).layers)
    made = [solve(problem, solver_for(problem, n), iterations=n).layers for n in (3, 8)]
    errors = [problem.mean_square_error(each) / best - 1 for each in made]
    assert errors[0] < 0.1
    assert errors[1] < 0.01


def test_what_fast_makes_without_compiled_loops_is_the_same_but_for_rounding(field):
    shown = Display.load("additive-3")
    made = synthesize(field, shown, method="fast", iterations=3).layers
    with plain():
        expected = synthesize(field, shown, method="fast", iterations=3).layers
    assert psnr(shown(made), shown(expected)) > 60


def test_from_layers_sweeps_go_on(field):
    problem = pose(field, Display.load("additive-3"))
    best = solve(problem, FourierAdmm(), iterations=100).layers
    made = solve(problem, solver_for(problem, 2), iterations=2, init=best.clone()).layers
    assert problem.mean_square_error(made) <= 1.001 * problem.mean_square_error(best)


@pytest.mark.parametrize(
    "text",
    [
        "views = [3, 3]\ndisparity = [0.5, 0, -1]",
        "views = [13, 13]\ndisparity = [1, 0, -1]",
    ],
)
def test_other_displays_have_learned_steps_alone(text):
    """Pixels between others, more views than words hold."""
    assert not serves_words(posed(text, (40, 40)))


def test_views_that_are_brighter_or_count_differently_have_them_too(field):
    shown = Display.load("additive-3")
    assert serves_words(pose(field, shown))
    codes = posed("views = [3, 3]\ndisparity = [1, -1]")
    assert not serves_words(replace(codes, weights=(2.0, *codes.weights[1:])))
    assert serves_words(replace(codes, views=KeptViews(codes.views.all())))
    assert not serves_words(replace(codes, views=KeptViews(3 * codes.views.all())))
    assert not serves_words(replace(codes, views=KeptViews(codes.views.all().double())))
    assert not serves_words(replace(codes, bounds=(0.0, 2.0)))


@pytest.mark.parametrize("size", [(75, 21), (2, 200), (210, 1)])
@pytest.mark.parametrize("kind", KINDS)
def test_words_of_codes_are_those_of_their_light(kind, size):
    problem = posed(KINDS[kind], size, batch=(2,))
    seen, made = problem.back_projected, problem.back_projected_words
    words, pixels = problem.constants.words, seen.shape[-1]
    assert words is not None
    assert made.shape == (*seen.shape[:-1], words.width)
    expected = (seen * (words.most / words.weight)).round().int()
    shown = made[..., :pixels].int()
    assert (shown - expected).abs().max() <= 1  # halves go either way
    assert torch.equal(replace(problem).back_projected_words[..., :pixels].int(), shown)


def test_layers_of_another_display_are_refused():
    problem, other = posed(KINDS["three layers"]), posed(KINDS["three layers"], (60, 21))
    words, seen = other.constants.words, problem.back_projected_words
    assert words is not None
    assert words.width % WORDS == 0
    with pytest.raises(ValueError, match=r"found layers of shape .*, expected"):
        word_sweeps.swept(words, seen, torch.rand(problem.layer_shape), [0.0])


def test_words_are_about_as_good_as_sweeps_without_bounds_on_their_number(field):
    """As many sweeps of floats, accelerated by their own rule, from the same steps."""
    problem = pose(field, Display.load("additive-3"))
    solver = solver_for(problem, 4)
    assert isinstance(solver, LearnedSweeps)
    begun = solve(problem, solver.direct, iterations=2).layers
    words = problem.mean_square_error(solve(problem, solver, iterations=4).layers)
    floats = problem.mean_square_error(solve(problem, Sweeps(), iterations=12, init=begun).layers)
    assert words <= 1.001 * floats
