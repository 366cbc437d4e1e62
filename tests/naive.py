"""Plain loops in double precision, one ray at a time: what the fast code is compared with."""

import math

import numpy as np


def sample(layer: np.ndarray, y: float, x: float) -> float:
    """Linear interpolation at a position inside the layer."""
    y0, x0 = math.floor(y + 1e-9), math.floor(x + 1e-9)
    fy, fx = max(y - y0, 0.0), max(x - x0, 0.0)
    total = 0.0
    for dy, wy in ((0, 1 - fy), (1, fy)):
        for dx, wx in ((0, 1 - fx), (1, fx)):
            if wy * wx > 1e-12:
                total += wy * wx * layer[y0 + dy, x0 + dx]
    return total


def composed(met: list[float], link: str) -> float:
    """The light of a path that meets these pixels."""
    if link == "multiplicative":
        return math.prod(met)
    return math.sin(math.pi / 2 * sum(met)) ** 2 if link == "polarisation" else sum(met)


def view(layers: np.ndarray, shifts, margin, link: str) -> np.ndarray:
    """One view of `[layer, y, x]`, pixel by pixel."""
    my, mx = margin
    height, width = layers.shape[1] - 2 * my, layers.shape[2] - 2 * mx
    result = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            met = [
                sample(layer, y + my + dy, x + mx + dx)
                for layer, (dx, dy) in zip(layers, shifts, strict=True)
            ]
            result[y, x] = composed(met, link)
    return result


def traced_view(layers, viewpoint, depths, pitch, margin, link: str, scales=None) -> np.ndarray:
    """One view by tracing rays from (X, Y, Z) through pixels to layers on their scaled grids.

    The ray through (x, y, 0) meets depth z at x (1 - z / Z) + X z / Z; the pixels of that layer are
    (1 - z / Z), or the scale given, times as large as those of the display plane. All lengths in
    metres.
    """
    ex, ey, ez = viewpoint
    my, mx = margin
    height, width = layers.shape[1] - 2 * my, layers.shape[2] - 2 * mx
    result = np.empty((height, width))
    for row in range(height):
        for column in range(width):
            x = (column - (width - 1) / 2) * pitch
            y = (row - (height - 1) / 2) * pitch
            met = []
            for k, (layer, z) in enumerate(zip(layers, depths, strict=True)):
                hit_x, hit_y = x * (1 - z / ez) + ex * z / ez, y * (1 - z / ez) + ey * z / ez
                own = pitch * (1 - z / ez if scales is None else scales[k])
                met.append(
                    sample(
                        layer,
                        hit_y / own + (height - 1) / 2 + my,
                        hit_x / own + (width - 1) / 2 + mx,
                    )
                )
            result[row, column] = composed(met, link)
    return result


def sample_or_dark(panel: np.ndarray, y: float, x: float) -> float:
    """Linear interpolation at any position; outside the panel there is no light."""
    y0, x0 = math.floor(y), math.floor(x)
    total = 0.0
    for row, wy in ((y0, 1 - (y - y0)), (y0 + 1, y - y0)):
        for column, wx in ((x0, 1 - (x - x0)), (x0 + 1, x - x0)):
            if 0 <= row < panel.shape[0] and 0 <= column < panel.shape[1]:
                total += wy * wx * panel[row, column]
    return total


def panel_view(panels, viewpoint, depths, pitch, size, link: str) -> np.ndarray:
    """One view by tracing rays to panels that are moved, turned and flipped. Lengths in metres.

    Panels are (light [y, x], pitch, offset, rotation, flip) with the rotation clockwise in radians
    and flip as signs along x and y.
    """
    ex, ey, ez = viewpoint
    height, width = size
    result = np.empty(size)
    for row in range(height):
        for column in range(width):
            x, y = (column - (width - 1) / 2) * pitch, (row - (height - 1) / 2) * pitch
            met = []
            for (light, own, offset, turn, flip), z in zip(panels, depths, strict=True):
                t = z / ez
                dx = x + (ex - x) * t - offset[0]
                dy = y + (ey - y) * t - offset[1]
                along = (dx * math.cos(turn) + dy * math.sin(turn)) * flip[0] / own
                down = (dy * math.cos(turn) - dx * math.sin(turn)) * flip[1] / own
                rows, columns = light.shape
                met.append(sample_or_dark(light, down + (rows - 1) / 2, along + (columns - 1) / 2))
            result[row, column] = composed(met, link)
    return result
