"""The figures of one result of `synth`: its layers, what they show, and how good it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from layerfield.display_spec import DisparitySpec
from layerfield.report.charts import (
    REFERENCE,
    histogram_chart,
    history_chart,
    layer_name,
    means_chart,
    scale_chart,
    slice_chart,
    view_figure,
)
from layerfield.report.facts import ResultFacts
from layerfield.report.page import Chart, Exhibit, Picture
from layerfield.report.plots import Level
from layerfield.report.rendering import error_picture, label, picture
from layerfield.stored_result import StoredResult

MOST_SUBFRAMES = 4  # whose layers are shown
_SCALES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # largest errors of a scale


@dataclass(frozen=True)
class ChosenView:
    """A view that the page shows.

    Args:
        index: of the view.
        why: it was chosen, "centre" or "worst".
        place: in words.
        psnr: dB; None where it is exact or not known.
        known: whether the PSNR is known.
    """

    index: int
    why: str
    place: str
    psnr: float | None
    known: bool

    @property
    def quality(self) -> str:
        """The PSNR in words, or nothing."""
        return decibels_text(self.psnr) if self.known else ""


def decibels_text(value: float | None) -> str:
    """Return a figure in dB; None, in JSON, stands for an infinite one.

    >>> decibels_text(31.234), decibels_text(None)
    ('31.23 dB', 'exact')
    """
    return "exact" if value is None else f"{value:.2f} dB"


def layer_pictures(result: StoredResult) -> Iterator[Picture]:
    """Return the layers of the first subframes, front to back."""
    several = len(result.layers) > 1
    for s, subframe in enumerate(result.layers[:MOST_SUBFRAMES]):
        for k, layer in enumerate(subframe):
            where = f"subframe {s}, " if several else ""
            name = f"subframe-{s}-layer-{k}" if several else f"layer-{k}"
            about = f"{where}{layer_name(k)}"
            mean = f"mean value {layer.mean():.3f}"
            yield Picture(
                name,
                picture(layer),
                f"{_sentence(about)}: {mean}, {_depth(result, k)}.",
                f"Picture of {about} of the display, {mean}",
            )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _depth(result: StoredResult, k: int) -> str:
    geometry = result.display.geometry
    if isinstance(result.display.spec, DisparitySpec):
        return f"disparity {signed(geometry.parallax[k])} px"
    return f"{signed(1e3 * geometry.depths[k])} mm from the display plane"


def signed(value: float) -> str:
    """Return a number with its sign.

    >>> signed(1.5), signed(0.0)
    ('+1.5', '0')
    """
    return f"{value:+g}" if value else "0"


def chosen_views(
    count: int, grid: tuple[int, int] | None, by_view: Sequence[float | None]
) -> list[ChosenView]:
    """Return the centre, a corner, the best and the worst view, each once.

    Args:
        count: of the views.
        grid: rows and columns; None for a list.
        by_view: dB of every view, None where it is exact; empty if not known.
    """
    middle = count // 2 if grid is None else (grid[0] // 2) * grid[1] + grid[1] // 2
    reasons: dict[int, list[str]] = {}
    wanted = [(middle, "centre" if grid else "middle of the list"), (0, "top left corner")]
    if grid is None:
        wanted[1] = (0, "first of the list")
    if by_view:
        ranked = sorted(range(count), key=lambda n: _rank(by_view[n]))
        wanted += [(ranked[-1], "best"), (ranked[0], "worst")]
    for index, why in wanted:
        reasons.setdefault(index, []).append(why)
    return [
        ChosenView(
            n, ", ".join(why), _place(n, grid), by_view[n] if by_view else None, bool(by_view)
        )
        for n, why in reasons.items()
    ]


def _rank(value: float | None) -> float:
    return float("inf") if value is None else value


def _place(index: int, grid: tuple[int, int] | None) -> str:
    if grid is None:
        return f"view {index}"
    return f"row {index // grid[1]}, column {index % grid[1]}"


def view_pictures(
    chosen: Sequence[ChosenView],
    views: Float[Tensor, "view c y x"],
    targets: Float[Tensor, "view c y x"] | None,
) -> Iterator[Exhibit]:
    """Return target, simulated view and error of every chosen view, then the scale of errors.

    Args:
        chosen: the views.
        views: all that the layers show.
        targets: all that were aimed at; None if not at hand, which leaves only what is shown.
    """
    errors = None if targets is None else _errors(chosen, views, targets)
    largest = 1.0 if errors is None else _largest(errors)
    for number, each in enumerate(chosen):
        name, about = f"view-{each.index:03d}", f"{_sentence(each.why)} ({each.place})"
        quality = f", {each.quality}" if each.quality else ""
        spoken = f"the view of {each.place} ({each.why})"
        if targets is not None:
            target = picture(targets[each.index])
            yield Picture(f"{name}-target", target, f"{about}: target.", f"Target of {spoken}")
        seen = picture(views[each.index])
        caption = f"{about}: what the layers show{quality}."
        yield Picture(f"{name}-shown", seen, caption, f"What the layers show in {spoken}{quality}")
        if errors is not None:
            error = error_picture(errors[number], largest)
            mean = f"mean {errors[number].mean():.4f}"
            caption = f"{about}: error, {mean}; colours as in the scale below."
            yield Picture(f"{name}-error", error, caption, f"Error of {spoken}, {mean}")


def error_scale(
    chosen: Sequence[ChosenView],
    views: Float[Tensor, "view c y x"],
    targets: Float[Tensor, "view c y x"],
) -> Chart:
    """Return the scale of colours of the errors of chosen views."""
    largest = _largest(_errors(chosen, views, targets))
    words = "absolute error, mean over colours, values from 0 to 1"
    return Chart(
        "error-scale",
        scale_chart(largest, words),
        f"Scale of the errors. Errors of {largest:g} and more have the last colour.",
        f"Scale of colours from light for no error to dark for {largest:g} and more",
    )


def _errors(
    chosen: Sequence[ChosenView],
    views: Float[Tensor, "view c y x"],
    targets: Float[Tensor, "view c y x"],
) -> Float[Tensor, "chosen y x"]:
    places = [each.index for each in chosen]
    return (views[places] - targets[places]).abs().mean(dim=1)


def _largest(errors: Float[Tensor, "chosen y x"]) -> float:
    """Return the smallest scale that has room for all but one error in a hundred."""
    ordered = errors.flatten().sort().values
    most = ordered[int(0.99 * (len(ordered) - 1))].item()
    return next((scale for scale in _SCALES if scale >= most), 1.0)


def views_chart(by_view: Sequence[float | None], grid: tuple[int, int] | None) -> Chart:
    """Return the PSNR of every view."""
    values = [value for value in by_view if value is not None]
    span = f" from {min(values):.2f} to {max(values):.2f} dB" if values else ""
    if grid is None:
        caption = "PSNR of every view, in the order of the list of viewpoints."
    else:
        caption = "PSNR of every view; row 0, column 0 is the view from the top left."
    return Chart(
        "views", view_figure(by_view, grid), caption, f"PSNR of {len(by_view)} views{span}"
    )


def course_chart(facts: ResultFacts) -> Chart:
    """Return the PSNR over the iterations, the reference as a line."""
    levels, known = [], facts.reference
    if known is not None and known.psnr is not None:
        name = label(f"{known.kind}, {known.psnr:.2f} dB")
        levels.append(Level(name, known.psnr, REFERENCE))
    done, errors = (
        [progress.iteration for progress in facts.history],
        [progress.mean_square_error for progress in facts.history],
    )
    unit = "PSNR of light, dB" if facts.in_light else "PSNR, dB"
    caption = (
        "PSNR after every iteration, of layers that are not rounded yet"
        + (", in linear light" if facts.in_light else "")
        + (f". The line is the {known.kind} ({known.method})." if levels and known else ".")
    )
    alt = f"Curve of PSNR over {len(done)} iterations"
    return Chart("iterations", history_chart(done, errors, levels, unit), caption, alt)


def layer_charts(result: StoredResult, facts: ResultFacts) -> Iterator[Chart]:
    """Return histograms and means of the layers."""
    flat = result.layers.movedim(1, 0).flatten(start_dim=1)
    yield Chart(
        "histograms",
        histogram_chart(flat),
        "Histogram of every layer, 64 bins; the vertical axis is logarithmic.",
        f"Histograms of the values of {len(flat)} layers",
    )
    means = [layer.mean for layer in facts.layers]
    yield Chart(
        "layer-means",
        means_chart(means),
        "Mean light of every layer. " + _what_means_say(result),
        "Mean light of the layers, front to back: " + ", ".join(f"{m:.3f}" for m in means),
    )


def _what_means_say(result: StoredResult) -> str:
    if result.display.link.is_sum:
        return "Layers add up, so parts of the sum are shares of the light."
    return "Layers do not add up here: this says how bright each is."


def slices_chart(
    grid: tuple[int, int],
    views: Float[Tensor, "view c y x"],
    targets: Float[Tensor, "view c y x"] | None,
) -> Chart:
    """Return the epipolar slice through the middle of the middle row of views."""
    rows, columns = grid
    middle, line = rows // 2, views.shape[-2] // 2
    row = slice(middle * columns, (middle + 1) * columns)

    def cut(given: Float[Tensor, "view c y x"]) -> Float[Tensor, "c column x"]:
        return given[row, :, line].transpose(0, 1)

    slices = [] if targets is None else [("target", cut(targets))]
    slices.append(("what the layers show", cut(views)))
    return Chart(
        "epipolar-slice",
        slice_chart(slices),
        f"Epipolar slice: line {line} of every view in row {middle}. Points of the scene are "
        "lines: upright on the display plane, slanted in front of it and behind.",
        f"Epipolar slice of {' and '.join(name for name, _ in slices)}",
    )
