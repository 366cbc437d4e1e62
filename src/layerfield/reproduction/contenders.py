"""Who is compared: the paper's networks, those trained beyond it, and the solvers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from layerfield.display import Display
from layerfield.shipped import TRAINED, find_shipped, shipped_networks

CNN, UNET = "stacked-cnn", "unet"
RECIPES = {CNN: "gao2024-stacked-cnn", UNET: "gao2024-unet"}
BETTER_CNN, BETTER_UNET = "better stacked-cnn", "better unet"
ITERATIVE, DIRECT = "nmf", "fourier-admm"
PAPER_ITERATIONS = 100  # of the iterative algorithm beside the networks in figure 5
DIRECT_ITERATIONS = 10

_NETWORKS = {CNN: "stacked CNN", UNET: "U-Net"}


@dataclass(frozen=True)
class Contender:
    """One way to make layers, under the name and colour it has in every figure.

    Args:
        key: in code and files.
        label: in figures and texts.
        method: that `synthesize` takes.
        iterations: to make; None for networks.
    """

    key: str
    label: str
    method: str
    iterations: int | None = None


SOLVERS = (
    Contender(ITERATIVE, f"NMF, {PAPER_ITERATIONS} iterations", ITERATIVE, PAPER_ITERATIONS),
    Contender(DIRECT, f"direct, {DIRECT_ITERATIONS} iterations", DIRECT, DIRECT_ITERATIONS),
)

COURSES = {"nmf": "NMF", "sart": "SART", "gradient": "projected gradient"}
STARTS = {
    "nmf": "from constant layers, multiplicative updates, which have no step size",
    "sart": "from constant layers, relaxation 0.3, clamped after every view",
    "gradient": "from constant layers, step 1 / (layers x views), Nesterov momentum with restart",
}

COLOURS = {  # after Okabe and Ito, told apart with any kind of colour vision
    CNN: "#E69F00",
    UNET: "#0072B2",
    BETTER_CNN: "#D55E00",
    BETTER_UNET: "#56B4E9",
    "nmf": "#009E73",
    "sart": "#CC79A7",
    "gradient": "#7A5C00",
    DIRECT: "#707070",
    "optimum": "#000000",
}


def faithful(weights: dict[str, Path | None]) -> list[Contender]:
    """Return the paper's networks, as far as their weights are there."""
    return [
        Contender(network, _NETWORKS[network], str(path))
        for network, path in weights.items()
        if path is not None
    ]


def improved(display: Display, others: Sequence[Contender]) -> list[Contender]:
    """Return the shipped defaults that are not among the others."""
    found = []
    taken = {each.method for each in others}
    for network, key in ((CNN, BETTER_CNN), (UNET, BETTER_UNET)):
        if network in shipped_networks(display):
            entry = find_shipped(network, display)
            path = str(TRAINED / entry.file)
            if path not in taken and entry.recipe not in RECIPES.values():
                found.append(Contender(key, f"{_NETWORKS[network]}, better trained", path))
    return found
