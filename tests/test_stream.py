"""Video: a frame that starts from the one before is better than one that starts anew."""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from inspect import unwrap
from pathlib import Path

import pytest
import torch
from test_cli import run

from layerfield import (
    DisparitySpec,
    Display,
    LightField,
    Solution,
    procedural_light_field,
    reference,
    solve,
    synthesize,
    synthesize_frames,
)
from layerfield.fast import read_learned
from layerfield.kernels.block_costs import neighbour_costs
from layerfield.kernels.compiled import plain
from layerfield.kernels.moved import moved_parts
from layerfield.motion import block_motion, comes_from_inside, framed, moved, rim_of
from layerfield.scenes import animated, panned, travelled
from layerfield.solvers.learned_admm import LearnedState
from layerfield.solvers.warm_admm import Left, WarmAdmm, moved_start
from layerfield.synthesizer import pose
from layerfield.training.learned_steps import LearnedSteps
from layerfield.training.steps_recipe import read_steps_recipe

SIZE = (48, 80)
TINY = """
name = "tiny"
solver = "fast"
link = "additive"
steps = [1, 2]
coarse = 0
frames = 3
displays = [{ views = [1, 5], disparity = [1.2, 0.0, -0.7] }]
scenes = 4
size = 48
iterations = 3
"""


def row_of_five(link: str) -> Display:
    return Display(DisparitySpec(link=link, disparity=(1.0, 0.0, -1.0), views=(1, 5)))  # pyright: ignore[reportArgumentType]


def pan(step: tuple[int, int], count: int, seed: int = 3) -> list[LightField]:
    """Crops of one wide light field, each `step` = (x, y) further."""
    x, y = step
    size = (SIZE[0] + count * y, SIZE[1] + count * x)
    whole = procedural_light_field(grid=(1, 5), size=size, seed=seed)
    return [
        replace(whole, stored=whole.views[..., t * y : t * y + SIZE[0], t * x : t * x + SIZE[1]])
        for t in range(count)
    ]


def errors(fields: list[LightField], display: Display, **options) -> list[float]:
    solutions = synthesize_frames(fields, display, **options)
    return [
        pose(field, display).mean_square_error(solution.layers)
        for field, solution in zip(fields, solutions, strict=True)
    ]


