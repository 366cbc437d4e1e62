import dataclasses
import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from layerfield.display import Display
from layerfield.geometry import grid_points
from layerfield.scenes import (
    Scene,
    make_scene,
    procedural_light_field,
    random_scenes,
    render,
    scenes_for,
    spot_scene,
)
from layerfield.scenes.scene import pixel_centres


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Small tensors: several threads only wait for one another on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def photographs() -> Tensor:
    scene = random_scenes(96, size=(96, 96), reach=0.1)
    return render(scene, [(0, 0)])[:, 0]


def textured_plane(disparity: float, seed: int = 0) -> Scene:
    """A random background alone, facing the viewer at a stated disparity."""
    scene = random_scenes(8, size=(64, 64), surfaces=1, seed=seed)
    return dataclasses.replace(
        scene,
        disparities=torch.full_like(scene.disparities, disparity),
        gradients=torch.zeros_like(scene.gradients),
    )


def windowed_spectrum(pictures: Tensor, shift: tuple[float, float]) -> Tensor:
    """Spectra `[batch, fy, fx]` under a Hann window that is moved along with the content."""
    size = pictures.shape[-1]
    x = torch.arange(size, dtype=torch.float64) - (size - 1) / 2
    across, down = (torch.cos(math.pi * ((x - s) / size).clamp(-0.5, 0.5)).square() for s in shift)
    window = down[:, None] * across
    grey = pictures.double().mean(1)
    mean = (grey * window).sum((-2, -1), keepdim=True) / window.sum()
    return torch.fft.fft2((grey - mean) * window)


def measured_shift(still: Tensor, moved: Tensor) -> tuple[float, float]:
    """(x, y) by which the content moved: phases of the cross spectrum, weighted least squares."""
    size = still.shape[-1]
    f = torch.fft.fftfreq(size, dtype=torch.float64)
    fy, fx = f[:, None].expand(size, size), f.expand(size, size)
    used = (torch.hypot(fy, fx) > 0.05) & (torch.hypot(fy, fx) < 0.25)
    terms = torch.stack([fx[used], fy[used]], dim=-1)
    shift = (0.0, 0.0)
    for _ in range(3):
        cross = windowed_spectrum(still, (0, 0)) * windowed_spectrum(moved, shift).conj()
        weight = cross.abs()[:, used].sqrt()
        phase = cross.angle()[:, used] / (2 * math.pi)
        weighted = (weight[..., None] * terms).flatten(0, 1)
        x, y = torch.linalg.lstsq(weighted, (weight * phase).flatten()[:, None]).solution[:, 0]
        shift = float(x), float(y)
    return shift


@pytest.mark.parametrize("disparity", [1.0, 0.37, -0.62, 1.45])
@pytest.mark.parametrize("axis", [0, 1])
def test_parallax_of_a_plane_is_right_to_a_fiftieth_of_a_pixel(disparity: float, axis: int):
    views = render(textured_plane(disparity), [(0, 0), (1 - axis, axis)])
    moved = measured_shift(views[:, 0], views[:, 1])
    expected = [0.0, 0.0]
    expected[axis] = -disparity  # nearer things move left in the right view, up in the lower view
    assert moved == pytest.approx(expected, abs=0.02)


def test_whole_disparities_shift_pixels_exactly():
    texture = torch.rand(1, 3, 24, 28)
    scene = make_scene(texture, [2.0], size=(16, 20), canvas=(24, 28))
    centre, right, below = render(scene, [(0, 0), (1, 0), (0, 1)])[0]
    torch.testing.assert_close(centre, texture[0, :, 4:20, 4:24])
    torch.testing.assert_close(right, texture[0, :, 4:20, 6:26])
    torch.testing.assert_close(below, texture[0, :, 6:22, 4:24])


