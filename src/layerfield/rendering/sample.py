"""The model that comes with the package: a still life, made here."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from layerfield.rendering.model import Material, Model, Surface

_FINE = 96  # pieces around
_TEXELS = 512
_GOLD = Material(colour=(1.0, 0.72, 0.3), metallic=1.0, roughness=0.22)
_VASE = ((0, 0), (0.2, 0), (0.24, 0.06), (0.36, 0.3), (0.37, 0.48), (0.26, 0.78), (0.13, 0.98))
_LIP = ((0.12, 1.1), (0.2, 1.24), (0.17, 1.24), (0.09, 1.1))

Profile = Float[np.ndarray, "n 2"]


def sample_model() -> Model:
    """Return a globe, a crate, a vase and a ring, with textures, gloss and metal."""
    rng = np.random.default_rng(7)
    things = [
        _placed(_lathe(_ball(0.5), _globe(rng), 0.3), (-0.8, 0.5, 0.3), turn=20),
        _placed(_crate(0.95, _planks(rng)), (0.1, 0.475, -0.65), turn=35),
        _placed(_lathe(_smooth((*_VASE, *_LIP)), _glaze(), 0.3), (0.98, 0.0, 0.05)),
        _placed(_ring(0.27, 0.085), (0.2, 0.085, 0.7)),
    ]
    return Model.centred(things, "sample")


def _placed(surface: Surface, at: tuple[float, float, float], turn: float = 0.0) -> Surface:
    a = np.radians(turn)
    turned = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return Surface(
        vertices=surface.vertices @ turned.T + at,
        faces=surface.faces,
        normals=None if surface.normals is None else surface.normals @ turned.T,
        texture_at=surface.texture_at,
        material=surface.material,
    )


def _lathe(profile: Profile, texture: UInt8[np.ndarray, "y x 3"], roughness: float) -> Surface:
    """Turn a profile, (radius, height) from below, about the vertical axis."""
    along = np.gradient(profile, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    angles = np.linspace(0, 2 * np.pi, _FINE + 1)
    radius, height = (np.repeat(profile[:, axis], len(angles)) for axis in (0, 1))
    out, up = np.repeat(along[:, 1], len(angles)), np.repeat(-along[:, 0], len(angles))
    around = np.tile(angles, len(profile))
    x, z = np.sin(around), np.cos(around)
    down = np.repeat(1 - np.linspace(0, 1, len(profile)), len(angles))
    return Surface(
        vertices=np.stack([radius * x, height, radius * z], axis=1),
        faces=_sheet(len(profile), len(angles)),
        normals=np.stack([out * x, up, out * z], axis=1),
        texture_at=np.stack([around / (2 * np.pi), down], axis=1),
        material=Material(colour=(1.0, 1.0, 1.0), texture=texture, roughness=roughness),
    )


def _sheet(rows: int, columns: int) -> np.ndarray:
    """Triangles between the points of a grid, its rows going up and its columns to the right."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
    pair = [[0, 1, columns + 1], [0, columns + 1, columns]]
    return np.concatenate([first + corners for corners in pair])


