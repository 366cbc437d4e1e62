"""What is at both ends of a solver, compiled: the balanced start and the codes of panels."""

import pytest
import torch

from layerfield import DisparitySpec, Display, Problem
from layerfield.display_spec import parse_spec
from layerfield.kernels.codes import mean_of
from layerfield.kernels.compiled import plain
from layerfield.kernels.starts import shared_start
from layerfield.panels import quantise


@pytest.mark.parametrize("torus", [None, (40, 48)])
@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_balanced_starts_are_those_of_pytorch(batch, torus):
    """A corner of the first layer is seen by nobody: viewpoints are not a grid."""
    viewpoints = "viewpoints = [[0, 0], [1, 1], [2, 2]]"
    text = f'name = "d"\nlink = "additive"\n{viewpoints}\ndisparity = [3, 0, -1]'
    display = Display(parse_spec(text, "a test"))
    problem = Problem.of(display, torch.rand(*batch, 3, 2, 20, 24))
    assert (problem.coverage == 0).any()
    with plain():
        expected = problem.even_start(torus)
    found = problem.even_start(torus)
    assert found.shape[-2:] == (torus or problem.layer_shape[-2:])
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)


def test_smaller_tori_are_refused():
    seen, shares, rest = torch.rand(3, 2, 5, 6), torch.rand(3, 1, 5, 6), torch.rand(1, 2, 1, 1)
    with pytest.raises(ValueError, match=r"found a torus \(4, 6\), expected"):
        shared_start(seen, shares, rest, (4, 6))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("shape", [(3, 1, 7, 9), (1, 3, 400, 500)])
def test_codes_are_those_of_pytorch(bits, shape):
    """Halves go to even codes, what is beyond black and white to those."""
    torch.set_num_threads(3)
    layers = torch.rand(shape) * 1.4 - 0.2
    layers.view(-1)[:20] = (torch.arange(20) + 0.5) / (2**bits - 1)
    with plain():
        expected = quantise(layers, bits)
    assert quantise(layers, bits).equal(expected)
    turned = layers.transpose(-1, -2)
    assert quantise(turned, bits).equal(expected.transpose(-1, -2))


def test_what_asks_for_derivatives_is_served_where_none_are_kept():
    seen, shares, rest = torch.rand(3, 2, 5, 6), torch.rand(3, 1, 5, 6), torch.rand(1, 2, 1, 1)
    with torch.no_grad():
        start = shared_start(seen.requires_grad_(), shares, rest, (8, 8))
        codes = quantise(seen, 8)
    assert not start.requires_grad
    assert codes.equal(quantise(seen.detach(), 8))


@pytest.mark.parametrize(("dtype", "largest"), [(torch.uint8, 255), (torch.uint16, 65535)])
@pytest.mark.parametrize("batch", [(), (2,)])
def test_the_mean_of_what_codes_stand_for(dtype, largest, batch):
    generator = torch.Generator().manual_seed(3)
    codes = torch.randint(largest + 1, (*batch, 5, 3, 21, 40), generator=generator).to(dtype)
    table = torch.rand(largest + 1, generator=generator) - 0.3
    expected = table.double()[codes.long()].mean(dim=(-4, -3, -2, -1))
    torch.testing.assert_close(mean_of(codes, table), expected, atol=1e-7, rtol=0)
    problem = Problem.of(
        Display(DisparitySpec(link="additive", disparity=(1.0, -1.0), views=(5, 1))), codes
    )
    start = problem.flat_start()
    assert start.shape == problem.layer_shape
    with plain():
        torch.testing.assert_close(start, problem.flat_start())


@pytest.mark.parametrize(("dtype", "largest"), [(torch.uint8, 255), (torch.uint16, 65535)])
@pytest.mark.parametrize("text", ["[2, 0, -1]", "[1, 0]"])
def test_sums_of_codes_are_those_of_pytorch(dtype, largest, text):
    """Of whole numbers they are exact: what is white is as white as there are views."""
    shown = f'name = "d"\nlink = "additive"\nviews = [3, 5]\ndisparity = {text}'
    display = Display(parse_spec(shown, "a test"))
    views = torch.randint(0, largest + 1, (2, 15, 3, 21, 75)).to(dtype)
    views[0] = largest
    found = Problem.of(display, views).back_projected
    with plain():
        expected = Problem.of(display, views).back_projected
    torch.testing.assert_close(found, expected, rtol=1e-7, atol=0)
    assert found[0].amax() == 15
