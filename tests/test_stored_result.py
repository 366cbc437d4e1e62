"""Results read back: what the viewer and the report start from."""

import json

import pytest
import torch

from layerfield import Display, procedural_light_field, synthesize
from layerfield.metrics import psnr_by_view
from layerfield.result import make_result, write_result
from layerfield.stored_result import open_result


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    field = procedural_light_field(size=(24, 32), seed=3)
    display = Display.load("multiplicative-3")
    solution = synthesize(field, display, iterations=2)
    result = make_result(field, display, solution, method="fourier-admm", bits=16)
    folder = tmp_path_factory.mktemp("made") / "out"
    write_result(folder, result, targets=field)
    return field, folder


def test_a_result_opens_with_what_it_shows_and_should_show(made):
    field, folder = made
    found = open_result(folder)
    assert (found.name, found.display.name, found.view_size) == (
        "out",
        "multiplicative-3",
        (24, 32),
    )
    assert found.targets is not None
    assert (found.targets - field.views).abs().max() <= 1 / 65535
    expected = psnr_by_view(found.views(), field.views)
    assert found.facts["psnr_by_view"] == pytest.approx(expected, abs=1e-3)


def test_plain_layers_open_with_a_display(made, tmp_path):
    _, folder = made
    with pytest.raises(ValueError, match=r"holds no display.toml; say which"):
        open_result(folder / "layers")
    found = open_result(folder / "layers", display=Display.load("multiplicative-3"))
    assert (found.facts, found.targets) == ({}, None)
    assert torch.equal(found.layers, open_result(folder).layers)


def test_another_light_field_is_refused(made):
    _, folder = made
    other = procedural_light_field(size=(20, 32), seed=3)
    with pytest.raises(ValueError, match="shows 25 views of 32x24 px in colour, the light field"):
        open_result(folder, other)


@pytest.mark.parametrize("text", ["[]", "{", "[" * 100_000])
def test_facts_that_are_none_are_refused(made, tmp_path, text):
    _, folder = made
    (tmp_path / "layers").symlink_to(folder / "layers")
    (tmp_path / "display.toml").write_text((folder / "display.toml").read_text())
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ValueError, match=r"result\.json (is not what synth|holds no margin)"):
        open_result(tmp_path)


def test_every_view_has_its_figure_in_json(made):
    facts = json.loads((made[1] / "result.json").read_text())
    assert len(facts["psnr_by_view"]) == 25
    assert max(facts["psnr_by_view"]) == facts["psnr_view_max"]
