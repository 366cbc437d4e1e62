"""Weight files, shipped weights, and networks as synthesizers like any other."""

import hashlib
import json
import pickle
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from test_cli import contents, fails, run, succeed, write_views

from layerfield import (
    DisparitySpec,
    Display,
    LightField,
    Problem,
    demo,
    evaluate,
    methods,
    procedural_light_field,
    psnr,
    solve,
    synthesize,
)
from layerfield.display_spec import format_spec
from layerfield.evaluate import parse_methods, tables
from layerfield.metrics import decibels
from layerfield.networks import NETWORKS, Network
from layerfield.networks.frame import pixels
from layerfield.networks.network import initialise, level
from layerfield.result import make_result
from layerfield.shipped import (
    TRAINED,
    find_shipped,
    load_shipped,
    shipped,
    shipped_networks,
)
from layerfield.solvers.fourier_admm import FourierAdmm
from layerfield.synthesizer import find_method, pose
from layerfield.weights import WeightsCard, read_weights, same_light_paths, write_weights

OPTIONS: dict[str, dict[str, int | bool]] = {
    "unet": {"width": 4, "depth": 2, "skips": True},
    "stacked-cnn": {"width": 4, "modules": 3},
}
ADDITIVE = Display.load("additive-3")
SMALL = Display(DisparitySpec(link="additive", disparity=(1.0, 0.0, -1.0), views=(3, 3)))
SYNTH = ["synth", "views", "--display", "additive-3", "--out", "out"]


def tiny(name: str, display: Display = ADDITIVE, seed: int = 0) -> Network:
    """A small network with random weights whose layers have useful values on noise."""
    network = NETWORKS[name](display.view_count, display.layer_count, **OPTIONS[name])
    generator = torch.Generator().manual_seed(seed)
    initialise(network, generator)
    level(network, torch.rand(2, display.view_count, 32, 32, generator=generator), 0.3)
    return network.eval()


def card(name: str, display: Display = ADDITIVE) -> WeightsCard:
    facts = {"steps": 3, "metrics": {"psnr": 31.5}, "command": "layerfield train x.toml"}
    return WeightsCard(name, OPTIONS[name], format_spec(display.spec), "tiny", facts)


def write(path: Path, name: str = "unet", display: Display = ADDITIVE, **how: Any) -> str:
    return write_weights(path, tiny(name, display), card(name, display), **how)


def entry(path: Path, name: str, display: Display = ADDITIVE, /, **changes: Any) -> dict[str, Any]:
    return {
        "name": path.stem,
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "network": name,
        "display": format_spec(display.spec),
        "recipe": "tiny",
        "command": "layerfield train tiny.toml",
        "megabytes": 0.1,
        "storage": "float32",
        "default": True,
        "metrics": {"mean_psnr": 31.25, "toys": 30.0},
        "trained_on": {"seconds": 1.0},
        "notes": "",
    } | changes


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """An empty registry in place of the package's own."""
    (tmp_path / "trained").mkdir()
    monkeypatch.setattr("layerfield.shipped.TRAINED", tmp_path / "trained")
    register(tmp_path / "trained")
    return tmp_path / "trained"


def register(folder: Path, *entries: dict[str, Any]) -> None:
    (folder / "registry.json").write_text(json.dumps(entries))


@pytest.fixture
def stocked(folder) -> Path:
    """A registry with both networks for additive-3."""
    for name in NETWORKS:
        write(folder / f"tiny-{name}.safetensors", name, half=True)
    register(folder, *(entry(folder / f"tiny-{name}.safetensors", name) for name in NETWORKS))
    return folder


@pytest.fixture
def desk(tmp_path, monkeypatch) -> Path:
    (tmp_path / "desk").mkdir()
    monkeypatch.chdir(tmp_path / "desk")
    write_views(tmp_path / "desk" / "views")
    return tmp_path / "desk"


@pytest.fixture(scope="module")
def scene() -> LightField:
    return procedural_light_field(size=(45, 61), disparity_range=(-1.3, 1.3), seed=5)


# ------------------------------------------------------------------------------------ weight files


