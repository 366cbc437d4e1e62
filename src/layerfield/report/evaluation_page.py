"""The page of an evaluation: methods on light fields and displays, the reference beside them."""

from collections.abc import Callable, Iterator, Sequence

from layerfield.report.evaluation_figures import frontier_chart, shares_chart, view_charts
from layerfield.report.facts import RowFacts
from layerfield.report.page import Block, Gallery, Page, Section, Table, Text
from layerfield.report.rendering import quiet_about_fonts
from layerfield.report.result_figures import decibels_text
from layerfield.report.result_page import made_with_text, percent


@quiet_about_fonts()
def evaluation_page(rows: Sequence[RowFacts]) -> Page:
    """Return the page of the rows of an evaluation.

    Args:
        rows: at least one; those of one light field and display become one section.
    """
    groups: dict[tuple[str, str], list[RowFacts]] = {}
    for row in rows:
        groups.setdefault((row.field, row.display), []).append(row)
    sections = [
        Section(f"{field} on {display}", list(_section(group, number)))
        for number, ((field, display), group) in enumerate(groups.items(), start=1)
    ]
    made = list(dict.fromkeys(made_with_text(row.made_with) for row in rows))
    return Page("Comparison of methods", _summary(rows), sections, " ".join(made))


def _summary(rows: Sequence[RowFacts]) -> str:
    methods, fields, displays = (
        len({getattr(row, key) for row in rows}) for key in ("method", "field", "display")
    )
    return (
        f"{_counted(methods, 'method')} on {_counted(fields, 'light field')} and "
        f"{_counted(displays, 'display')}. PSNR is pooled over all views, channels and pixels, "
        "peak 1, of layers as their panels show them; the excess error is how much the mean "
        "square error exceeds that of the reference (0.1 dB is 2.3 %)."
    )


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _section(rows: list[RowFacts], number: int) -> Iterator[Block]:
    yield _table(rows)
    if len(rows) > 1:
        yield Gallery([frontier_chart(rows, f"{number}-frontier")])
    yield Text("PSNR over the views, with one scale of colours for all methods.")
    yield Gallery(list(view_charts(rows, f"{number}-views")), columns=3)
    yield Gallery([shares_chart(rows, f"{number}-shares")])


def _table(rows: Sequence[RowFacts]) -> Table:
    columns = [name for name, cell in _COLUMNS.items() if any(map(cell, rows))]
    first = rows[0]
    last: list[str] = []
    if first.reference_kind:
        bound = first.reference_gap_db
        certified = "" if bound is None else f", certified to {bound:.3f} dB"
        name = f"{first.reference_kind} ({first.reference_method}{certified})"
        # The reference is one of light, whatever the values in the files are.
        place = _LIGHT if _LIGHT in columns else _PSNR
        last = [name, *(_number(first.reference_psnr) if c == place else "" for c in columns)]
    caption = f"{first.field} on {first.display}, layers of {first.bits} bit"
    lines = [[row.method, *(_COLUMNS[name](row) for name in columns)] for row in rows]
    return Table(caption, ["method", *columns], lines, last)


def _number(value: float | None) -> str:
    return decibels_text(value).removesuffix(" dB")


_PSNR, _LIGHT = "PSNR, dB", "linear light, dB"
_COLUMNS: dict[str, Callable[[RowFacts], str]] = {
    "iterations": lambda row: f"{row.iterations}",
    _PSNR: lambda row: _number(row.psnr),
    _LIGHT: lambda row: _number(row.psnr_linear) if row.in_light else "",
    "between, dB": lambda row: "" if row.psnr_between is None else _number(row.psnr_between),
    "interior, dB": lambda row: _number(row.psnr_interior),
    "excess": lambda row: "" if row.excess is None else percent(row.excess),
    "SSIM": lambda row: f"{row.ssim:.4f}",
    "views min, dB": lambda row: _number(row.psnr_view_min),
    "max, dB": lambda row: _number(row.psnr_view_max),
    "std, dB": lambda row: _number(row.psnr_view_std),
    "time, s": lambda row: f"{row.seconds:.2f}",
    "memory, MB": lambda row: "" if row.peak_mb is None else f"{row.peak_mb:.0f}",
}
