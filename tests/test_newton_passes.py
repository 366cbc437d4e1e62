"""Compiled passes of Newton steps: the same as PyTorch's."""

import pytest
import torch

from layerfield import Display, Problem
from layerfield.display_spec import parse_spec
from layerfield.kept_views import KeptViews
from layerfield.kernels.compiled import plain
from layerfield.solvers.newton_admm import NewtonAdmm


def posed(batch: tuple[int, ...]) -> tuple[Problem, torch.Tensor]:
    text = 'name = "d"\nlink = "multiplicative"\nviews = [3, 3]\ndisparity = [1, 0, -1]'
    generator = torch.Generator().manual_seed(3)
    codes = torch.rand(*batch, 9, 2, 40, 31, generator=generator).mul(255).to(torch.uint8)
    problem = Problem.of(Display(parse_spec(text, "a test")), KeptViews(codes))
    start = torch.rand(problem.layer_shape, generator=generator) * 1.2 - 0.1
    return problem, start.clamp(0, 1)  # many are at bounds, which hold some of them


@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize("threads", [1, 3])
def test_steps_are_those_of_pytorch(batch, threads):
    """Before the first D is unknown; it is found anew in the first three, and in the seventh."""
    torch.set_num_threads(threads)
    problem, start = posed(batch)
    solver = NewtonAdmm()
    state = solver.init(problem, start)
    for _ in range(8):
        with plain():
            expected = solver.step(problem, state)
        state = solver.step(problem, state)
        torch.testing.assert_close(state.shadow, expected.shadow, rtol=0, atol=2e-5)


def test_what_lies_otherwise_in_memory_is_left_to_pytorch():
    problem, start = posed(())
    solver, turned = NewtonAdmm(), start.mT.contiguous().mT
    one, other = (solver.step(problem, solver.init(problem, each)) for each in (start, turned))
    torch.testing.assert_close(one.shadow, other.shadow, rtol=0, atol=2e-5)
    one, other = solver.step(problem, one), solver.step(problem, other)
    torch.testing.assert_close(one.shadow, other.shadow, rtol=0, atol=5e-5)
