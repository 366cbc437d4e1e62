"""Training: data that repeat, the loss, recipes, resuming after a kill, several processes."""

import os
import signal
import subprocess
import sys
import time
from copy import deepcopy
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from test_cli import run

from layerfield import Display, LightField, procedural_light_field, synthesize
from layerfield.links import LINKS
from layerfield.networks import NETWORKS, StackedCnn, UNet, deepen, modules
from layerfield.networks.network import dead_layers, hand_on, initialise, level, reseed
from layerfield.result import write_views
from layerfield.training.checkpoint import read_checkpoint, write_checkpoint
from layerfield.training.loop import Run, train
from layerfield.training.muon import orthogonal
from layerfield.training.objective import Objective
from layerfield.training.recipe import Loss, read_recipe, recipe_names
from layerfield.training.records import CHECKPOINT, WEIGHTS, open_run, read_history
from layerfield.training.sources import source_of, turned
from layerfield.training.start import starting_network
from layerfield.training.steps_recipe import is_of_steps, read_steps_recipe
from layerfield.weights import read_weights

TINY = """
name = "tiny"
display = "additive-3"
network = "unet"
options = { width = 4, depth = 1 }
batch = 4
epochs = 3
start = "even"

[stored]
scenes = 4
patch = 24
intensities = [1.0, 0.5]

[optimiser]
name = "adam"
rate = 1e-3

[judging]
scenes = 2
size = 24
"""
DRAWN = TINY.replace(
    "[stored]\nscenes = 4\npatch = 24\nintensities = [1.0, 0.5]",
    "[drawn]\npool = 3\nevery = 2\nsize = 32\npatch = 24\nsteps = 4",
).replace('name = "adam"\nrate = 1e-3', 'name = "muon"\nrate = 0.01\nschedule = "cosine"')
COMMAND = Path(sys.executable).with_name("layerfield")
CPU = torch.device("cpu")


def recipe(tmp_path: Path, text: str = TINY):
    path = tmp_path / "tiny.toml"
    path.write_text(text, "utf-8")
    return read_recipe(path)


def trained(tmp_path: Path, name: str, text: str = TINY, **options) -> dict[str, torch.Tensor]:
    out = tmp_path / name
    open_run(out, resume=options.get("resume", False), force=False)
    train(Run(recipe=recipe(tmp_path, text), out=out, **options))
    return load_file(out / WEIGHTS)


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor], within: float = 0.0):
    assert first.keys() == second.keys()
    return all((first[key] - second[key]).abs().max() <= within for key in first)


def test_gammas_give_the_same_scenes_other_tones(tmp_path):
    display, plain = Display.load("additive-3"), DRAWN.replace("[drawn]", "[drawn]\nGIVEN")
    found = {}
    for gamma in (1.0, 2.0):
        text = plain.replace("GIVEN", f"gammas = [{gamma}, {gamma}]\nintensities = [0.5, 0.5]")
        found[gamma] = source_of(recipe(tmp_path, text), display, tmp_path, CPU).batch(3, 1)
    torch.testing.assert_close(found[2.0] / 0.5, (found[1.0] / 0.5) ** 2)


@pytest.mark.parametrize("text", [TINY, DRAWN])
def test_batches_depend_on_seed_and_step_alone(tmp_path, text):
    display, chosen = Display.load("additive-3"), recipe(tmp_path, text)
    first, second = (source_of(chosen, display, tmp_path, CPU) for _ in range(2))
    for step in (0, 1, 5):
        first.batch(step, 4)
    assert torch.equal(first.batch(5, 4), second.batch(5, 4))
    assert not torch.equal(second.batch(5, 4), second.batch(6, 4))
    other = source_of(chosen.model_copy(update={"seed": 1}), display, tmp_path, CPU)
    assert not torch.equal(other.batch(5, 4), second.batch(5, 4))


def test_an_epoch_of_stored_samples_is_one_pass(tmp_path):
    source = source_of(recipe(tmp_path), Display.load("additive-3"), tmp_path, CPU)
    assert source.facts()["samples"] == 4 * 2 * 3
    for epoch in range(2):
        parts = [source.batch(epoch * 5 + n, 5) for n in range(source.steps(5))]
        assert torch.cat(parts).flatten(1).unique(dim=0).shape[0] == 24


