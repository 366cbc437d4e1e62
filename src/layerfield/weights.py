"""Trained networks in files that describe themselves.

A weight file is safetensors: tensors, and in its metadata, under the key `layerfield`, the
`WeightsCard` as JSON. Pickles are never loaded.
"""

import copy
import hashlib
import inspect
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import torch
from pydantic import TypeAdapter, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import parse_spec
from layerfield.io.safe_output import whole_file
from layerfield.nearest import did_you_mean
from layerfield.networks import NETWORKS, Network
from layerfield.transfer import NONE, named

WEIGHT_SUFFIX = ".safetensors"
REMEDY = "train with `layerfield train RECIPE.toml` and give --method FILE.safetensors"
PICKLE_SUFFIXES = (".pt", ".pth", ".ckpt", ".pkl", ".pickle", ".bin")

_KEY = "layerfield"  # of the metadata
_PICKLE_STARTS = (b"PK", b"\x80")  # a zip of PyTorch, or a bare pickle
_LARGEST_OPTION = 1024  # a larger one comes from a damaged card, and would take all memory
_SAME_SHIFT = 1e-6  # pixels

Checked = TypeVar("Checked")


@dataclass(frozen=True)
class WeightsCard:
    """What a weight file says of itself.

    Args:
        network: key of `NETWORKS`.
        options: constructor options of the network, as width, depth, modules, skips.
        display: what it was trained for, as TOML (`format_spec`).
        recipe: name of the recipe.
        training: facts: command, steps, seconds, metrics, versions.
    """

    network: str
    options: dict[str, int | bool]
    display: str
    recipe: str
    training: dict[str, Any]


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network with its weights, ready to run.

    Args:
        network: in evaluation mode, float32, on the CPU.
        card: what its file says of it.
        display: what it was trained for.
        sha256: of the file.
        name: of the file, without suffix.
        placed: see `on`.
    """

    network: Network
    card: WeightsCard
    display: Display
    sha256: str
    name: str
    placed: dict[tuple[torch.device, torch.dtype], Network] = field(
        default_factory=dict, init=False, repr=False
    )

    def refuse_other(self, display: Display) -> None:
        """Refuse a display that the network was not trained for.

        Raises:
            ValueError: another link, transfer, view grid or shifts; names both view grids.
        """
        if not same_light_paths(self.display, display):
            raise ValueError(
                f"weights '{self.name}' were trained for '{self.display.name}' "
                f"({described(self.display)}), found display '{display.name}' "
                f"({described(display)}); take that display, or {REMEDY}"
            )

    def on(self, device: torch.device, dtype: torch.dtype) -> Network:
        """Return the network on a device and in a precision; itself if it is there already."""
        there = device, dtype
        if there not in self.placed:
            here = self.network.last.weight
            known = (here.device, here.dtype) == there
            self.placed[there] = self.network if known else copy.deepcopy(self.network).to(*there)
        return self.placed[there]


def same_light_paths(one: Display, other: Display) -> bool:
    """Say whether displays have the same laws, view grid and shifts, whatever their names."""
    laws = [(d.link.name, d.subframes, d.transfer, d.geometry.grid) for d in (one, other)]
    pair = [[c for view in d.geometry.shifts for s in view for c in s] for d in (one, other)]
    if laws[0] != laws[1] or len(pair[0]) != len(pair[1]):
        return False
    return all(math.isclose(a, b, abs_tol=_SAME_SHIFT) for a, b in zip(*pair, strict=True))


def described(display: Display) -> str:
    """Return what networks depend on, in a line."""
    grid = display.geometry.grid
    views = f"{grid[0]}x{grid[1]} views" if grid else f"{display.view_count} listed views"
    reach = max(abs(c) for view in display.geometry.shifts for shift in view for c in shift)
    law = "" if display.transfer == NONE else f", transfer {named(display.transfer)}"
    times = f"{display.subframes} subframes of " if display.subframes > 1 else ""
    layers = f"{times}{display.layer_count} layers, shifts to {reach:g} px{law}"
    return f"{display.link.name}, {views}, {layers}"


# ------------------------------------------------------------------------------------ weight files


def write_weights(
    path: str | Path, network: Network, card: WeightsCard, *, half: bool = False
) -> str:
    """Write a weight file, whole or not at all; an earlier one is replaced.

    Args:
        path: ends in .safetensors.
        network: its weights.
        card: what is to be said of it.
        half: store float16, half the size.

    Returns:
        The sha256 of the file.

    Raises:
        ValueError: weights that are not finite (in float16), or the file cannot be written.
    """
    dtype = torch.float16 if half else torch.float32
    tensors = {
        name: tensor.detach().to("cpu", dtype).contiguous()
        for name, tensor in network.state_dict().items()
    }
    _refuse_infinite(tensors, f"cannot write {path}")
    data = save(tensors, {_KEY: json.dumps(asdict(card), sort_keys=True)})
    with whole_file(path, force=True) as temporary:
        temporary.write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def read_weights(path: str | Path) -> TrainedNetwork:
    """Read a weight file.

    Raises:
        ValueError: no such file, a pickle, damaged, without a card, a card that describes no
            network, or tensors that do not fit it or are not finite.
    """
    path = Path(path)
    data = _bytes_of(path)
    tensors = _tensors(data, path)
    card = _card(data, path)
    display = Display(parse_spec(card.display, f"the display that {path} was trained for"))
    network = _network(card, display, path)
    _refuse_misfits(tensors, network.state_dict(), path)
    _refuse_infinite(tensors, f"cannot use {path}")
    network.to_empty(device="cpu").load_state_dict(tensors)
    sha256 = hashlib.sha256(data).hexdigest()
    return TrainedNetwork(network.eval(), card, display, sha256, path.stem)


def kept_weights(path: str | Path) -> TrainedNetwork:
    """Return `read_weights`, once as long as the file stays the same. Not to be changed."""
    path = Path(path)
    try:
        found = path.stat()
    except OSError:
        return read_weights(path)  # which says what is wrong
    return _kept(path.resolve(), path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=4)
def _kept(_resolved: Path, path: Path, _changed: int, _size: int) -> TrainedNetwork:
    return read_weights(path)


def _bytes_of(path: Path) -> bytes:
    if path.suffix.lower() in PICKLE_SUFFIXES:
        raise ValueError(_never_loaded(path))
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ValueError(f"there is no file {path}; expected trained weights") from None
    except OSError as error:
        raise ValueError(f"cannot read the weights {path}: {error.strerror}") from None


def _tensors(data: bytes, path: Path) -> dict[str, Tensor]:
    try:
        return load(data)
    except (SafetensorError, KeyError, AssertionError, RuntimeError) as error:
        if data.startswith(_PICKLE_STARTS) and any(data[2:8]):  # where a header's length has 0
            raise ValueError(_never_loaded(path)) from None
        raise ValueError(
            f"{path} is damaged, cut off or no safetensors file ({error}); copy or train it again"
        ) from None


def _never_loaded(path: Path) -> str:
    return (
        f"{path} is a pickle; such files can run any program and are never loaded: give weights "
        "as .safetensors, which `layerfield train` writes"
    )


def _card(data: bytes, path: Path) -> WeightsCard:
    """Return the card in a header that has been found valid."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    text = header.get("__metadata__", {}).get(_KEY)
    if text is None:
        raise ValueError(
            f"{path} does not say what network and display it is for: its metadata lacks "
            f"'{_KEY}'; give a file that `layerfield train` wrote"
        )
    return from_json(TypeAdapter(WeightsCard).validate_python, text, f"the metadata of {path}")