@pytest.mark.parametrize("name", NETWORKS)
def test_a_file_holds_the_network_and_all_that_is_known_of_it(tmp_path, name):
    path, network = tmp_path / "mine.safetensors", tiny(name)
    written = write_weights(path, network, card(name))
    found = read_weights(path)
    assert (found.name, found.card, found.sha256) == ("mine", card(name), written)
    assert written == hashlib.sha256(path.read_bytes()).hexdigest()
    assert found.display.spec == ADDITIVE.spec
    assert type(found.network) is NETWORKS[name]
    assert not found.network.training
    for key, tensor in network.state_dict().items():
        assert torch.equal(found.network.state_dict()[key], tensor)
    assert all(parameter.requires_grad for parameter in found.network.parameters())


def test_half_precision_halves_the_file_and_rounds(tmp_path):
    network = NETWORKS["unet"](25, 3, width=16)
    facts = replace(card("unet"), options={"width": 16})
    sizes = []
    for half in (False, True):
        write_weights(tmp_path / "w.safetensors", network, facts, half=half)
        sizes.append((tmp_path / "w.safetensors").stat().st_size)
    assert sizes[1] < 0.51 * sizes[0]
    found = read_weights(tmp_path / "w.safetensors").network.state_dict()
    for key, tensor in network.state_dict().items():
        assert torch.equal(found[key], tensor.half().float())


def test_the_same_network_gives_the_same_bytes_and_replaces_the_earlier_file(tmp_path):
    first = write(tmp_path / "w.safetensors", "stacked-cnn")
    assert write(tmp_path / "w.safetensors", "unet") != first
    assert write(tmp_path / "w.safetensors", "stacked-cnn") == first
    assert [path.name for path in tmp_path.iterdir()] == ["w.safetensors"]


@pytest.mark.parametrize(("value", "half"), [(torch.nan, False), (torch.inf, False), (1e6, True)])
def test_weights_that_are_not_finite_are_not_written(tmp_path, value, half):
    network = tiny("unet")
    torch.nn.init.constant_(network.last.weight, value)
    with pytest.raises(ValueError, match=r"'last.weight' holds values that are not finite"):
        write_weights(tmp_path / "w.safetensors", network, card("unet"), half=half)
    assert list(tmp_path.iterdir()) == []


def put(change: Callable[[dict[str, torch.Tensor], dict[str, Any]], object]) -> Callable:
    """Return what writes a weight file after a change of its tensors or its card."""

    def prepare(path: Path) -> None:
        tensors, facts = dict(tiny("unet").state_dict()), asdict(card("unet"))
        change(tensors, facts)
        save_file(tensors, path, {"layerfield": json.dumps(facts)})

    return prepare


def facts(**changes: Any) -> Callable:
    return put(lambda _, known: known.update(changes))


def tensor(value: torch.Tensor) -> Callable:
    return put(lambda tensors, _: tensors.update({"last.bias": value}))


def cut(path: Path) -> None:
    write(path)
    path.write_bytes(path.read_bytes()[:-40])


def metadata(**of_file: str) -> Callable:
    return lambda path: save_file(tiny("unet").state_dict(), path, of_file)


def pickled(path: Path) -> None:
    torch.save(tiny("unet").state_dict(), path)


