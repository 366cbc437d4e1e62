"""Layer counts and depths that suit given light fields.

Disparities of layers are places on an axis that covers the scenes. In closed form all evenly spaced
stacks are compared. Then layers are moved one by one, from the best of those and from a stack that
was grown layer by layer. What is suggested is solved: the closed form knows no bounds on layers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import DisparitySpec
from layerfield.light_field import LightField
from layerfield.links import LINKS, Link
from layerfield.metrics import decibels, mean_square_error
from layerfield.spectrum import Errors, Spectrum, predicted_error, spectrum
from layerfield.synthesizer import synthesize

USUAL = (1.0, 0.0, -1.0)  # the disparities that designs are compared with
MOST_LAYERS = 8
LARGEST = 400  # pixels of what is solved, along each side
_PLACES = 65
_COARSE, _FINEST = 0.5, 1 / 32  # pixels per view step, between places
_WIDEST = 16.0  # disparity looked for, pixels per view step
_FINDERS = 4  # layers that find out where a scene is
_EVERY = 4  # all stacks are compared at this share of the frequencies, the best 65 at all
_GAIN = 1e-3  # of a round of moves, below which it ends
_WORTH = 0.01  # an uneven stack must be better by this share, 0.04 dB


@dataclass(frozen=True)
class Suggestion:
    """A stack of layers.

    Args:
        name: of its display: `design-3`, and `design-3-even` where the former is not even.
        disparity: of every layer, pixels per view step, front to back.
        predicted: mean square error by the closed form, the mean over the light fields.
        solved: the same of the solver's layers, on the middle of the views.
    """

    name: str
    disparity: tuple[float, ...]
    predicted: float
    solved: float


@dataclass(frozen=True)
class Design:
    """What suits some light fields.

    Args:
        fields: their names.
        link: of the displays.
        grid: (rows, columns) of the views.
        suggestions: in order of layers.
        usual: the display with disparities 1, 0, -1.
    """

    fields: tuple[str, ...]
    link: str
    grid: tuple[int, int]
    suggestions: tuple[Suggestion, ...]
    usual: Suggestion

    def gain(self, suggestion: Suggestion) -> float:
        """Return how many dB a suggestion is better than disparities 1, 0, -1."""
        return decibels(suggestion.solved) - decibels(self.usual.solved)

    def spec(self, suggestion: Suggestion) -> DisparitySpec:
        """Return a suggestion as a display file holds it."""
        return DisparitySpec(
            name=suggestion.name,
            description=f"designed for {', '.join(self.fields)}",
            link=self.link,  # pyright: ignore[reportArgumentType]  one of LINKS
            disparity=suggestion.disparity,
            views=self.grid,
        )


def parse_layers(text: str) -> tuple[int, ...]:
    """Parse the layer counts to design for.

    Raises:
        ValueError: not numbers from 1 to 8.

    >>> parse_layers("3,2")
    (2, 3)
    """
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() and 1 <= int(word) <= MOST_LAYERS for word in words):
        raise ValueError(
            f"found layers '{text}', expected numbers from 1 to {MOST_LAYERS}, as 1,2,3"
        )
    return tuple(sorted({int(word) for word in words}))


def refuse_unfit(fields: Sequence[LightField]) -> None:
    """Refuse light fields for which there is nothing to design.

    Raises:
        ValueError: a single view, or different view grids.
    """
    for field in fields:
        if field.grid == (1, 1):
            raise ValueError(
                f"'{field.name}' has a single view, which no depth suits better than another; "
                "take a light field of more views"
            )
        if field.grid != fields[0].grid:
            found, first = ("{}x{}".format(*f.grid) for f in (field, fields[0]))
            raise ValueError(
                f"'{field.name}' has {found} views and '{fields[0].name}' {first}; one display "
                f"serves one grid: choose the same views with --views"
            )


def design(
    fields: Sequence[LightField],
    link: str,
    layers: Sequence[int],
    *,
    tick: Callable[[str], None] = lambda _: None,
) -> Design:
    """Find the displays that suit light fields best, all of them together, and solve them.

    Args:
        fields: of one view grid.
        link: "additive" or "multiplicative".
        layers: counts to design for.
        tick: called with a word on what is being done, for progress displays.

    Raises:
        ValueError: a single view, or different view grids.
    """
    refuse_unfit(fields)
    tick("reading spectra")
    spectra = [centred_spectrum(field, LINKS[link]) for field in fields]
    axis = _axis(spectra, min(map(_widest, fields)))
    search = Search(spectra, axis)

    middles = [middle(field) for field in fields]

    def judged(name: str, disparity: tuple[float, ...]) -> Suggestion:
        tick(f"solving {name}")
        predicted = sum(predicted_error(each, disparity) for each in spectra) / len(spectra)
        errors = [solved_error(field, link, disparity) for field in middles]
        return Suggestion(name, disparity, predicted, sum(errors) / len(errors))

    found: list[Suggestion] = []
    for count in layers:
        tick(f"looking for {count} layers")
        even = search.even(count)
        free = search.free(even)
        best = even if search.gain(even, free) < _WORTH else free
        found.append(judged(f"design-{count}", search.disparity(best)))
        if best is not even:
            found.append(judged(f"design-{count}-even", search.disparity(even)))
    names = tuple(field.name for field in fields)
    return Design(names, link, fields[0].grid, tuple(found), judged("usual", USUAL))


def middle(field: LightField, largest: int = LARGEST) -> LightField:
    """Return the middle of large views: what it asks for takes less time and says enough."""
    (height, width), stored = field.size, field.stored
    y, x = (max(0, (size - largest) // 2) for size in (height, width))
    return LightField(
        stored[..., y : height - y, x : width - x][..., :largest, :largest], field.grid, field.name
    )


def solved_error(
    field: LightField, link: str, disparity: Sequence[float], iterations: int | None = None
) -> float:
    """Return the mean square error of the direct solver's layers.

    Args:
        field: the views.
        link: of the display.
        disparity: of its layers, front to back.
        iterations: the method's own number if not given; after the start in logarithms two, as
            more gain little.
    """
    spec = DisparitySpec(link=link, disparity=tuple(disparity), views=field.grid)  # pyright: ignore[reportArgumentType]
    display = Display(spec)
    count = 2 if iterations is None and not display.link.is_sum else iterations
    solution = synthesize(field, display, method="fourier-admm", iterations=count)
    return mean_square_error(display(solution.layers), field.views)


class Search:
    """Looks for stacks of layers on an axis of disparities, by the sum of predicted errors.

    Args:
        spectra: of the light fields.
        axis: disparities from near to far, evenly spaced.
    """

    def __init__(self, spectra: Sequence[Spectrum], axis: Sequence[float]) -> None:
        self.axis = tuple(axis)
        self._spectra = spectra
        self._tables = [Errors(each, axis) for each in spectra]

    @cached_property
    def _rough(self) -> list[Errors]:
        return [Errors(each.thinned(_EVERY), self.axis) for each in self._spectra]

    def disparity(self, stack: Int[Tensor, " layer"]) -> tuple[float, ...]:
        """Return the disparities of a stack of places."""
        return tuple(self.axis[place] for place in stack)

    def errors(self, stacks: Int[Tensor, "n layer"]) -> Float[Tensor, " n"]:
        """Return the errors of stacks of places, summed over the light fields."""
        return _summed(self._tables, stacks)

    def even(self, layers: int) -> Int[Tensor, " layer"]:
        """Return the best stack of evenly spaced layers."""
        stacks = even_stacks(len(self.axis), layers)
        if len(stacks) > _PLACES:
            stacks = stacks[_summed(self._rough, stacks).argsort()[:_PLACES]]
        return stacks[self.errors(stacks).argmin()]

    def moved(self, stack: Int[Tensor, " layer"]) -> Int[Tensor, " layer"]:
        """Return a stack after moving its layers, one by one, for as long as that gains much."""
        best, before = stack, float("inf")
        error = self.errors(stack[None]).item()
        while error < before * (1 - _GAIN):
            before = error
            for layer in range(len(stack)):
                tried = self._with(torch.cat([best[:layer], best[layer + 1 :]]))
                errors = self.errors(tried)
                if errors.min().item() < error:
                    best, error = tried[errors.argmin()], errors.min().item()
        return best

    def free(self, even: Int[Tensor, " layer"]) -> Int[Tensor, " layer"]:
        """Return the best stack without a rule, found from an even one and from none."""
        moved, grown = self.moved(even), self.grown(len(even))
        return grown if self.gain(moved, grown) > 0 else moved

    def gain(self, old: Int[Tensor, " layer"], new: Int[Tensor, " layer"]) -> float:
        """Return by which share of its error a stack is better than another."""
        before, after = self.errors(torch.stack([old, new])).tolist()
        return (before - after) / before if before > 0 else 0.0

    def grown(self, layers: int) -> Int[Tensor, " layer"]:
        """Return a good stack of layers that were added one by one and then moved."""
        stack = torch.empty(0, dtype=torch.long)
        for _ in range(layers):
            tried = self._with(stack)
            stack = tried[self.errors(tried).argmin()]
        return self.moved(stack)

    def _with(self, others: Int[Tensor, " n"]) -> Int[Tensor, "m layer"]:
        """Return all stacks that have one layer more than these."""
        free = [place for place in range(len(self.axis)) if place not in others.tolist()]
        stacks = torch.cat([others.expand(len(free), -1), torch.tensor(free)[:, None]], dim=1)
        return stacks.sort(dim=1).values


def _summed(tables: Sequence[Errors], stacks: Tensor) -> Tensor:
    return torch.stack([table(stacks) for table in tables]).sum(dim=0)


def even_stacks(places: int, layers: int) -> Int[Tensor, "n layer"]:
    """Return the places of all stacks of evenly spaced layers.

    >>> even_stacks(3, 2).tolist()
    [[0, 1], [1, 2], [0, 2]]
    """
    gaps = max(layers - 1, 1)
    steps = range(1, (places - 1) // gaps + 1) if layers > 1 else range(1)
    stacks = [
        [first + k * step for k in range(layers)]
        for step in steps
        for first in range(places - (layers - 1) * step)
    ]
    return torch.tensor(stacks)


def centred_spectrum(field: LightField, link: Link) -> Spectrum:
    """Return the spectrum of a light field whose borders fade with the bulk of the scene.

    The bulk is where a single layer serves best the middle of the views.
    """
    part, bulk, reach = middle(field, LARGEST // 2), 0.0, _widest(field)
    for step in (_COARSE, _COARSE / 8):
        nearby = [bulk + each for each in _disparities(reach, step)]
        search = Search([spectrum(part, link, centre=bulk)], nearby)
        (bulk,) = search.disparity(search.even(1))
        reach = _COARSE
    return spectrum(field, link, centre=bulk)


def _axis(spectra: Sequence[Spectrum], widest: float) -> list[float]:
    """Return the disparities of the scenes and one pixel around, from near to far."""
    coarse = Search([each.thinned(_EVERY) for each in spectra], _disparities(widest, _COARSE))
    found = coarse.disparity(coarse.grown(_FINDERS))
    near, far = found[0] + 1, found[-1] - 1
    step = _FINEST
    while (near - far) / step > _PLACES - 1:
        step *= 2
    return [near - n * step for n in range(int((near - far) / step) + 1)]


def _disparities(reach: float, step: float) -> list[float]:
    """Return disparities from near to far, about 0."""
    count = int(reach / step)
    return [step * n for n in range(count, -count - 1, -1)]


def _widest(field: LightField) -> float:
    """The largest disparity to look for: the outermost views still share half of the picture."""
    reach = [
        size / 2 / (views - 1)
        for size, views in zip(field.size, field.grid, strict=True)
        if views > 1
    ]
    return max(min(_WIDEST, *reach), _FINDERS * _COARSE / 2)
