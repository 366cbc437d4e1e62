"""What adds up view by view does so piece by piece, and comes to the same."""

from dataclasses import replace

import pytest
import torch

from layerfield import DisparitySpec, Display, procedural_light_field, solve
from layerfield.back_projection import back_projected
from layerfield.kept_views import KeptViews
from layerfield.panels import quantise
from layerfield.pieces import Piece, pieces
from layerfield.problem import Problem
from layerfield.solvers.ntf import Ntf
from layerfield.solvers.slope import slope
from layerfield.solvers.sweeps import Sweeps
from layerfield.warped_projection import WarpedProjection


def problem(*, link="multiplicative", step=1.0, subframes=1, warped=False) -> Problem:
    field = procedural_light_field(grid=(3, 3), size=(23, 31), seed=2)
    views = KeptViews(quantise(field.views, 8))
    spec = DisparitySpec(link="additive", disparity=(step, 0.0, -step), views=(3, 3))
    display = Display(spec.model_copy(update={"link": link, "subframes": subframes}))
    posed = Problem.of(display, views.then(torch.Tensor.double))
    if not warped:
        return posed
    plain = posed.projection
    wide = (plain.margin[0] + 2, plain.margin[1] + 3)
    magnifications = ((1.1, 1.0, 0.9),) * 9
    return replace(posed, projection=WarpedProjection(plain.shifts, wide, magnifications))


CASES = [  # and pieces of 200 pixels
    ({}, 12),
    ({"step": 0.7}, 12),
    ({"subframes": 2}, 24),
    ({"link": "polarisation", "step": 0.4}, 12),
    ({"warped": True}, 3),
]


@pytest.fixture
def small(monkeypatch):
    """Pieces of some rows of one channel."""

    def use() -> None:
        monkeypatch.setattr("layerfield.pieces._PIXELS", 200)
        monkeypatch.setattr(torch, "get_num_threads", lambda: 1)

    return use


def number_of_pieces(posed: Problem) -> int:
    return len(list(posed.pieces()))


@pytest.mark.parametrize(("case", "count"), CASES, ids=str)
def test_pieces_add_up_to_the_whole(small, case, count):
    posed = problem(**case)
    generator = torch.Generator().manual_seed(0)
    layers = torch.rand(posed.layer_shape, generator=generator, dtype=torch.float64)

    def everything():
        curvature = torch.zeros_like(layers)
        solvers = [Sweeps(), Ntf()] if case.get("link") != "polarisation" else [Sweeps()]
        found = [solve(posed, each, iterations=2, init=layers).layers for each in solvers]
        if posed.subframes == 1:
            found += [slope(posed, layers, curvature), curvature]
        return [*found, back_projected(posed.projection, posed.views, posed.weights)]

    assert number_of_pieces(posed) == 1
    whole = everything()
    small()
    assert number_of_pieces(posed) == count
    for one, other in zip(whole, everything(), strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-12)


def test_whole_numbers_add_up_exactly(small):
    posed = problem(link="additive")
    views = KeptViews(posed.views.stored)
    whole = back_projected(posed.projection, views, posed.weights)
    small()
    assert torch.equal(back_projected(posed.projection, views, posed.weights), whole)


def test_small_pictures_and_other_devices_are_one_piece(small):
    posed = problem()
    assert list(pieces(posed.projection, posed.views)) == [
        Piece(slice(0, 3), slice(0, 23), slice(0, 25))
    ]
    small()
    elsewhere = KeptViews(posed.views.stored.to("meta"))
    assert len(list(pieces(posed.projection, elsewhere))) == 1
