"""The page of one result of `synth`."""

from collections.abc import Iterator
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from layerfield.display_spec import PhysicalSpec
from layerfield.metrics import finite, psnr, psnr_by_view
from layerfield.report.facts import ResultFacts, checked_facts
from layerfield.report.page import Block, Facts, Gallery, Page, Section, Text
from layerfield.report.rendering import LONGEST_SIDE, quiet_about_fonts
from layerfield.report.result_figures import (
    MOST_SUBFRAMES,
    chosen_views,
    course_chart,
    decibels_text,
    error_scale,
    layer_charts,
    layer_pictures,
    signed,
    slices_chart,
    view_pictures,
    views_chart,
)
from layerfield.stored_result import StoredResult
from layerfield.synthesizer import spelled
from layerfield.transfer import NONE, named

_TARGETS = (
    "make the result with synth --targets, or give the light field that it was made of with "
    "report --field"
)
_FARTHEST = 0.5  # dB between the recorded PSNR and that of the views given as targets


@dataclass(frozen=True, eq=False)
class _Shown:
    """A result with what it shows, computed once.

    Args:
        result: as it lies on disk.
        facts: what it says of itself.
        views: what viewers see.
        by_view: PSNR of every view, dB; None where it is exact; empty if not known.
    """

    result: StoredResult
    facts: ResultFacts
    views: Float[Tensor, "view c y x"]
    by_view: list[float | None]

    @property
    def grid(self) -> tuple[int, int] | None:
        """Rows and columns of the viewpoints; None if they are a list."""
        return self.result.display.geometry.grid

    @property
    def targets(self) -> Float[Tensor, "view c y x"] | None:
        """What was aimed at, if it is at hand."""
        return self.result.targets


@quiet_about_fonts()
def result_page(result: StoredResult) -> Page:
    """Return the page of a result; parts that need targets are left out where there are none.

    Args:
        result: with facts.

    Raises:
        ValueError: no facts, or targets that are not those of the result.
    """
    facts, views = checked_facts(result), result.views()
    if result.targets is not None:
        _refuse_other_targets(result, facts, views)
    shown = _Shown(result, facts, views, _by_view(result, facts, views))
    sections = [
        Section("The run", list(_run(shown))),
        Section("Layers", list(_layers(shown))),
        Section("Views", list(_views(shown))),
        Section("PSNR over the views", list(_view_quality(shown))),
        Section("PSNR over iterations", list(_course(shown))),
        Section("Epipolar slice", list(_slices(shown))),
    ]
    title = f"{facts.field.name} on {facts.display}"
    return Page(title, _summary(facts), sections, made_with_text(facts.made_with))


def made_with_text(versions: dict[str, str | int]) -> str:
    """Return versions and processor in one line."""
    return "Made with " + ", ".join(f"{name} {value}" for name, value in versions.items()) + "."


def _refuse_other_targets(
    result: StoredResult, facts: ResultFacts, views: Float[Tensor, "view c y x"]
) -> None:
    """Views of the same size may be those of another scene, or others of the same."""
    assert result.targets is not None
    found, recorded = finite(psnr(views, result.targets)), facts.psnr
    if found is None or recorded is None or min(found, recorded) > 60:  # rounding of files
        return
    if abs(found - recorded) > _FARTHEST:
        raise ValueError(
            f"'{result.name}' shows these views with {found:.2f} dB, but reached {recorded:.2f} dB "
            "when it was made; give the light field that it was made of"
        )


def _by_view(
    result: StoredResult, facts: ResultFacts, views: Float[Tensor, "view c y x"]
) -> list[float | None]:
    if len(facts.psnr_by_view) == len(views):
        return facts.psnr_by_view
    return [] if result.targets is None else finite(psnr_by_view(views, result.targets))


def _summary(facts: ResultFacts) -> str:
    rows, columns = facts.field.grid
    height, width = facts.field.size
    against = ""
    if facts.reference is not None:
        where = " in linear light" if facts.in_light else ""
        more = "" if facts.excess is None else f", an excess error of {percent(facts.excess)}"
        against = f"; {facts.reference.kind} {decibels_text(facts.reference.psnr)}{where}{more}"
    reached = "exactly" if facts.psnr is None else f"with {decibels_text(facts.psnr)}"
    return (
        f"{spelled(facts.method, facts.iterations)} shows {rows}x{columns} views of "
        f"{width}x{height} px {reached}{against}."
    )


def percent(share: float) -> str:
    """Return a share in percent.

    >>> percent(0.0234), percent(-0.00001)
    ('2.3 %', '0.0 %')
    """
    return f"{max(100 * share, 0.0) if share > -5e-4 else 100 * share:.1f} %"


def _run(shown: _Shown) -> Iterator[Block]:
    facts = shown.facts
    yield Facts([*_made(facts), *_display(shown.result), *_figures(facts)])
    yield Text(
        "PSNR is pooled over all views, channels and pixels, peak 1, of the layers as they are "
        "in their files, as the papers do"
        + (
            "; in linear light the same is taken of what the panels emit."
            if facts.in_light
            else "."
        )
    )
    if facts.reference is None:
        yield Text(
            "How near this is to the best is not recorded; synth --reference computes it.",
            "missing",
        )


def _made(facts: ResultFacts) -> list[tuple[str, str]]:
    rows = [
        ("Method", facts.method),
        ("Iterations", f"{facts.iterations}"),
        ("Time", f"{facts.seconds:.2f} s"),
        ("Layer files", f"{facts.bits} bit, rounding {facts.rounding or 'not recorded'}"),
    ]
    if facts.status:
        rows.append(("Status", facts.status))
    if facts.field.options:
        options = ", ".join(f"{name} {value}" for name, value in facts.field.options.items())
        rows.append(("Light field read with", options))
    return rows