@pytest.mark.parametrize("preset", ["additive-3", "perspective-3"])
@pytest.mark.parametrize("layer", [0, 2])
def test_a_plane_at_the_depth_of_a_layer_looks_like_the_layer(preset: str, layer: int):
    display = Display.load(preset)
    size = (12, 14)
    canvas = (size[0] + 2 * display.margin[0], size[1] + 2 * display.margin[1])
    picture = torch.rand(1, 3, *canvas)
    layers = torch.zeros(1, 3, 3, *canvas)
    layers[:, layer] = picture
    scene = make_scene(picture, [display.geometry.parallax[layer]], size=size, canvas=canvas)
    views = render(scene, display.geometry.slopes)[0]
    # texels are pixels here: both interpolate linearly between the same neighbours
    torch.testing.assert_close(views, display(layers), atol=2e-5, rtol=0)


@pytest.mark.parametrize("slope", [(1.5, 0.0), (0.0, -2.0), (-1.3, 0.8)])
def test_points_of_slanted_planes_move_by_their_own_disparity(slope: tuple[float, float]):
    gradient, at_centre, (ux, uy) = (0.03, -0.05), 0.4, (6.2, -4.7)
    canvas = (128, 128)
    y, x = pixel_centres(canvas, torch.device("cpu"))
    silhouettes = torch.stack([torch.full(canvas, 99.0), 5.0 - torch.hypot(x - ux, y - uy)])
    scene = make_scene(
        torch.tensor([0.0, 1.0]).view(2, 1, 1, 1),
        [-5.0, at_centre],
        size=(64, 64),
        gradients=[(0, 0), gradient],
        silhouettes=silhouettes,
        canvas=canvas,
    )
    view = render(scene, [slope])[0, 0, 0]
    y, x = pixel_centres((64, 64), torch.device("cpu"))
    found = float((view * x).sum() / view.sum()), float((view * y).sum() / view.sum())
    disparity = at_centre + gradient[0] * ux + gradient[1] * uy
    expected = ux - slope[0] * disparity, uy - slope[1] * disparity
    assert found == pytest.approx(expected, abs=0.02)


def test_the_nearest_surface_hides_the_others_in_any_order():
    near, far = ((0.0, 0.0), 1.0), ((3.0, 0.0), -1.0)
    slope = [(1.5, 0.0)]  # both discs appear around x = -1.5 and x = 4.5: from here they part
    first = render(spot_scene([near, far], size=(24, 24), radius=3), [(-1.0, 0.0), *slope])
    second = render(spot_scene([far, near], size=(24, 24), radius=3), [(-1.0, 0.0), *slope])
    torch.testing.assert_close(first, second)
    scene = spot_scene([near, far], size=(24, 24), radius=3)
    assert scene.disparity_map[0, 11, 11] == 1
    assert scene.disparity_map[0, 11, 16] == -1
    assert scene.disparity_map[0, 0, 0] == -2
    dark_near = scene.textures.clone()
    dark_near[:, 1] = 0.5
    overlap = render(dataclasses.replace(scene, textures=dark_near), [(0.0, 0.0)])[0, 0, 0, 11]
    assert overlap[11:14] == pytest.approx(torch.full((3,), 0.5))
    assert overlap[16] == 1


@pytest.mark.parametrize("edge", [0.0, 0.3, 0.5, -0.85])
def test_edges_are_sharp_and_anti_aliased(edge: float):
    canvas = (16, 32)
    _, x = pixel_centres(canvas, torch.device("cpu"))
    silhouettes = torch.stack([torch.full(canvas, 99.0), (edge - x).expand(canvas)])
    scene = make_scene(
        torch.tensor([0.0, 1.0]).view(2, 1, 1, 1),
        [0.0, 1.0],
        size=(8, 16),
        silhouettes=silhouettes,
        canvas=canvas,
    )
    for slope in (0.0, 0.25, 1.0):
        row = render(scene, [(slope, 0.0)])[0, 0, 0, 4]
        assert float(row.sum()) == pytest.approx(8 + edge - slope, abs=1e-4)
        assert int(((row > 0) & (row < 1)).sum()) <= 2


