"""Time multiplexing: several subframes a layer, whose mean is seen."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from test_cli import run

from layerfield import Display, LightField, procedural_light_field, synthesize
from layerfield.display_spec import DisparitySpec, format_spec
from layerfield.evaluate import evaluate
from layerfield.metrics import psnr
from layerfield.result import write_views
from layerfield.solve import solve
from layerfield.solvers.ntf import Ntf
from layerfield.solvers.sweeps import Sweeps, best_layer
from layerfield.stored_result import read_layers
from layerfield.synthesizer import SOLVERS, pose

NONLINEAR = ["multiplicative", "polarisation"]
PAIRS = [
    (m.name, link)
    for m in SOLVERS.values()
    for link in m.links
    if link in NONLINEAR and m.name not in {"tone", "row-newton"}
]


def display(link: str = "multiplicative", subframes: int = 3, **more) -> Display:
    values = {"disparity": (1.0, 0.0, -1.0), "views": (5, 5)} | more
    return Display(DisparitySpec(link=link, subframes=subframes, **values))  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def scene() -> LightField:
    return procedural_light_field(size=(48, 56), disparity_range=(-1.3, 1.3), seed=5)


@pytest.mark.parametrize("link", NONLINEAR)
def test_the_mean_of_the_subframes_is_seen(link):
    many, one = display(link), display(link, 1)
    layers = torch.rand(3, 3, 1, 24, 28)
    single = torch.stack([one(layers[s : s + 1]) for s in range(3)])
    torch.testing.assert_close(many(layers), single.mean(dim=0))


@pytest.mark.parametrize(("method", "link"), PAIRS)
def test_subframes_show_more(scene, method, link):
    """Every method profits; the same call gives the same layers; batches equal singles."""
    many = display(link)
    iterations = {"gradient": 100, "ntf": 50}.get(method, 20)
    lone = synthesize(scene, display(link, 1), method=method, iterations=iterations)
    shared = synthesize(scene, many, method=method, iterations=iterations)
    assert shared.layers.shape[:2] == (3, 3)
    assert 0 <= shared.layers.min() <= shared.layers.max() <= 1
    before = psnr(display(link, 1)(lone.layers), scene.views)
    after = psnr(many(shared.layers), scene.views)
    assert after > before + 0.3
    again = synthesize(scene, many, method=method, iterations=iterations)
    assert torch.equal(again.layers, shared.layers)


@pytest.mark.parametrize("link", NONLINEAR)
def test_a_warm_start_and_a_batch_are_as_they_were(scene, link):
    many = display(link)
    whole = synthesize(scene, many, iterations=5)
    rest = synthesize(scene, many, iterations=2, init=synthesize(scene, many, iterations=3))
    torch.testing.assert_close(rest.layers, whole.layers, atol=1e-6, rtol=0)
    batch = LightField(torch.stack([scene.views, 0.5 * scene.views]), scene.grid)
    first = synthesize(batch, many, iterations=5).layers[0]
    torch.testing.assert_close(first, whole.layers, atol=1e-5, rtol=0)


def test_a_start_with_other_subframes_is_refused(scene):
    lone = synthesize(scene, display(subframes=1), iterations=1)
    with pytest.raises(ValueError, match=r"shape \(1, 3, 3, .*expected \(3, 3, 3,"):
        synthesize(scene, display(), init=lone.layers)


@pytest.mark.parametrize("make", [Ntf(), Sweeps(momentum=0)])
@pytest.mark.parametrize("disparity", [(1.0, 0.0, -1.0), (1.0, 0.25, -0.6)])
def test_updates_descend(scene, make, disparity):
    problem = pose(scene, display(disparity=disparity))
    errors = [p.mean_square_error for p in solve(problem, make, iterations=8, history=True).history]
    assert all(after <= before for before, after in pairwise(errors))


def test_a_step_is_the_least_squares_solution_of_a_layer():
    """Against dense least squares, where the box does not bind."""
    torch.manual_seed(0)
    many = display(subframes=2, disparity=(1.0, 0.0), views=(1, 9))
    problem = pose(LightField(torch.rand(9, 1, 2, 3, dtype=torch.float64), (1, 9)), many)
    problem = replace(problem, bounds=(-1e3, 1e3))
    layers = torch.rand(problem.layer_shape, dtype=torch.float64)
    for _ in range(300):
        layers[:, 0] = best_layer(problem, layers, 0)
    unknowns = layers[:, 0].numel()
    columns = []
    for n in range(unknowns):
        unit = layers.clone()
        unit[:, 0] = torch.eye(unknowns, dtype=torch.float64)[n].reshape(layers[:, 0].shape)
        columns.append(many(unit).flatten())
    matrix, target = torch.stack(columns, 1).numpy(), problem.target.flatten().numpy()
    best = np.linalg.lstsq(matrix, target)[0]  # in double precision, of any rank
    dense = np.square(matrix @ best - target).mean()
    assert problem.mean_square_error(layers) == pytest.approx(dense, rel=1e-3)


def test_networks_and_sums_have_no_subframes(scene):
    with pytest.raises(ValueError, match="2 subframes of 3 layers"):
        synthesize(scene, display(subframes=2), method="unet")
    with pytest.raises(ValueError, match="a mean of sums is a sum"):
        display("additive")
    with pytest.raises(ValueError, match="'tone' encodes what one subframe shows"):
        synthesize(scene, display(), method="tone")


def test_the_reference_has_them_too(scene, quick_references):
    row = evaluate([scene], [display(subframes=2)], [("fourier-admm", 3)])[0]
    assert row.reference is not None
    assert row.reference.psnr >= row.figures.psnr - 0.01
    assert len(row.figures.layers) == 3


def test_files_of_subframes_go_there_and_back(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_views(Path("views"), scene.views, display(), 16)
    Path("d.toml").write_text(format_spec(display(subframes=2).spec))
    options = ["--display", "d.toml", "--bits", "16", "--iterations", "3", "--simulate"]
    assert run("synth", "views", *options, "--out", "out").status == 0
    written = sorted(str(p.relative_to("out")) for p in Path("out/layers").rglob("*.png"))
    assert written == [f"layers/subframe_{s}/layer_{k}.png" for s in range(2) for k in range(3)]
    assert read_layers("out").shape[:2] == (2, 3)
    facts = json.loads(Path("out/result.json").read_text())
    assert facts["subframes"] == 2
    assert run("simulate", "out", "--out", "seen", "--bits", "16").status == 0
    for view in Path("out/views").iterdir():
        assert view.read_bytes() == (Path("seen/views") / view.name).read_bytes()
    Path("out/layers/subframe_1/layer_2.png").unlink()
    done = run("simulate", "out", "--out", "again")
    assert done.status == 2
    assert "found 2 pictures in out/layers/subframe_1, 3 in out/layers/subframe_0" in done.err
    done = run("simulate", "out/layers/subframe_0", "--display", "d.toml", "--out", "again")
    assert done.status == 2
    assert "found 1 subframes, display 'display' has 2" in done.err


@pytest.mark.parametrize("value", ["0", "65", "1.5", '"3"'])
def test_a_wrong_number_of_subframes_is_one_line(tmp_path, monkeypatch, value):
    monkeypatch.chdir(tmp_path)
    text = format_spec(display().spec).replace("subframes = 3", f"subframes = {value}")
    Path("d.toml").write_text(text)
    done = run("synth", "views", "--display", "d.toml", "--out", "x")
    assert done.status == 2
    assert "'subframes'" in done.err
    assert len(done.err.strip().splitlines()) == 1
