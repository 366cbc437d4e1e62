"""Light fields written in other forms: quilts, atlases, arrays, folders."""

from pathlib import Path

import numpy as np
import pytest
import torch
from test_cli import contents, fails, run, succeed

from layerfield import FieldOptions, LightField, load_light_field
from layerfield.io.forms import FORMS, form_of, write_light_field
from layerfield.io.options import Quilt
from layerfield.io.quilt import (
    atlas_of_views,
    nearly_square,
    quilt_in_name,
    quilt_of_views,
    views_of_atlas,
    views_of_quilt,
    with_quilt_in_name,
)


def test_quilts_run_from_the_bottom_left_and_atlases_from_the_top():
    views = np.random.default_rng(0).integers(0, 256, (2, 3, 4, 5, 3), dtype=np.uint8)
    quilt, atlas = quilt_of_views(views), atlas_of_views(views)
    assert quilt.shape == atlas.shape == (8, 15, 3)
    np.testing.assert_array_equal(quilt[4:, :5], views[0, 0])
    np.testing.assert_array_equal(quilt[:4, 10:], views[1, 2])
    np.testing.assert_array_equal(atlas[:4, 10:], views[0, 2])
    np.testing.assert_array_equal(views_of_quilt(quilt, 3, 2), views)
    np.testing.assert_array_equal(views_of_atlas(atlas, 3, 2), views)
    with pytest.raises(ValueError, match="quilt is 15x8 px, which 4 columns and 2 rows"):
        views_of_quilt(quilt, 4, 2)


def test_names_of_quilts_tell_their_layout():
    path = Path("some/where.v2.png")
    for quilt in (Quilt(8, 6, 0.75), Quilt(5, 9, 1.7778), Quilt(3, 1)):
        assert quilt_in_name(with_quilt_in_name(path, quilt)) == quilt
    assert quilt_in_name(Path("go_qs5x9a1.77z1.2f0.0.jpg")) == Quilt(5, 9, 1.77)
    assert quilt_in_name(path) is None


@pytest.mark.parametrize(
    ("count", "size", "columns"),
    [(48, (560, 420), 8), (45, (455, 819), 5), (25, (30, 40), 5), (7, (30, 40), 1), (1, (9, 9), 1)],
)
def test_layouts_are_nearly_square(count: int, size: tuple[int, int], columns: int):
    quilt = nearly_square(count, size)
    assert (quilt.columns, quilt.columns * quilt.rows) == (columns, count)


def field(grid: tuple[int, int], dtype: str = "uint8", channels: int = 3) -> LightField:
    values = np.random.default_rng(1).random((grid[0] * grid[1], channels, 12, 16), np.float32)
    whole = dtype != "float32"
    stored = (values * np.iinfo(dtype).max if whole else values).astype(dtype)
    return LightField(torch.from_numpy(stored), grid, "f", bits=8 * stored.itemsize * whole or None)


WRITTEN = [
    ("folder", (2, 3), {}),
    ("folder.h5py", (2, 3), {}),
    ("line_qs2x2a1.33.png", (1, 4), {}),
    ("line.png", (1, 4), {}),
    ("atlas.png", (2, 3), {"grid": "2x3"}),
    ("array.npy", (2, 3), {}),
    ("array.h5", (2, 3), {}),
]


