"""Light fields of a picture with its depth map."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from test_cli import contents, fails, run, succeed

from layerfield import Display, load_light_field, psnr
from layerfield.disparity import estimate_disparity
from layerfield.geometry import Geometry, grid_points
from layerfield.io import read_image
from layerfield.rgbd.depth_maps import read_depth_map
from layerfield.rgbd.flat_picture import PictureWithDepth
from layerfield.rgbd.sheets import with_edges
from layerfield.scenes import random_scenes, render

GRID = Geometry(slopes=grid_points((3, 3)), depths=(1.0, -1.0), grid=(3, 3))


def views(picture: torch.Tensor, disparity: torch.Tensor, geometry: Geometry = GRID):
    return torch.stack(list(PictureWithDepth(picture, disparity, geometry).views()))


def noise(height: int = 20, width: int = 24) -> torch.Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("disparity", [2.0, -1.0])
def test_a_plane_that_faces_the_viewer_is_shifted_exactly(disparity: float):
    """Left in the next view to the right and up in the next view below, if it is near."""
    picture = noise()
    made = views(picture, torch.full((20, 24), disparity)).unflatten(0, (3, 3))
    d = int(disparity)
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            due = torch.roll(picture, (-row * d, -column * d), (1, 2))
            assert torch.equal(made[row + 1, column + 1, :, 2:-2, 2:-2], due[:, 2:-2, 2:-2])


def test_half_a_pixel_is_interpolated_linearly():
    picture = noise()
    found = views(picture, torch.full((20, 24), 0.5))[5]
    due = (picture[..., :-1] + picture[..., 1:]) / 2
    torch.testing.assert_close(found[..., :-1], due, atol=1e-6, rtol=0)


@pytest.fixture(scope="module")
def scene():
    """Picture, disparity and true views of a procedural scene."""
    made = random_scenes(1, size=(60, 80), seed=3, reach=1.5)
    return render(made, [(0.0, 0.0)])[0, 0], made.disparity_map[0], render(made, GRID.slopes)[0]


def test_the_eye_in_the_middle_sees_the_picture(scene):
    picture, disparity, _ = scene
    assert torch.equal(views(picture, disparity)[4], picture)


def test_views_are_near_the_true_ones(scene):
    picture, disparity, true = scene
    still = psnr(picture.expand_as(true), true)
    assert psnr(views(picture, disparity), true) > still + 7
    blurred = torch.from_numpy(cv2.GaussianBlur(disparity.numpy(), (0, 0), 1.0))
    assert psnr(views(picture, blurred), true) > still + 6


def test_eyes_at_different_distances():
    far = Geometry(
        slopes=((-0.05, 0.0), (0.04, 0.02)), depths=(0.01, -0.01), pitch=4e-4, distance=(0.2, 2.0)
    )
    made = random_scenes(1, size=(60, 80), disparity_range=(-25.0, 25.0), reach=0.1, seed=3)
    picture, disparity = render(made, [(0.0, 0.0)])[0, 0], made.disparity_map[0]
    true = render(made, far.slopes, far.approaches)[0]
    one = views(picture, disparity, dataclasses.replace(far, distance=0.36))
    assert psnr(views(picture, disparity, far), true) > psnr(one, true) + 2


def test_what_comes_into_view_is_background():
    """A blue square in front of red: as much blue as ever, where it is due, and red around it."""
    picture = torch.tensor([0.8, 0.0, 0.0])[:, None, None].repeat(1, 40, 48)
    picture[:, 12:28, 16:32] = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    disparity = torch.full((40, 48), -2.0)
    disparity[12:28, 16:32] = 3.0
    for view, (x, y) in zip(views(picture, disparity), GRID.slopes, strict=True):
        due = torch.roll(picture, (-3 * int(y), -3 * int(x)), (1, 2))
        torch.testing.assert_close(view, due, atol=1e-6, rtol=0)


def test_edges_leap_and_slopes_do_not():
    edge = torch.tensor([0.0, 0, 0, 0, 0.2, 0.5, 0.8, 1, 1, 1, 1]).repeat(9, 1)
    leap = with_edges(edge, 0.5)[4]
    assert sorted(set(leap.tolist())) == [0.0, 1.0]
    ramp = torch.linspace(0, 1, 40).repeat(9, 1)
    assert torch.equal(with_edges(ramp, 0.5), ramp)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, scene) -> Path:
    """A folder with a picture and its maps."""
    folder = tmp_path_factory.mktemp("rgbd")
    picture, disparity, _ = scene
    pixels = np.moveaxis(picture.numpy()[::-1], 0, -1)
    cv2.imwrite(str(folder / "photo.png"), (255 * pixels).round().astype(np.uint8))
    near = disparity.numpy()
    near = (near - near.min()) / np.ptp(near)
    cv2.imwrite(str(folder / "near.png"), (65535 * near).round().astype(np.uint16))
    cv2.imwrite(str(folder / "far.png"), (255 * (1 - near)).round().astype(np.uint8))
    np.save(folder / "distance.npy", 1 / (near + 0.25))
    cv2.imwrite(str(folder / "half.png"), (255 * near[::2, ::2]).round().astype(np.uint8))
    cv2.imwrite(str(folder / "wide.png"), (255 * near[:40]).round().astype(np.uint8))
    cv2.imwrite(str(folder / "even.png"), np.full((60, 80), 7, np.uint8))
    np.save(folder / "none.npy", np.full((60, 80), np.nan))
    np.save(folder / "deep.npy", near[None, None])
    np.save(folder / "words.npy", np.full((60, 80), "a"))
    (folder / "cut.npy").write_bytes((folder / "distance.npy").read_bytes()[:500])
    (folder / "map.exr").write_bytes(b"v/1\1")
    (folder / "flat.toml").write_text('link = "additive"\ndisparity = [0]\nviews = [3, 3]\n')
    return folder


def test_kinds_of_maps(made: Path):
    due, notes = read_depth_map(made / "near.png", "near-white", (60, 80))
    assert notes == ()
    assert (due.min(), due.max()) == (0, 1)
    inverted, _ = read_depth_map(made / "far.png", "near-black", (60, 80))
    np.testing.assert_allclose(inverted, due, atol=0.51 / 255)
    distances, _ = read_depth_map(made / "distance.npy", "depth", (60, 80))
    np.testing.assert_allclose(distances, due, atol=1e-4)
    half, notes = read_depth_map(made / "half.png", "near-white", (60, 80))
    assert "resized" in notes[0]
    np.testing.assert_allclose(half[::2, ::2], due[::2, ::2], atol=0.02)


def test_pixels_without_a_value_take_that_of_the_nearest(tmp_path: Path):
    distance = np.array([[1.0, 1, 1, 1], [2, 2, 2, 2]]).repeat(4, 0)
    distance[2, 1], distance[6, 2] = 0, np.nan
    np.save(tmp_path / "holes.npy", distance)
    found, notes = read_depth_map(tmp_path / "holes.npy", "depth", (8, 4))
    assert notes[0].startswith("6.2% of the depth map has no values")
    np.testing.assert_array_equal(found, np.array([[1.0], [0.0]]).repeat(4, 0).repeat(4, 1))


def test_info_finds_the_disparities_that_are_said(made: Path, monkeypatch: pytest.MonkeyPatch):
    """With the sign right, over the whole depth of the display; the middle view is the picture."""
    monkeypatch.chdir(made)
    said = succeed("rgbd", "photo.png", "near.png", "--display", "additive-3", "--out", "field")
    assert "approximation" in said
    assert "disparities are -1.00 to 1.00 px" in said
    field = load_light_field("field")
    assert (field.grid, field.size, field.bits) == ((5, 5), (60, 80), 8)
    found = estimate_disparity(field)
    assert found.agree is True
    assert found.horizontal == pytest.approx((-1, 1), abs=0.3)
    np.testing.assert_array_equal(read_image("field/view_02_02.png"), read_image("photo.png"))
    assert json.loads(Path("field/field.json").read_text())["disparities"] == [-1, 1]
    how = ["--display", "perspective-3", "--depth-mm", "6", "--width", "40", "--bits", "16"]
    said = succeed("rgbd", "photo.png", "near.png", *how, "--out", "field", "--force")
    assert load_light_field("field").size == (30, 40)
    step, reach = 2 * np.tan(np.radians(4)) / 4, 3e-3
    due = [step * z / (1 - z / 0.5) / 4e-4 for z in (-reach, reach)]
    assert f"disparities are {due[0]:.2f} to {due[1]:.2f} px" in said
    assert Display.load("field/display.toml").spec.name == "perspective-3"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["near.png", "near.png", "--map", "white"], ("unknown kind of map 'white'", "near-white")),
        (["photo.png", "photo.png"], ("photo.png is in colour", "grey")),
        (["photo.png", "wide.png"], ("80x40 px", "80x60", "same shape")),
        (["photo.png", "even.png"], ("one value only",)),
        (["photo.png", "none.npy"], ("no values",)),
        (["photo.png", "deep.npy"], ("shape (1, 1, 60, 80)", "[y, x]")),
        (["photo.png", "words.npy"], ("no numbers",)),
        (["photo.png", "cut.npy"], ("cut.npy", "damaged")),
        (["photo.png", "map.exr"], ("map.exr", "a picture or .npy")),
        (["photo.png", "nothing.png"], ("cannot read nothing.png",)),
        (["nothing.png", "near.png"], ("cannot read nothing.png",)),
        (["near.npy", "near.png"], ("near.npy",)),
        (["photo.png", "near.png", "--width", "4"], ("4x3 px", "--width")),
        (["photo.png", "near.png", "--bits", "9"], ("9 bits",)),
        (["photo.png", "near.png", "--depth-mm", "9"], ("--depth-px",)),
        (["photo.png", "near.png", "--depth-px", "-1"], ("depth is -1",)),
        (["photo.png", "near.png", "--display", "flat.toml"], ("no depth", "px of disparity")),
        (["photo.png", "near.png", "--out", "photo.png"], ("photo.png", "folder")),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(
    made: Path, monkeypatch: pytest.MonkeyPatch, args: list[str], words: tuple[str, ...]
):
    monkeypatch.chdir(made)
    before = contents(made)
    fails(run("rgbd", *args[:2], "--display", "additive-3", "--out", "out", *args[2:]), *words)
    assert contents(made) == before
