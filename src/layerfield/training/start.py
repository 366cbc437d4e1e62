"""The network that a training starts from: drawn weights, or those of a trained one."""

from collections.abc import Mapping
from pathlib import Path

import torch

from layerfield.display import Display
from layerfield.nearest import did_you_mean
from layerfield.networks import NETWORKS, Network, deepen, modules
from layerfield.networks.network import dead_layers, hand_on, initialise, level, reseed
from layerfield.shipped import load_shipped, shipped
from layerfield.training.recipe import Recipe
from layerfield.training.sources import Source
from layerfield.weights import WEIGHT_SUFFIX, TrainedNetwork, listed, read_weights, same_light_paths

_MOST_SEEDS = 100  # of a dead layer
_STARTS = ("drawn", "even", "identity")


def starting_network(
    recipe: Recipe, display: Display, source: Source, folder: Path, given: Network | None = None
) -> tuple[Network, list[str]]:
    """Return the network that training starts from, and what had to be done about dead layers.

    Args:
        recipe: its `start` says how.
        display: that is trained for.
        source: of samples that tell dead layers.
        folder: that paths in the recipe are relative to.
        given: a network to go on with instead.

    Raises:
        ValueError: a recipe whose options the network does not have, or whose `start` is none.
    """
    if given is not None:
        return given.train(), []
    generator = torch.Generator().manual_seed(recipe.seed)
    network, known, notes = _begun(recipe, display, folder, generator)
    views = display.transfer.decode(source.batch(0, recipe.batch))
    side = views.shape[-1] // network.multiple * network.multiple
    views = views[..., :side, :side].cpu()
    for _ in range(_MOST_SEEDS):
        dead = dead_layers(network, views)
        if not dead:
            break
        notes.append(f"layer {' and '.join(map(str, dead))} was dead at the start and drawn anew")
        reseed(network, dead, generator)
    if recipe.start != "drawn" and not known:
        even = display.link.to_sum(views.mean()) / display.layer_count
        level(network, views, display.link.from_sum(even).item())
    return network, notes


def _begun(
    recipe: Recipe, display: Display, folder: Path, generator: torch.Generator
) -> tuple[Network, bool, list[str]]:
    """Return the network with its first weights, whether they know the display, and notes."""
    network = network_for(recipe, display)
    if recipe.start not in _STARTS:
        trained = _named_weights(recipe.start, folder)
        notes = [f"started from the weights {trained.name} (sha256 {trained.sha256})"]
        found, wanted = modules(trained.network), modules(network)
        if found < wanted and deepen(network, trained.network):
            notes.append(f"deepened from {found} to {wanted} modules")
        else:
            refuse_other_network(network, trained, recipe)
            network.load_state_dict(trained.network.state_dict())
        # What adds up values knows how to add up densities.
        sums = network.densities and trained.display.link.is_sum
        return network, sums or same_light_paths(trained.display, display), notes
    initialise(network, generator)
    if recipe.start == "identity":
        hand_on(network)
    return network, False, []


def _named_weights(name: str, folder: Path) -> TrainedNetwork:
    """Return shipped weights by name, or those of a file, relative to the recipe."""
    entries = {entry.name: entry for entry in shipped()}
    if name in entries:
        return load_shipped(entries[name])
    if name.endswith(WEIGHT_SUFFIX):
        return read_weights(folder / name)
    near = did_you_mean(name, [*_STARTS, *entries])
    raise ValueError(f"'start' is '{name}', neither a way to start nor weights{near}")


def refuse_other_network(network: Network, trained: TrainedNetwork, recipe: Recipe) -> None:
    """Refuse weights that do not fit the network of a recipe.

    Raises:
        ValueError: another network, other options, views or layers; names both.
    """
    found, expected = (
        {key: tuple(value.shape) for key, value in each.state_dict().items()}
        for each in (trained.network, network)
    )
    if found != expected:
        theirs = _described(trained.card.network, trained.card.options, trained.network)
        raise ValueError(
            f"the weights '{trained.name}' are of a {theirs}, the recipe's network is a "
            f"{_described(recipe.network, recipe.options, network)}; take others"
        )


def _described(name: str, options: Mapping[str, int | bool], network: Network) -> str:
    """Return a network in words: what it is and what goes in and out."""
    return f"{name} ({listed(options)}) for {network.views} views and {network.layers} layers"


def network_for(recipe: Recipe, display: Display) -> Network:
    """Return an untrained network of a recipe.

    Raises:
        ValueError: an unknown network, or options it does not have.
    """
    make = NETWORKS[recipe.network]
    return make(display.view_count, display.layer_count, **recipe.options)
