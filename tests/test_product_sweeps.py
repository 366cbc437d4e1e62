"""Sweeps over layers whose light multiplies, gathered pixel by pixel, against PyTorch's."""

import pytest
import torch

from layerfield import Display
from layerfield.display_spec import parse_spec
from layerfield.kept_views import KeptViews
from layerfield.kernels import product_sweeps
from layerfield.kernels.compiled import plain
from layerfield.kernels.product_sweeps import ProductSweeps
from layerfield.links import Multiplicative
from layerfield.problem import Problem
from layerfield.projection import Projection
from layerfield.solvers.sweeps import Sweeps, SweepsState

TEXTS = [
    "views = [5, 5]\ndisparity = [1, 0, -1]",
    "views = [3, 5]\ndisparity = [4, 1]",
    "views = [1, 7]\ndisparity = [2, 0, -1, -2]",
    "views = [3, 3]\ndisparity = [0]",
]


def projection(text: str) -> Projection:
    return Display(parse_spec(f'name = "d"\nlink = "multiplicative"\n{text}', "a test")).projection


def noise(*shape: int, seed: int = 1) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def in_sixteen_bits(codes: torch.Tensor) -> torch.Tensor:
    """Light that words hold exactly."""
    return (codes**2.2 * 65535).round() / 65535


def posed(
    text: str, size: tuple[int, int], kind: str = "codes", batch: tuple[int, ...] = ()
) -> Problem:
    shown = projection(text)
    count = len(shown.shifts)
    views = noise(*batch, count, 2, *size)
    kept = {
        "codes": KeptViews((views * 255).to(torch.uint8)),
        "long codes": KeptViews((views * 65535).to(torch.uint16)),
        "light": KeptViews((views * 255).to(torch.uint8)).then(in_sixteen_bits),
        "bright": KeptViews((views * 255).to(torch.uint8)).then(lambda codes: 1.5 * codes),
        "values": KeptViews(views),
    }[kind]
    weights = tuple(1 + 0.1 * n for n in range(count))
    return Problem(shown, Multiplicative(), kept, weights)


def begun(problem: Problem, push: float = 0.7) -> SweepsState:
    shape = problem.layer_shape
    pushes = torch.full((*shape[:-5], 1, 1, 1, 1, 1), push)
    layers, last = (0.2 + 0.8 * noise(*shape, seed=seed) for seed in (2, 3))
    return SweepsState(layers, last, pushes, torch.zeros_like(pushes))


def swept(
    problem: Problem, layers: torch.Tensor, last: torch.Tensor, push: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    sweeps = ProductSweeps.along(problem.light_paths, (0.0, 1.0), 0.9)
    made, _, _, since = sweeps(layers, last, push, torch.zeros_like(push), sweeps=1)
    return made, since


@pytest.mark.parametrize("kind", ["codes", "long codes", "light", "bright", "values"])
@pytest.mark.parametrize("text", TEXTS)
def test_a_sweep_is_what_pytorch_makes(text, kind):
    # Rows end in and behind blocks of pixels, and are shorter than one; planes come in parts.
    for size in ((150, 70), (33, 47), (5, 3)):
        problem = posed(text, size, kind)
        state = begun(problem)
        assert product_sweeps.serves(problem.light_paths, state.layers)
        made = Sweeps().step(problem, state)
        with plain():
            expected = Sweeps().step(problem, state)
        apart = (made.layers - expected.layers).abs()
        # Behind dark pixels rounding is much of what there is to go by, of both alike.
        assert apart.mean() < 1e-6
        assert apart.max() < 1e-3
        assert torch.equal(made.push, expected.push)


def test_light_has_sixteen_bits():
    codes = KeptViews(torch.arange(256, dtype=torch.uint8).view(1, 1, 16, 16))
    light = codes.then(lambda values: values**2.2)
    apart = product_sweeps._light_of(light).all() - light.all()
    assert 0 < apart.abs().max() <= 0.501 / 65535


def test_items_of_a_batch_have_pushes_of_their_own():
    problem = posed(TEXTS[0], (40, 50), batch=(2,))
    state = begun(problem)
    state.push[1] = 0
    layers, count = swept(problem, state.layers, state.last, state.push)
    assert count.shape == state.push.shape
    for n in range(2):
        alone = Problem(
            problem.projection,
            problem.link,
            KeptViews(problem.views.stored[n]),
            problem.weights,
        )
        given = state.layers[n], state.last[n], state.push[n]
        found, since = swept(alone, *given)
        assert torch.equal(found, layers[n])
        assert torch.equal(since, count[n])


@pytest.mark.parametrize("count", [0, 1, 2, 3, 8])
def test_sweeps_at_once_are_those_one_after_the_other(count):
    problem = posed(TEXTS[0], (150, 70), batch=(2,))
    state = begun(problem)
    given = [each.clone() for each in (state.layers, state.last, state.push)]
    found, expected = Sweeps().steps(problem, state, count), state
    for _ in range(count):
        expected = Sweeps().step(problem, expected)
    for name in ("layers", "last", "push", "count"):
        assert torch.equal(getattr(found, name), getattr(expected, name))
    assert all(map(torch.equal, given, (state.layers, state.last, state.push)))


def test_momentum_begins_anew_where_a_sweep_led_back():
    problem = posed(TEXTS[0], (40, 50), batch=(2,))
    state = begun(problem)
    state.count[:] = 5
    state.push[1] = 0
    made = Sweeps().steps(problem, state, 4)
    with plain():
        expected = Sweeps().steps(problem, state, 4)
    assert (made.count < 9).all()
    assert torch.equal(made.count, expected.count)
    assert torch.equal(made.push, expected.push)


def test_views_of_no_weight_are_not_looked_at():
    problem = posed(TEXTS[0], (40, 50), "values")
    weights = [1.0] * 25
    weights[3] = weights[7] = 0.0
    known = Problem(problem.projection, problem.link, problem.views, tuple(weights))
    state = begun(known)
    before = Sweeps().step(known, state).layers
    problem.views.stored[[3, 7]] = torch.nan
    assert torch.equal(Sweeps().step(known, state).layers, before)


def test_pixels_that_nothing_shines_through_stay():
    problem = posed(TEXTS[1], (40, 50))
    layers = noise(*problem.layer_shape, seed=2)
    layers[0, 0] = 0  # so nothing is seen of the other, and it stays; then this one follows
    state = Sweeps().init(problem, layers)
    made = Sweeps().step(problem, state).layers
    assert (made[0, 0] > 0).any()
    layers[0, 1] = 0
    made = Sweeps().step(problem, Sweeps().init(problem, layers)).layers
    assert torch.equal(made, layers)


def test_layers_do_not_depend_on_the_number_of_threads():
    problem = posed(TEXTS[2], (300, 64))
    state, threads = begun(problem), torch.get_num_threads()
    made = Sweeps().step(problem, state).layers
    try:
        torch.set_num_threads(1)
        assert torch.equal(Sweeps().step(problem, state).layers, made)
    finally:
        torch.set_num_threads(threads)


def test_layers_of_another_size_are_refused():
    problem = posed(TEXTS[0], (40, 50))
    state = begun(problem)
    with pytest.raises(ValueError, match="expected"):
        swept(problem, state.layers[..., 1:], state.last[..., 1:], state.push)


@pytest.mark.parametrize("text", ["views = [5, 5]\ndisparity = [1.5, 0]"])
def test_paths_between_pixels_are_left_to_others(text):
    problem = posed(text, (40, 50))
    assert not product_sweeps.serves(problem.light_paths, begun(problem).layers)
