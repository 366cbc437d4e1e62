"""Readers, picture files and safe output: what comes in is right, or one line says why not."""

import os
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from layerfield.io import (
    FieldOptions,
    Order,
    contact_sheet,
    load_light_field,
    read_image,
    write_png,
)
from layerfield.io.readers import READERS
from layerfield.io.stored import Reader
from layerfield.light_field import LightField

parse = FieldOptions.parse
FIELDS = Path(
    os.environ.get("LAYERFIELD_FIELDS", Path(__file__).parents[2] / "shared" / "lightfields")
)
needs_fields = pytest.mark.skipif(
    not FIELDS.is_dir(), reason=f"no light fields in {FIELDS} (set LAYERFIELD_FIELDS)"
)
fuzz = settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def pictures(rows=2, columns=3, size=(8, 10), seed=0):
    """Return random views [rows, columns, y, x, 3]."""
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (rows, columns, *size, 3), dtype=np.uint8)


def save_folder(folder, views, name="view_{:02}_{:02}.png"):
    folder.mkdir(exist_ok=True)
    for row, line in enumerate(views):
        for column, view in enumerate(line):
            Image.fromarray(view).save(folder / name.format(row, column))
    return folder


def as_field(views):
    tensor = torch.from_numpy(views.astype(np.float32) / np.float32(255))
    return tensor.flatten(0, 1).movedim(-1, 1)


def refuses(path, *parts, **options):
    with pytest.raises(ValueError) as caught:
        load_light_field(path, parse(**options))
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message, message


@pytest.fixture
def folder(tmp_path):
    return save_folder(tmp_path / "scene", pictures())


# Folders of views


def test_folder_with_rows_and_columns(folder):
    (folder / "SOURCE.txt").write_text("from here")
    (folder / "depthmaps").mkdir()
    field = load_light_field(folder)
    assert field.grid == (2, 3)
    assert field.name == "scene"
    assert field.views.dtype == torch.float32
    assert torch.equal(field.views, as_field(pictures()))


@pytest.mark.parametrize(
    "name",
    [
        "{:d}_{:d}.png",
        "translucent_{:02}_{:02}.png",
        "scene 7_{:02}_{:02}.bmp",
        "out_{:02}_{:02}_-381.909271_1103.376221_.png",
        "out_{:02}_{:02}_-381.909271_1103.376221.png",
    ],
)
def test_names_with_rows_and_columns(tmp_path, name):
    field = load_light_field(save_folder(tmp_path / "s", pictures(3, 2), name))
    assert field.grid == (3, 2)
    assert torch.equal(field.views, as_field(pictures(3, 2)))


def test_names_that_count_in_steps(tmp_path):
    for row in (1, 3):
        for column in (1, 3, 5):
            Image.fromarray(pictures()[0, 0]).save(tmp_path / f"v_{row}_{column}.png")
    field = load_light_field(tmp_path)
    assert field.grid == (2, 3)
    assert "steps of 2" in field.notes[0]


@pytest.mark.parametrize("first", [0, 1])
def test_numbered_row_by_row(tmp_path, first):
    views = pictures(3, 3).reshape(9, 8, 10, 3)
    for number, view in enumerate(views):
        Image.fromarray(view).save(tmp_path / f"input_Cam{number + first:03}.png")
    Image.fromarray(views[0]).save(tmp_path / "mask_highres.png")
    field = load_light_field(tmp_path)
    assert torch.equal(field.views, as_field(pictures(3, 3)))
    assert field.notes == ("1 pictures with other names were ignored",)
    (tmp_path / f"input_Cam{4 + first:03}.png").unlink()
    refuses(tmp_path, "lacks 1 of the 3x3 views", f"Cam{4 + first:03}")


def test_sorted_by_number_with_a_grid(tmp_path):
    views = pictures(3, 4)
    for number, view in enumerate(views.reshape(12, 8, 10, 3)):
        Image.fromarray(view).save(tmp_path / f"{number}.png")
    assert torch.equal(load_light_field(tmp_path, parse(grid="3x4")).views, as_field(views))
    refuses(tmp_path, "12 views", "grid 1x12")
    refuses(tmp_path, "12 views", "needs 25", grid="5x5")


