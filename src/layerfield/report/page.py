"""One HTML page that holds everything it shows: text, tables, charts as SVG, pictures as PNG."""

import json
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from matplotlib.figure import Figure
from PIL import Image

from layerfield.report.rendering import (
    inline,
    png,
    png_of,
    printable,
    svg,
)

_WIDEST = 115  # CSS pixels for an inch of a chart, which has 96


def shown(text: str) -> str:
    """Return a text as HTML holds it.

    >>> shown("a<b> & c")
    'a&lt;b&gt; &amp; c'
    """
    return escape(printable(text))


@dataclass(frozen=True)
class Text:
    """A paragraph.

    Args:
        words: plain text.
        kind: "" or "missing", for what a page could show and does not.
    """

    words: str
    kind: str = ""

    def html(self) -> str:
        return f'<p class="{self.kind}">{shown(self.words)}</p>' if self.kind else _p(self.words)


def _p(words: str) -> str:
    return f"<p>{shown(words)}</p>"


@dataclass(frozen=True)
class Facts:
    """Names and what they stand for, in columns."""

    rows: Sequence[tuple[str, str]]

    def html(self) -> str:
        pairs = (f"<div><dt>{shown(k)}</dt><dd>{shown(v)}</dd></div>" for k, v in self.rows)
        return f"<dl>{''.join(pairs)}</dl>"


@dataclass(frozen=True)
class Table:
    """A table with a caption; the first column holds names, all others numbers.

    Args:
        caption: above it.
        heading: of every column.
        rows: a text for every column; "" where there is nothing.
        last: a row that is set apart, if there is one.
    """

    caption: str
    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    last: Sequence[str] = ()

    def html(self) -> str:
        head = "".join(f'<th scope="col">{shown(name)}</th>' for name in self.heading)
        foot = f"<tfoot>{_row(self.last)}</tfoot>" if self.last else ""
        return (
            f'<div class="wide" role="region" tabindex="0" aria-label="{shown(self.caption)}">'
            f"<table><caption>{shown(self.caption)}</caption><thead><tr>{head}</tr></thead>"
            f"<tbody>{''.join(map(_row, self.rows))}</tbody>{foot}</table></div>"
        )


def _row(cells: Sequence[str]) -> str:
    first, *others = map(shown, cells)
    return f'<tr><th scope="row">{first}</th>{"".join(f"<td>{cell}</td>" for cell in others)}</tr>'


@dataclass(frozen=True, eq=False)
class Chart:
    """A drawing.

    Args:
        name: of its files.
        figure: the drawing.
        caption: below it.
        alt: what it shows, for those who do not see it.
    """

    name: str
    figure: Figure
    caption: str
    alt: str

    def html(self) -> str:
        drawing = inline(self._document).replace(
            "<svg", f'<svg role="img" aria-label="{shown(self.alt)}"', 1
        )
        width = round(_WIDEST * self.figure.get_figwidth())
        return _figure(f'<div class="card" style="max-width:{width}px">{drawing}</div>', self)

    def write(self, folder: Path) -> list[str]:
        (folder / f"{self.name}.svg").write_text(self._document, "utf-8")
        (folder / f"{self.name}.png").write_bytes(png(self.figure))
        return [f"{self.name}.svg", f"{self.name}.png"]

    @cached_property
    def _document(self) -> str:
        return svg(self.figure)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture; other arguments as of `Chart`.

    Args:
        image: the picture.
    """

    name: str
    image: Image.Image
    caption: str
    alt: str

    def html(self) -> str:
        data = b64encode(self._file).decode("ascii")
        width, height = self.image.size
        return _figure(
            f'<img src="data:image/png;base64,{data}" width="{width}" height="{height}" '
            f'alt="{shown(self.alt)}">',
            self,
        )

    def write(self, folder: Path) -> list[str]:
        (folder / f"{self.name}.png").write_bytes(self._file)
        return [f"{self.name}.png"]

    @cached_property
    def _file(self) -> bytes:
        return png_of(self.image)


Exhibit = Chart | Picture


def _figure(content: str, given: Exhibit) -> str:
    return f"<figure>{content}<figcaption>{shown(given.caption)}</figcaption></figure>"


@dataclass(frozen=True, eq=False)
class Gallery:
    """Figures side by side, as many in a row as the window has room for.

    Args:
        exhibits: the figures.
        columns: the most in a row.
    """

    exhibits: Sequence[Exhibit]
    columns: int = 1

    def html(self) -> str:
        inside = "".join(each.html() for each in self.exhibits)
        return f'<div class="gallery" style="--columns:{self.columns}">{inside}</div>'


Block = Text | Facts | Table | Gallery


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page under a heading."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, eq=False)
class Page:
    """A page.

    Args:
        title: of the window, too.
        summary: the first sentences.
        sections: its parts.
        made_with: versions, at the foot.
    """

    title: str
    summary: str
    sections: Sequence[Section]
    made_with: str

    def exhibits(self) -> Iterator[Exhibit]:
        """Return all figures, from top to bottom."""
        for section in self.sections:
            for block in section.blocks:
                if isinstance(block, Gallery):
                    yield from block.exhibits


def html(page: Page) -> str:
    """Return a page as one HTML document that asks for no other file."""
    folder = files("layerfield.report")
    links = (f'<li><a href="#part-{k}">{shown(s.title)}</a></li>' for k, s in _numbered(page))
    return Template((folder / "page.html").read_text("utf-8")).substitute(
        title=shown(page.title),
        style=(folder / "page.css").read_text("utf-8"),
        summary=shown(page.summary),
        contents="".join(links),
        body="\n".join(_section(k, section) for k, section in _numbered(page)),
        made_with=shown(page.made_with),
    )


def _numbered(page: Page) -> Iterator[tuple[int, Section]]:
    return enumerate(page.sections, start=1)


def _section(number: int, section: Section) -> str:
    blocks = "\n".join(block.html() for block in section.blocks)
    title = f'<h2 id="part-{number}">{shown(section.title)}</h2>'
    return f'<section aria-labelledby="part-{number}">{title}\n{blocks}</section>'


def write_page(path: Path, page: Page, figures: Path | None = None) -> None:
    """Write a page, and its figures as files if they are wanted.

    Beside them lies `figures.json`, which says what each file shows.

    Args:
        path: of the page.
        page: with names of figures that differ.
        figures: an empty folder.
    """
    path.write_text(html(page), "utf-8")
    if figures is not None:
        index = [
            {"files": each.write(figures), "caption": each.caption, "alt": each.alt}
            for each in page.exhibits()
        ]
        (figures / "figures.json").write_text(json.dumps(index, indent=2), "utf-8")