def test_training_validation_and_test_scenes_are_disjoint(tmp_path):
    source = source_of(recipe(tmp_path), Display.load("additive-3"), tmp_path, CPU)
    sets = source.sets(recipe(tmp_path))
    scenes = torch.cat([sets["train"], sets["validation"], sets["test"]]).flatten(1)
    assert torch.cdist(scenes, scenes).add(torch.eye(len(scenes)) * 9).min() > 1


def test_a_joint_turn_is_a_light_field_of_the_same_display():
    """The turned views of a scene obey the display's geometry: a point still moves as it must."""
    display = Display.load("additive-3")
    layers = torch.rand(2, 1, 3, 1, 20, 20)
    shown = display(layers)[:, :, 0]
    for seed in range(4):
        views = turned(shown, (5, 5), torch.Generator().manual_seed(seed))
        images = layers[:, 0, :, 0]
        generator = torch.Generator().manual_seed(seed)
        transpose, half = (torch.rand(2, generator=generator) < 0.5).tolist()
        images = images.transpose(-1, -2) if transpose else images
        images = images.flip(-1, -2) if half else images
        assert torch.allclose(display(images[:, None, :, None])[:, :, 0], views, atol=1e-6)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("regulariser", ["range", "energy"])
@pytest.mark.parametrize("clamped", [False, True])
def test_the_loss_is_its_formula(link, regulariser, clamped):
    display = Display.load(f"{link}-3")
    network = UNet(25, 3, width=4, depth=1)
    initialise(network, torch.Generator().manual_seed(3))
    views = torch.rand(2, 25, 16, 16)
    with torch.no_grad():
        network.last.weight *= 3  # so that some values are above 1
    chosen = Loss(regulariser=regulariser, weight=0.7, clamped=clamped)
    loss = Objective(network, display, chosen)(views)
    padded = torch.nn.functional.pad(views, (2, 2, 2, 2), mode="replicate")
    values = network.pixels(padded)
    assert (values > 1).any()
    light = values.clamp(0, 1) if clamped else values.relu()
    shown = display(light[:, None, :, None])[:, :, 0]
    error = ((shown - views) ** 2).mean()
    outside = torch.where(values > 1, values - 1, torch.where(values < 0, values, 0.0))
    penalty = outside if regulariser == "range" else values
    assert torch.allclose(loss, error + 0.7 * (penalty**2).mean(), rtol=1e-5)


@pytest.mark.parametrize("densities", [False, True])
@pytest.mark.parametrize("name", NETWORKS)
def test_dead_layers_are_found_and_drawn_anew(name, densities):
    network = NETWORKS[name](25, 3, width=4, densities=densities)
    generator = torch.Generator().manual_seed(0)
    initialise(network, generator)
    views = torch.rand(2, 25, 16, 16)
    level(network, views, 0.2)
    logarithms = network.pixels(views).log().mean(dim=(0, 2, 3)).exp()
    means = logarithms if densities else network.pixels(views).mean(dim=(0, 2, 3))
    assert torch.allclose(means, torch.full((3,), 0.2), atol=1e-5)
    with torch.no_grad():
        network.last.weight[1] = -network.last.weight[1].abs()
    assert dead_layers(network, views) == [1]
    kept = network.last.weight[0].clone()
    reseed(network, [1], generator)
    assert torch.equal(network.last.weight[0], kept)