@pytest.mark.parametrize("text", ["tl-row", "tr-row", "bl-row", "br-row"])
def test_order_flips(folder, text):
    views = pictures()
    flipped = views[::-1] if text[0] == "b" else views
    flipped = flipped[:, ::-1] if text[1] == "r" else flipped
    field = load_light_field(folder, parse(order=text))
    assert torch.equal(field.views, as_field(flipped))
    columns = load_light_field(folder, parse(order=text.replace("row", "column")))
    turned = views.transpose(1, 0, 2, 3, 4)
    turned = turned[::-1] if text[0] == "b" else turned
    turned = turned[:, ::-1] if text[1] == "r" else turned
    assert columns.grid == (3, 2)
    assert torch.equal(columns.views, as_field(turned))
    assert str(Order.parse(text)) == text


def test_grid_of_named_files_must_fit(folder):
    assert load_light_field(folder, parse(grid="2x3")).grid == (2, 3)
    refuses(folder, "holds 2x3 views", "3x3", grid="3x3")


def test_one_named_line_may_be_laid_out(tmp_path):
    save_folder(tmp_path / "s", pictures(1, 6))
    assert load_light_field(tmp_path / "s", parse(grid="2x3")).grid == (2, 3)


def test_errors_of_folders(tmp_path, folder):
    refuses(tmp_path / "nowhere", "there is no file or folder", "nowhere")
    refuses("\0", "there is no file or folder")
    (tmp_path / "empty").mkdir()
    refuses(tmp_path / "empty", "found no pictures", "png")
    refuses(folder, "quilt is for one picture", quilt="2x3")
    Image.fromarray(pictures()[0, 0]).save(folder / "other_01_02.png")
    refuses(folder, "two files for one view", "other_01_02.png", "view_01_02.png")
    (folder / "other_01_02.png").unlink()
    Image.fromarray(pictures()[0, 0][:5]).save(folder / "view_01_02.png")
    refuses(folder, "view_01_02.png is 10x5 px", "10x8")
    Image.fromarray(pictures()[0, 0][..., 0]).save(folder / "view_01_02.png")
    refuses(folder, "view_01_02.png is grey", "view_00_00.png is in colour")
    (folder / "view_01_02.png").write_text("no picture")
    refuses(folder, "view_01_02.png is not a picture")
    (folder / "view_01_02.png").unlink()
    refuses(folder, "lacks 1 of the 2x3 views (found 5)", "missing 01_02")


