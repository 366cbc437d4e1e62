"""Compiled sums of a step: the same as PyTorch's."""

import pytest
import torch

from layerfield.kernels import blends
from layerfield.kernels.blends import Shares, blended
from layerfield.kernels.compiled import plain

SHARES = Shares(1.4, -0.3, 0.7)
BOUNDS = (0.1, 0.8)


def values(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


@pytest.mark.parametrize("shape", [(1, 1), (2, 1, 3, 2, 9, 13), (1, 3, 3, 300, 200)])
@pytest.mark.parametrize("smaller", [None, 0, 1])
@pytest.mark.parametrize("added_to", [False, True])
def test_sums_are_those_of_pytorch(shape, smaller, added_to):
    torch.set_num_threads(3)
    shadow, onto = values(*shape), values(*shape).flip(-1) if added_to else None
    other = None
    if smaller is not None:
        height, width = shape[-2] - smaller, shape[-1] - smaller
        other = values(*shape[:-2], height, width)
    with plain():
        expected = blended(SHARES, shadow, BOUNDS, other, None if onto is None else onto.clone())
    found = blended(SHARES, shadow, BOUNDS, other, onto)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    assert onto is None or found is onto


def test_what_lies_otherwise_in_memory_is_summed_up_too():
    shadow, onto = values(2, 9, 13).mT, values(2, 9, 13).mT
    expected = onto + 1.4 * shadow.clamp(*BOUNDS) - 0.3 * shadow
    found = blended(SHARES, shadow, BOUNDS)
    torch.testing.assert_close(found, expected - onto)
    torch.testing.assert_close(blended(SHARES, shadow, BOUNDS, onto=onto), expected)
    torch.testing.assert_close(onto, expected)


def test_larger_planes_are_refused():
    with pytest.raises(ValueError, match=r"found planes of \(4, 6\), expected \(4, 5\)"):
        blended(SHARES, values(2, 4, 5), BOUNDS, values(2, 4, 6))


def test_derivatives_and_double_precision_are_left_to_pytorch(monkeypatch):
    monkeypatch.setattr(blends, "_blend", None)
    exact = blended(SHARES, values(2, 4, 5).double(), BOUNDS)
    shadow = values(2, 4, 5).requires_grad_()
    found = blended(SHARES, shadow, BOUNDS)
    torch.testing.assert_close(found.double(), exact, rtol=0, atol=1e-6)
    found.sum().backward()
    assert shadow.grad is not None
