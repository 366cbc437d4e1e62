"""Round layers together, so that later layers make up for the rounding of earlier ones."""

from dataclasses import dataclass

from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.nearest import did_you_mean
from layerfield.panels import Response, quantise
from layerfield.problem import Problem
from layerfield.solve import solve
from layerfield.solvers.sweeps import best_layer
from layerfield.transfer import NONE, Transfer

ROUNDINGS = ("joint", "nearest")
ROUNDING_SWEEPS = 2


@dataclass(frozen=True)
class JointRounding:
    """Sweeps over layers that can only take the codes of a panel.

    A step rounds the least-squares solution of one layer given the others. Whole-pixel shifts let
    no two pixels of one layer meet, so this is the best choice of codes for that layer.

    Args:
        responses: the codes of every layer's panel, front to back.
    """

    responses: tuple[Response, ...]

    def init(self, problem: Problem, start: Tensor | None) -> Tensor:
        return problem.flat_start() if start is None else start.clone()

    def step(self, problem: Problem, state: Tensor) -> Tensor:
        layers = state.clone()
        for k, response in enumerate(self.responses):
            best = best_layer(problem, layers, k)
            layers[..., k, :, :, :] = response.light(response.codes(best))
        return layers

    def layers(
        self, problem: Problem, state: Tensor
    ) -> Float[Tensor, "*batch subframe layer c ly lx"]:
        return state


def panel_codes(
    problem: Problem,
    layers: Float[Tensor, "*batch subframe layer c ly lx"],
    *,
    bits: int,
    rounding: str = "joint",
    transfer: Transfer = NONE,
) -> UInt[Tensor, "*batch subframe layer c ly lx"]:
    """Return layers as codes of a panel.

    Args:
        problem: what the layers show.
        layers: light, 0 to 1.
        bits: 8 or 16.
        rounding: "joint": layers together, against the views; at 16 bits, where rounding costs
            nothing, it is "nearest" all the same: each pixel by itself.
        transfer: what light the codes make.

    Raises:
        ValueError: another number of bits or kind of rounding.
    """
    if rounding not in ROUNDINGS:
        raise ValueError(f"unknown rounding '{rounding}'{did_you_mean(rounding, ROUNDINGS)}")
    if rounding == "joint" and bits == 8:
        solver = JointRounding((Response(bits, transfer),) * problem.layer_count)
        layers = solve(problem, solver, iterations=ROUNDING_SWEEPS, init=layers).layers
    return quantise(layers, bits, transfer)
