"""What the page needs to know of results, and their pictures.

Pictures are 8-bit PNGs, which browsers read exactly; of 16-bit layers there are two, one for the
high and one for the low byte of every code.
"""

import base64
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, UInt
from torch import Tensor, nn

from layerfield.display import Display
from layerfield.display_spec import PhysicalSpec
from layerfield.io.images import png
from layerfield.metrics import finite, psnr, psnr_by_view
from layerfield.panels import quantise
from layerfield.stored_result import StoredResult
from layerfield.transfer import NONE, Transfer

Publish = Callable[[str, bytes], str]  # a name and the bytes of a picture -> its address

_LONGEST = 4096  # pixels of a layer's side; graphics processors refuse longer ones
_MOST_PIXELS = 100_000_000  # of all layers together, four bytes each
_MOST_PICTURES = 256  # what WebGL2 promises to take in one texture
_ENCODED_POINTS = 1024  # of the table from light to values; over the root of light


@dataclass(frozen=True, eq=False)
class _Shown:
    """Pictures as the page shows them: at most as large as it can take.

    Args:
        codes: of the layers.
        targets: codes of the views aimed at, 8 bit; None if not at hand.
        margin: pixels (y, x) by which they exceed the views on each side.
        factor: by which both are smaller than the files.
    """

    codes: UInt[Tensor, "subframe layer c ly lx"]
    targets: UInt[Tensor, "view c y x"] | None
    margin: tuple[int, int]
    factor: int


def exhibit(results: Sequence[StoredResult], publish: Publish) -> dict[str, Any]:
    """Describe results as plain data, after publishing their pictures.

    Args:
        results: what is shown; figures of methods stand side by side.
        publish: takes every picture and says where the page finds it.

    Raises:
        ValueError: a result with more pictures than a graphics processor takes.
    """
    return {"results": [_described(r, i, publish) for i, r in enumerate(results)]}