BAD = {
    "missing": (lambda path: None, "there is no file w.safetensors"),
    "folder": (Path.mkdir, "cannot read the weights w.safetensors|directory"),
    "empty": (Path.touch, "w.safetensors is damaged, cut off"),
    "text": (lambda path: path.write_text("weights" * 9), "damaged, cut off or no safetensors"),
    "cut": (cut, "damaged, cut off"),
    "pickle renamed": (pickled, "pickle|never loaded|.safetensors"),
    "bare pickle": (
        lambda path: path.write_bytes(pickle.dumps({"a": 1})),
        "is a pickle|never loaded",
    ),
    "no metadata": (metadata(), "does not say what network|metadata lacks 'layerfield'"),
    "other metadata": (metadata(format="pt"), "metadata lacks 'layerfield'"),
    "no JSON": (metadata(layerfield="{"), "metadata of w.safetensors is not valid JSON"),
    "nested": (metadata(layerfield="[" * 100_000), "is not valid JSON"),
    "a list": (metadata(layerfield="[]"), "metadata of w.safetensors"),
    "no recipe": (put(lambda _, known: known.pop("recipe")), "'recipe': |required"),
    "options of words": (facts(options={"width": "wide"}), "'options.width|integer"),
    "unknown network": (facts(network="unett"), "unknown network 'unett'; did you mean 'unet'?"),
    "unknown option": (facts(options={"widht": 4}), "no option 'widht'; did you mean 'width'?"),
    "option of others": (facts(options={"modules": 4}), "'unet' has no option 'modules'|known are"),
    "views are no option": (facts(options={"views": 4}), "'unet' has no option 'views'"),
    "large option": (facts(options={"width": 10**9}), "option 'width' is 1000000000, at most 1024"),
    "negative option": (facts(options={"depth": -1}), "option 'depth' is -1"),
    "impossible": (facts(options={"depth": 1000}), "no 'unet' with the options depth = 1000"),
    "display": (facts(display="link = 3"), "the display that w.safetensors was trained for"),
    "other width": (facts(options={"width": 5, "depth": 2}), "do not fit|4x25x3x3, expected 5x25"),
    "other depth": (facts(options={"width": 4, "depth": 3}), "do not fit|is missing, expected"),
    "one too many": (
        put(lambda tensors, _: tensors.update(more=torch.ones(2))),
        "'more' is 2, expected missing",
    ),
    "one too few": (
        put(lambda tensors, _: tensors.pop("last.bias")),
        "'last.bias' is missing, expected 3",
    ),
    "whole numbers": (tensor(torch.ones(3, dtype=torch.int64)), "'last.bias' is 3 of torch.int64"),
    "nan": (tensor(torch.tensor([0, torch.nan, 0])), "'last.bias'|not finite|diverged"),
    "infinite": (tensor(torch.tensor([0, 0, torch.inf])), "'last.bias'|not finite"),
    "other grid": (
        lambda path: write(path, "unet", SMALL),
        "trained for 'display' (additive, 3x3 views|found display 'additive-3'|5x5 views|train",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_weight_files_are_one_line(desk, case):
    prepare, words = BAD[case]
    prepare(Path("w.safetensors"))
    before = contents(desk)
    for method in ("w.safetensors", "w.safetensors+sweeps"):
        found = run(*SYNTH, "--method", method)
        fails(found, *words.split("|"))
    assert contents(desk) == before


@pytest.mark.parametrize("name", ["w.pt", "w.pth", "w.CKPT", "runs/w.pkl"])
def test_pickles_are_never_opened(desk, monkeypatch, name):
    monkeypatch.setattr(torch, "load", lambda *_, **__: pytest.fail("was loaded"))
    before = contents(desk)
    fails(run(*SYNTH, "--method", name), f"{name} is a pickle", "never loaded", "layerfield train")
    assert contents(desk) == before


def test_damage_anywhere_is_an_error_or_does_no_harm(tmp_path):
    path = tmp_path / "w.safetensors"
    write(path, "stacked-cnn")
    data = path.read_bytes()
    header = 8 + int.from_bytes(data[:8], "little")
    random = np.random.default_rng(0)
    for _ in range(150):
        damaged = bytearray(data)
        if random.random() < 0.3:
            del damaged[random.integers(len(data)) :]
        else:
            damaged[random.integers(header)] = random.integers(256)
        path.write_bytes(damaged)
        try:
            read_weights(path)
        except ValueError as error:
            assert "\n" not in str(error)


# --------------------------------------------------------------------------------- shipped weights


def test_the_registry_of_the_package_is_in_order():
    for found in shipped():
        trained = load_shipped(found)
        assert trained.card.network == found.network
        assert trained.card.recipe == found.recipe
        assert same_light_paths(trained.display, found.trained_for)
        assert found.megabytes == pytest.approx(
            (TRAINED / found.file).stat().st_size / 1e6, rel=0.05
        )
        assert found.megabytes <= 20
        assert trained.name == found.name


def test_the_display_decides_not_its_name(stocked):
    renamed = Display(ADDITIVE.spec.model_copy(update={"name": "mine", "description": "my own"}))
    assert find_shipped("unet", renamed).name == "tiny-unet"
    physical = Display.load("perspective-3")
    for other in (physical, SMALL, Display.load("multiplicative-3")):
        with pytest.raises(ValueError, match=f"for display '{other.name}'"):
            find_shipped("unet", other)
    assert shipped_networks(renamed) == sorted(NETWORKS)
    assert shipped_networks(physical) == []


def test_the_default_is_taken_where_several_fit(stocked):
    path = stocked / "tiny-unet.safetensors"
    plain = entry(path, "unet", name="plain", default=False)
    by_name = entry(path, "unet", name="best", display="additive-3")
    register(stocked, plain, by_name)
    assert find_shipped("unet", ADDITIVE).name == "best"
    register(stocked, plain)
    assert find_shipped("unet", ADDITIVE).name == "plain"


def test_shipped_weights_are_methods_by_name(stocked):
    plain, best = (
        entry(stocked / "tiny-unet.safetensors", "unet", name=name, default=name == "best")
        for name in ("plain", "best")
    )
    register(stocked, plain, best)
    field = LightField(torch.rand(25, 1, 12, 12), (5, 5))
    assert torch.equal(*(synthesize(field, ADDITIVE, method=m).layers for m in ("plain", "unet")))
    chain = synthesize(field, ADDITIVE, method="plain+sweeps", iterations=1)
    assert chain.iterations == 1
    with pytest.raises(ValueError, match="trained for 'additive-3'"):
        synthesize(field, Display.load("multiplicative-3"), method="plain")
    with pytest.raises(ValueError, match="unknown method 'plin'; did you mean 'plain'"):
        synthesize(field, ADDITIVE, method="plin")


def test_shipped_weights_are_loaded_once_and_again_when_they_change(stocked):
    found = find_shipped("unet", ADDITIVE)
    first = load_shipped(found)
    assert load_shipped(found) is first
    sha256 = write_weights(stocked / found.file, tiny("unet", seed=1), card("unet"))
    assert load_shipped(replace(found, sha256=sha256)).sha256 == sha256
    with pytest.raises(ValueError, match=r"registry expects .* install layerfield anew"):
        load_shipped(found)


def test_shipped_weights_that_cannot_be_used_are_one_line(desk, stocked):
    def said(*words: str) -> None:
        before = contents(desk)
        fails(run(*SYNTH, "--method", "unet"), *words)
        assert contents(desk) == before

    path = stocked / "tiny-unet.safetensors"
    register(stocked, entry(path, "unet", sha256="0" * 64))
    said("sha256", "000000000000...", "install layerfield anew")
    register(stocked, entry(path, "unet", file="gone.safetensors"))
    said("there is no file", "gone.safetensors")
    register(stocked, entry(path, "unet", display='link = "sum"'))
    said("the display of the shipped 'tiny-unet'")
    register(stocked, entry(path, "unet", megabytes="many"))
    said("registry.json", "megabytes", "number")
    register(stocked, entry(path, "unet", SMALL))
    said(
        "no weights of 'unet'", "'additive-3' (additive, 5x5", "(additive, 3x3", "layerfield train"
    )
    register(stocked)
    said("no weights of 'unet'", "5x5 views", "only for none", "layerfield train")
    (stocked / "registry.json").write_text("[")
    said("registry.json is not valid JSON")
    (stocked / "registry.json").unlink()
    said("cannot read", "registry.json")


def test_weights_are_listed_with_their_scores(stocked):
    lines = succeed("weights").splitlines()
    assert lines[0].split() == ["name", "network", "display", "MB", "scores", "recipe"]
    assert "tiny-unet" in lines[2]
    assert "mean psnr 31.25" in lines[2]
    assert "toys" not in lines[2]
    register(stocked)
    assert "no weights are shipped" in succeed("weights")


# ----------------------------------------------------------------------------------- their spelling


def test_every_spelling_finds_its_method():
    assert (find_method("unet").title, find_method("unet").iterations) == ("unet", 0)
    chain = find_method("stacked-cnn+sweeps")
    assert (chain.title, chain.iterations, chain.file) == ("stacked-cnn+sweeps", 3, None)
    assert find_method("unet+nmf").links == ("additive",)
    file = find_method("/home/me/runs/a+b/w.safetensors")
    assert (file.title, file.file) == ("a+b/w.safetensors", Path(file.name))
    chain = find_method("runs/a+b/w.safetensors+nmf")
    assert (chain.title, chain.file) == ("a+b/w.safetensors+nmf", Path("runs/a+b/w.safetensors"))
    assert parse_methods("unet, unet+nmf,12:30/w.safetensors,w.safetensors+nmf:4", 7) == [
        ("unet", 0),
        ("unet+nmf", 7),
        ("12:30/w.safetensors", 0),
        ("w.safetensors+nmf", 4),
    ]


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("unett", "unknown method 'unett'; did you mean 'unet'?"),
        ("unte+nmf", "unknown network 'unte' in 'unte+nmf'; did you mean 'unet'?"),
        ("unet+swaps", "unknown solver 'swaps' in 'unet+swaps'; did you mean 'sweeps'?"),
        ("nmf+unet", "'nmf' in 'nmf+unet' is a solver; expected NETWORK+SOLVER"),
        ("nmf+w.safetensors", "'nmf' in 'nmf+w.safetensors' is a solver"),
        ("unet+unet", "'unet' in 'unet+unet' is a network; expected NETWORK+SOLVER"),
        ("unet+w.safetensors", "'w.safetensors' in 'unet+w.safetensors' is a network"),
        ("unet+nmf+sweeps", "unknown network 'unet+nmf' in"),
        ("+nmf", "unknown network '' in '+nmf'"),
        ("unet+", "unknown solver '' in 'unet+'"),
    ],
)
def test_wrong_spellings_say_which_part(desk, method, words):
    fails(run(*SYNTH, "--method", method), words)
    fails(run("evaluate", "views", "--display", "additive-3", "--methods", method), words)


