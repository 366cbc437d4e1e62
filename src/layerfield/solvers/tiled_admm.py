"""The direct solver with its Fourier transforms in tiles, for pictures for which they are large."""

from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.frequencies import Spectral
from layerfield.gram import spectral_of
from layerfield.lengths import fast_length
from layerfield.problem import Problem
from layerfield.solvers.fourier_admm import AdmmState, FourierAdmm, dual_at_bounds

_LEAST_CORE = 16  # pixels of a tile that are not overlap


@dataclass(frozen=True)
class Span:
    """A tile along an axis of a torus.

    Args:
        start: first pixel that it reads, before the first one of the torus if need be.
        length: pixels that it reads, around the torus if need be.
        core: pixels of the torus that it writes.
    """

    start: int
    length: int
    core: slice

    @property
    def inner(self) -> slice:
        """The core in pixels of the tile."""
        return slice(self.core.start - self.start, self.core.stop - self.start)

    def read(self, values: Tensor, dim: int) -> Tensor:
        """Return what it reads of a torus along a dimension."""
        places = torch.arange(self.start, self.start + self.length, device=values.device)
        return values.index_select(dim, places % values.shape[dim])


@dataclass(frozen=True, eq=False)
class TiledState(AdmmState):
    """Iterate and dual on the torus of the whole picture.

    Args:
        tile: its frequencies.
        rows: of the tiles.
        columns: of the tiles.
    """

    tile: Spectral
    rows: tuple[Span, ...]
    columns: tuple[Span, ...]


@dataclass(frozen=True)
class TiledAdmm(FourierAdmm):
    """Take the steps of `FourierAdmm` with its Fourier transforms in tiles.

    All that couples far pixels in a step is (G + rho I)^-1, a convolution whose kernel fades
    exponentially: within some ten pixels, the farther the more shifts differ and the softer the
    penalty is. So a step transforms tiles with that much around them and keeps the core of each.
    All tiles take one step before any takes the next: however far light of low frequency is moved
    in the course of the iterations, the way is that of the whole picture, and there are no seams.
    (Tiles that are solved each to its end divide such light among the layers each in its own way.)
    The term for balance, of means over the whole torus, is taken there.

    Four times the layers are in memory, where the whole takes ten.

    Args:
        size: pixels of a tile along an axis, overlap included, at most.
        rest: share of the kernel that may lie outside a tile.
    """

    size: int = 1024
    rest: float = 1e-4

    def init(self, problem: Problem, start: AdmmState | Tensor | None) -> AdmmState:
        if isinstance(start, AdmmState):
            return start
        penalty = self.penalty if start is None else self.warm_penalty
        gram, weights = problem.gram, problem.weights
        whole = gram.torus
        size = (_tile_length(whole[0], self.size), _tile_length(whole[1], self.size))
        tile = spectral_of(gram.projection, weights, size, problem.views.like)
        reach = [
            0 if size[axis] == whole[axis] else _reach(tile, penalty, axis, self.rest)
            for axis in range(2)
        ]
        rows, columns = map(_spans, whole, size, reach)
        if start is None:
            shadow = problem.even_start(gram.torus)
        else:
            shadow = gram.to_torus(start + _dual(problem, start, penalty * sum(weights)))
        return TiledState(shadow, penalty, tile, rows, columns)

    def steps(self, problem: Problem, state: AdmmState, count: int) -> AdmmState:
        for _ in range(count):
            assert isinstance(state, TiledState)
            state = self._step(problem, state)
        return state

    def _step(self, problem: Problem, state: TiledState) -> TiledState:
        share = 1 / (2 * state.penalty * sum(problem.weights))
        result = state.shadow.clamp(*problem.bounds)
        right = torch.sub(result, state.shadow, alpha=0.5)
        problem.gram.from_torus(right).add_(problem.back_projected, alpha=share)
        problem.gram.add_band_(right, result, share)
        shift = self._balancing(problem, state, right)
        for rows in state.rows:
            strip = rows.read(right, -2)
            for columns in state.columns:
                part = columns.read(strip, -1)
                solved = state.tile.solved_pixels(part, state.penalty, balance=0, gain=2)
                moved = solved[..., rows.inner, columns.inner] + shift
                iterate = result[..., rows.core, columns.core]
                before = state.shadow[..., rows.core, columns.core]
                torch.add(before, moved.sub_(iterate), alpha=self.relaxation, out=moved)
                iterate.copy_(moved)
        return replace(state, shadow=result)

    def unbounded(
        self, problem: Problem, state: AdmmState
    ) -> Float[Tensor, "*batch 1 layer c ly lx"]:
        raise NotImplementedError("the certificate of an optimum comes from FourierAdmm")

    def _balancing(self, problem: Problem, state: TiledState, right: Tensor) -> Tensor:
        """What the term for balance, at frequency zero of the whole torus, adds to a solution."""
        pull = 0 if state.tile.by_row else self.balance
        mean = right.mean(dim=(-2, -1), keepdim=True)
        return (mean - mean.mean(dim=-4, keepdim=True)) * (-2 * pull / (state.penalty + pull))


def _dual(problem: Problem, layers: Tensor, rho: float) -> Tensor:
    gradient = torch.zeros_like(layers)
    problem.projection.add_normal_(gradient, layers, problem.weights)
    gradient -= problem.back_projected
    return dual_at_bounds(layers, gradient, problem.bounds, rho)


def _tile_length(length: int, size: int) -> int:
    """The whole torus where it fits, or the largest fast length that does."""
    if length <= size:
        return length
    return next(n for n in range(size - size % 2, 0, -2) if fast_length(n) == n)


def _reach(tile: Spectral, penalty: float, axis: int, rest: float) -> int:
    """Return how far the kernel of a resolvent reaches along an axis, but for the rest of it."""
    like = tile.symbol
    layers = torch.eye(len(like), dtype=like.dtype.to_complex(), device=like.device)
    # one impulse a layer, their spectrum
    impulses = layers[..., None, None, None].repeat(1, 1, 1, *like.shape[-2:])
    answers = tile.solved_frequencies(impulses, penalty, balance=0)[:, :, 0]
    kernel = tile.to_pixels(answers).abs().sum(dim=1).amax(dim=0)
    along = kernel.sum(dim=1 - axis).double().cpu()
    places = torch.arange(len(along))
    share = torch.zeros_like(along).index_add_(0, torch.minimum(places, len(along) - places), along)
    return 1 + int((share.cumsum(0) < (1 - rest) * share.sum()).sum())


def _spans(length: int, tile: int, reach: int) -> tuple[Span, ...]:
    """Divide a torus evenly into tiles that read so far to each side.

    Raises:
        ValueError: next to nothing would be left of a tile.
    """
    core = tile - 2 * reach
    if core < min(_LEAST_CORE, length):
        raise ValueError(
            f"tiles of {tile} px are too small: on this display low frequencies reach {reach} px "
            f"to each side; take tiles of {2 * reach + 4 * _LEAST_CORE} px or more"
        )
    cuts = torch.linspace(0, length, 1 - (-length // core), dtype=torch.float64).round().int()
    return tuple(
        Span(first - reach, tile, slice(first, last)) for first, last in pairwise(cuts.tolist())
    )
