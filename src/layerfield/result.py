"""What synthesis leaves behind: a folder with layers, the display, and the facts.

OUT/layers/layer_0.png ...   codes of the layers, encoded as the views are; layer 0 nearest to the
                             viewer, margin included; OUT/layers/subframe_0/layer_0.png ... if there
                             are several subframes
OUT/panels/panel_0.png ...   codes of the panels, if the display has any, in the same order
OUT/display.toml             the display they are for
OUT/result.json              method, figures, margin, versions
OUT/views/view_RR_CC.png     what viewers see, if asked for
OUT/targets/view_RR_CC.png   what they should see, if asked for
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.evaluate import Figures, figures, light_error
from layerfield.io import whole_directory, write_png
from layerfield.light_field import LightField
from layerfield.metrics import decibels, excess, finite, psnr
from layerfield.panel_images import PanelImages, panel_images, views_through_panels
from layerfield.panels import dequantise, quantise
from layerfield.provenance import provenance
from layerfield.reference import Reference
from layerfield.solve import Solution
from layerfield.solvers.rounding import panel_codes
from layerfield.stored_result import simulate_panels
from layerfield.synthesizer import pose


@dataclass(frozen=True, eq=False)
class Result:
    """Layers and panels as codes, and the facts about them.

    Args:
        codes: the layers that are written, front to back.
        display: what they are for.
        facts: everything that `result.json` holds.
        panels: the pictures of the panels, if the display has any.
    """

    codes: UInt[Tensor, "subframe layer c ly lx"]
    display: Display
    facts: dict[str, Any]
    panels: tuple[UInt[Tensor, "subframe c _ _"], ...] = ()


def make_result(
    field: LightField,
    display: Display,
    solution: Solution,
    *,
    method: str,
    bits: int,
    rounding: str = "joint",
    reference: Reference | None = None,
    options: dict[str, Any] | None = None,
) -> Result:
    """Quantise a solution and gather its facts; figures are those of the quantised layers.

    Args:
        field: what the layers are to show.
        display: on what.
        solution: what a synthesizer returned.
        method: its name.
        bits: of the panels, 8 or 16.
        rounding: "joint" or "nearest".
        reference: the optimum or best known, if it was computed.
        options: how the light field was read, to be recorded.
    """
    solved = solution.problem or pose(field, display)
    codes = panel_codes(
        solved, solution.layers, bits=bits, rounding=rounding, transfer=display.transfer
    )
    layers = dequantise(codes, display.transfer)
    error = light_error(layers, field, display)
    panels = panel_images(solved, solution.layers, display) if display.panels else None
    judged = figures(layers, field, display)
    facts = {
        "method": method,
        "solver": _hyper_parameters(solution),
        "iterations": solution.iterations,
        "status": solution.status,
        "seconds": solution.seconds,
        "history": [progress._asdict() for progress in solution.history],
        "details": dict(solution.details),
        "seed": None,  # nothing here is random
        "field": {"name": field.name, "grid": field.grid, "size": field.size} | (options or {}),
        "display": display.name,
        "bits": bits,
        "rounding": rounding if bits == 8 else "nearest",
        "subframes": display.subframes,
        "margin": display.margin,
        "made_with": provenance(field.stored.device),
        **_quality(judged),
        **_observed(judged, solved.weights[: display.view_count]),
        "reference": reference and asdict(reference) | {"psnr": finite(reference.psnr)},
        "excess": reference and finite(excess(error, reference.mean_square_error)),
    }
    if panels is None:
        return Result(codes, display, facts)
    facts["panels"] = _panel_figures(panels, field, display)
    return Result(codes, display, facts, panels.codes)


def _observed(judged: Figures, weights: Sequence[float]) -> dict[str, Any]:
    """The figure that counts views as the observers do, where they count differently."""
    if len(set(weights)) == 1:
        return {}
    errors = [10 ** (-psnr / 10) for psnr in judged.psnr_by_view]
    pooled = sum(w * e for w, e in zip(weights, errors, strict=True)) / sum(weights)
    return {"psnr_observers": finite(decibels(pooled))}


def _panel_figures(panels: PanelImages, field: LightField, display: Display) -> dict[str, Any]:
    values = [dequantise(codes) for codes in panels.codes]
    light = views_through_panels(values, display, field.size)
    found = {
        "psnr": psnr(display.transfer.encode(light), field.views),
        "psnr_linear": psnr(light, display.transfer.decode(field.views)),
    }
    return finite(found) | {"missed": panels.missed}


def write_result(
    folder: str | Path,
    result: Result,
    *,
    simulate: bool = False,
    targets: LightField | None = None,
    force: bool = False,
) -> None:
    """Write a result, whole or not at all.

    Args:
        folder: to be made.
        result: what to write.
        simulate: write the views that the layers show, too.
        targets: what the layers are to show, if it is to be written, too.
        force: replace an earlier result of this name.

    Raises:
        ValueError: the folder exists, or it cannot be written.
    """
    with whole_directory(folder, force=force) as temporary:
        _write_pictures(temporary / "layers", "layer", result.codes.unbind(dim=1))
        if result.panels:
            _write_pictures(temporary / "panels", "panel", result.panels)
        (temporary / "display.toml").write_text(format_spec(result.display.spec), "utf-8")
        (temporary / "result.json").write_text(json.dumps(result.facts, indent=2), "utf-8")
        if simulate:
            views = _views_of(result)
            write_views(temporary / "views", views, result.display, result.facts["bits"])
        if targets is not None:
            bits = 8 if targets.bits is not None and targets.bits <= 8 else 16
            write_views(temporary / "targets", targets.kept, result.display, bits)


def _write_pictures(
    folder: Path, name: str, pictures: Sequence[UInt[Tensor, "subframe c _ _"]]
) -> None:
    folder.mkdir()
    for k, subframes in enumerate(pictures):
        for s, codes in enumerate(subframes):
            place = folder / f"subframe_{s}" if len(subframes) > 1 else folder
            place.mkdir(exist_ok=True)
            write_png(place / f"{name}_{k}.png", codes.cpu())


def _views_of(result: Result) -> Iterable[Float[Tensor, "c y x"]]:
    """Return what viewers see: of the panels, or of the layers where there are none."""
    display = result.display
    if result.panels:
        pictures = [dequantise(codes) for codes in result.panels]
        return simulate_panels(pictures, display, result.facts["field"]["size"])
    layers = dequantise(result.codes, display.transfer)
    each = range(display.view_count)
    return (display.transfer.encode(display.view(layers, i)) for i in each)


def write_views(
    folder: Path, views: Iterable[Float[Tensor, "c y x"]], display: Display, bits: int
) -> None:
    """Write views as `view_RR_CC.png`, clipped to 0..1; a list of viewpoints is one row."""
    folder.mkdir()
    _, columns = display.geometry.grid or (1, display.view_count)
    for i, view in enumerate(views):
        codes = quantise(view.clamp(0, 1), bits)
        write_png(folder / f"view_{i // columns:02d}_{i % columns:02d}.png", codes.cpu())


def write_views_array(
    path: Path, views: Float[Tensor, "view c y x"], grid: tuple[int, int]
) -> None:
    """Write unclipped float32 views as `.npy`, `[row, column, y, x, c]`."""
    array = views.cpu().unflatten(0, grid).movedim(2, -1).numpy()
    np.save(path, array.astype(np.float32), allow_pickle=False)


def _hyper_parameters(solution: Solution) -> dict[str, Any]:
    solver = solution.solver
    return _by_name(solver) if dataclasses.is_dataclass(solver) else {}


def _by_name(value: Any) -> Any:
    """Return plain data: what dataclasses and named tuples hold, by name; of weights a digest."""
    if isinstance(value, Tensor):
        digest = hashlib.sha256(value.detach().cpu().contiguous().numpy().tobytes())
        return {"shape": list(value.shape), "sha256": digest.hexdigest()}
    if dataclasses.is_dataclass(value):
        return {each.name: _by_name(getattr(value, each.name)) for each in fields(value)}
    if hasattr(value, "_asdict"):
        return {name: _by_name(each) for name, each in value._asdict().items()}
    return [_by_name(each) for each in value] if isinstance(value, tuple | list) else value


def _quality(found: Figures) -> dict[str, Any]:
    return finite(asdict(found) | {"layers": [layer._asdict() for layer in found.layers]})
