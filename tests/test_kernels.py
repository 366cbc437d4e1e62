"""Compiled loops: the same as PyTorch's, whatever the views, layers, weights and threads."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from displays import SHOWN

from layerfield import Display, Problem
from layerfield.display_spec import parse_spec
from layerfield.kept_views import KeptViews
from layerfield.kernels import compiled, sweep_passes, threads
from layerfield.kernels.compiled import plain
from layerfield.kernels.threads import in_threads
from layerfield.solvers import ntf, sweeps
from layerfield.solvers.slope import slope

KEPT = ["codes", "codes of 16 bits", "linear light", "values", "a window of more"]


def display(kind: str, link: str) -> Display:
    return Display(parse_spec(f'name = "d"\nlink = "{link}"\n{SHOWN[kind]}', "a test"))


def kept(kind: str, count: int, batch: tuple[int, ...] = ()) -> KeptViews:
    """Return views of 75 rows, which are three bands."""
    generator = torch.Generator().manual_seed(5)
    values = torch.rand(*batch, count, 2, 75, 20, generator=generator)
    if kind == "values":
        return KeptViews(values)
    if kind == "codes of 16 bits":
        return KeptViews((values * 65535).to(torch.uint16))
    codes = KeptViews((values * 255).to(torch.uint8))
    if kind == "a window of more":
        return replace(codes, stored=codes.stored[..., 1:15])
    return codes.then(lambda light: light**2.2) if kind == "linear light" else codes


def posed(
    kind: str, link: str, views: str = "codes", batch: tuple[int, ...] = ()
) -> tuple[Problem, torch.Tensor]:
    """Return a problem with weights of its own, and layers within bounds."""
    shown = display(kind, link)
    weights = [1.0 + n % 3 for n in range(shown.view_count)]
    problem = Problem.of(shown, kept(views, shown.view_count, batch), weights)
    generator = torch.Generator().manual_seed(3)
    return problem, torch.rand(problem.layer_shape, generator=generator)


def same(found: torch.Tensor, expected: torch.Tensor) -> bool:
    return torch.allclose(found, expected, rtol=1e-5, atol=1e-5 * float(expected.abs().max()))


def served(problem: Problem, layers: torch.Tensor) -> bool:
    return problem.light_paths.serve(layers)


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("kind", SHOWN)
@pytest.mark.parametrize("views", KEPT)
def test_slope_curvature_and_error_are_those_of_pytorch(kind, link, views):
    problem, layers = posed(kind, link, views)
    assert served(problem, layers)

    def found() -> tuple[torch.Tensor, ...]:
        curvature, error = torch.zeros_like(layers), torch.ones(1, 1, 1, 1, 1)
        return slope(problem, layers, curvature, error), curvature, error, slope(problem, layers)

    compiled_ones = found()
    with plain():
        assert not served(problem, layers)
        expected = found()
    assert all(map(same, compiled_ones, expected))


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("batch", [(2,), (2, 3)])
def test_light_fields_of_a_batch_do_not_mix(link, batch):
    problem, layers = posed("two layers, fractions", link, batch=batch)
    error = torch.zeros(*batch, 1, 1, 1, 1, 1)
    found = slope(problem, layers, error=error)
    with plain():
        expected_error = torch.zeros_like(error)
        expected = slope(problem, layers, error=expected_error)
    assert same(found, expected)
    assert same(error, expected_error)


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("kind", SHOWN)
def test_the_best_layer_is_that_of_pytorch(kind, link):
    problem, layers = posed(kind, link, batch=(2,))
    for index in range(problem.layer_count):
        found = sweeps.best_layer(problem, layers, index)
        with plain():
            assert same(found, sweeps.best_layer(problem, layers, index))


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("link", ["additive", "multiplicative"])
def test_sweeps_are_those_of_pytorch(link, threads):
    """From layers where a light field of two goes uphill in between, and starts anew."""
    torch.set_num_threads(threads)
    problem, layers = posed("two layers, fractions", link, batch=(2,))
    solver = sweeps.Sweeps()
    state, counts = solver.init(problem, layers), list[torch.Tensor]()
    state = replace(state, last=torch.stack([layers[0], 2 * layers[1] - 1]), push=state.push + 1)
    for _ in range(5):
        with plain():
            expected = solver.step(problem, state)
        state = solver.step(problem, state)
        assert same(state.layers, expected.layers)
        assert torch.equal(state.push, expected.push)
        assert torch.equal(state.count, expected.count)
        counts.append(state.count.flatten())
    assert len({tuple(each.tolist()) for each in counts}) > 1


def test_pixels_behind_nearly_black_ones_stay_numbers():
    """Their curvature is so small that one over it is infinite."""
    layers, nothing = torch.full((1, 1, 1, 1, 40), 0.5), torch.zeros(1, 1, 1, 1, 40)
    sweep_passes.move_layer_(layers, 0, nothing, torch.full_like(nothing, 1e-40), (0.0, 1.0))
    assert torch.equal(layers, torch.full_like(layers, 0.5))


@pytest.mark.parametrize("is_turned", [False, True])
def test_a_multiplicative_update_is_that_of_pytorch(is_turned):
    """Of layers that lie otherwise in memory, too."""
    problem, layers = posed("three layers", "multiplicative")
    if is_turned:
        layers = layers.mT.contiguous().mT
    found = ntf.Ntf().step(problem, layers)
    with plain():
        assert same(found, ntf.Ntf().step(problem, layers))


@pytest.mark.parametrize("views", KEPT)
@pytest.mark.parametrize("kind", SHOWN)
def test_views_seen_from_the_layers_are_those_of_pytorch(kind, views):
    problem, _ = posed(kind, "additive", views)
    found = problem.back_projected
    with plain():
        assert same(found, replace(problem).back_projected)


def test_sums_do_not_depend_on_the_threads():
    problem, layers = posed("two layers, fractions", "multiplicative")
    one = slope(problem, layers)
    torch.set_num_threads(3)
    assert torch.equal(slope(problem, layers), one)


def test_what_is_not_served_is_left_to_pytorch():
    problem, layers = posed("three layers", "polarisation")
    assert not served(problem, layers)
    problem, layers = posed("three layers", "multiplicative")
    assert not served(problem, layers.double())
    assert not served(problem, layers.clone().requires_grad_())
    assert not served(replace(problem, views=KeptViews(torch.rand(9, 2, 9, 9).double())), layers)
    assert not served(problem, torch.cat([layers, layers], dim=-5))
    values = KeptViews(torch.rand(9, 2, 75, 20).requires_grad_())
    assert not served(replace(problem, views=values), layers)
    with torch.no_grad():
        assert served(replace(problem, views=values), layers.clone().requires_grad_())
        slope(replace(problem, views=values), layers.clone().requires_grad_())
    (gradient,) = torch.autograd.grad(slope(problem, layers.requires_grad_()).sum(), layers)
    assert gradient.abs().sum() > 0


def test_layers_of_another_size_are_refused():
    problem, layers = posed("three layers", "multiplicative")
    with pytest.raises(ValueError, match=r"found layers of shape .* expected \(1, 3, 2, 77, 22\)"):
        slope(problem, layers[..., 1:])
    apart = torch.empty(layers.mT.shape).mT
    with pytest.raises(ValueError, match="expected contiguous"):
        problem.light_paths.add_up_(apart, layers)


@compiled.compiled
def _count(visits, pair, begin, end):
    for number in range(begin, end):
        visits[number] += pair[0] + pair[1][0]


@compiled.compiled
def _ask_for_too_much(visits, begin, end):
    visits[begin] = np.zeros(1 << 56)[0]


@compiled.compiled
def _count_before(made, seen, needs, begin, end):
    """Those that come first take longest, so that others would pass them by."""
    for number in range(begin, end):
        for place in range(needs[number]):
            seen[number] += made[place]
        value = 1.0
        for _ in range(20000 if number % 7 == 0 else 1):
            value = np.sqrt(value + 1)
        made[number] = 1 if value > 0 else 0


@compiled.compiled
def _fail_in_the_middle(made, begin, end):
    for number in range(begin, end):
        made[number] = 1
        if number == 20:
            made[number] = np.zeros(1 << 56)[0]


@pytest.fixture(params=["PyTorch's", "our own", "one"])
def some_threads(request, monkeypatch):
    torch.set_num_threads(1 if request.param == "one" else 3)
    if request.param == "our own":
        monkeypatch.setattr(compiled, "parallel_address", lambda: None)
    elif threads.parallel_address() is None:
        pytest.skip("PyTorch's threads are others here")


@pytest.mark.usefixtures("some_threads")
@pytest.mark.parametrize("count", [0, 1, 2, 13, 5000])
@pytest.mark.parametrize("numbers", [0, 1 << 30])
def test_spans_come_to_all_there_is(count, numbers):
    visits = np.zeros(count)
    _count.in_spans(visits, (1.0, np.ones(2)), count=count, numbers=numbers)
    assert (visits == 2).all()


@pytest.mark.usefixtures("some_threads")
def test_loops_that_get_no_memory_say_so():
    with pytest.raises(MemoryError):
        _ask_for_too_much.in_spans(np.zeros(9), count=9, numbers=1 << 30)


@pytest.mark.usefixtures("some_threads")
@pytest.mark.parametrize("count", [0, 1, 300])
@pytest.mark.parametrize("numbers", [0, 1 << 30])
def test_spans_begin_when_what_they_need_is_done(count, numbers):
    needs = np.arange(count) - np.arange(count) % 5
    made, seen = np.zeros(count, np.int64), np.zeros(count, np.int64)
    _count_before.in_spans(made, seen, needs, count=count, numbers=numbers, needs=needs)
    assert (made == 1).all()
    assert (seen == needs).all()


@pytest.mark.usefixtures("some_threads")
def test_nobody_waits_for_ever_for_what_failed():
    made, needs = np.zeros(90, np.int64), np.maximum(np.arange(90) - 2, 0)
    with pytest.raises(MemoryError):
        _fail_in_the_middle.in_spans(made, count=90, numbers=1 << 30, needs=needs)
    assert made[:20].all()
    assert not made[25:].any()


def test_every_task_is_done_once():
    torch.set_num_threads(3)
    done: list[int] = []
    in_threads(done.append, 50)
    assert sorted(done) == list(range(50))
    in_threads(done.append, 0)
    assert len(done) == 50


def test_what_a_task_raises_is_raised():
    torch.set_num_threads(3)
    begun: list[int] = []

    def task(number: int) -> None:
        begun.append(number)
        if threading.current_thread() is threading.main_thread():
            raise ZeroDivisionError
        time.sleep(0.05)

    with pytest.raises(ZeroDivisionError):
        in_threads(task, 50)
    assert len(begun) < 10


def test_spans_come_to_all_in_a_forked_process():
    """It has none of the threads that its parent had."""
    torch.set_num_threads(3)
    visits = np.zeros(50)
    _count.in_spans(visits, (0.5, np.zeros(1)), count=50, numbers=1 << 30)
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        _count.in_spans(visits, (0.5, np.zeros(1)), count=50, numbers=1 << 30)
        os._exit(0 if (visits == 1).all() else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_what_cannot_be_kept_on_disk_is_compiled_all_the_same(monkeypatch):
    known = numba.njit

    def nowhere(*, cache=False, **options):
        def compiled_of(function):
            if cache:
                raise RuntimeError("cannot cache function: no locator available for file")
            return known(**options)(function)

        return compiled_of

    monkeypatch.setattr(numba, "njit", nowhere)

    def double(values):
        for n in range(len(values)):
            values[n] *= 2

    values = torch.arange(3.0).numpy()
    compiled.compiled(double)(values)
    assert values.tolist() == [0, 2, 4]


def test_numbas_own_switch_leaves_everything_to_pytorch():
    code = (
        "import torch; from layerfield import Display, procedural_light_field, synthesize\n"
        "from layerfield.kernels.compiled import is_plain\n"
        "assert is_plain()\n"
        "field = procedural_light_field(size=(24, 32), seed=3)\n"
        "synthesize(field, Display.load('multiplicative-3'), method='fast', iterations=1)\n"
    )
    disabled = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run(
        [sys.executable, "-c", code], check=False, env=disabled, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr


def test_what_is_kept_is_named_by_all_compiled_functions(tmp_path, monkeypatch):
    """One may be inside another of a file that has not changed."""
    before = compiled._fingerprint()
    (tmp_path / "compiled.py").write_text("")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert compiled._fingerprint.__wrapped__() != before
    (tmp_path / "other.py").write_text("1")
    assert len({compiled._fingerprint.__wrapped__(), before}) == 2
