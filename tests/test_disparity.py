"""Disparities and the order of views, on planes whose disparities are known and on real views."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from layerfield.disparity import estimate_disparity
from layerfield.io import FieldOptions, Order, load_light_field
from layerfield.light_field import LightField
from layerfield.plane_sweep import Line, contour_votes, hidden_point_votes, sweep

FIELDS = Path(
    os.environ.get("LAYERFIELD_FIELDS", Path(__file__).parents[2] / "shared" / "lightfields")
)
needs_fields = pytest.mark.skipif(
    not FIELDS.is_dir(), reason=f"no light fields in {FIELDS} (set LAYERFIELD_FIELDS)"
)


@pytest.fixture(autouse=True)
def one_thread():
    """Small images: a second thread costs more than it brings, much more on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def noise(size, seed):
    """Return a texture without detail finer than two pixels."""
    texture = torch.rand(1, 3, size // 2, size // 2, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(texture, (size, size), mode="bilinear")[0]


def planes(grid=(5, 5), near=1.5, far=-1.0, size=120, seed=0):
    """Return textured discs at disparity `near` before a textured wall at disparity `far`."""
    wide = 2 * size
    y, x = torch.meshgrid(torch.arange(wide), torch.arange(wide), indexing="ij")
    spots = [(0.3, 0.3), (0.3, 0.7), (0.7, 0.35), (0.72, 0.75), (0.5, 0.52)]
    disc = torch.zeros(wide, wide)
    for row, column in spots:
        centre = (size / 2 + row * size, size / 2 + column * size)
        disc += ((y - centre[0]) ** 2 + (x - centre[1]) ** 2 < (0.11 * size) ** 2).float()
    discs = torch.cat([noise(wide, seed) * 0.5 + 0.5, disc.clamp(max=1)[None]])
    wall = noise(wide, seed + 1) * 0.5
    views = [
        seen(discs, wall, near, far, (row - (grid[0] - 1) / 2, column - (grid[1] - 1) / 2), size)
        for row in range(grid[0])
        for column in range(grid[1])
    ]
    return LightField(torch.stack(views), grid)


def seen(discs, wall, near, far, step, size):
    front, back = moved(discs, near, step, size), moved(wall, far, step, size)
    return front[3:] * front[:3] + (1 - front[3:]) * back


def moved(image, disparity, step, size):
    """Sample at (y + d * row, x + d * column), bilinearly."""
    lines = [torch.arange(size) + size / 2 + disparity * s for s in step]
    grid = torch.stack(torch.meshgrid(lines[1], lines[0], indexing="xy"), -1)
    grid = grid * 2 / (image.shape[-1] - 1) - 1
    return torch.nn.functional.grid_sample(image[None], grid[None], align_corners=True)[0]


def flipped(field, order):
    """Return the field as it would be read if it were stored in another order."""
    views = field.views.unflatten(0, field.grid)
    dims = [dim for dim, flip in enumerate((order.bottom, order.right)) if flip]
    return replace(field, stored=views.flip(dims).flatten(0, 1))


def orders(*names):
    return pytest.mark.parametrize("order", [Order.parse(name) for name in names], ids=str)


def test_ranges_of_planes():
    report = estimate_disparity(planes())
    for found in (report.horizontal, report.vertical):
        assert found == pytest.approx((-1.0, 1.5), abs=0.2)
    assert report.agree is True
    assert report.repair is None
    assert report.confidence > 0.5
    assert report.shift == 0
    assert any("supports the order" in line for line in report.lines())


@orders("bl-row", "tr-row")
def test_one_reversed_axis_is_found_and_named(order):
    report = estimate_disparity(flipped(planes(), order))
    assert report.agree is False
    assert report.repair == order
    assert report.confidence > 0.5
    text = " ".join(report.lines())
    assert "bl-row" in text
    assert "tr-row" in text


def test_half_turn_is_found_by_occlusion():
    report = estimate_disparity(flipped(planes(), Order.parse("br-row")))
    assert report.agree is True
    assert report.repair == Order.parse("br-row")
    assert "near and far" in " ".join(report.lines())


def test_repairs_are_relative_to_the_order_read():
    read = Order.parse("tr-column")
    report = estimate_disparity(flipped(planes(), Order.parse("bl-row")), order=read)
    assert str(report.repair) == "br-column"


@pytest.mark.parametrize("far", [3.0, 11.0])
def test_shift_centres_a_scene_far_from_zero(far):
    report = estimate_disparity(planes(near=far + 2, far=far, size=160))
    assert report.horizontal == pytest.approx((far, far + 2), abs=0.3)
    assert report.shift == pytest.approx(far + 1, abs=0.25)
    assert f"suggested shift: {report.shift:g} px" in report.lines()[-1]


def test_agreement_does_not_depend_on_the_zero_plane():
    field = planes(near=5.0, far=3.0, size=160)
    assert estimate_disparity(flipped(field, Order.parse("bl-row"))).agree is False


@pytest.mark.parametrize("grid", [(1, 7), (7, 1)])
def test_a_single_line_cannot_tell(grid):
    report = estimate_disparity(planes(grid=grid))
    assert report.agree is None
    assert (report.horizontal is None) == (grid[1] == 1)
    assert "cannot tell whether the order" in " ".join(report.lines())


@pytest.mark.parametrize(
    "field",
    [
        LightField(torch.rand(1, 3, 40, 40), (1, 1)),
        LightField(torch.full((9, 1, 40, 40), 0.5), (3, 3)),
        LightField(torch.rand(4, 1, 1, 1), (2, 2)),
        LightField(torch.rand(4, 3, 2, 9), (2, 2)),
    ],
)
def test_nothing_to_measure(field):
    report = estimate_disparity(field)
    assert report.agree is None
    assert report.shift == 0
    assert report.lines()


def test_two_views_are_enough_for_a_range():
    report = estimate_disparity(planes(grid=(2, 2)))
    assert report.horizontal == pytest.approx((-1.0, 1.5), abs=0.3)
    assert report.agree is True


def test_votes_change_sides_when_the_line_is_reversed():
    views = planes(grid=(1, 5)).views
    candidates = torch.arange(-8, 9) * 0.25
    lines = [Line(views, 2), Line(views.flip(0), 2)]
    swept = [sweep(line, candidates) for line in lines]
    for votes in (hidden_point_votes, contour_votes):
        one, other = (votes(line, s) for line, s in zip(lines, swept, strict=True))
        assert sum(one) > 50
        assert other == pytest.approx(one[::-1], abs=0.05 * sum(one))
    hidden = hidden_point_votes(lines[0], swept[0])
    assert hidden[0] > 4 * hidden[1]


@needs_fields
@pytest.mark.fields
@pytest.mark.parametrize(
    ("name", "options", "horizontal", "vertical"),
    [
        ("toys_9x9", {"views": "5x5"}, (-0.8, 0.6), (-0.8, 0.6)),
        ("snu_buildings", {"shift": 5, "views": "5x5"}, (-2, 2.25), (-2, 2.25)),
        ("mit_dragons", {"scale": 0.5}, (-0.65, 0.9), (-0.65, 0.9)),
        ("stanford_cards", {"scale": 0.5, "views": "5x5"}, (-1.8, 2.75), (-1.7, 2.5)),
    ],
)
def test_shared_fields(name, options, horizontal, vertical):
    field = load_light_field(FIELDS / name, FieldOptions.parse(**options))
    report = estimate_disparity(field)
    assert report.horizontal == pytest.approx(horizontal, abs=0.3)
    assert report.vertical == pytest.approx(vertical, abs=0.3)
    assert report.agree is True
    assert report.repair is None
    reversed_rows = estimate_disparity(flipped(field, Order.parse("bl-row")))
    assert reversed_rows.agree is False
    assert reversed_rows.repair in (None, Order.parse("bl-row"))
