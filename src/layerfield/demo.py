"""The demonstration: from nothing to layers, views, a table and one picture."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from layerfield.display import Display
from layerfield.evaluate import Row, evaluate, write_rows
from layerfield.io import whole_directory
from layerfield.light_field import LightField
from layerfield.metrics import psnr
from layerfield.panels import dequantise
from layerfield.reference import cached_reference
from layerfield.report.comparison import ERROR_GAIN, Strip, Tile, comparison_picture, error_map
from layerfield.result import Result, make_result, write_result, write_views
from layerfield.scenes import procedural_light_field
from layerfield.shipped import shipped_networks
from layerfield.solvers.rounding import panel_codes
from layerfield.synthesizer import pose, synthesize

_SOLVERS = {
    "additive-3": [("fourier-admm", 10), ("nmf", 10), ("nmf", 100), ("sart", 10)],
    "multiplicative-3": [("fourier-admm", 2), ("fourier-admm", 10), ("sweeps", 10)],
}
DISPLAYS = tuple(_SOLVERS)
_SHOWN = ("fourier-admm", 10)
_SIZE = (192, 256)
_SEED = 8


def sample_field() -> LightField:
    """Return the small procedural light field of the demonstration."""
    field = procedural_light_field(size=_SIZE, disparity_range=(-1.5, 1.5), seed=_SEED)
    return replace(field, name="sample")


def run_demo(
    folder: str | Path, *, force: bool = False, tick: Callable[[str], None] | None = None
) -> list[Row]:
    """Make, solve, simulate and compare a sample light field; write all of it.

    Args:
        folder: to be made: the field's views, a result of each display, `comparison.png`.
        force: replace an earlier one.
        tick: called with a word on what is being done.

    Returns:
        The rows of the table.
    """
    rows: list[Row] = []
    with whole_directory(folder, force=force) as temporary:
        field = sample_field()
        strips: list[Strip] = []
        for name in _SOLVERS:
            display = Display.load(name)
            rows += evaluate([field], [display], _methods(display), tick=tick)
            result = _solve(field, display)
            write_result(temporary / name, result, simulate=True, targets=field)
            strips += _strips(field, display, result)
        write_views(temporary / "field", field.views, Display.load("additive-3"), 8)
        write_rows(temporary / "result.json", rows)
        comparison_picture(strips).save(temporary / "comparison.png")
    return rows


def _methods(display: Display) -> list[tuple[str, int]]:
    """Solvers and their iterations, and the networks that have weights for the display."""
    return _SOLVERS[display.name] + [(name, 0) for name in shipped_networks(display)]


def _solve(field: LightField, display: Display) -> Result:
    solution = synthesize(field, display, method=_SHOWN[0], iterations=_SHOWN[1])
    reference = cached_reference(pose(field, display))
    return make_result(field, display, solution, method=_SHOWN[0], bits=8, reference=reference)


def _strips(field: LightField, display: Display, result: Result) -> list[Strip]:
    corner = 0
    target = field.view(corner)
    shown = display(dequantise(result.codes))[corner]
    others = []
    for method, iterations in _methods(display):
        if (method, iterations) == _SHOWN:
            continue
        solution = synthesize(field, display, method=method, iterations=iterations)
        codes = panel_codes(pose(field, display), solution.layers, bits=8)
        view = display(dequantise(codes))[corner]
        others.append(_error_tile(view, target, _heading(method, iterations)))
    layers = [
        Tile(layer, f"layer {k}" + (" (nearest)" if k == 0 else ""), _disparity(display, k))
        for k, layer in enumerate(dequantise(result.codes[0]))
    ]
    views = [Tile(target, "target, top left view"), Tile(shown, "what the eye there sees")]
    return [
        Strip(f"{display.name}: {display.spec.description}", [*views, *layers]),
        Strip(
            f"error in that view, {ERROR_GAIN} times, white is none",
            [_error_tile(shown, target, _heading(*_SHOWN)), *others],
        ),
    ]


def _heading(method: str, iterations: int) -> str:
    return f"{method}, {iterations} iterations" if iterations else method


def _error_tile(view, target, heading: str) -> Tile:
    return Tile(error_map(view, target), heading, f"{psnr(view, target):.2f} dB")


def _disparity(display: Display, layer: int) -> str:
    return f"disparity {display.geometry.parallax[layer]:+g} px"
