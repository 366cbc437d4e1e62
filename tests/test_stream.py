"""Video: a frame that starts from the one before is better than one that starts anew."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch

from layerfield import (
    DisparitySpec,
    Display,
    LightField,
    procedural_light_field,
    reference,
    synthesize,
    synthesize_frames,
)
from layerfield.motion import block_motion, moved
from layerfield.synthesizer import pose

SIZE = (48, 80)


def row_of_five(link: str) -> Display:
    return Display(DisparitySpec(link=link, disparity=(1.0, 0.0, -1.0), views=(1, 5)))  # pyright: ignore[reportArgumentType]


def pan(step: tuple[int, int], count: int, seed: int = 3) -> list[LightField]:
    """Crops of one wide light field, each `step` = (x, y) further."""
    x, y = step
    size = (SIZE[0] + count * y, SIZE[1] + count * x)
    whole = procedural_light_field(grid=(1, 5), size=size, seed=seed)
    return [
        replace(whole, views=whole.views[..., t * y : t * y + SIZE[0], t * x : t * x + SIZE[1]])
        for t in range(count)
    ]


def errors(fields: list[LightField], display: Display, **options) -> list[float]:
    solutions = synthesize_frames(fields, display, **options)
    return [
        pose(field, display).mean_square_error(solution.layers)
        for field, solution in zip(fields, solutions, strict=True)
    ]


def test_motion_of_a_shifted_picture_is_found():
    torch.manual_seed(0)
    picture = torch.nn.functional.avg_pool2d(torch.rand(2, 110, 130), 3, 1)
    for x, y in ((0, 0), (3, -2), (-13, 9)):
        old = picture[:, 15:79, 15:111]
        new = picture[:, 15 + y : 79 + y, 15 + x : 111 + x]
        inside = block_motion(new, old)[:, 20:-20, 20:-20]
        wanted = torch.tensor([float(x), float(y)])[:, None, None].expand_as(inside)
        torch.testing.assert_close(inside, wanted, atol=0.15, rtol=0)


def test_moved_pictures_are_interpolated_and_end_at_the_edge():
    picture = torch.arange(12.0).reshape(3, 4)
    motion = torch.stack([torch.full((3, 4), 0.5), torch.ones(3, 4)])
    # the last column of the second row is half a pixel past the edge, which still counts
    expected = torch.tensor([[4.5, 5.5, 6.5, 7.0], [8.5, 9.5, 10.5, 11.0], [0.0, 0.0, 0.0, 0.0]])
    torch.testing.assert_close(moved(picture, motion), expected)


@pytest.mark.parametrize("link", ["additive", "multiplicative"])
@pytest.mark.parametrize("step", [(2, 0), (3, 1)])
def test_a_warm_frame_is_no_worse_than_a_cold_one_of_the_same_count(link, step):
    display, fields = row_of_five(link), pan(step, 6)
    warm = errors(fields, display)
    for field, error in list(zip(fields, warm, strict=True))[1:]:
        cold = synthesize(field, display, iterations=3).layers
        assert error <= pose(field, display).mean_square_error(cold) * 1.001


@pytest.mark.parametrize("method", ["sweeps", "nmf", "gradient"])
def test_other_solvers_gain_as_well(method):
    display, fields = row_of_five("additive"), pan((2, 0), 4)
    warm = errors(fields, display, method=method)[-1]
    cold = synthesize(fields[-1], display, method=method, iterations=3).layers
    assert warm < pose(fields[-1], display).mean_square_error(cold)


def test_a_still_video_comes_to_the_optimum():
    display, field = row_of_five("additive"), pan((0, 0), 1)[0]
    found = errors([field] * 30, display)
    assert found[-1] < 1.02 * reference(pose(field, display)).mean_square_error
    assert found[-1] < found[5] < found[0]


def test_a_cut_is_found_and_starts_anew():
    display = row_of_five("additive")
    fields = [*pan((1, 0), 3), *pan((1, 0), 2, seed=8)]
    made = list(synthesize_frames(fields, display))
    assert [s.details["start"] for s in made] == ["cold", "moved", "moved", "cut", "moved"]
    assert [s.iterations for s in made] == [10, 3, 3, 10, 3]
    torch.testing.assert_close(made[3].layers, synthesize(fields[3], display).layers)


def test_frames_are_taken_and_let_go_one_by_one():
    taken: list[int] = []

    def frames() -> Iterator[LightField]:
        for t, field in enumerate(pan((1, 0), 4)):
            taken.append(t)
            yield field

    made = synthesize_frames(frames(), row_of_five("additive"))
    assert taken == []
    for t, solution in enumerate(made):
        assert taken == list(range(t + 1))
        assert solution.problem is not None
        assert solution.problem.target.shape == (5, 3, *SIZE)


def test_networks_start_anew_in_every_frame():
    display = Display.load("additive-3")
    field = procedural_light_field(size=(24, 32))
    made = list(synthesize_frames([field, field], display, method="stacked-cnn"))
    assert [s.details["start"] for s in made] == ["cold", "cold"]
    assert torch.equal(made[0].layers, made[1].layers)


def test_what_makes_no_video_is_refused():
    display, field = row_of_five("additive"), pan((0, 0), 1)[0]
    smaller = replace(field, views=field.views[..., 1:])
    with pytest.raises(ValueError, match="the first frame had"):
        list(synthesize_frames([field, smaller], display))
    with pytest.raises(ValueError, match="expected 0 or more"):
        synthesize_frames([field], display, iterations=-1)
    with pytest.raises(ValueError, match="expected one light field"):
        list(synthesize_frames([replace(field, views=field.views[None])], display))
    with pytest.raises(ValueError, match="serves"):
        synthesize_frames([field], display, method="ntf")
