"""What synthesis leaves behind: a folder with layers, the display, and the facts.

OUT/layers/layer_0.png ...   codes of the panels, layer 0 nearest to the viewer, margin included
OUT/display.toml             the display they are for
OUT/result.json              method, figures, margin, versions
OUT/views/view_RR_CC.png     what viewers see, if asked for
"""

import dataclasses
import json
import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt
from torch import Tensor

from layerfield.display import Display
from layerfield.display_spec import format_spec
from layerfield.evaluate import Figures, figures
from layerfield.io import read_image, whole_directory, write_png
from layerfield.io.images import SUFFIXES
from layerfield.light_field import LightField
from layerfield.metrics import excess, mean_square_error
from layerfield.panels import dequantise, quantise
from layerfield.provenance import provenance
from layerfield.reference import Reference
from layerfield.solve import Problem, Solution
from layerfield.solvers.rounding import panel_codes


@dataclass(frozen=True, eq=False)
class Result:
    """Layers as codes of the panels, and the facts about them.

    Args:
        codes: what is written, front to back.
        display: what they are for.
        facts: everything that `result.json` holds.
    """

    codes: UInt[Tensor, "layer c ly lx"]
    display: Display
    facts: dict[str, Any]


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
    problem = Problem.of(display, field.views)
    codes = panel_codes(
        problem, solution.layers, bits=bits, rounding=rounding, transfer=display.transfer
    )
    layers = dequantise(codes, display.transfer)
    error = mean_square_error(display(layers), problem.target)
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
        "margin": display.margin,
        "made_with": provenance(field.views.device),
        **_quality(figures(layers, field, display)),
        "reference": reference and asdict(reference) | {"psnr": _finite(reference.psnr)},
        "excess": reference and _finite(excess(error, reference.mean_square_error)),
    }
    return Result(codes.squeeze(-5), display, facts)


def write_result(
    folder: str | Path, result: Result, *, simulate: bool = False, force: bool = False
) -> None:
    """Write a result, whole or not at all.

    Args:
        folder: to be made.
        result: what to write.
        simulate: write the views that the layers show, too.
        force: replace an earlier result of this name.

    Raises:
        ValueError: the folder exists, or it cannot be written.
    """
    with whole_directory(folder, force=force) as temporary:
        (temporary / "layers").mkdir()
        for k, layer in enumerate(result.codes):
            write_png(temporary / "layers" / f"layer_{k}.png", layer.cpu())
        (temporary / "display.toml").write_text(format_spec(result.display.spec), "utf-8")
        (temporary / "result.json").write_text(json.dumps(result.facts, indent=2), "utf-8")
        if simulate:
            views = _seen(dequantise(result.codes), result.display, result.display.margin)
            write_views(temporary / "views", views, result.display, result.facts["bits"])


def write_views(
    folder: Path, views: Float[Tensor, "view c y x"], display: Display, bits: int
) -> None:
    """Write views as `view_RR_CC.png`, clipped to 0..1; a list of viewpoints is one row."""
    folder.mkdir()
    _, columns = display.geometry.grid or (1, display.view_count)
    for i, view in enumerate(quantise(views.clamp(0, 1), bits)):
        write_png(folder / f"view_{i // columns:02d}_{i % columns:02d}.png", view.cpu())


def write_views_array(path: Path, views: Float[Tensor, "view c y x"], display: Display) -> None:
    """Write unclipped float32 views as `.npy`, `[row, column, y, x, c]`."""
    grid = display.geometry.grid or (1, display.view_count)
    array = views.cpu().unflatten(0, grid).movedim(2, -1).numpy()
    np.save(path, array.astype(np.float32), allow_pickle=False)


def read_layers(folder: str | Path) -> Float[Tensor, "layer c ly lx"]:
    """Read layer images, values from 0 to 1, of a result of `synth` or a plain folder of images.

    Images are taken in the order of the numbers in their names, the nearest to the viewer first.

    Raises:
        ValueError: no folder, no images, or images that differ in size.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}; expected a result of synth or layer images")
    inner = folder / "layers"
    images = _layer_files(inner if inner.is_dir() else folder)
    if not images:
        raise ValueError(
            f"found no layer images in {folder}; expected layer_0.png, layer_1.png ..."
        )
    layers = [torch.from_numpy(read_image(image)) for image in images]
    for image, layer in zip(images, layers, strict=True):
        if layer.shape != layers[0].shape:
            raise ValueError(
                f"{image.name} is {_size(layer)}, {images[0].name} is {_size(layers[0])}; "
                "all layers must have one size and one kind"
            )
    return torch.stack(layers)


def display_of(folder: str | Path) -> Display | None:
    """Return the display that a result of `synth` is for; None for a plain folder."""
    path = Path(folder) / "display.toml"
    return Display.load(path) if path.is_file() else None


def margin_of(folder: str | Path) -> tuple[int, int] | None:
    """Return the margin (y, x) of the layers in a result of `synth`; None for a plain folder.

    Raises:
        ValueError: a result.json without a margin.
    """
    path = Path(folder) / "result.json"
    if not path.is_file():
        return None
    try:
        margin = json.loads(path.read_text("utf-8"))["margin"]
    except (ValueError, KeyError, TypeError, RecursionError):
        margin = None
    match margin:
        case [int(y), int(x)]:
            return y, x
    raise ValueError(f"{path} holds no margin; give --margin, or make the result anew")


def simulate(
    layers: Float[Tensor, "layer c ly lx"], display: Display, margin: tuple[int, int]
) -> Float[Tensor, "view c y x"]:
    """Return the unclipped views that layers show, encoded as those in files are.

    Args:
        layers: encoded values, 0 to 1, front to back.
        display: what shows them.
        margin: pixels (y, x) by which they exceed the views on each side. Light paths that leave
            the layers go on unchanged: nothing is added, or multiplied.

    Raises:
        ValueError: not as many layers as the display has, or nothing left of the views.
    """
    if len(layers) != display.layer_count:
        raise ValueError(
            f"found {len(layers)} layer images, display '{display.name}' has {display.layer_count}"
        )
    size = [n - 2 * m for n, m in zip(layers.shape[-2:], margin, strict=True)]
    if min(margin) < 0 or min(size) < 1:
        raise ValueError(
            f"layers of {_size(layers)} with a margin of {margin[1]}x{margin[0]} px show no views; "
            "give a smaller --margin, 0 or more"
        )
    return _seen(layers, display, margin)


def _seen(layers: Tensor, display: Display, margin: tuple[int, int]) -> Tensor:
    light = display.surround(display.transfer.decode(layers), display.margin, margin)
    return display.transfer.encode(display(light.unsqueeze(-5)))


def _layer_files(folder: Path) -> list[Path]:
    images = [
        p
        for p in folder.iterdir()
        if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and not p.is_dir()
    ]
    return sorted(images, key=lambda p: ([int(n) for n in re.findall(r"\d+", p.stem)], p.name))


def _size(layer: Tensor) -> str:
    kind = "grey" if layer.shape[-3] == 1 else "in colour"
    return f"{layer.shape[-1]}x{layer.shape[-2]} px {kind}"


def _hyper_parameters(solution: Solution) -> dict[str, Any]:
    solver = solution.solver
    return dataclasses.asdict(solver) if dataclasses.is_dataclass(solver) else {}  # pyright: ignore[reportArgumentType]


def _quality(found: Figures) -> dict[str, Any]:
    record = asdict(found) | {"layers": [layer._asdict() for layer in found.layers]}
    return {key: _finite(value) for key, value in record.items()}


def _finite(value: Any) -> Any:
    """JSON has no infinity: a perfect figure becomes None."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