def test_unreadable_file(folder, monkeypatch):
    def forbid(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_bytes", forbid)
    refuses(folder, "cannot read", "Permission denied")


def test_only_chosen_views_are_decoded(folder):
    (folder / "view_01_02.png").write_text("no picture")
    field = load_light_field(folder, parse(views="1x1"))
    assert torch.equal(field.views, as_field(pictures()[:1, 1:2]))


# One picture


def test_atlas(tmp_path):
    views = pictures(2, 3)
    path = tmp_path / "atlas.png"
    Image.fromarray(np.vstack([np.hstack(list(line)) for line in views])).save(path)
    field = load_light_field(path, parse(grid="2x3"))
    assert torch.equal(field.views, as_field(views))
    assert field.name == "atlas"
    refuses(path, "one picture", "grid RxC", "quilt CxR", "lenslet PITCH")
    refuses(path, "30x16 px", "3x3 equal tiles do not divide", grid="3x3")
    refuses(path, "is 30x16 px", "lenslets of 4 px", lenslet=4)


def test_quilt_runs_from_the_bottom_left(tmp_path):
    views = pictures(2, 3)
    quilt = np.vstack([np.hstack(list(line)) for line in views[::-1]])
    for name, options in (("q.png", {"quilt": "3x2"}), ("scene_qs3x2a1.25.png", {})):
        Image.fromarray(quilt).save(tmp_path / name)
        field = load_light_field(tmp_path / name, parse(**options))
        assert field.grid == (1, 6)
        assert torch.equal(field.views, as_field(views))
        assert field.notes == ()
    left_over = load_light_field(tmp_path / "q.png", parse(quilt="4x2a0.75"))
    assert tuple(left_over.views.shape) == (8, 3, 8, 7)
    assert "left out" in left_over.notes[0]
    assert "aspect 0.75" in left_over.notes[1]
    refuses(tmp_path / "q.png", "too small", quilt="31x2")


def test_lenslets(tmp_path):
    views = pictures(4, 4, size=(3, 5))
    image = views.transpose(2, 0, 3, 1, 4).reshape(12, 20, 3)
    Image.fromarray(image).save(tmp_path / "l.png")
    field = load_light_field(tmp_path / "l.png", parse(lenslet="4"))
    assert torch.equal(field.views, as_field(views))


def test_unknown_kind(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    refuses(tmp_path / "a.txt", "of no kind that is known", ".npy")


# Arrays and HDF5


def test_arrays(tmp_path):
    views = pictures(2, 3)
    expected = as_field(views)
    listed = views.reshape(6, 8, 10, 3)
    cases = {
        "grid": (views, {}),
        "first": (np.moveaxis(views, -1, 2), {}),
        "floats": (views.astype(np.float64) / 255, {}),
        "listed": (listed, {"grid": "2x3"}),
        "listed_first": (np.moveaxis(listed, -1, 1), {"grid": "2x3"}),
        "alpha": (np.concatenate([views, views[..., :1]], -1), {}),
    }
    for name, (array, options) in cases.items():
        np.save(tmp_path / f"{name}.npy", array)
        field = load_light_field(tmp_path / f"{name}.npy", parse(**options))
        assert field.grid == (2, 3)
        torch.testing.assert_close(field.views, expected)
    assert "alpha" in load_light_field(tmp_path / "alpha.npy").notes[0]
    np.savez_compressed(tmp_path / "z.npz", views=views, other=np.zeros(3))
    assert torch.equal(load_light_field(tmp_path / "z.npz").views, expected)
    np.save(tmp_path / "grey.npy", (views[..., 0].astype(np.uint16) * 257))
    assert torch.equal(
        load_light_field(tmp_path / "grey.npy", parse(grid="2x3")).views, expected[:, :1]
    )


@pytest.mark.parametrize(
    ("array", "parts"),
    [
        (np.full((2, 2, 4, 4, 3), np.nan), ["not finite"]),
        (np.full((2, 2, 4, 4, 3), np.inf), ["not finite"]),
        (np.full((2, 2, 4, 4, 3), 255.0), ["255", "expected 0 to 1", "divide"]),
        (np.full((2, 2, 4, 4, 3), -0.5), ["-0.5"]),
        (np.zeros((2, 2, 4, 4, 3), np.int32), ["int32", "uint8"]),
        (np.zeros((2, 2, 5, 5, 7)), ["(2, 2, 5, 5, 7)", "expected"]),
        (np.zeros(5), ["(5,)"]),
        (np.zeros((0, 2, 4, 4, 3)), ["empty"]),
        (np.zeros((4, 5, 6, 3)), ["4 views", "grid 2x2"]),
        (np.array({"a": 1}), ["Python objects"]),
    ],
)
def test_errors_of_arrays(tmp_path, array, parts):
    np.save(tmp_path / "a.npy", array)
    refuses(tmp_path / "a.npy", *parts)


def test_errors_of_archives(tmp_path):
    np.savez(tmp_path / "two.npz", a=np.zeros(2), b=np.zeros(2))
    refuses(tmp_path / "two.npz", "2 arrays (a, b)")
    np.save(tmp_path / "a.npy", np.zeros((2, 2, 4, 4, 3)))
    (tmp_path / "b.npy").write_bytes((tmp_path / "a.npy").read_bytes()[:-9])
    refuses(tmp_path / "b.npy", "damaged")


def test_hdf5(tmp_path):
    views = pictures(2, 3)
    path = tmp_path / "old.h5"
    with h5py.File(path, "w") as file:
        file["LF"] = views
    assert torch.equal(load_light_field(path).views, as_field(views))
    (tmp_path / "cut.h5").write_bytes(path.read_bytes()[:600])
    refuses(tmp_path / "cut.h5", "damaged")
    with h5py.File(path, "w") as file:
        file["LF"] = views[0]
    refuses(path, "(3, 8, 10, 3)", "[rows, columns, y, x, channels]")
    with h5py.File(path, "w") as file:
        file["depth"] = views
    refuses(path, "no dataset /LF (found depth)")


# Which part to take


def numbered(tmp_path, rows, columns, size=(5, 5)):
    values = np.arange(rows * columns, dtype=np.uint8).reshape(rows, columns, 1, 1)
    np.save(tmp_path / "n.npy", np.broadcast_to(values, (rows, columns, *size)))
    return tmp_path / "n.npy"


def taken(path, **options):
    field = load_light_field(path, parse(**options))
    return field.grid, (field.views[:, 0, 0, 0] * 255).round().int().tolist()


def test_step_and_views(tmp_path):
    path = numbered(tmp_path, 9, 9)
    assert taken(path, step=4) == ((3, 3), [0, 4, 8, 36, 40, 44, 72, 76, 80])
    assert taken(path, step=3) == ((3, 3), [10, 13, 16, 37, 40, 43, 64, 67, 70])
    assert taken(path, views="1x3") == ((1, 3), [39, 40, 41])
    assert taken(path, views="3x1", step=2) == ((3, 1), [22, 40, 58])
    refuses(path, "step is 9", "9x9", step=9)
    refuses(path, "views is 7x5", "5x5 views after step 2", views="7x5", step=2)


def test_horizontal_only(tmp_path):
    path = numbered(tmp_path, 1, 7)
    assert taken(path, views="1x5") == ((1, 5), [1, 2, 3, 4, 5])
    assert taken(path, step=2) == ((1, 4), [0, 2, 4, 6])
    refuses(path, "views is 5x5", "1x7", views="5x5")


def moving(count, disparity, size=24):
    """Return a [count, count] field of one plane of the given disparity."""
    x = np.arange(size)
    steps = np.arange(count) - (count - 1) / 2
    wave = np.array([0.5 + 0.4 * np.sin((x + disparity * s) * 0.7) for s in steps])
    return (wave[:, None, :, None] * wave[None, :, None, :]).astype(np.float64)


@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("shift", [2, -1])
def test_whole_shift_removes_disparity_exactly(tmp_path, count, shift):
    np.save(tmp_path / "m.npy", moving(count, shift))
    field = load_light_field(tmp_path / "m.npy", parse(grid=f"{count}x{count}", shift=shift))
    assert field.size == (24 - abs(shift) * (count - 1),) * 2
    torch.testing.assert_close(field.views, field.views[:1].expand_as(field.views))


def test_whole_shift_copies(tmp_path):
    views = pictures(1, 3, size=(6, 20))
    np.save(tmp_path / "m.npy", views)
    field = load_light_field(tmp_path / "m.npy", parse(shift=2))
    expected = as_field(np.stack([views[0, i, :, 4 - 2 * i : 20 - 2 * i] for i in range(3)])[None])
    assert torch.equal(field.views, expected)


def test_fractional_shift(tmp_path):
    np.save(tmp_path / "m.npy", moving(5, 1.25, size=40))
    left = load_light_field(tmp_path / "m.npy", parse(shift=0.5))
    np.save(tmp_path / "w.npy", moving(5, 0.75, size=40))
    expected = load_light_field(tmp_path / "w.npy").views[..., 1:-1, 1:-1]
    assert left.size == (38, 38)
    torch.testing.assert_close(
        left.views[..., 1:-1, 1:-1], expected[..., 1:-1, 1:-1], atol=2e-2, rtol=0
    )
    refuses(tmp_path / "m.npy", "shift is 30 px", shift=30)


def test_scale_and_crop(tmp_path):
    views = pictures(2, 2, size=(8, 12))
    np.save(tmp_path / "m.npy", views)
    assert load_light_field(tmp_path / "m.npy", parse(scale=0.5)).size == (4, 6)
    assert load_light_field(tmp_path / "m.npy", parse(scale="2", crop="10x9")).size == (9, 10)
    central = load_light_field(tmp_path / "m.npy", parse(crop="4x2")).views
    assert torch.equal(central, as_field(views[:, :, 3:5, 4:8]))
    placed = load_light_field(tmp_path / "m.npy", parse(crop="4x2+8+0")).views
    assert torch.equal(placed, as_field(views[:, :, 0:2, 8:12]))
    refuses(tmp_path / "m.npy", "crop is 13x2", "12x8 px", crop="13x2")
    refuses(tmp_path / "m.npy", "crop is 4x2 at 9,0", crop="4x2+9+0")


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("grid", "5"), ("grid", "0x5"), ("grid", "5x"), ("views", "axb"), ("views", "-1x3"),
        ("order", "tl"), ("order", "row-tl"), ("step", "0"), ("step", "1.5"), ("step", "-1"),
        ("shift", "far"), ("shift", "nan"), ("shift", "inf"), ("scale", "0"), ("scale", "-1"),
        ("scale", "nan"), ("scale", "1e9"), ("crop", "5"), ("crop", "0x4"), ("crop", "4x4+1"),
        ("quilt", "4"), ("quilt", "0x8"), ("quilt", "4x8a"), ("lenslet", "0"), ("lenslet", "x"),
    ],
)  # fmt: skip
def test_wrong_options(option, text):
    with pytest.raises(ValueError, match=f"^{option} is .*expected") as caught:
        parse(**{option: text})
    assert "\n" not in str(caught.value)


