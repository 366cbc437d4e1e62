"""The state of a training in one file: safetensors, written whole or not at all."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from layerfield.io import whole_file


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Everything that the rest of a training depends on, beside its recipe.

    Args:
        tensors: of network and optimisers.
        facts: step, history and whatever else is plain data.
    """

    tensors: dict[str, Tensor]
    facts: dict[str, Any]


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the one that was there stays until the new one is complete."""
    held = checkpoint.tensors.items()
    tensors = {key: tensor.detach().cpu().contiguous() for key, tensor in held}
    with whole_file(path, force=True) as temporary:
        save_file(tensors, temporary, {"training": json.dumps(checkpoint.facts)})


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        ValueError: not there, or not written by this program.
    """
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads((file.metadata() or {})["training"])
            return Checkpoint({key: file.get_tensor(key) for key in file.keys()}, facts)  # noqa: SIM118
    except FileNotFoundError:
        raise ValueError(f"there is no {path} to resume from; start without --resume") from None
    except (SafetensorError, KeyError, ValueError, OSError):
        raise ValueError(f"{path} is not a checkpoint of layerfield; start anew") from None


def state_of(network: nn.Module, optimisers: list[torch.optim.Optimizer]) -> dict[str, Tensor]:
    """Return the tensors of a network and its optimisers under flat names."""
    tensors = {f"network.{key}": value for key, value in network.state_dict().items()}
    for n, optimiser in enumerate(optimisers):
        for index, state in optimiser.state_dict()["state"].items():
            tensors |= {f"optimiser.{n}.{index}.{key}": value for key, value in state.items()}
    return tensors


def restore(
    tensors: dict[str, Tensor], network: nn.Module, optimisers: list[torch.optim.Optimizer]
) -> None:
    """Put the tensors of `state_of` back."""
    mark = "network."
    own = {k.removeprefix(mark): v for k, v in tensors.items() if k.startswith(mark)}
    network.load_state_dict(own)
    for n, optimiser in enumerate(optimisers):
        whole = optimiser.state_dict()
        states: dict[int, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith(f"optimiser.{n}."):
                _, _, index, name = key.split(".", 3)
                states.setdefault(int(index), {})[name] = value
        optimiser.load_state_dict(whole | {"state": states})
