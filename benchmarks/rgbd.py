"""How near views made of one picture and its depth map come to the true ones.

    python benchmarks/rgbd.py OUT.json [FIELD] [--figure OUT.webp]

Procedural scenes of 384x512, 5x5 views, disparities -1 to 1: PSNR of all views that are made of the
middle one and the exact disparities, or of these blurred by 2 px and rounded to 8 bits; and of the
middle view in place of all. FIELD is what `layerfield render --depth` made: judged, and drawn.
"""

import argparse
import json
import statistics
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image
from torch import Tensor

from layerfield import load_light_field, psnr
from layerfield.geometry import Geometry, grid_points
from layerfield.io import whole_file
from layerfield.rgbd.flat_picture import PictureWithDepth
from layerfield.scenes import random_scenes, render

SEEDS, SIZE = range(100, 110), (384, 512)
GRID = (5, 5)
GEOMETRY = Geometry(slopes=grid_points(GRID), depths=(1.0, -1.0), grid=GRID)
MIDDLE, CORNER = 12, 0
EDGE = (slice(86, 182), slice(120, 248))  # of the figure, y and x of a part to be enlarged


def made_of(picture: Tensor, disparity: Tensor) -> Tensor:
    return torch.stack(list(PictureWithDepth(picture, disparity, GEOMETRY).views()))


def poor(disparity: Tensor) -> Tensor:
    blurred = cv2.GaussianBlur(disparity.numpy(), (0, 0), 2)
    low, high = blurred.min(), blurred.max()
    codes = ((blurred - low) / (high - low) * 255).round()
    return torch.from_numpy((codes / 255 * (high - low) + low).astype(np.float32))


def judged(name: str, true: Tensor, disparity: Tensor) -> dict[str, float | str]:
    picture = true[MIDDLE]
    row = {
        "scene": name,
        "exact": psnr(made_of(picture, disparity), true),
        "blurred": psnr(made_of(picture, poor(disparity)), true),
        "picture": psnr(picture.expand_as(true), true),
    }
    print(json.dumps(row), flush=True)
    return row


def procedural(seed: int) -> dict[str, float | str]:
    scene = random_scenes(1, size=SIZE, seed=seed)
    return judged(f"seed {seed}", render(scene, GEOMETRY.slopes)[0], scene.disparity_map[0])


def rendered(folder: Path) -> tuple[Tensor, Tensor]:
    disparity = np.load(folder / "disparity" / "disparity_02_02.npy")
    return load_light_field(folder).views, torch.from_numpy(disparity)


def draw(true: Tensor, disparity: Tensor, path: Path) -> None:
    """The picture and its map; below a corner view, true and made; an edge of both, enlarged."""
    made = made_of(true[MIDDLE], disparity)[CORNER]
    near = (disparity - disparity.min()) / (disparity.max() - disparity.min())
    error = (4 * (made - true[CORNER])).abs().mean(0)
    rows = [
        [true[MIDDLE], near.expand_as(made), error.expand_as(made)],
        [true[CORNER], made, torch.cat([_large(true[CORNER]), _large(made)], dim=1)],
    ]
    size = true.shape[-2:]
    lines = [torch.cat([_fitted(p, size) for p in row], dim=2) for row in rows]
    pixels = (torch.cat(lines, dim=1).clamp(0, 1) * 255).round().byte()
    with whole_file(path, force=True) as temporary:
        Image.fromarray(pixels.permute(1, 2, 0).numpy()).save(temporary, quality=85)


def _large(picture: Tensor) -> Tensor:
    return picture[:, *EDGE].repeat_interleave(3, 1).repeat_interleave(3, 2)


def _fitted(picture: Tensor, size: torch.Size) -> Tensor:
    height, width = size
    pixels = picture.permute(1, 2, 0).numpy()
    resized = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(resized).permute(2, 0, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("field", type=Path, nargs="?")
    parser.add_argument("--figure", type=Path)
    asked = parser.parse_args()
    rows = [procedural(seed) for seed in SEEDS]
    kinds = ("exact", "blurred", "picture")
    means = {kind: statistics.fmean(float(row[kind]) for row in rows) for kind in kinds}
    if asked.field:
        true, disparity = rendered(asked.field)
        rows.append(judged(asked.field.name, true, disparity))
        if asked.figure:
            draw(true, disparity, asked.figure)
    print(json.dumps(means))
    with whole_file(asked.out, force=True) as temporary:
        temporary.write_text(json.dumps({"means": means, "rows": rows}, indent=1), "utf-8")


if __name__ == "__main__":
    main()