def from_json(validate: Callable[[Any], Checked], text: str, source: str) -> Checked:
    """Return what JSON describes.

    Raises:
        ValueError: it is no JSON, or says something else; `source` is named.
    """
    try:
        return validate(json.loads(text))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{source}: '{place}': {first['msg'].lower()}") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source} is not valid JSON: {error}") from None


def _network(card: WeightsCard, display: Display, path: Path) -> Network:
    """Return the network that a card describes, with shapes but without memory."""
    if card.network not in NETWORKS:
        near = did_you_mean(card.network, NETWORKS)
        raise ValueError(f"{path} is for an unknown network '{card.network}'{near}")
    make = NETWORKS[card.network]
    _refuse_unknown_options(card, inspect.signature(make).parameters, path)
    try:
        with torch.device("meta"):
            return make(display.view_count, display.layer_count, **card.options)
    except (ValueError, TypeError, ArithmeticError, RuntimeError):
        raise ValueError(
            f"{path}: there is no '{card.network}' with the options {listed(card.options)}"
        ) from None


def _refuse_unknown_options(card: WeightsCard, known: Iterable[str], path: Path) -> None:
    known = [name for name in known if name not in ("views", "layers")]
    for name, value in card.options.items():
        if name not in known:
            near = did_you_mean(name, known)
            raise ValueError(f"{path}: '{card.network}' has no option '{name}'{near}")
        if not 0 <= value <= _LARGEST_OPTION:
            raise ValueError(f"{path}: option '{name}' is {value}, at most {_LARGEST_OPTION} is")


def listed(options: Mapping[str, int | bool]) -> str:
    """Return the options of a network in words."""
    named = [f"{name} = {value}" for name, value in sorted(options.items())]
    return ", ".join(named) or "of its own"


def _refuse_misfits(found: dict[str, Tensor], expected: dict[str, Tensor], path: Path) -> None:
    for name in [*expected, *found]:
        has, wants = (_kind(tensors.get(name)) for tensors in (found, expected))
        if has != wants:
            raise ValueError(
                f"the weights in {path} do not fit its network: '{name}' is {has}, expected "
                f"{wants}; train it again"
            )


def _kind(tensor: Tensor | None) -> str:
    if tensor is None:
        return "missing"
    size = "x".join(map(str, tensor.shape))
    return size if tensor.is_floating_point() else f"{size} of {tensor.dtype}"


def _refuse_infinite(tensors: dict[str, Tensor], what: str) -> None:
    for name, tensor in tensors.items():
        if not tensor.float().isfinite().all():
            raise ValueError(
                f"{what}: '{name}' holds values that are not finite, the training has diverged; "
                "train with a lower rate"
            )
