"""Who looks from where: weights of views through the command line."""

import json
from pathlib import Path

import pytest
from test_cli import run

from layerfield import Display, procedural_light_field
from layerfield.result import write_views


@pytest.fixture
def desk(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    field = procedural_light_field(size=(40, 48), disparity_range=(-2, 2), seed=3)
    write_views(tmp_path / "views", field.views, Display.load("additive-3"), 8)
    Path("left.csv").write_text("1,0.5,0,0,0\n" * 5)
    return tmp_path


@pytest.mark.parametrize("method", ["fourier-admm", "sweeps", "nmf", "gradient"])
@pytest.mark.parametrize("observers", ["central:0.7", "left.csv"])
def test_views_that_count_more_are_shown_better(desk, method, observers):
    facts = {}
    for name, more in (("even", []), ("own", ["--observers", observers])):
        options = ["--display", "additive-3", "--method", method, *more]
        done = run("synth", "views", *options, "--out", name)
        assert done.status == 0, done.err
        facts[name] = json.loads(Path(name, "result.json").read_text())
        assert ("as observers count" in done.out) == (name == "own")
    assert "psnr_observers" not in facts["even"]
    assert facts["own"]["psnr_observers"] > facts["even"]["psnr"] + 1
    assert facts["own"]["field"]["options"]["observers"] == observers


@pytest.mark.parametrize(
    ("observers", "words"),
    [
        ("centre", "there is no such file; expected central"),
        ("central:0", "STEPS above 0"),
        ("central:wide", "STEPS above 0"),
        ("short.csv", "holds 4 lines of 5 numbers, expected 5x5"),
        ("words.csv", "expected 5x5 numbers, at least 0"),
        ("nobody.csv", "not all 0"),
        ("views", "cannot read observers from views"),
    ],
)
def test_wrong_observers_are_one_line(desk, observers, words):
    Path("short.csv").write_text("1,1,1,1,1\n" * 4)
    Path("words.csv").write_text("1,1,x,1,1\n" * 5)
    Path("nobody.csv").write_text("0,0,0,0,0\n" * 5)
    done = run("synth", "views", "--display", "additive-3", "--observers", observers, "--out", "o")
    assert done.status == 2
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not Path("o").exists()


def test_networks_take_no_observers(desk):
    options = ["--display", "additive-3", "--method", "unet", "--observers", "central"]
    done = run("synth", "views", *options, "--out", "o")
    assert done.status == 2
    assert "takes no view weights" in done.err
