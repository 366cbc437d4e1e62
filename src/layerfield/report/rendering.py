"""Figures and pictures as bytes: the same figure gives the same bytes."""

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor

ERROR_COLOURS = "magma_r"  # light where there is no error, dark where it is large
LONGEST_SIDE = 480  # pixels of a picture on a page

_DPI = 200
# Without them matplotlib writes the date, its version, and names of its own making.
_NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_SETTINGS: Any = {"svg.hashsalt": "layerfield", "svg.fonttype": "none"}
_LONGEST_LABEL = 40  # characters


@contextmanager
def quiet_about_fonts() -> Iterator[None]:
    """Keep quiet where a name has characters that matplotlib's font lacks; pages have others."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        yield


def printable(text: str) -> str:
    """Return a text without characters that no page, and no XML, can hold.

    >>> printable("a" + chr(27) + "b")
    'a�b'
    """
    return "".join(c if c.isprintable() else "\ufffd" for c in text)


def label(text: str) -> str:
    """Return a name as matplotlib draws it: no longer than a line, no formula, not hidden.

    >>> label("_x"), len(label("x" * 99))
    (' _x', 40)
    """
    short = printable(text)
    if len(short) > _LONGEST_LABEL:
        short = short[: _LONGEST_LABEL - 1] + "…"
    return re.sub(r"^_", " _", short.replace("$", r"\$"))


def svg(figure: Figure) -> str:
    """Return a figure as an SVG document, its text as text."""
    buffer = io.StringIO()
    with quiet_about_fonts(), mpl.rc_context(_SETTINGS):
        _settle(figure)
        FigureCanvasSVG(figure)
        figure.savefig(buffer, format="svg", dpi=_DPI, metadata=_NO_METADATA)
    return buffer.getvalue()


def _settle(figure: Figure) -> None:
    """Arrange a figure once; every drawing would do so again, which takes most of its time."""
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()
        figure.set_layout_engine(None)


def inline(document: str) -> str:
    """Return the element of an SVG document for a page that holds several of them.

    Names of groups, which nothing refers to, would be the same in all.
    """
    element = re.sub(r'<g id="[^"]*"', "<g", document[document.index("<svg") :])
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", element).strip()


def png(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    buffer = io.BytesIO()
    with quiet_about_fonts():
        _settle(figure)
        FigureCanvasAgg(figure)
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return buffer.getvalue()


def picture(pixels: Float[Tensor, "c y x"]) -> Image.Image:
    """Return values, clipped to 0..1, as a picture no longer than 480 px."""
    codes = (pixels.detach().cpu().float().clamp(0, 1) * 255).round().byte().numpy()
    array = codes[0] if len(codes) == 1 else np.moveaxis(codes, 0, -1)
    return _shrunk(Image.fromarray(np.ascontiguousarray(array)))


def error_picture(errors: Float[Tensor, "y x"], largest: float) -> Image.Image:
    """Return errors as a picture in colours no longer than 480 px.

    Args:
        errors: absolute ones.
        largest: what the last colour stands for, and all above it.
    """
    scaled = (errors.detach().cpu().float() / largest).clamp(0, 1) * 255
    image = _shrunk(Image.fromarray(scaled.round().byte().numpy()))
    colours = colormaps[ERROR_COLOURS](np.arange(256), bytes=True)[:, :3]
    image.putpalette(colours.tobytes())
    return image


def _shrunk(image: Image.Image) -> Image.Image:
    factor = LONGEST_SIDE / max(image.size)
    if factor >= 1:
        return image
    width, height = (max(1, round(side * factor)) for side in image.size)
    return image.resize((width, height), Image.Resampling.BOX)


def png_of(image: Image.Image) -> bytes:
    """Return a picture as PNG."""
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()