@pytest.mark.parametrize(
    "args",
    [
        [*SYNTH, "--method", "unet", "--iterations", "5"],
        [*SYNTH, "--method", "none.safetensors"],
        [*SYNTH, "--method", "unet", "--display", "perspective-3"],
        ["evaluate", "views", "--display", "additive-3", "--methods", "unet:3"],
        ["evaluate", "views", "--display", "multiplicative-3", "--methods", "sweeps,unet"],
        ["evaluate", "views", "--display", "multiplicative-3", "--methods", "unet+nmf"],
    ],
)
def test_nothing_is_read_before_the_method_is_good(desk, stocked, monkeypatch, args):
    for room in ("info", "fields"):
        name = f"layerfield.cli.{room}.load_light_field"
        monkeypatch.setattr(name, lambda *_: pytest.fail("was read"))
    fails(run(*args))


def test_weights_that_are_read_are_not_replaced(desk):
    (desk / "run").mkdir()
    write(desk / "run" / "w.safetensors")
    (desk / "run" / "result.json").write_text("{}")
    before = contents(desk)
    method = "run/w.safetensors+nmf"
    fails(run(*SYNTH[:-1], "run", "--force", "--method", method), "the input run/w.safetensors")
    rows = ["--json", "run/w.safetensors", "--force"]
    args = ["evaluate", "views", "--display", "additive-3", "--methods", method, *rows]
    fails(run(*args), "the input run/w.safetensors")
    assert contents(desk) == before