@pytest.mark.parametrize(("name", "grid", "how"), WRITTEN)
@pytest.mark.parametrize(("dtype", "channels"), [("uint8", 3), ("uint16", 1), ("float32", 3)])
def test_what_is_written_is_read_again(
    tmp_path: Path, name: str, grid: tuple[int, int], how: dict[str, str], dtype: str, channels: int
):
    """Bit for bit; floats become 16 bits where pictures are written."""
    given = field(grid, dtype, channels)
    asked = {"line.png": "quilt", "atlas.png": "atlas", "folder.h5py": "folder"}.get(name)
    form = form_of(Path(name), asked)
    path = write_light_field(tmp_path / name, given, form, facts={})
    found = load_light_field(path, FieldOptions.parse(**how))
    assert (found.grid, found.notes) == (grid, ())
    if dtype == "float32" and form.pictures:
        assert found.bits == 16
        assert (found.views - given.views).abs().max() <= 0.51 / 65535
    else:
        assert found.bits == given.bits
        assert torch.equal(found.stored, given.stored)
    if name == "line.png":
        assert path.name == "line_qs2x2a1.3333.png"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with views and a result for them."""
    folder = tmp_path_factory.mktemp("made")
    write_light_field(folder / "views", field((3, 3)), FORMS["folder"], facts={})
    (folder / "d.toml").write_text('link = "additive"\ndisparity = [1, 0]\nviews = [3, 3]\n')
    (folder / "listed.toml").write_text(
        'link = "additive"\ndisparity = [1, 0]\nviewpoints = [[-1, 0], [1, 0]]\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        succeed("synth", "views", "--display", "d.toml", "--out", "result")
        succeed("convert", "views", "--views", "1x2", "--out", "two")
        succeed("synth", "two", "--display", "listed.toml", "--out", "listed")
        succeed("simulate", "result", "--out", "seen")
    return folder


@pytest.fixture
def here(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(made)
    return made


def test_convert_takes_a_part_and_says_where_it_is(here: Path):
    said = succeed("convert", "views", "--views", "1x3", "--out", "row_qs3x1.png")
    assert (
        said == "3 views of 16x12 px, from the bottom left, left to right, are in row_qs3x1.png\n"
    )
    row, all_ = load_light_field("row_qs3x1.png"), load_light_field("views")
    assert torch.equal(row.stored, all_.stored[3:6])
    said = succeed("convert", "views", "--out", "all.png", "--as", "atlas", "--bits", "16")
    assert "read it with --grid 3x3" in said
    deep = load_light_field("all.png", FieldOptions(grid=(3, 3)))
    assert torch.equal(deep.views, all_.views)


def test_a_result_becomes_a_quilt_of_eyes_from_left_to_right(here: Path):
    succeed("convert", "result", "--out", "eyes_qs5x1.png")
    eyes = [word for x in (-1, -0.5, 0, 0.5, 1) for word in ("--eye", f"{x},0")]
    succeed("simulate", "result", *eyes, "--out", "looked")
    looked = load_light_field("looked/views", FieldOptions(grid=(1, 5)))
    assert torch.equal(load_light_field("eyes_qs5x1.png").stored, looked.stored)
    assert "result_qs1x3a1.3333.png" in succeed(
        "convert", "result", "--as", "quilt", "--out", "result.png"
    )


def test_a_result_and_what_simulate_wrote_become_the_same_views(here: Path):
    succeed("convert", "result", "--out", "shown")
    succeed("convert", "seen", "--out", "shown.npy")
    shown = load_light_field("shown")
    assert torch.equal(shown.stored, load_light_field("shown.npy").stored)
    assert shown.grid == (3, 3)
    succeed("convert", "views", "--out", "shown", "--force")
    assert torch.equal(load_light_field("shown").stored, load_light_field("views").stored)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["views", "--out", "a.png"], ("an atlas or a quilt", "--as")),
        (["views", "--out", "a.jpg"], ("ends in .jpg", ".png")),
        (["views", "--out", "a_qs3x3.jpg"], ("written as quilt", ".png")),
        (["views", "--out", "a_qs3x3.png"], ("3x3 views", "one row", "--views 1x3")),
        (["views", "--views", "1x3", "--out", "a_qs2x2.png"], ("2x2 views", "has 3", "_qs1x3")),
        (["views", "--views", "1x3", "--out", "a_qs3x1a0.75.png"], ("aspect is 0.75", "1.333")),
        (["views", "--views", "1x3", "--out", "a_qs3x0.png"], ("quilt is '3x0'",)),
        (["views", "--out", "a_qs3x3.png", "--as", "atlas"], ("name of a quilt", "atlas")),
        (["views", "--out", "a.png", "--as", "folder"], ("written as folder", "no ending")),
        (["views", "--out", "a.png", "--as", "qilt"], ("did you mean 'quilt'",)),
        (["views", "--out", "a", "--bits", "12"], ("12 bits",)),
        (["views", "--out", "views", "--force"], ("among the input views",)),
        (["views", "--out", "views/a.png", "--as", "atlas"], ("among the input",)),
        (["result", "--out", "result/layers/a.png", "--as", "atlas"], ("among the input",)),
        (["result", "--out", "a", "--views", "1x3"], ("is a result", "--views")),
        (["result", "--out", "a_qs9999x9.png"], ("89991 eyes", "at most 1000")),
        (["listed", "--out", "a_qs2x2.png"], ("are a list", "grid")),
        (["nothing", "--out", "a"], ("no file or folder nothing",)),
        (["views", "--out", "two"], ("two exists",)),
        (["views", "--out", "none/a.npy"], ("none does not exist",)),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(
    here: Path, args: list[str], words: tuple[str, ...]
):
    before = contents(here)
    fails(run("convert", *args), *words)
    assert contents(here) == before