def test_orthogonal_keeps_directions_and_levels_their_strength():
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(12, 30, generator=generator)
    for given in (matrix, matrix.T):
        strengths = torch.linalg.svdvals(orthogonal(given))
        assert strengths.min() > 0.6 and strengths.max() < 1.3


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folders of trainings that nothing interrupted, by recipe."""
    folder = tmp_path_factory.mktemp("whole")
    for name, text in (("stored", TINY), ("drawn", DRAWN)):
        trained(folder, name, text)
    return {TINY: folder / "stored", DRAWN: folder / "drawn"}


@pytest.mark.parametrize("text", [TINY, DRAWN])
def test_a_resumed_training_ends_where_an_uninterrupted_one_does(tmp_path, whole, text):
    shorter = text.replace("epochs = 3", "epochs = 2")
    if "cosine" in text:  # the schedule depends on the number of epochs: break off instead
        stop = _Stop(after=2)
        with pytest.raises(KeyboardInterrupt):
            trained(tmp_path, "parts", text, tick=stop)
    else:
        trained(tmp_path, "parts", shorter)
    ended = trained(tmp_path, "parts", text, resume=True)
    assert same(ended, load_file(whole[text] / WEIGHTS))
    rows = [read_history(folder) for folder in (whole[text], tmp_path / "parts")]
    for one, other in zip(*rows, strict=True):
        assert {**one, "seconds": 0} == {**other, "seconds": 0}


def test_recipes_in_checkpoints_may_be_older_but_not_others(tmp_path, monkeypatch):
    """A key added since then has its default; one that is no longer known is one line."""
    monkeypatch.chdir(tmp_path)
    trained(tmp_path, "parts", TINY.replace("epochs = 3", "epochs = 1"))
    path = tmp_path / "parts" / CHECKPOINT
    found = read_checkpoint(path)
    del found.facts["recipe"]["loss"]["clamped"]
    write_checkpoint(path, found)
    recipe(tmp_path, TINY.replace("epochs = 3", "epochs = 2"))
    resumed = ["train", "tiny.toml", "--out", "parts", "--resume"]
    assert run(*resumed).status == 0
    recipe(tmp_path, TINY.replace("batch = 4", "batch = 5"))
    assert "another recipe: 'batch' was 4, now it is 5; give another --out" in run(*resumed).err
    found.facts["recipe"]["loss"]["tone"] = 1
    write_checkpoint(path, found)
    wrong = run(*resumed)
    assert (wrong.status, wrong.out) == (2, "")
    assert wrong.err == "layerfield: the recipe in parts: unknown key 'loss.tone'" + (
        "; known are clamped, error, regulariser, weight\n"
    )


def test_tensorboard_reads_a_run_and_its_files_name_no_machine(tmp_path):
    stop = _Stop(after=2)
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path, "parts", tick=stop)
    trained(tmp_path, "parts", resume=True)
    folder = tmp_path / "parts" / "tensorboard"
    assert sorted(path.name for path in folder.iterdir()) == [
        f"events.out.tfevents.000000000{n}" for n in range(2)
    ]
    found = EventAccumulator(str(folder)).Reload().Scalars("validation_psnr")
    rows = read_history(tmp_path / "parts")
    assert [event.step for event in found] == [row["step"] for row in rows]
    assert [event.value for event in found] == pytest.approx(
        [row["validation_psnr"] for row in rows], rel=1e-6
    )


class _Stop:
    """Interrupts a training at the start of an epoch."""

    def __init__(self, after: int) -> None:
        self.after = after

    def __call__(self, what: str, done: int) -> None:
        if done == self.after:
            raise KeyboardInterrupt


def test_a_killed_training_goes_on(tmp_path, whole):
    recipe(tmp_path, DRAWN)
    command = [COMMAND, "train", "tiny.toml", "--out", "killed"]
    process = subprocess.Popen(command, cwd=tmp_path, env=os.environ | {"OMP_NUM_THREADS": "1"})
    checkpoint = tmp_path / "killed" / CHECKPOINT
    while not checkpoint.exists() and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = run("train", tmp_path / "tiny.toml", "--out", tmp_path / "killed", "--resume")
    assert done.status == 0, done.err
    ended = load_file(tmp_path / "killed" / WEIGHTS)
    assert same(ended, load_file(whole[DRAWN] / WEIGHTS), within=1e-6)


@pytest.mark.parametrize("write", range(9))
def test_a_fault_at_any_write_loses_nothing(tmp_path, monkeypatch, whole, write):
    """Every file of a run is renamed into place; the n-th of these renames fails."""
    rename, seen = Path.replace, []

    def faulty(self, target):
        if "broken" in str(target):
            seen.append(target)
            if len(seen) == write + 1:
                raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "replace", faulty)
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path, "broken")
    monkeypatch.undo()
    out = tmp_path / "broken"
    assert not [p for p in out.iterdir() if p.name.startswith(".")]
    resume = (out / CHECKPOINT).exists()
    open_run(out, resume=resume, force=True)
    train(Run(recipe=recipe(tmp_path), out=out, resume=resume))
    assert same(load_file(out / WEIGHTS), load_file(whole[TINY] / WEIGHTS))


def test_two_processes_train_as_one(tmp_path, whole):
    recipe(tmp_path)
    done = run("train", tmp_path / "tiny.toml", "--out", tmp_path / "two", "--devices", "2")
    assert done.status == 0, done.err
    ended = load_file(tmp_path / "two" / WEIGHTS)
    assert same(ended, load_file(whole[TINY] / WEIGHTS), within=1e-5)


def test_a_network_is_adapted_to_a_field(tmp_path, monkeypatch, whole):
    monkeypatch.chdir(tmp_path)
    recipe(tmp_path)
    start = whole[TINY] / WEIGHTS
    field = procedural_light_field(size=(40, 48), seed=5)
    write_views(tmp_path / "views", field.views, Display.load("additive-3"), 8)
    adapt = ["train", "tiny.toml", "--adapt", "views", "--weights", str(start)]
    done = run(*adapt, "--out", "adapted")
    assert done.status == 0, done.err
    before, after = (
        Display.load("additive-3")(layers_by(path, field))
        for path in (start, tmp_path / "adapted" / WEIGHTS)
    )
    assert (after - field.views).square().mean() < (before - field.views).square().mean()


def test_weights_of_another_network_are_not_adapted(tmp_path, monkeypatch, whole):
    monkeypatch.chdir(tmp_path)
    recipe(tmp_path, TINY.replace("width = 4", "width = 8"))
    field = procedural_light_field(size=(40, 48), seed=5)
    write_views(tmp_path / "views", field.views, Display.load("additive-3"), 8)
    given = ["--weights", str(whole[TINY] / WEIGHTS), "--out", "adapted"]
    done = run("train", "tiny.toml", "--adapt", "views", *given)
    assert done.status == 2
    assert "'weights' are of a unet (depth = 1, width = 4) for 25 views and 3 layers" in done.err
    assert "the recipe's network is a unet (depth = 1, width = 8) for 25 views" in done.err
    assert not (tmp_path / "adapted").exists()


def layers_by(path: Path, field: LightField) -> torch.Tensor:
    return synthesize(field, Display.load("additive-3"), method=str(path)).layers


WRONG = {
    "unknown key": ('batch = 4\nbacth = 4', "unknown key 'bacth'; did you mean 'batch'"),
    "unknown key in a table": ("scenes = 4\nsceens = 4", "unknown key 'stored.sceens'"),
    "wrong type": ('batch = "four"', "'batch' is 'four'"),
    "negative rate": ("rate = -1e-3", "'optimiser.rate' is -0.001"),
    "unknown network": ('network = "unnet"', "unknown network 'unnet'; did you mean 'unet'"),
    "unknown option": ("options = { widht = 4 }", "unknown key 'options.widht'"),
    "option of nothing": ("options = { width = 0 }", "'options.width' is 0, expected a whole"),
    "option of a switch": ("options = { skips = 2 }", "'options.skips' is 2, expected true"),
    "option of a number": ("options = { depth = true }", "'options.depth' is True"),
    "unknown display": ('display = "additive-4"', "unknown display 'additive-4'"),
    "no patches": ("patch = 2", "'stored.patch' is 2"),
    "two sources": ("[fields]\nfolder = 'x'\npatch = 24\n[judging]", "found [stored] and [fields]"),
    "symmetries of a stored set": ("batch = 4\nsymmetries = true", "'symmetries' turns samples"),
    "not TOML": ("batch = = 4", "is not valid TOML"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_recipe_is_one_line(tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    line, expected = WRONG[case]
    key = line.split("\n")[-1] if line.endswith("[judging]") else line.split("=")[0].strip()
    lines = TINY.splitlines()
    (place,) = [n for n, old in enumerate(lines) if old.startswith(key)][:1]
    Path("wrong.toml").write_text("\n".join([*lines[:place], line, *lines[place + 1 :]]))
    done = run("train", "wrong.toml")
    assert done.status == 2
    assert expected in done.err.replace("\n", " ")
    assert len(done.err.strip().splitlines()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["wrong.toml"]


def test_other_wrong_trainings_are_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.toml").write_text(TINY)
    missing = TINY.replace("[stored]\nscenes = 4", "[fields]\nfolder = 'none'").replace(
        "intensities = [1.0, 0.5]", ""
    )
    Path("missing.toml").write_text(missing)
    twice = [
        'name = "twice"',
        'link = "multiplicative"',
        "disparity = [1, 0, -1]",
        "views = [5, 5]",
    ]
    Path("twice.toml").write_text("\n".join([*twice, "subframes = 2"]))
    Path("flicker.toml").write_text(TINY.replace('"additive-3"', '"twice.toml"'))
    cases = {
        "train flicker.toml": "display 'twice' has 2 subframes",
        "train quikc": "unknown recipe 'quikc'; did you mean 'quick'",
        "train missing.toml": "there is no folder none",
        "train tiny.toml --resume": "holds no checkpoint.safetensors to resume from",
        "train tiny.toml --adapt none --weights tiny.toml": "none",
    }
    for command, expected in cases.items():
        done = run(*command.split())
        assert done.status == 2
        assert expected in done.err, done.err
        assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize("name", [name for name in recipe_names() if not is_of_steps(name)])
def test_recipes_that_ship_are_valid(name):
    found = read_recipe(f"recipes/{name}.toml")
    assert found.name == name
    assert Display.load(found.display).view_count == 25
    network = NETWORKS[found.network](25, 3, **found.options)
    assert sum(p.numel() for p in network.parameters()) < 10e6


@pytest.mark.parametrize("name", [name for name in recipe_names() if is_of_steps(name)])
def test_recipes_of_steps_that_ship_are_valid(name):
    assert read_steps_recipe(f"recipes/{name}.toml").name == name


def test_a_training_may_start_from_trained_weights(tmp_path, whole):
    """On the same display they stay as they are; on another one their layers are levelled."""
    weights = whole[TINY] / WEIGHTS
    stored = load_file(weights)
    for link, same_display in (("additive", True), ("multiplicative", False)):
        text = TINY.replace("additive-3", f"{link}-3").replace('"even"', f'"{weights}"')
        chosen = recipe(tmp_path, text)
        display = Display.load(chosen.display)
        source = source_of(chosen, display, tmp_path, CPU)
        network, notes = starting_network(chosen, display, source, tmp_path)
        assert "started from the weights weights (sha256" in notes[0]
        found = network.state_dict()
        assert torch.equal(found["entry.0.weight"], stored["entry.0.weight"])
        assert torch.equal(found["last.weight"], stored["last.weight"]) == same_display
    network, _ = starting_network(chosen, display, source, tmp_path)
    mean = network.pixels(source.batch(0, 4)).mean(dim=(0, 2, 3))
    assert torch.allclose(mean, source.batch(0, 4).mean().pow(1 / 3).expand(3), atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_on_densities_adds_what_multiplies(name):
    """The logarithm of its layers is what the same weights make of the views' logarithms."""
    plain, dense = (NETWORKS[name](25, 3, width=4, densities=d) for d in (False, True))
    dense.load_state_dict(plain.state_dict())
    views = torch.rand(2, 25, 16, 16)
    views[:, :, 0, 0] = 0
    views[:, :, 0, 1] = 1
    logarithms = views.clamp(min=1 / 128).log() / -(7 * torch.tensor(2.0).log())
    assert logarithms.max() == 1
    assert logarithms.min() == 0
    expected = 128 ** -plain.pixels(logarithms)
    assert torch.allclose(dense.pixels(views), expected, rtol=1e-5)
    assert dense(views).isfinite().all()