# ------------------------------------------------------------------------- networks as synthesizers


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("size", [(1, 1), (13, 17), (45, 61)])
def test_layers_are_what_the_network_says_clamped(stocked, scene, name, size):
    field = replace(scene, stored=scene.views[..., : size[0], : size[1]])
    solution = synthesize(field, ADDITIVE, method=name)
    trained = load_shipped(find_shipped(name, ADDITIVE))
    assert solution.layers.shape == (1, 3, 3, size[0] + 4, size[1] + 4)
    shares = []
    for c in range(3):
        with torch.no_grad():
            said = pixels(trained.network, field.views[None, :, c], (2, 2))[0]
        shares.append((said > 1).float().mean().item())
        torch.testing.assert_close(solution.layers[0, :, c], said.clamp(0, 1), atol=1e-4, rtol=0)
    assert solution.details == {
        "weights": trained.name,
        "sha256": trained.sha256,
        "clamped": pytest.approx(sum(shares) / 3, abs=1e-4),
    }
    assert (solution.iterations, solution.status) == (0, "one forward pass")
    assert solution.seconds > 0
    assert not solution.layers.requires_grad


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("size", [(45, 61), (61, 37)])
def test_tiles_make_the_same_as_the_whole(stocked, scene, monkeypatch, name, size):
    views = torch.nn.functional.interpolate(scene.views, size, mode="bilinear")
    field = replace(scene, stored=views)
    whole = synthesize(field, ADDITIVE, method=name).layers
    tiled = partial(methods.tiled_pixels, at_once=12 * 12)
    monkeypatch.setattr(methods, "tiled_pixels", tiled)
    parts = synthesize(field, ADDITIVE, method=name).layers
    torch.testing.assert_close(parts, whole, atol=1e-5, rtol=0)