def textured(height: int, width: int) -> torch.Tensor:
    noise = torch.rand(1, height, width, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.avg_pool2d(noise, 3, 1)[0]


def test_motion_of_a_shifted_picture_is_found():
    picture = textured(110, 130)
    for x, y in ((0, 0), (3, -2), (-13, 9)):
        old = picture[15:79, 15:111]
        new = picture[15 + y : 79 + y, 15 + x : 111 + x]
        inside = block_motion(new, old)[:, 20:-20, 20:-20]
        wanted = torch.tensor([float(x), float(y)])[:, None, None].expand_as(inside)
        torch.testing.assert_close(inside, wanted, atol=0.15, rtol=0)


def test_edges_of_things_run_through_blocks():
    behind, thing = textured(106, 130), textured(180, 200)[100:148, 100:140]
    new, old = behind.clone(), behind.clone()
    new[44:92, 48:88] = old[46:94, 45:85] = thing
    motion = block_motion(new, old)
    torch.testing.assert_close(motion[:, 16:44], torch.zeros(2, 28, 128), atol=0.15, rtol=0)
    wanted = torch.tensor([-3.0, 2.0])[:, None, None].expand(2, 48, 40)
    torch.testing.assert_close(motion[:, 44:92, 48:88], wanted, atol=0.15, rtol=0)


def test_where_all_is_even_motion_is_that_of_the_rest():
    picture = textured(70, 200)
    picture[:, 90:] = 0.5
    motion = block_motion(picture[:, 3:180], picture[:, :177])
    torch.testing.assert_close(motion[0, :, 8:150], torch.full((68, 142), 3.0), atol=0.15, rtol=0)


def test_moved_pictures_are_interpolated_and_go_on_at_their_edges():
    picture = torch.arange(12.0).reshape(3, 4)
    motion = torch.stack([torch.full((3, 4), 0.5), torch.ones(3, 4)])
    expected = torch.tensor([[4.5, 5.5, 6.5, 7.0], [8.5, 9.5, 10.5, 11.0], [8.5, 9.5, 10.5, 11.0]])
    torch.testing.assert_close(moved(picture, motion), expected)
    # the last column is half a pixel past the edge, which still counts
    inside = torch.tensor([True, True, False])[:, None].expand(3, 4)
    assert torch.equal(comes_from_inside(motion), inside)


def test_a_frame_has_the_means_of_what_is_near_its_edge():
    picture = torch.rand(2, 30, 40, generator=torch.Generator().manual_seed(1))
    picture[:, :, :5] += 7.0
    around = framed(picture)
    assert torch.equal(around[:, 1:-1, 1:-1], picture)
    torch.testing.assert_close(around[0, 11, 0], picture[0, 6:15, :5].mean())
    torch.testing.assert_close(around[1, -1, 21], picture[1, -5:, 16:25].mean())
    beyond = moved(around, torch.stack([torch.full((30, 40), -50.0), torch.zeros(30, 40)]))
    torch.testing.assert_close(beyond, around[:, 1:-1, :1].expand(2, 30, 40))


@pytest.fixture
def learned(monkeypatch):
    """Have `fast` take learned steps where it would solve rows by themselves."""
    monkeypatch.setattr("layerfield.fast._FAR", 0)


@pytest.mark.parametrize(
    ("method", "count", "gain"),
    [("fast", 1, 0.99), ("row-newton", 1, 0.99), ("fourier-admm", 3, 0.94)],
)
@pytest.mark.parametrize("step", [(2, 0), (3, 1)])
def test_a_warm_frame_is_better_than_a_cold_one_of_the_same_count(method, count, gain, step):
    display, fields = row_of_five("additive"), pan(step, 5)
    warm = errors(fields, display, method=method, iterations=count)
    for field, error in list(zip(fields, warm, strict=True))[1:]:
        cold = synthesize(field, display, method=method, iterations=count).layers
        assert error < gain * pose(field, display).mean_square_error(cold)


@pytest.mark.usefixtures("learned")
@pytest.mark.parametrize("step", [(2, 0), (3, 1)])
def test_a_warm_frame_of_learned_steps_is_better_than_a_cold_one(step):
    test_a_warm_frame_is_better_than_a_cold_one_of_the_same_count("fast", 3, 0.99, step)


@pytest.mark.usefixtures("learned")
def test_four_learned_steps_are_better_than_three_and_three_than_one():
    display, fields = row_of_five("additive"), pan((3, 0), 5)
    one, three, four = (errors(fields, display, iterations=n)[-1] for n in (1, 3, 4))
    assert four < three < one


def test_where_light_is_multiplied_every_frame_starts_itself():
    display, fields = row_of_five("multiplicative"), pan((2, 0), 3)
    made = list(synthesize_frames(fields, display, iterations=1))
    assert [s.details["start"] for s in made] == ["cold", "cold", "cold"]
    assert [s.iterations for s in made] == [4, 1, 1]
    cold = synthesize(fields[2], display, method="fast", iterations=1).layers
    torch.testing.assert_close(made[2].layers, cold)


def test_any_grid_and_number_of_layers_is_served():
    spec = DisparitySpec(link="additive", disparity=(1.5, 0.5, -0.5, -1.5), views=(3, 3))
    display, whole = Display(spec), procedural_light_field(grid=(3, 3), size=(48, 70), seed=5)
    fields = [replace(whole, stored=whole.views[..., 2 * t : 2 * t + 60]) for t in range(4)]
    warm = errors(fields, display)[-1]
    cold = synthesize(fields[-1], display, method="fast", iterations=3).layers
    assert warm < pose(fields[-1], display).mean_square_error(cold)


@pytest.mark.parametrize("method", ["sweeps", "nmf", "gradient"])
def test_other_solvers_gain_as_well(method):
    display, fields = row_of_five("additive"), pan((2, 0), 4)
    warm = errors(fields, display, method=method)[-1]
    cold = synthesize(fields[-1], display, method=method, iterations=3).layers
    assert warm < pose(fields[-1], display).mean_square_error(cold)


@pytest.mark.parametrize(("method", "excess"), [("fast", 0.02), ("fourier-admm", 0.02)])
def test_a_still_video_comes_near_the_optimum(method, excess):
    display, field = row_of_five("additive"), pan((0, 0), 1)[0]
    found = errors([field] * 30, display, method=method)
    assert found[-1] < (1 + excess) * reference(pose(field, display)).mean_square_error
    assert found[-1] < min(found[0], found[5])


def test_a_still_grid_comes_to_rest():
    display, field = Display.load("additive-3"), procedural_light_field(size=SIZE, seed=2)
    made = [solution.layers for solution in synthesize_frames([field] * 30, display)]
    problem = pose(field, display)
    found = problem.mean_square_error(made[-1])
    assert found < 1.005 * reference(problem).mean_square_error
    assert found < problem.mean_square_error(made[0])
    assert (made[-1] - made[-2]).abs().mean() < 0.1 / 255


def test_a_grid_that_moves_is_nearer_than_a_cold_one():
    display = Display.load("additive-3")
    whole = procedural_light_field(size=(SIZE[0], SIZE[1] + 10), seed=6)
    views = whole.views
    fields = [replace(whole, stored=views[..., 2 * t : 2 * t + SIZE[1]]) for t in range(5)]
    warm = errors(fields, display, iterations=1)[-1]
    cold = synthesize(fields[-1], display, method="fast", iterations=1).layers
    assert warm < 0.997 * pose(fields[-1], display).mean_square_error(cold)


def test_a_cut_is_found_and_starts_anew():
    display = row_of_five("additive")
    fields = [*pan((1, 0), 3), *pan((1, 0), 2, seed=8)]
    made = list(synthesize_frames(fields, display))
    assert [s.details["start"] for s in made] == ["cold", "moved", "moved", "cut", "moved"]
    assert [s.iterations for s in made] == [4, 3, 3, 4, 3]
    assert "unexplained" not in made[0].details
    shares = [float(s.details["unexplained"]) for s in made[1:]]
    assert [share > 0.3 for share in shares] == [False, False, True, False]
    cold = synthesize(fields[3], display, method="fast", iterations=4).layers
    torch.testing.assert_close(made[3].layers, cold)


@pytest.mark.usefixtures("learned")
def test_learned_steps_take_twenty_where_nothing_comes_before():
    fields = [*pan((1, 0), 2), *pan((1, 0), 1, seed=8)]
    made = list(synthesize_frames(fields, row_of_five("additive")))
    assert [s.iterations for s in made] == [20, 3, 20]


def test_a_motion_from_outside_explains_nothing(monkeypatch):
    def far(new: torch.Tensor, old: torch.Tensor) -> torch.Tensor:
        return torch.full((2, *new.shape[-2:]), 1000.0)

    monkeypatch.setattr("layerfield.stream.block_motion", far)
    made = list(synthesize_frames(pan((1, 0), 2), row_of_five("additive")))
    assert (made[1].details["start"], made[1].details["unexplained"]) == ("cut", math.inf)


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
    smaller = replace(field, stored=field.views[..., 1:])
    with pytest.raises(ValueError, match="the first frame had"):
        list(synthesize_frames([field, smaller], display))
    with pytest.raises(ValueError, match="expected 0 or more"):
        synthesize_frames([field], display, iterations=-1)
    with pytest.raises(ValueError, match="expected one light field"):
        list(synthesize_frames([replace(field, stored=field.views[None])], display))
    spec = DisparitySpec(link="polarisation", disparity=(1.0, -1.0), views=(1, 5))
    with pytest.raises(ValueError, match="take fourier-admm"):
        synthesize_frames([field], Display(spec))
    with pytest.raises(ValueError, match="serves"):
        synthesize_frames([field], display, method="ntf")


def test_moving_scenes_are_shifted_views_of_one():
    geometry, size = row_of_five("additive").geometry, (32, 40)
    for step in ((2, 1), (-2, -1)):
        views = panned(geometry, step, 3, size=size, seed=1)
        x, y = abs(step[0]), abs(step[1])
        first, later = (views[0], views[2]) if step[0] > 0 else (views[2], views[0])
        torch.testing.assert_close(first[..., 2 * y :, 2 * x :], later[..., : -2 * y, : -2 * x])
    seen = travelled(geometry, 1.0, 2, size=size, seed=1)
    torch.testing.assert_close(seen[0, 1:], seen[1, :-1])
    moving = animated(geometry, 3.0, 3, size=size, seed=1)
    assert moving.shape == (3, 5, 3, *size)
    assert not torch.equal(moving[0], moving[2])


def test_the_learned_steps_of_a_video_are_what_their_training_computes():
    """The differentiable formula, and the solver."""
    field, display = pan((0, 0), 1)[0], row_of_five("additive")
    problem, model = pose(field, display), LearnedSteps(3, 0)
    state = problem.even_start() * 1.3
    expected = model.onward(problem, state).clamp(0, 1)
    solver = WarmAdmm(model.rows().full)
    start = LearnedState(problem.gram.to_torus(state))
    begun = Solution(state, 0, 0.0, "", solver=solver, state=start)
    found = solve(problem, solver, iterations=3, init=begun).layers
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)