def test_weights_that_add_start_those_that_multiply_as_they_are(tmp_path, whole):
    text = TINY.replace("additive-3", "multiplicative-3").replace(
        '"even"', f'"{whole[TINY] / WEIGHTS}"'
    )
    chosen = recipe(tmp_path, text.replace("depth = 1", "depth = 1, densities = true"))
    display = Display.load(chosen.display)
    source = source_of(chosen, display, tmp_path, CPU)
    network, _ = starting_network(chosen, display, source, tmp_path)
    assert torch.equal(network.last.weight, load_file(whole[TINY] / WEIGHTS)["last.weight"])


def test_a_stack_may_hand_on_its_input():
    network = StackedCnn(25, 3, width=32, modules=6)
    initialise(network, torch.Generator().manual_seed(0))
    hand_on(network, share=0.0)
    views = torch.rand(1, 25, 12, 12)
    assert torch.equal(network.stack(views)[:, :25], views)


def test_a_deep_stack_may_start_from_a_shallow_one(tmp_path, monkeypatch):
    """At first it gives the same layers; then it learns."""
    monkeypatch.chdir(tmp_path)
    shallow = TINY.replace('"unet"', '"stacked-cnn"').replace("depth = 1", "modules = 2")
    recipe(tmp_path, shallow)
    assert run("train", "tiny.toml", "--out", "shallow").status == 0
    deep = shallow.replace("modules = 2", "modules = 5").replace(
        '"even"', '"shallow/weights.safetensors"'
    )
    chosen = recipe(tmp_path, deep)
    display = Display.load(chosen.display)
    source = source_of(chosen, display, tmp_path, CPU)
    network, notes = starting_network(chosen, display, source, tmp_path)
    assert notes[1] == "deepened from 2 to 5 modules"
    known = read_weights(tmp_path / "shallow" / WEIGHTS).network
    views = source.batch(0, 4)
    assert torch.equal(network.pixels(views), known.pixels(views))
    done = run("train", "tiny.toml", "--out", "deep")
    assert done.status == 0
    assert "deepened from 2 to 5 modules" in done.out
    wider = recipe(tmp_path, deep.replace("width = 4", "width = 8"))
    with pytest.raises(ValueError, match=r"modules = 2, width = 4.*modules = 5, width = 8"):
        starting_network(wider, display, source, tmp_path)