@pytest.mark.parametrize("margin", [2, 3])
@pytest.mark.parametrize("size", range(40, 48))
def test_views_are_continued_about_as_far_as_in_training(size, margin):
    """Zeros follow: a network knows how far away they were around patches of whole strides."""

    class Recorder(Network):
        multiple = 8

        def pixels(self, views: torch.Tensor) -> torch.Tensor:
            assert views.shape[-2] % 8 == 0
            beyond.append(views.shape[-2] - size - 2 * margin)
            return views[:, : self.layers]

    beyond: list[int] = []
    made = pixels(Recorder(4, 2), torch.rand(1, 4, size, size), (margin, margin))
    assert made.shape == (1, 2, size + 2 * margin, size + 2 * margin)
    trained = -2 * margin % 8
    assert trained - 1 <= beyond[0] < trained + 7
    assert size % 8 or beyond[0] == trained


@pytest.mark.parametrize("size", [131, 132])
def test_the_u_net_serves_pictures_of_any_size(size):
    """No side is a multiple of its stride of 8."""
    field = procedural_light_field(size=(size, size), disparity_range=(-1.5, 1.5), seed=42)
    losses = []
    for side in (size, 128):
        cut = LightField(field.stored[..., :side, :side].contiguous(), (5, 5))
        problem = pose(cut, ADDITIVE)
        made, best = (
            problem.mean_square_error(synthesize(cut, ADDITIVE, method=name).layers)
            for name in ("unet", "fourier-admm")
        )
        losses.append(decibels(best) - decibels(made))
    assert losses[0] < losses[1] + 0.25


@pytest.mark.parametrize("name", NETWORKS)
def test_bfloat16_is_close_and_comes_back_in_float32(stocked, scene, name):
    whole = synthesize(scene, ADDITIVE, method=name).layers
    field = replace(scene, stored=scene.views.bfloat16())
    for method in (name, f"{name}+fourier-admm"):
        layers = synthesize(field, ADDITIVE, method=method).layers
        assert layers.dtype == torch.float32
        if method == name:
            error = (layers - whole).abs()
            assert error.mean() < 0.01
            assert error.flatten().quantile(0.99) < 0.1
    assert load_shipped(find_shipped(name, ADDITIVE)).network.last.weight.dtype == torch.float32


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("method", ["{}", "{}+fourier-admm"])
def test_grey_fields_and_batches_equal_single_ones(stocked, scene, name, method):
    method = method.format(name)
    small = scene.views[..., :21, :26]
    both = torch.stack([small, small.flip(-1) * 0.7])
    batch = synthesize(LightField(both, (5, 5)), ADDITIVE, method=method).layers
    assert batch.shape == (2, 1, 3, 3, 25, 30)
    for b in range(2):
        single = synthesize(LightField(both[b], (5, 5)), ADDITIVE, method=method).layers
        torch.testing.assert_close(batch[b], single, atol=1e-5, rtol=0)
    grey = synthesize(LightField(small[:, 1:2], (5, 5)), ADDITIVE, method=method).layers
    assert grey.shape == (1, 3, 1, 25, 30)
    torch.testing.assert_close(grey[:, :, 0], batch[0, :, :, 1], atol=1e-5, rtol=0)


