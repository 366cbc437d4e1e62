"""Steps of ADMM for links that are a sum, each with constants of its own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from layerfield.frequencies import Spectral
from layerfield.kernels.blends import Blend, Shares
from layerfield.kernels.steps import steps_in_one_call
from layerfield.problem import Problem

OVERRELAXED = 1.6  # relaxation that leads nowhere astray; constants of few layers go beyond
_LAYERS = 4  # that may go as far as they want


class Constants(NamedTuple):
    """What one step of ADMM depends on.

    Args:
        penalty: rho as a share of the sum of view weights.
        relaxation: a, how far to go.
        trust: factor of the dual that enters the step.
        kept: share of the dual that the next step is given.
        momentum: share of the last change that is made once more.
    """

    penalty: float
    relaxation: float
    trust: float
    kept: float
    momentum: float

    def among(self, layers: int) -> "Constants":
        """Return the constants of a step of so many layers; see `stride`."""
        share, beyond = stride(layers), max(self.relaxation - OVERRELAXED, 0.0)
        relaxation = self.relaxation - (1 - share**2) * beyond
        return self._replace(relaxation=relaxation, momentum=share * self.momentum)


def plain_constants(penalty: float, relaxation: float = 1.0) -> Constants:
    """Return those of ADMM as it is known."""
    return Constants(penalty, relaxation, trust=1.0, kept=1.0, momentum=0.0)


def stride(layers: int) -> float:
    """Return how boldly many layers go, as a share of what few do.

    Each layer goes as if the others stayed where they are. Where many go at once, their sum or
    product goes too far: with the constants of few layers, eight end farther from the optimum after
    twelve steps than after eight.
    """
    return min(1.0, _LAYERS / layers)


def after_steps(
    problem: Problem,
    shadow: Float[Tensor, "*batch 1 layer c ty tx"],
    before: Float[Tensor, "*batch 1 layer c ty tx"] | None,
    constants: Sequence[Constants],
    balance: float,
) -> tuple[Float[Tensor, "*batch 1 layer c ty tx"], Float[Tensor, "*batch 1 layer c ty tx"] | None]:
    """Return s after steps, and of one step before.

        z = clamp(s),  u = s - z,  x = (G + rho I)^-1 (b + rho (z - trust u))
        s <- z + kept u + a (x - z) + momentum (s - s of one step ago)

    b = A^T W L + band. How many are made at once does not change what comes out.

    Args:
        problem: what to solve.
        shadow: s.
        before: s of one step ago, if there is one.
        constants: of every step.
        balance: as of `FourierAdmm`.
    """
    data, spectral, sides = problem.back_projected, problem.gram.spectral, problem.gram.sides
    if constants and sides is not None and spectral.serves(shadow, before, data):
        system = spectral.system(balance, problem.bounds)
        made = steps_in_one_call(shadow, before, data, system, sides, constants)
        if made is not None:
            return made
    for each in constants:
        right = right_hand_side(problem, shadow, right_shares(spectral, each))
        after = moved(spectral, right, shadow, before, problem.bounds, each, balance)
        del right  # as large as all layers, and there is another in the next step
        shadow, before = after, shadow
    return shadow, before


def right_hand_side(
    problem: Problem, shadow: Float[Tensor, "*batch 1 layer c ty tx"], shares: Shares
) -> Float[Tensor, "*batch 1 layer c ty tx"] | Blend:
    """Return shares of z, s and b: A^T W L, and around the views what layers show there."""
    gram, bounds = problem.gram, problem.bounds
    right = Blend(shares, shadow, bounds, problem.back_projected)
    if right.serves() and (strips := gram.strips(shadow, bounds)) is not None:
        return replace(right, strips=strips)
    planes = right.planes()
    gram.add_band_(planes, shadow, shares.other, bounds)
    return planes


def right_shares(spectral: Spectral, constants: Constants) -> Shares:
    """Of z - trust (s - z) + b / rho."""
    other = 1 / (constants.penalty * spectral.weight)
    return Shares(1 + constants.trust, -constants.trust, other)


def moved(
    spectral: Spectral,
    right: Float[Tensor, "*batch layer c ty tx"] | Blend,
    shadow: Float[Tensor, "*batch layer c ty tx"],
    before: Float[Tensor, "*batch layer c ty tx"] | None,
    bounds: tuple[float, float],
    constants: Constants,
    balance: float,
) -> Float[Tensor, "*batch layer c ty tx"]:
    """Return s after a step, from z - trust u + b / rho."""
    a, kept = constants.relaxation, constants.kept
    ago = before if constants.momentum != 0 else None
    momentum = 0.0 if ago is None else constants.momentum
    # a x + (1 - a) z + kept (s - z) + momentum (s - s of one step ago)
    shares = Shares(1 - a - kept, kept + momentum, -momentum)
    rest = Blend(shares, shadow, bounds, ago)
    return spectral.solved_pixels(right, constants.penalty, balance, gain=a, added=rest)