def test_a_u_net_may_get_more_convolutions_on_its_first_level():
    """They hand on what they get: the same layers, at first from farther away."""
    known, deep = UNet(9, 2, width=4, depth=2), UNet(9, 2, width=4, depth=2, first=5)
    assert deepen(deep, known)
    views = torch.rand(1, 9, 16, 20)
    assert torch.equal(deep.pixels(views), known.pixels(views))
    assert (modules(known), modules(deep)) == (10, 16)
    assert (known.reach, deep.reach) == (26, 32)
    before = deepcopy(deep.state_dict())
    assert not deepen(deep, UNet(9, 2, width=8, depth=2))
    assert all(torch.equal(value, before[key]) for key, value in deep.state_dict().items())


@pytest.mark.parametrize("start", ["evne", "none.safetensors", "other"])
def test_a_wrong_start_is_one_line_and_replaces_nothing(tmp_path, monkeypatch, whole, start):
    monkeypatch.chdir(tmp_path)
    trained(tmp_path, "before")
    kept = (tmp_path / "before" / WEIGHTS).read_bytes()
    given = whole[TINY] / WEIGHTS if start == "other" else start
    text = TINY.replace('"even"', f'"{given}"').replace("width = 4", "width = 8")
    Path("wrong.toml").write_text(text)
    done = run("train", "wrong.toml", "--out", "before", "--force")
    assert done.status == 2
    expected = {
        "evne": "did you mean 'even'",
        "none.safetensors": "there is no file none.safetensors",
        "other": "width",
    }
    assert expected[start] in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert (tmp_path / "before" / WEIGHTS).read_bytes() == kept