def test_steps_of_a_video_are_trained_by_a_recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.toml").write_text(TINY)
    done = run("train", "tiny.toml", "--out", "whole")
    assert done.status == 0, done.err
    assert "fast, dB on test scenes" in done.out
    learned = read_learned(Path("whole", "weights.safetensors"))
    assert [len(learned.steps[n].full) for n in (1, 2)] == [1, 2]
    Path("tiny.toml").write_text(TINY.replace("coarse = 0", "coarse = 2"))
    done = run("train", "tiny.toml", "--out", "other")
    assert (done.status, len(done.err.strip().splitlines())) == (2, 1)
    assert "expected 'additive' and 0" in done.err


def test_what_the_page_shows_runs():
    page = (Path(__file__).parents[1] / "docs" / "video.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    exec(compile(code, "video.md", "exec"), {})
    (recipe,) = re.findall(r"layerfield train (\S+)", page)
    assert read_steps_recipe(recipe).frames > 1


def test_what_the_frame_before_has_changed_is_changed_once_more():
    """Where nothing moves; within the bounds, and without the dual."""
    even, before = torch.full((1, 1, 1, 4, 6), 0.3), torch.full((1, 1, 1, 4, 6), 0.2)
    state, carried = torch.full_like(even, 0.6), torch.full_like(even, 0.5)
    state[..., 0], state[..., 1] = 1.2, 0.95
    left, still = Left(state, before, carried), torch.zeros(2, 4, 6)
    start = moved_start(even, left, still, again=0.5)
    assert start.state[..., 2:].sub(0.3 + 0.4 + 0.05).abs().max() < 1e-6
    assert start.carried[..., 2:].sub(0.3 + 0.4).abs().max() < 1e-6
    assert start.state[..., 0].sub(1.2).abs().max() < 1e-6
    assert start.state[..., 1].max() == start.carried[..., 0].max() == 1
    alone = moved_start(even, left, still)
    torch.testing.assert_close(alone.carried, start.carried)
    torch.testing.assert_close(alone.state, alone.carried + state - state.clamp(0, 1))


@pytest.mark.parametrize("kind", ["still", "by blocks", "by pixels", "far away"])
@pytest.mark.parametrize("size", [(37, 61), (16, 16), (3, 5)])
def test_moved_starts_in_one_pass_are_those_of_pytorch(size, kind):
    generator = torch.Generator().manual_seed(3)

    def planes(*size: int) -> torch.Tensor:
        return torch.rand(1, 2, 3, *size, generator=generator) * 1.4 - 0.2

    def offsets(height: int, width: int) -> torch.Tensor:
        return 3 * torch.randn(2, height, width, generator=generator)

    torus = size[0] + 3, size[1] + 8
    motion = {
        "still": lambda: torch.zeros(2, *size),
        "by blocks": lambda: offsets(5, 8).repeat_interleave(8, 1).repeat_interleave(8, 2),
        "by pixels": lambda: offsets(*size),
        "far away": lambda: 20 * offsets(*size),
    }[kind]()[:, : size[0], : size[1]]
    even, left = planes(*size), Left(planes(*torus), planes(*size), planes(*size))
    given = partial(moved_start, even, left, motion, again=0.6, bounds=(0.1, 0.9), size=torus)
    start = given()
    with plain():
        expected = given()
    torch.testing.assert_close(start.state, expected.state, atol=1e-4, rtol=0)
    torch.testing.assert_close(start.carried, expected.carried, atol=1e-4, rtol=0)
    assert start.state[..., size[0] :, :].abs().max() == 0


def test_compiled_loops_refuse_planes_that_do_not_fit():
    even, motion, size = torch.zeros(1, 3, 3, 8, 16), torch.zeros(2, 8, 16), (8, 16)
    fewer, short = torch.zeros(1, 2, 3, 8, 16), torch.zeros(1, 3, 3, 7, 16)
    unchecked = unwrap(moved_parts)  # annotations are looked at in tests alone
    rim = rim_of(lambda y, x: even[None].expand(3, -1, -1, -1, -1, -1)[..., y, x])
    for state, before, carried, way, torus in (
        (short, even, even, motion, size),
        (fewer, even, even, motion, size),
        (even, fewer, even, motion, size),
        (even, even, short, motion, size),
        (even, even, even, motion[:, 1:], size),
        (even, even, even, motion, (8, 15)),
    ):
        with pytest.raises(ValueError, match="expected all to fit"):
            unchecked(even, state, before, carried, 0.5, way, rim, (0.0, 1.0), torus)


def test_motion_of_pictures_that_do_not_fit_is_refused():
    new, motion = torch.rand(16, 20), torch.zeros(2, 2, 3)
    unchecked = unwrap(neighbour_costs)
    for old, way in ((new[:, 1:], motion), (new, motion[:, 1:]), (new, motion[:, :, 1:])):
        with pytest.raises(ValueError, match="expected both to fit"):
            unchecked(new, old, way, [(0, 0)])


@pytest.mark.parametrize("size", [(64, 96), (61, 83), (9, 5), (1, 1)])
def test_motion_is_the_same_from_compiled_loops(size):
    wide = procedural_light_field(size=(size[0] + 8, size[1] + 8)).views[0].mean(dim=0)
    new, old = wide[2 : 2 + size[0], 4 : 4 + size[1]], wide[: size[0], : size[1]]
    found = block_motion(new, old)
    with plain():
        torch.testing.assert_close(found, block_motion(new, old), atol=1e-3, rtol=0)


def test_subframes_of_a_video_start_from_those_before():
    facts = {"name": "fast LCDs", "link": "multiplicative", "views": (1, 5), "subframes": 2}
    display = Display(DisparitySpec.model_validate(facts | {"disparity": (1.0, 0.0, -1.0)}))
    first, second = synthesize_frames(pan((1, 0), 2), display, method="gradient", iterations=2)
    assert second.details["start"] == "moved"
    assert second.layers.shape == first.layers.shape
    assert not torch.equal(*second.layers)


def test_motion_that_is_found_wrongly_does_not_add_up_in_the_dual():
    """Again and again a dark pixel takes its state from where it was bright."""
    even = torch.full((1, 1, 1, 4, 6), 0.1)
    bright, state, still = torch.full_like(even, 0.4), even.clone(), torch.zeros(2, 4, 6)
    held = even * 0 - 0.2  # a layer that its bound keeps dark
    for _ in range(20):
        state = moved_start(even, Left(state, bright, bright), still).state
        held = moved_start(even, Left(held, even, even), still).state
    assert (state - state.clamp(0, 1)).abs().max() == 0
    torch.testing.assert_close(held, torch.full_like(held, -0.2))
