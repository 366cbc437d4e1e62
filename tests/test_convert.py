"""Light fields written in other forms: quilts and atlases."""

from pathlib import Path

import numpy as np
import pytest

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