def _ball(radius: float) -> Profile:
    turn = np.linspace(-np.pi / 2, np.pi / 2, _FINE // 2 + 1)
    return radius * np.stack([np.cos(turn).clip(1e-6), np.sin(turn)], axis=1)


def _smooth(corners: tuple[tuple[float, float], ...]) -> Profile:
    """Round off a line through corners: each piece is cut at a quarter, again and again."""
    line = np.array(corners, np.float64)
    for _ in range(4):
        near, far = line[:-1], line[1:]
        cut = np.stack([0.75 * near + 0.25 * far, 0.25 * near + 0.75 * far], axis=1)
        line = np.concatenate([line[:1], cut.reshape(-1, 2), line[-1:]])
    return line


def _ring(radius: float, thickness: float) -> Surface:
    angles = np.linspace(0, 2 * np.pi, _FINE + 1)
    around, across = (a.reshape(-1) for a in np.meshgrid(angles, angles))
    out = np.stack([np.sin(around), 0 * around, np.cos(around)], axis=1)
    normals = np.cos(across)[:, None] * out + np.sin(across)[:, None] * [0.0, 1.0, 0.0]
    return Surface(
        vertices=radius * out + thickness * normals,
        faces=_sheet(len(angles), len(angles)),
        normals=normals,
        material=_GOLD,
    )


def _crate(side: float, texture: UInt8[np.ndarray, "y x 3"]) -> Surface:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
    front = np.column_stack([square, np.full(4, side / 2)])
    turns = [np.roll(np.eye(3), n, axis=1) for n in range(3)]
    flip = np.diag([-1.0, 1.0, -1.0])
    sides = [front @ turn.T @ back for turn in turns for back in (np.eye(3), flip)]
    sides[4:] = [front @ t.T for t in (turns[2], turns[2] @ flip)]
    corners = np.concatenate(sides)
    return Surface(
        vertices=corners,
        faces=np.concatenate([4 * n + np.array([[0, 1, 2], [0, 2, 3]]) for n in range(6)]),
        texture_at=np.tile((square / side * [1, -1] + 0.5), (6, 1)),
        material=Material(colour=(1.0, 1.0, 1.0), texture=texture),
    )


def _globe(rng: np.random.Generator) -> UInt8[np.ndarray, "y x 3"]:
    """Lands and seas: sums of waves in all directions, so that they close around the globe."""
    down, around = np.meshgrid(
        np.linspace(np.pi / 2, -np.pi / 2, _TEXELS), np.linspace(0, 2 * np.pi, 2 * _TEXELS),
        indexing="ij",
    )  # fmt: skip
    place = np.stack(
        [np.cos(down) * np.sin(around), np.sin(down), np.cos(down) * np.cos(around)], axis=-1
    ).astype(np.float32)
    height = np.zeros(down.shape, np.float32)
    for wave in rng.normal(size=(90, 3)).astype(np.float32):
        often = 2.2 * rng.random() ** -0.45
        height += np.sin(place @ (often * wave) + rng.uniform(0, 7)) / often
    land = np.clip(6 * height - 0.5, 0, 1)[..., None]
    sea = np.array([40, 92, 150]) * (1 + 0.1 * height[..., None])
    ground = np.array([196, 172, 110]) * (1 - 0.35 * np.clip(height[..., None], 0, 1.5))
    lines = (np.cos(12 * around) > 0.995) | (np.cos(12 * down) > 0.995)
    return _bytes(np.where(lines[..., None], 235.0, sea + land * (ground - sea)))


def _planks(rng: np.random.Generator) -> UInt8[np.ndarray, "y x 3"]:
    """Boards with a grain, a frame of darker ones around them."""
    grain = cv2.resize(rng.normal(size=(160, 5)), (_TEXELS, _TEXELS), interpolation=cv2.INTER_CUBIC)
    tone = np.repeat(rng.uniform(0.8, 1.15, 5), _TEXELS // 5 + 1)[:_TEXELS, None] + 0.07 * grain
    y, x = np.mgrid[:_TEXELS, :_TEXELS]
    tone = np.where(y % (_TEXELS // 5 + 1) < 5, 0.35, tone)
    edge = np.minimum(np.minimum(x, y), _TEXELS - 1 - np.maximum(x, y))
    tone = np.where(edge < 58, 0.72 + 0.06 * grain.T, tone)
    tone = np.where(abs(edge - 58) < 4, 0.3, tone)
    return _bytes(tone[..., None] * np.array([178, 122, 70]))


def _glaze() -> UInt8[np.ndarray, "y x 3"]:
    """White with blue bands and a pattern of leaves."""
    v, u = np.mgrid[:_TEXELS, : 2 * _TEXELS] / _TEXELS
    leaves = np.sin(2 * np.pi * (5 * u + 2 * v)) * np.sin(2 * np.pi * (5 * u - 5 * v)) > 0.35
    blue = (leaves & (v > 0.34) & (v < 0.78)) | (abs(v - 0.3) < 0.012) | (abs(v - 0.82) < 0.012)
    return _bytes(np.where(blue[..., None], [38.0, 62.0, 140.0], [238.0, 236.0, 228.0]))


def _bytes(colours: Float[np.ndarray, "y x 3"]) -> UInt8[np.ndarray, "y x 3"]:
    return colours.round().clip(0, 255).astype(np.uint8)