def test_quilt_and_lenslet_exclude_each_other():
    with pytest.raises(ValueError, match="both quilt and lenslet"):
        parse(quilt="2x2", lenslet=3)


def test_a_reader_is_one_entry():
    assert all(isinstance(reader, Reader) for reader in READERS)


# Pictures


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
def test_png_round_trip(tmp_path, dtype, channels):
    top = np.iinfo(dtype).max
    pixels = np.random.default_rng(0).integers(0, top + 1, (channels, 5, 7)).astype(dtype)
    write_png(tmp_path / "a.png", pixels)
    write_png(tmp_path / "b.png", torch.from_numpy(pixels))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    back = read_image(tmp_path / "a.png")
    assert back.dtype == np.float32
    assert np.array_equal(np.rint(back.astype(np.float64) * top).astype(dtype), pixels)
    if dtype == np.uint8 and channels == 3:  # another program sees the same colours
        seen = np.asarray(Image.open(tmp_path / "a.png"))
        assert np.array_equal(np.moveaxis(seen, -1, 0), pixels)


@pytest.mark.parametrize(
    "pixels",
    [np.zeros((3, 4, 4), np.float32), np.zeros((2, 4, 4), np.uint8), np.zeros((4, 4), np.uint8)],
)
def test_png_refuses(tmp_path, pixels):
    with pytest.raises(ValueError, match="expected"):
        write_png(tmp_path / "a.png", pixels)
    with pytest.raises(ValueError, match="cannot write"):
        write_png(tmp_path / "none" / "a.png", np.zeros((1, 2, 2), np.uint8))


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".webp", ".jpg"])
def test_kinds_of_pictures(tmp_path, suffix):
    pixels = np.full((6, 9, 3), (200, 100, 50), np.uint8)
    Image.fromarray(pixels).save(tmp_path / f"a{suffix}")
    seen = read_image(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(seen, np.moveaxis(pixels, -1, 0) / 255, atol=0.03)


def test_sixteen_bit_tiff_and_alpha(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 65536, (5, 7, 4)).astype(np.uint16)
    red_first = np.moveaxis(pixels[..., 2::-1], -1, 0) / 65535
    for name, stored in (("a.tif", pixels[..., :3]), ("a.png", pixels)):
        cv2.imwrite(str(tmp_path / name), stored)
        np.testing.assert_allclose(read_image(tmp_path / name), red_first, atol=1e-6)
    cv2.imwrite(str(tmp_path / "g.tif"), pixels[..., 0])
    np.testing.assert_allclose(read_image(tmp_path / "g.tif")[0], pixels[..., 0] / 65535, atol=1e-6)


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGBA", "CMYK"])
def test_modes(tmp_path, mode):
    suffix = ".tif" if mode == "CMYK" else ".png"
    Image.fromarray(pictures()[0, 0]).convert(mode).save(tmp_path / f"a{suffix}")
    assert read_image(tmp_path / f"a{suffix}").shape[0] == (1 if mode in ("1", "L", "LA") else 3)


def test_alpha_is_noted(tmp_path):
    views = np.concatenate([pictures(), pictures()[..., :1]], -1)
    field = load_light_field(save_folder(tmp_path / "s", views))
    assert field.notes == ("the alpha channel was dropped",)
    assert torch.equal(field.views, as_field(pictures()))


def test_animations_and_bombs_are_refused(tmp_path, monkeypatch):
    frames = [Image.fromarray(view) for view in pictures()[0]]
    frames[0].save(tmp_path / "a.png", save_all=True, append_images=frames[1:])
    with pytest.raises(ValueError, match="3 pictures in one file"):
        read_image(tmp_path / "a.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 30)
    frames[0].save(tmp_path / "b.png")
    with pytest.raises(ValueError, match="million pixels"):
        read_image(tmp_path / "b.png")


def sample_file(folder, suffix):
    path = folder / f"whole{suffix}"
    if suffix == ".npy":
        np.save(path, pictures())
    elif suffix == ".npz":
        np.savez_compressed(path, views=pictures())
    elif suffix == ".h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("LF", data=pictures(), compression="gzip")
    elif suffix == ".16.png":
        write_png(path, np.random.default_rng(0).integers(0, 65536, (3, 16, 30)).astype(np.uint16))
    else:
        Image.fromarray(pictures(1, 1, (16, 30))[0, 0]).save(path)
    return path.read_bytes()


SUFFIXES = [".png", ".16.png", ".jpg", ".tif", ".webp", ".bmp", ".npy", ".npz", ".h5"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(data=st.data())
@fuzz
def test_damaged_files_only_raise_value_errors(tmp_path, suffix, data):
    whole = bytearray(sample_file(tmp_path, suffix))
    cut = data.draw(st.integers(0, len(whole)))
    places = st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), max_size=6)
    for place, value in data.draw(places):
        whole[place] = value
    (tmp_path / f"x{suffix}").write_bytes(whole[:cut])
    only_value_errors(tmp_path / f"x{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(junk=st.binary(max_size=300))
@fuzz
def test_random_bytes_only_raise_value_errors(tmp_path, suffix, junk):
    (tmp_path / f"x{suffix}").write_bytes(junk)
    only_value_errors(tmp_path / f"x{suffix}")


def only_value_errors(path):
    try:
        field = load_light_field(path, parse(grid="2x3"))
    except ValueError as error:
        assert "\n" not in str(error)
    else:
        assert bool(torch.isfinite(field.views).all())


@pytest.mark.parametrize(
    "suffix", [".png", ".16.png", ".jpg", ".tif", ".webp", ".npy", ".npz", ".h5"]
)
@pytest.mark.parametrize("part", [0.5, 0.9])
def test_truncated_files_are_errors(tmp_path, suffix, part):
    whole = sample_file(tmp_path, suffix)
    (tmp_path / f"x{suffix}").write_bytes(whole[: int(part * len(whole))])
    refuses(tmp_path / f"x{suffix}", grid="2x3")


@given(text=st.text(max_size=12))
@settings(max_examples=100, deadline=None)
def test_options_only_raise_value_errors(text):
    for option in ("grid", "order", "views", "step", "shift", "scale", "crop", "quilt", "lenslet"):
        try:
            parse(**{option: text})
        except ValueError as error:
            assert "\n" not in str(error) or "\n" in text


# Contact sheet


@pytest.mark.parametrize("grid", [(3, 4), (1, 25), (40, 40), (1, 1)])
def test_contact_sheet(grid):
    field = LightField(torch.rand(grid[0] * grid[1], 1, 30, 40), grid)
    sheet = contact_sheet(field, max_width=800)
    assert sheet.mode == "RGB"
    assert sheet.width <= 800
    with pytest.raises(ValueError, match="max_width"):
        contact_sheet(field, max_width=4)


# The shared light fields


@needs_fields
@pytest.mark.parametrize(
    ("name", "options", "grid", "size"),
    [
        ("toys_9x9", {"step": 2}, (5, 5), (400, 400)),
        ("lytro_translucent", {"views": "1x3"}, (1, 3), (430, 619)),
        ("snu_buildings", {"shift": 5, "views": "3x3"}, (3, 3), (390, 390)),
        ("stanford_cards", {"views": "1x2", "scale": 0.5}, (1, 2), (384, 384)),
        ("mpi_car_hpo", {"views": "1x3"}, (1, 3), (720, 960)),
        ("quilts/example01.png", {"quilt": "4x8"}, (1, 32), (256, 512)),
        ("formats/lenslet_20px_fluor.jpg", {"lenslet": 20}, (20, 20), (114, 170)),
    ],
)
def test_shared_fields(name, options, grid, size):
    field = load_light_field(FIELDS / name, parse(**options))
    assert field.grid == grid
    assert field.size == size


@needs_fields
def test_atlas_equals_folder():
    atlas = load_light_field(
        FIELDS / "formats" / "atlas_9x9_toys1.jpg", parse(grid="9x9", views="3x3")
    )
    assert torch.equal(atlas.views, load_light_field(FIELDS / "toys_9x9", parse(views="3x3")).views)


@needs_fields
def test_incomplete_folder_names_what_is_missing():
    refuses(FIELDS / "formats" / "hci_incomplete_cotton", "lacks 48", "found 33", "Cam001")
