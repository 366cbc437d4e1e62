"""Designs: the closed form against dense least squares, scenes with known depths, the command."""

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest
import torch
from test_cli import fails, read, run, succeed, write_views
from test_package import commands_in

from layerfield import Display, LightField, procedural_light_field, synthesize
from layerfield import spectrum as closed_form
from layerfield.design import (
    Search,
    centred_spectrum,
    design,
    even_stacks,
    parse_layers,
    solved_error,
)
from layerfield.geometry import grid_points
from layerfield.io import load_light_field
from layerfield.links import LINKS
from layerfield.report.designs import contrast_figure, design_lines
from layerfield.spectrum import Spectrum, contrast, predicted_error, spectrum

GRID, SIZE = (2, 3), (6, 8)
ADDITIVE = LINKS["additive"]


def whole_spectrum(views: torch.Tensor) -> Spectrum:
    """All frequencies of views on a torus, with no window."""
    height, width = SIZE
    columns = width // 2 + 1
    places = torch.arange(height * columns)
    counted = torch.tensor([1.0, 2, 2, 2, 1], dtype=torch.float64).repeat(height)
    return Spectrum(
        grid=GRID,
        values=torch.fft.rfft2(views).flatten(-2),
        along_y=torch.fft.fftfreq(height, dtype=torch.float64)[places // columns],
        along_x=torch.fft.rfftfreq(width, dtype=torch.float64)[places % columns],
        weights=counted / (height * width) ** 2 / math.prod(GRID) / views.shape[1],
    )


def dense(disparities: tuple[float, ...]) -> torch.Tensor:
    """A on a torus, `[view y x, layer y x]`, by plain linear interpolation."""
    height, width = SIZE
    matrix = np.zeros((math.prod(GRID), height, width, len(disparities), height, width))
    for i, (px, py) in enumerate(grid_points(GRID)):
        for y, x, k in np.ndindex(height, width, len(disparities)):
            at_y, at_x = y + disparities[k] * py, x + disparities[k] * px
            top, left = math.floor(at_y), math.floor(at_x)
            for row, wy in ((top, 1 - at_y + top), (top + 1, at_y - top)):
                for column, wx in ((left, 1 - at_x + left), (left + 1, at_x - left)):
                    matrix[i, y, x, k, row % height, column % width] += wy * wx
    pixels = height * width
    return torch.from_numpy(matrix.reshape(math.prod(GRID) * pixels, -1))


@pytest.mark.parametrize("disparities", [(0.5,), (1.0, -1.0), (1.25, 0.0, -0.6)])
def test_closed_form_equals_dense_least_squares(disparities, monkeypatch):
    torch.manual_seed(0)
    views = torch.rand(6, 2, *SIZE, dtype=torch.float64)
    matrix = dense(disparities)
    wanted = views.transpose(0, 1).flatten(1).T
    best = torch.linalg.lstsq(matrix, wanted, driver="gelsd").solution
    residual = (matrix @ best - wanted).square().mean().item()
    monkeypatch.setattr(closed_form, "_PRICE", 1e-9)
    assert predicted_error(whole_spectrum(views), disparities) == pytest.approx(residual, rel=1e-5)


def test_price_is_that_of_large_pixels():
    """||A P - v||^2 where P minimises ||A P - v||^2 + e N ||P||^2, by dense normal equations."""
    torch.manual_seed(0)
    views = torch.rand(6, 1, *SIZE, dtype=torch.float64)
    matrix, wanted = dense((1.0, 0.3)), views.transpose(0, 1).flatten(1).T
    normal = matrix.T @ matrix
    normal += closed_form._PRICE * 6 * torch.eye(len(normal))
    residual = matrix @ torch.linalg.solve(normal, matrix.T @ wanted) - wanted
    least = residual.square().mean().item()
    assert predicted_error(whole_spectrum(views), (1.0, 0.3)) == pytest.approx(least)


def test_drawn_frequencies_stand_for_all():
    field = procedural_light_field(size=(60, 70), seed=3)
    few, many = (spectrum(field, ADDITIVE, count=n) for n in (1000, 100_000))
    assert len(few.weights) < 1000 < len(many.weights)
    for stack in ((1.0, 0.0, -1.0), (0.25,)):
        assert predicted_error(few, stack) == pytest.approx(predicted_error(many, stack), rel=0.1)


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("disparity", [0.75, -1.5, 2.0])
def test_a_plane_is_best_served_by_a_layer_there(disparity, link):
    field = procedural_light_field(size=(72, 80), disparity_range=(disparity, disparity), seed=4)
    found = design([field], link, (1,))
    assert found.suggestions[0].disparity[0] == pytest.approx(disparity, abs=0.07)
    assert found.gain(found.suggestions[0]) > 3


def test_prediction_ranks_as_solving_does():
    field = procedural_light_field(size=(120, 144), disparity_range=(-1.5, 2), seed=11)
    stacks = [(0.5, 0.25, 0.0), (0.75, 0.25, -0.25), (1.25, 0.25, -0.75), (2.25, 0.25, -1.75)]
    given = centred_spectrum(field, ADDITIVE)
    predicted = [predicted_error(given, stack) for stack in stacks]
    solved = [solved_error(field, "additive", stack) for stack in stacks]
    assert np.argsort(predicted).tolist() == np.argsort(solved).tolist()


def test_free_layers_are_no_worse_than_even_ones():
    field = procedural_light_field(size=(64, 72), disparity_range=(-2, 1), seed=2)
    search = Search([spectrum(field, ADDITIVE)], [1 - n / 8 for n in range(25)])
    even = search.even(3)
    errors = search.errors(torch.stack([even, search.free(even)]))
    assert errors[1] <= errors[0] <= search.errors(even_stacks(25, 3)).min() * (1 + 1e-9)


def test_a_grating_at_a_layer_is_shown_in_full_and_far_from_it_is_not():
    disparities = torch.tensor([1.0, 0.0, 0.9], dtype=torch.float64)
    frequencies = torch.tensor([0.02, 0.25, 0.45], dtype=torch.float64)
    shown = contrast((1.0,), 5, disparities, frequencies)
    assert shown[0].min() > 0.99
    assert shown[1, 1] < 0.1
    assert (shown[2].diff() < 0).all()


def test_light_without_detail_has_a_design():
    field = LightField(torch.zeros(9, 1, 20, 24), (3, 3))
    found = design([field], "additive", (2,))
    assert len(found.suggestions) == 1
    assert all(len(line) == 6 for line in design_lines(found))


def test_layers_are_parsed():
    assert parse_layers(" 3,1,3 ") == (1, 3)


def test_figure_has_a_panel_for_every_suggestion():
    field = procedural_light_field(size=(40, 48), seed=1)
    found = design([field], "additive", (1, 2))
    panels = [axes for axes in contrast_figure(found).axes if axes.get_title()]
    assert [panel.get_title().split(",")[0] for panel in panels] == [
        "display-1.toml",
        "display-2.toml",
    ]
    assert all("px per view step" in panel.get_xlabel() for panel in panels)


# ---------------------------------------------------------------------------------- the command


@pytest.fixture
def desk(tmp_path, monkeypatch) -> Path:
    write_views(tmp_path / "views")
    write_views(tmp_path / "row", grid=(1, 5))
    write_views(tmp_path / "single", grid=(1, 1))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_command_leaves_displays_figures_and_facts(desk):
    said = succeed("design", "views", "--out", "out", "--layers", "1,3")
    assert "predicted dB" in said
    assert "over 1, 0, -1" in said
    found = json.loads(Path("out/design.json").read_text("utf-8"))
    ranked = [entry["psnr"] for entry in found["ranking"]]
    assert ranked == sorted(ranked, reverse=True)
    assert {entry["layers"] for entry in found["ranking"]} == {1, 3}
    assert found["made_with"]["layerfield"]
    assert np.ptp(read(Path("out/contrast.png"))) > 200
    field = load_light_field("views")
    for entry in found["ranking"]:
        if entry["file"]:
            display = Display.load(Path("out") / entry["file"])
            assert display.geometry.depths == tuple(entry["disparity"])
            error = (display(synthesize(field, display).layers) - field.views).square().mean()
            assert -10 * math.log10(error.item()) == pytest.approx(entry["psnr"], abs=0.01)
    succeed("synth", "views", "--display", "out/display-3.toml", "--out", "made")
    fails(run("design", "views", "--out", "out"), "out exists", "force")
    succeed("design", "views", "--out", "out", "--layers", "2", "--force")
    assert not Path("out/display-1.toml").exists()


def test_command_serves_one_row_of_views_and_both_links(desk):
    for link in ("additive", "multiplicative"):
        succeed("design", "row", "--layers", "2", "--link", link, "--out", link)
        display = Display.load(Path(link, "display-2.toml"))
        assert (display.geometry.grid, display.link.name) == ((1, 5), link)


def test_command_serves_several_fields_together_and_alone(desk):
    write_views(desk / "other", change=lambda view: 0.5 * view)
    said = succeed("design", "views", "other", "--layers", "2", "--out", "out")
    assert "views, other: additive" in said
    found = json.loads(Path("out/design.json").read_text("utf-8"))
    assert found["together"]["fields"] == ["views", "other"]
    assert [own["fields"] for own in found["alone"]] == [["views"], ["other"]]
    for place in (".", "views", "other"):
        Display.load(Path("out", place, "display-2.toml"))


def test_every_command_of_the_page_runs(desk):
    """In a folder with light fields called `my-views` and `other-views`."""
    (desk / "views").rename("my-views")
    write_views(desk / "other-views")
    page = (Path(__file__).parents[1] / "docs" / "design.md").read_text("utf-8")
    for command in commands_in(page):
        succeed(*shlex.split(command)[1:])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["views", "--layers", "0"], ["layers '0'", "1 to 8"]),
        (["views", "--layers", "three"], ["layers 'three'", "1 to 8"]),
        (["views", "--layers", "9"], ["layers '9'", "1 to 8"]),
        (["views", "--link", "additiv"], ["additiv", "additive"]),
        (["single"], ["'single'", "single view", "more views"]),
        (["views", "row"], ["5x5", "1x5", "--views"]),
        (["views", "--crop", "12x12"], ["12x12", "16x16"]),
        (["nowhere"], ["nowhere"]),
    ],
)
def test_command_refuses(desk, words, expected):
    fails(run("design", *words, "--out", "out"), *expected)
    assert not Path("out").exists()