def _described(result: StoredResult, number: int, publish: Publish) -> dict[str, Any]:
    shown, display = _fitting(result), result.display
    height, width = (n // shown.factor for n in result.view_size)
    high, low = _bytes(shown.codes)
    quality = _quality(result)
    return {
        "title": _title(result),
        "display": _geometry(display),
        "view": {"width": width, "height": height},
        "layer": {
            "width": shown.codes.shape[-1],
            "height": shown.codes.shape[-2],
            "margin": shown.margin,
            "factor": shown.factor,
        },
        "pictures": _published(high, f"{number}/high", publish),
        "fine": None if low is None else _published(low, f"{number}/low", publish),
        "targets": None
        if shown.targets is None
        else [
            publish(f"{number}/target/{i}.png", png(view)) for i, view in enumerate(shown.targets)
        ],
        "transfer": _tables(display.transfer, 8 if low is None else 16),
        "psnr": quality.by_view,
        "figures": _figures(result, quality),
        "notes": _notes(result, shown.factor),
    }


def _published(codes: UInt[Tensor, "subframe layer c y x"], name: str, publish: Publish) -> list:
    return [
        [publish(f"{name}/{s}/{k}.png", png(picture)) for k, picture in enumerate(pictures)]
        for s, pictures in enumerate(codes)
    ]


def _bytes(codes: Tensor) -> tuple[Tensor, Tensor | None]:
    """Part codes into high and low bytes; 8-bit codes have only the former."""
    if codes.dtype == torch.uint8:
        return codes, None
    wide = codes.to(torch.int32)
    return (wide >> 8).to(torch.uint8), (wide & 255).to(torch.uint8)


def _fitting(result: StoredResult) -> _Shown:
    """Make layers and targets smaller by a whole factor, in light, if they are too large."""
    subframes, count, _, height, width = result.layers.shape
    if subframes * count > _MOST_PICTURES:
        raise ValueError(
            f"{result.name} has {subframes * count} pictures, {count} layers in {subframes} "
            f"subframes; the viewer takes at most {_MOST_PICTURES}"
        )
    by_side = math.ceil(max(height, width) / _LONGEST)
    by_pixels = math.ceil(math.sqrt(subframes * count * height * width / _MOST_PIXELS))
    factor, targets = max(by_side, by_pixels, 1), result.targets
    if factor == 1:
        codes = None if targets is None else quantise(targets, 8)
        return _Shown(_codes(result.layers), codes, result.margin, 1)
    display = result.display
    y, x = (m + -m % factor for m in result.margin)  # views start at a whole pixel
    light = display.surround(display.transfer.decode(result.layers), (y, x), result.margin)
    return _Shown(
        quantise(_smaller(light, factor), 8, display.transfer),
        None if targets is None else _smaller_views(targets, display.transfer, factor),
        (y // factor, x // factor),
        factor,
    )


def _smaller_views(views: Tensor, transfer: Transfer, factor: int) -> Tensor:
    return quantise(_smaller(transfer.decode(views), factor), 8, transfer)


def _codes(layers: Float[Tensor, "*batch c y x"]) -> UInt[Tensor, "*batch c y x"]:
    """Return the codes in the files: 8 bit where all values are such."""
    codes = layers * 255
    return quantise(layers, 8 if (codes - codes.round()).abs().max() < 1e-3 else 16)


def _smaller(pictures: Float[Tensor, "*batch c y x"], factor: int) -> Tensor:
    flat = pictures.flatten(0, -4)
    return nn.functional.avg_pool2d(flat, factor).unflatten(0, pictures.shape[:-3])


def _geometry(display: Display) -> dict[str, Any]:
    """What `page/optics.js` computes light paths from."""
    geometry = display.geometry
    distances = geometry.distances
    common = distances[0] if geometry.is_regular else sum(distances) / len(distances)
    return {
        "name": display.name,
        "link": display.link.name,
        "neutral": display.link.neutral,
        "subframes": display.subframes,
        "depths": geometry.depths,
        "scales": geometry.scales,
        "parallax": geometry.parallax,
        "slopes": geometry.slopes,
        "grid": geometry.grid,
        "step": _step(display),
        "distance": common if math.isfinite(common) else None,
        "physical": isinstance(display.spec, PhysicalSpec),
    }


def _step(display: Display) -> tuple[float, float] | None:
    """The slope between neighbouring viewpoints of a grid, across and down; never 0."""
    geometry = display.geometry
    if geometry.grid is None:
        return None
    (x, y), (next_x, next_y) = geometry.slope_at((0, 0)), geometry.slope_at((1, 1))
    across, down = next_x - x, next_y - y
    return across or down or 1.0, down or across or 1.0


def _tables(transfer: Transfer, bits: int) -> dict[str, str] | None:
    """The light of every code, and values over the root of light, which is steep in the dark."""
    if transfer == NONE:
        return None
    codes = torch.linspace(0, 1, 2**bits, dtype=torch.float64)
    root = torch.linspace(0, 1, _ENCODED_POINTS, dtype=torch.float64)
    values = transfer.encode(root.square()).clamp(0, 1)
    return {"decoded": _base64(transfer.decode(codes)), "encoded": _base64(values)}


def _base64(numbers: Float[Tensor, " n"]) -> str:
    return base64.b64encode(numbers.numpy().astype("<f4").tobytes()).decode("ascii")


@dataclass(frozen=True)
class _Quality:
    """PSNR over all views as files hold values, in light, and of every view; None if not known."""

    whole: float | None = None
    light: float | None = None
    by_view: list[float | None] | None = None


def _quality(result: StoredResult) -> _Quality:
    """Judge the layers where targets are at hand, or return what was found when they were made."""
    facts, display, targets = result.facts, result.display, result.targets
    if targets is None:
        kept = facts.get("psnr_by_view")
        fits = isinstance(kept, list) and len(kept) == display.view_count
        return _Quality(facts.get("psnr"), facts.get("psnr_linear"), kept if fits else None)
    light = display(result.light())
    views = display.transfer.encode(light)
    return _Quality(
        psnr(views, targets),
        psnr(light, display.transfer.decode(targets)),
        finite(psnr_by_view(views, targets)),
    )


def _figures(result: StoredResult, quality: _Quality) -> dict[str, str]:
    """The table's line: PSNR as files hold values, in light where that differs, and the effort."""
    found = {"display": result.display.name}
    if quality.whole is not None:
        found["PSNR dB"] = _decibels(quality.whole)
    if quality.light not in (None, quality.whole):
        found["linear light dB"] = _decibels(quality.light)
    kept = (("SSIM", "ssim", 4), ("iterations", "iterations", 0), ("s", "seconds", 2))
    for name, key, digits in kept:
        if isinstance(result.facts.get(key), int | float):
            found[name] = f"{result.facts[key]:.{digits}f}"
    return found


def _decibels(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "exact"


def _title(result: StoredResult) -> str:
    method = result.facts.get("method")
    return f"{result.name}: {method}" if isinstance(method, str) else result.name


def _notes(result: StoredResult, factor: int) -> list[str]:
    """What a person who looks should know."""
    height, width = result.layers.shape[-2:]
    notes = []
    if factor > 1:
        notes.append(f"layers ({width}x{height} px) are shown at 1/{factor} of their size")
    if result.display.panels:
        notes.append("what is shown are the layers, not the panels that they are resampled to")
    if not result.display.geometry.is_regular:
        notes.append("the viewpoints lie at different distances; the map shows their directions")
    return [f"{result.name}: {note}." for note in notes]