def _display(result: StoredResult) -> list[tuple[str, str]]:
    display, spec = result.display, result.display.spec
    physical = isinstance(spec, PhysicalSpec)
    depths = (
        ", ".join(signed(1e3 * z) for z in display.geometry.depths) + " mm"
        if physical
        else ", ".join(map(signed, display.geometry.parallax)) + " px per view"
    )
    grid = display.geometry.grid
    rows = [
        ("Display", display.name),
        ("Link", f"{spec.link}, {display.layer_count} layers"),
        ("Depths, front to back" if physical else "Disparities, front to back", depths),
        (
            "Viewpoints",
            f"{grid[0]}x{grid[1]} grid" if grid else f"list of {display.view_count}",
        ),
    ]
    if display.subframes > 1:
        rows.append(("Subframes", f"{display.subframes}, of which viewers see the mean"))
    if display.transfer != NONE:
        rows.append(("Transfer", f"{named(display.transfer)}: light is decoded from the values"))
    return rows


def _figures(facts: ResultFacts) -> list[tuple[str, str]]:
    rows = [("PSNR, whole image", decibels_text(facts.psnr))]
    if facts.in_light:
        rows.append(("PSNR, linear light", decibels_text(facts.psnr_linear)))
    rows += [
        ("PSNR, interior", decibels_text(facts.psnr_interior)),
        ("SSIM", f"{facts.ssim:.4f}"),
        (
            "PSNR of views, lowest to highest",
            f"{decibels_text(facts.psnr_view_min)} to {decibels_text(facts.psnr_view_max)}",
        ),
    ]
    if facts.psnr_observers is not None:
        rows.append(("PSNR, as observers count", decibels_text(facts.psnr_observers)))
    return rows + _reference(facts) + _panels(facts)


def _reference(facts: ResultFacts) -> list[tuple[str, str]]:
    known = facts.reference
    if known is None:
        return []
    light = " of light" if facts.in_light else ""
    bound = "" if known.gap_db is None else f", certified to {known.gap_db:.3f} dB"
    kind = known.kind[:1].upper() + known.kind[1:]
    rows = [(kind, f"{decibels_text(known.psnr)}{light} ({known.method}{bound})")]
    if facts.excess is not None:
        rows.append(("Excess error", f"{percent(facts.excess)} above the {known.kind}"))
    return rows


def _panels(facts: ResultFacts) -> list[tuple[str, str]]:
    found = facts.panels
    if found is None:
        return []
    light = "" if found.psnr_linear == found.psnr else ", linear light "
    linear = decibels_text(found.psnr_linear) if light else ""
    rows = [("PSNR of the panels", f"{decibels_text(found.psnr)}{light}{linear}")]
    if any(found.missed):
        dark = f"up to {percent(max(found.missed))} of the light paths are dark"
        rows.append(("Light paths that miss a panel", dark))
    return rows


def _layers(shown: _Shown) -> Iterator[Block]:
    layers, (y, x) = shown.result.layers, shown.result.margin
    yield Text(
        f"Layer images as in their files, front to back, {layers.shape[-1]}x{layers.shape[-2]} px; "
        f"they exceed the views by {x} px left and right, {y} px above and below."
        + _scaled(max(layers.shape[-2:]))
    )
    if len(layers) > MOST_SUBFRAMES:
        yield Text(f"The first {MOST_SUBFRAMES} of {len(layers)} subframes are shown.", "missing")
    yield Gallery(list(layer_pictures(shown.result)), columns=min(layers.shape[1], 4))
    yield Gallery(list(layer_charts(shown.result, shown.facts)), columns=2)


def _scaled(longest: int) -> str:
    return f" Pictures are scaled to {LONGEST_SIDE} px." if longest > LONGEST_SIDE else ""


def _views(shown: _Shown) -> Iterator[Block]:
    chosen = chosen_views(len(shown.views), shown.grid, shown.by_view)
    if shown.targets is None:
        yield Text("What the layers show." + _scaled(max(shown.result.view_size)))
        yield Text(f"For targets and errors beside it, {_TARGETS}.", "missing")
        yield Gallery(list(view_pictures(chosen, shown.views, None)), columns=3)
        return
    yield Text(
        "Target, what the layers show, and the error." + _scaled(max(shown.result.view_size))
    )
    yield Gallery(list(view_pictures(chosen, shown.views, shown.targets)), columns=3)
    yield Gallery([error_scale(chosen, shown.views, shown.targets)])


def _view_quality(shown: _Shown) -> Iterator[Block]:
    if shown.by_view:
        yield Gallery([views_chart(shown.by_view, shown.grid)])
    else:
        yield Text(f"The figures of single views are not recorded; {_TARGETS}.", "missing")


def _course(shown: _Shown) -> Iterator[Block]:
    if shown.facts.history:
        yield Gallery([course_chart(shown.facts)])
    else:
        yield Text(
            "The error of every iteration was not recorded; synth --history does so.", "missing"
        )


def _slices(shown: _Shown) -> Iterator[Block]:
    if shown.grid is None or shown.grid[1] < 2:
        yield Text("There is no row of several viewpoints to cut through.", "missing")
        return
    if shown.targets is None:
        yield Text(f"For the slice of the target, {_TARGETS}.", "missing")
    yield Gallery([slices_chart(shown.grid, shown.views, shown.targets)])