def test_the_field_of_another_grid_is_named_first(stocked, scene):
    field = LightField(scene.views[:9], (3, 3), name="nine")
    with pytest.raises(ValueError, match=r"'nine' has 3x3 views, .* expects 5x5"):
        synthesize(field, ADDITIVE, method="unet")
    with pytest.raises(ValueError, match=r"'display' \(additive, 3x3 views.*5x5 views"):
        synthesize(field, SMALL, method="unet")


def test_what_a_network_cannot_heed_is_refused(stocked, scene):
    refused: list[tuple[dict[str, Any], str]] = [
        ({"init": torch.zeros(1, 3, 3, 49, 65)}, "'unet' is a network and takes no init"),
        ({"weights": [1.0] * 25}, "takes no view weights"),
        ({"iterations": 2}, r"makes no iterations, found 2; .* unet\+fourier-admm"),
    ]
    for options, words in refused:
        with pytest.raises(ValueError, match=words):
            synthesize(scene, ADDITIVE, method="unet", **options)
    with pytest.raises(ValueError, match="starts from the layers of its network"):
        synthesize(scene, ADDITIVE, method="unet+sweeps", init=torch.zeros(1, 3, 3, 49, 65))


# ------------------------------------------------------------------------------------------- chains


@pytest.mark.parametrize("name", NETWORKS)
def test_a_chain_starts_from_the_layers_of_the_network(stocked, scene, name):
    start = synthesize(scene, ADDITIVE, method=name)
    favoured = [2.0] + [1.0] * 24
    problem = pose(scene, ADDITIVE, favoured)
    expected = solve(problem, FourierAdmm(), iterations=2, init=start.layers, history=True)
    seen: list[int] = []
    chain = synthesize(
        scene, ADDITIVE, method=f"{name}+fourier-admm", iterations=2, weights=favoured,
        history=True, callback=lambda done, _: seen.append(done),
    )  # fmt: skip
    torch.testing.assert_close(chain.layers, expected.layers)
    assert chain.details == start.details
    assert chain.status == "one forward pass, then stopped after the 2 iterations asked for"
    assert seen == [1, 2] == [progress.iteration for progress in chain.history]
    assert 0 < chain.history[0].seconds < chain.history[1].seconds <= chain.seconds
    hasty = synthesize(scene, ADDITIVE, method=f"{name}+fourier-admm", time_limit=0)
    assert hasty.iterations == 0


def test_a_chain_is_better_than_either_alone(folder, scene):
    """Even behind a network that was trained for a second."""
    network = tiny("stacked-cnn")
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    patches = scene.views.transpose(0, 1).contiguous()
    for _ in range(60):
        layers = pixels(network, patches, (2, 2))[:, None, :, None]
        loss = (ADDITIVE(layers)[:, :, 0] - patches).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    write_weights(folder / "w.safetensors", network, card("stacked-cnn"))
    register(folder, entry(folder / "w.safetensors", "stacked-cnn"))

    def reached(method: str, iterations: int) -> float:
        layers = synthesize(scene, ADDITIVE, method=method, iterations=iterations).layers
        return psnr(ADDITIVE(layers), scene.views)

    alone = reached("stacked-cnn", 0)
    for count in (1, 3):
        chain = reached("stacked-cnn+sweeps", count)
        assert chain > max(alone, reached("sweeps", count)) + 0.2


def test_a_network_for_another_link_and_a_list_of_viewpoints(folder):
    spec = DisparitySpec(
        link="multiplicative",
        disparity=(0.5, -1.0),
        viewpoints=((0.0, 0.0), (1.0, 0.0), (-0.5, 2.0), (0.0, -1.0)),
    )
    display = Display(spec)
    write(folder / "w.safetensors", "unet", display)
    register(folder, entry(folder / "w.safetensors", "unet", display))
    field = LightField(torch.rand(4, 3, 14, 19), (2, 2))
    for method in ("unet", "unet+sweeps", "unet+fourier-admm"):
        assert synthesize(field, display, method=method).layers.shape == (1, 2, 3, 18, 21)


