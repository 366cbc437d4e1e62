"""Compiled sums of a step: the same as PyTorch's."""

import numpy as np
import pytest
import torch

from layerfield.kernels import blends, transforms
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.compiled import plain
from layerfield.kernels.planes import transformed, transformed_back
from layerfield.kernels.strips import Strips, add_strips_
from layerfield.kernels.transforms import transforms_made

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
        known = Blend(SHARES, shadow, BOUNDS, other)
        expected = known.planes(None if onto is None else onto.clone())
    found = known.planes(onto)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    assert onto is None or found is onto


def test_what_lies_otherwise_in_memory_is_summed_up_too():
    shadow, onto = values(2, 9, 13).mT, values(2, 9, 13).mT
    expected = onto + 1.4 * shadow.clamp(*BOUNDS) - 0.3 * shadow
    known = Blend(SHARES, shadow, BOUNDS)
    torch.testing.assert_close(known.planes(), expected - onto)
    torch.testing.assert_close(known.planes(onto), expected)
    torch.testing.assert_close(onto, expected)


def test_larger_planes_are_refused():
    with pytest.raises(ValueError, match=r"found planes of \(4, 6\), expected \(4, 5\)"):
        Blend(SHARES, values(2, 4, 5), BOUNDS, values(2, 4, 6)).planes()


def test_derivatives_and_double_precision_are_left_to_pytorch(monkeypatch):
    monkeypatch.setattr(blends, "_blend", None)
    exact = Blend(SHARES, values(2, 4, 5).double(), BOUNDS).planes()
    shadow = values(2, 4, 5).requires_grad_()
    found = Blend(SHARES, shadow, BOUNDS).planes()
    torch.testing.assert_close(found.double(), exact, rtol=0, atol=1e-6)
    found.sum().backward()
    assert shadow.grad is not None


@pytest.mark.parametrize("by_row", [False, True])
@pytest.mark.parametrize("shape", [(2, 3, 2, 9, 14), (1, 3, 3, 40, 36)])
def test_planes_are_summed_up_beside_their_transforms(shape, by_row, monkeypatch):
    """One by one in the cache, or all at once where there is nothing to call."""
    torch.set_num_threads(3)
    shadow, other = values(*shape), values(*shape[:-2], shape[-2] - 1, shape[-1] - 2)
    known = Blend(SHARES, shadow, BOUNDS, other)

    def there_and_back() -> tuple[torch.Tensor, torch.Tensor]:
        pairs = transformed(known, by_row)
        return pairs.clone(), transformed_back(pairs, by_row, known)

    found = there_and_back()
    with transforms_made() as made:
        again = there_and_back()
    pairs = (*shape[:-1], shape[-1] // 2)
    assert made == [(pairs, by_row, False), (pairs, by_row, True)]
    monkeypatch.setattr(transforms, "_maker", lambda: None)
    expected = there_and_back()
    for one, same, other in zip(found, again, expected, strict=True):
        assert torch.equal(one, same)
        torch.testing.assert_close(one, other, rtol=0, atol=1e-5 * other.abs().max().item())


def test_strips_are_added_where_they_belong():
    shadow, below, beside = values(2, 4, 5), values(2, 2, 5), values(2, 4, 3)
    strips = Strips(below.numpy(), beside.numpy(), 3, 4, np.float32(0.5))
    expected = Blend(SHARES, shadow, BOUNDS).planes()
    for a in range(2):
        expected[:, (3 + a) % 4] += 0.35 * below[:, a]
    for a in range(3):
        expected[:, :, (4 + a) % 5] += 0.35 * beside[:, :, a]
    found = Blend(SHARES, shadow, BOUNDS, strips=strips).planes()
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="found strips"):
        Blend(SHARES, values(3, 4, 5), BOUNDS, strips=strips).planes()
    with pytest.raises(ValueError, match="found strips"):
        add_strips_(values(3, 4, 5), strips)