def test_planes_that_cut_each_other_meet_in_an_anti_aliased_crease():
    scene = make_scene(
        torch.tensor([0.0, 1.0]).view(2, 1, 1, 1),
        [0.0, 0.01],
        size=(8, 16),
        gradients=[(0.0, 0.0), (0.1, 0.0)],
    )
    row = render(scene, [(0.0, 0.0)])[0, 0, 0, 4]
    assert float(row.sum()) == pytest.approx(8.1, abs=1e-4)  # equal disparities at x = -0.1


def test_the_disparity_map_tells_where_everything_is_in_the_other_views():
    scene = random_scenes(8, size=(64, 64), disparity_range=(-3, 3), reach=1)
    slope = (0.7, -0.6)
    centre, other = render(scene, [(0, 0), slope]).unbind(1)

    def error(disparity: Tensor) -> float:
        y, x = pixel_centres((64, 64), torch.device("cpu"))
        moved = torch.stack([x - slope[0] * disparity, y - slope[1] * disparity], dim=-1) / 32
        found = grid_sample(other, moved, padding_mode="border", align_corners=False)
        return float((found - centre)[..., 4:-4, 4:-4].abs().median())

    right = error(scene.disparity_map)
    assert right < 0.006
    assert error(-scene.disparity_map) > 4 * right
    assert error(scene.disparity_map + 0.5) > 1.5 * right


def test_disparities_stay_in_their_range_and_use_it():
    low, high = -1.5, 0.5
    found = random_scenes(48, size=(48, 64), disparity_range=(low, high)).disparity_map
    assert found.amin() >= low - 1e-4
    assert found.amax() <= high + 1e-4
    spread = found.flatten(1).amax(1) - found.flatten(1).amin(1)
    assert spread.median() > 0.6 * (high - low)


def test_the_same_seed_gives_the_same_bits():
    first, second = (random_scenes(3, size=(32, 32), seed=5) for _ in range(2))
    positions = grid_points((3, 3))
    assert torch.equal(render(first, positions), render(second, positions))
    assert torch.equal(first.disparity_map, second.disparity_map)


def test_element_b_is_the_scene_of_seed_plus_b():
    batch = render(random_scenes(4, size=(32, 40), seed=11), [(0.5, 0.0)])
    for b in range(4):
        alone = render(random_scenes(1, size=(32, 40), seed=11 + b), [(0.5, 0.0)])
        torch.testing.assert_close(alone[0], batch[b], atol=2e-4, rtol=0)
    assert (batch[0] - batch[1]).abs().mean() > 0.02


def test_spectra_fall_like_those_of_photographs(photographs: Tensor):
    grey = photographs.mean(1)
    size = grey.shape[-1]
    window = torch.hann_window(size, periodic=False)
    grey = (grey - grey.mean((-2, -1), keepdim=True)) * window[:, None] * window
    power = torch.fft.fft2(grey).abs().square()
    f = torch.fft.fftfreq(size)
    radius = torch.hypot(f[:, None], f)
    edges = torch.logspace(math.log10(0.03), math.log10(0.4), 9)
    rings = [(radius >= a) & (radius < b) for a, b in pairwise(edges)]
    x = torch.stack([radius[ring].mean().log() for ring in rings])
    y = torch.stack([power[:, ring].mean(-1).log() / 2 for ring in rings], dim=-1)
    x = x - x.mean()
    slopes = (y * x).sum(-1) / x.square().sum()
    assert -1.5 < slopes.mean() < -1.0
    assert slopes.std() > 0.05


def test_gradients_are_heavy_tailed(photographs: Tensor):
    gradients = photographs.mean(1).diff(dim=-1).flatten(1)
    gradients = gradients - gradients.mean(1, keepdim=True)
    kurtosis = gradients.pow(4).mean(1) / gradients.square().mean(1).square()
    assert kurtosis.median() > 8
    assert (kurtosis > 6).float().mean() > 0.9  # Gaussian: 3