# -------------------------------------------------------------- evaluate, results, the command line


def test_rows_say_network_and_chain(stocked, scene):
    chosen = parse_methods("unet,stacked-cnn+nmf:2,unet+sweeps:0,nmf:0")
    small = replace(scene, stored=scene.views[..., :24, :28])
    rows = evaluate([small], [ADDITIVE], chosen)
    ((_, lines),) = tables(rows)
    assert [line[0] for line in lines[1:]] == [
        "unet",
        "stacked-cnn+nmf:2",
        "unet+sweeps:0",
        "nmf:0",
    ]
    assert [bool(row.as_record()["details"]) for row in rows] == [True, True, True, False]


def test_evaluate_runs_weight_files_in_processes_of_their_own(desk):
    (desk / "run").mkdir()
    write(desk / "run" / "w.safetensors")
    wanted = "run/w.safetensors,run/w.safetensors+fourier-admm:2"
    args = ["--display", "additive-3", "--methods", wanted, "--crop", "16x16", "--json", "rows"]
    out = succeed("evaluate", "views", *args).split()
    assert {"run/w.safetensors", "run/w.safetensors+fourier-admm:2"} < set(out)
    rows = json.loads((desk / "rows").read_text())
    assert [row["method"] for row in rows] == [
        "run/w.safetensors",
        "run/w.safetensors+fourier-admm",
    ]
    assert all(row["peak_mb"] > 1 and row["details"]["weights"] == "w" for row in rows)


@pytest.mark.parametrize("iterations", [0, 3])
def test_synth_says_and_records_what_the_network_did(desk, stocked, iterations):
    method = "unet+fourier-admm" if iterations else "unet"
    out = succeed(*SYNTH, "--method", method)
    more = f" and {iterations} iterations" if iterations else ", "
    assert f"{method} on additive-3: " in out
    assert f"after one forward pass{more}" in out
    found = json.loads((desk / "out" / "result.json").read_text())
    assert f"{100 * found['details']['clamped']:.1f} % of layer pixels clamped" in out
    assert found["details"]["weights"] == "tiny-unet"
    assert found["details"]["sha256"] == find_shipped("unet", ADDITIVE).sha256
    assert (found["method"], found["iterations"]) == (method, iterations)
    assert bool(found["solver"]) == bool(iterations)


def test_results_hold_no_paths(desk):
    path = desk / "private" / "run" / "w.safetensors"
    path.parent.mkdir(parents=True)
    write(path)
    succeed(*SYNTH, "--method", str(path))
    text = (desk / "out" / "result.json").read_text()
    assert json.loads(text)["method"] == "run/w.safetensors"
    assert "private" not in text


def test_solvers_have_no_details(scene):
    solution = synthesize(scene, ADDITIVE, iterations=1)
    assert solution.details == {}
    result = make_result(scene, ADDITIVE, solution, method="fourier-admm", bits=16)
    assert result.facts["details"] == {}


def test_the_demonstration_shows_networks_that_have_weights(stocked):
    multiplicative = Display.load("multiplicative-3")
    assert demo._methods(ADDITIVE)[-2:] == [("stacked-cnn", 0), ("unet", 0)]
    assert demo._methods(multiplicative)[-1] == ("sweeps", 10)
    assert demo._heading("unet", 0) == "unet"
    assert demo._heading("nmf", 10) == "nmf, 10 iterations"


def test_any_problem_can_be_run_by_a_method(stocked, scene):
    """What `synthesize` is made of."""
    options = methods.RunOptions(0)
    problem = Problem.of(ADDITIVE, scene.views)
    solution = find_method("unet").run(problem, ADDITIVE, options)
    assert torch.equal(solution.layers, synthesize(scene, ADDITIVE, method="unet").layers)