def test_colours_exposures_and_contrasts_vary_like_those_of_photographs(photographs: Tensor):
    assert photographs.min() >= 0
    assert photographs.max() <= 1
    correlation = torch.corrcoef(photographs.transpose(0, 1).flatten(1))
    assert 0.8 < correlation[0, 2] < 0.99
    means = photographs.mean((1, 2, 3))
    assert means.min() < 0.25
    assert means.max() > 0.65
    grey = photographs.mean(1)
    assert 0.005 < (grey < 0.05).float().mean() < 0.2
    assert 0.005 < (grey > 0.95).float().mean() < 0.2
    assert grey.std((1, 2)).min() > 0.04  # no empty picture


def test_views_are_equally_sharp_at_every_fraction_of_a_pixel():
    scene = random_scenes(24, size=(64, 64), seed=100)
    views = render(scene, [(i / 8, i / 16) for i in range(-8, 9)])
    energy = views.diff(dim=-1).square().mean((0, 2, 3, 4))
    assert energy.max() / energy.min() < 1.06


def test_a_light_field_has_its_views_row_by_row():
    field = procedural_light_field(grid=(2, 3), size=(32, 40), seed=3)
    assert field.grid == (2, 3)
    assert field.views.shape == (6, 3, 32, 40)
    scene = random_scenes(1, size=(32, 40), reach=1, seed=3)
    torch.testing.assert_close(field.views[5], render(scene, [(1.0, 0.5)])[0, 0])


def test_scenes_for_a_display_fill_its_depth():
    geometry = Display.load("perspective-3").geometry
    scene = scenes_for(geometry, 12, size=(48, 48))
    high, low = geometry.parallax[0], geometry.parallax[-1]
    found = scene.disparity_map
    assert low - 1e-3 <= found.amin() < low + 0.2 * (high - low)
    assert high - 0.2 * (high - low) < found.amax() <= high + 1e-3
    assert render(scene, geometry.slopes[:2]).shape == (12, 2, 3, 48, 48)
    wider = scenes_for(geometry, 12, size=(48, 48), stretch=1.5).disparity_map
    assert wider.amax() > high


@pytest.mark.parametrize("size", [(8, 8), (17, 90), (64, 31)])
@pytest.mark.parametrize("span", [(-1.0, 1.0), (3.0, 7.25), (0.5, 0.5), (-20.0, 20.0)])
def test_any_size_and_range_gives_finite_views(size: tuple[int, int], span: tuple[float, float]):
    scene = random_scenes(2, size=size, disparity_range=span, seed=7)
    views = render(scene, [(-2.0, -2.0), (0.0, 0.0), (2.0, 1.0)])
    assert bool(torch.isfinite(views).all())
    assert 0 <= float(views.min()) <= float(views.max()) <= 1


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="farthest"):
        random_scenes(1, size=(32, 32), disparity_range=(1, -1))
    with pytest.raises(ValueError, match="too small"):
        random_scenes(1, size=(4, 32))
    with pytest.raises(ValueError, match="0 scenes"):
        random_scenes(0, size=(32, 32))
    with pytest.raises(ValueError, match="2 disparities"):
        make_scene(torch.rand(1, 3, 8, 8), [1.0, 2.0], size=(8, 8))
    with pytest.raises(ValueError, match="no spots"):
        spot_scene([], size=(8, 8))
    steep = make_scene(torch.rand(1, 3, 8, 8), [0.0], size=(8, 8), gradients=[(0.6, 0.0)])
    with pytest.raises(ValueError, match="from behind"):
        render(steep, [(2.0, 0.0)])
    with pytest.raises(ValueError, match="no viewpoints"):
        render(steep, [])


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_seed_means_the_same_scene_on_a_gpu():
    positions = [(0.0, 0.0), (1.0, -0.5)]
    here = render(random_scenes(2, size=(32, 40), seed=4), positions)
    there = render(random_scenes(2, size=(32, 40), seed=4, device="cuda"), positions).cpu()
    assert (here - there).abs().mean() < 1e-4
