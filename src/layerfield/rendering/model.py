"""A 3D model as it is rendered: triangles and what they are made of."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int, Num, UInt8

_CREASE = np.cos(np.radians(40))  # faces that meet under a larger angle have an edge between them
_FACES_OF_A_CORNER = 64  # of more, as at the tip of a fine cone, only neighbours are asked

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """What a surface is made of, after the metallic-roughness model of glTF.

    Factors are light (linear), 0 to 1, and multiply the textures; textures hold sRGB values where
    they are colours and plain numbers where they are not. Their first row is at the top, v = 0.

    Args:
        colour: share of the light that comes back; of metals, the colour of their gloss.
        texture: of the colour.
        metallic: 0 for other matter, 1 for metals.
        roughness: 0 for a mirror, 1 for chalk.
        metallic_roughness: texture whose green channel is roughness and whose blue one is metallic.
        bumps: tangent-space normals as a texture.
        glow: light that the surface gives by itself.
        glow_texture: of it.
        opacity: 1 for solid surfaces.
        cutout: texture of the opacity.
    """

    colour: Colour = (0.6, 0.6, 0.6)
    texture: UInt8[np.ndarray, "y x 3"] | None = None
    metallic: float = 0.0
    roughness: float = 1.0
    metallic_roughness: UInt8[np.ndarray, "y x 3"] | None = None
    bumps: UInt8[np.ndarray, "y x 3"] | None = None
    glow: Colour = (0.0, 0.0, 0.0)
    glow_texture: UInt8[np.ndarray, "y x 3"] | None = None
    opacity: float = 1.0
    cutout: Float[np.ndarray, "y x"] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """Triangles of one material.

    Args:
        vertices: positions in units of the model.
        faces: three vertices each, counterclockwise seen from outside.
        normals: of the vertices; None makes them from the faces, with edges where faces meet
            sharply.
        texture_at: (u, v) of every vertex, v = 0 at the top of the texture.
        colours: of the vertices, linear, multiplying that of the material.
        material: what they are made of.
    """

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    normals: Float[np.ndarray, "vertex 3"] | None = None
    texture_at: Float[np.ndarray, "vertex 2"] | None = None
    colours: Float[np.ndarray, "vertex 3"] | None = None
    material: Material = field(default_factory=Material)

    def by_corners(self) -> "Surface":
        """Return the same triangles, none of which shares a vertex with another, with normals."""
        corners = self.faces.reshape(-1)
        apart = {
            name: None if values is None else values[corners]
            for name in ("normals", "texture_at", "colours")
            for values in [getattr(self, name)]
        }
        if apart["normals"] is None:
            apart["normals"] = _corner_normals(self.vertices, self.faces)
        return Surface(
            vertices=self.vertices[corners],
            faces=np.arange(len(corners)).reshape(-1, 3),
            material=self.material,
            **apart,
        )


@dataclass(frozen=True, eq=False)
class Model:
    """Surfaces, the second axis pointing up and the third to the front.

    Args:
        surfaces: with at least one triangle in all.
        name: what tables call it.
    """

    surfaces: tuple[Surface, ...]
    name: str

    @classmethod
    def centred(cls, surfaces: Sequence[Surface], name: str) -> "Model":
        """Return the model, moved so that the centre of its box is the origin: it turns there."""
        vertices = cls(tuple(surfaces), name).vertices
        centre = (vertices.min(0) + vertices.max(0)) / 2
        moved = (replace(surface, vertices=surface.vertices - centre) for surface in surfaces)
        return cls(tuple(moved), name)

    @property
    def vertices(self) -> Float[np.ndarray, "vertex 3"]:
        """All vertices that are corners of triangles."""
        return np.concatenate([s.vertices[np.unique(s.faces)] for s in self.surfaces])


def decode_srgb(values: Num[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Return the light, 0 to 1, that 8-bit sRGB values stand for."""
    v = np.asarray(values, np.float64) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def _corner_normals(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "corner 3"]:
    """Return the mean normal of the faces around a corner that are about as steep as its own.

    Larger faces count more. Vertices at one place are one vertex.
    """
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    areas = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    directions = _unit(areas)
    order = np.argsort(place.reshape(-1)[faces.reshape(-1)], kind="stable")
    at, areas, directions = (
        place.reshape(-1)[faces.reshape(-1)][order],
        areas[order],
        directions[order],
    )
    total = areas.copy()
    for apart in range(1, min(_FACES_OF_A_CORNER, len(at))):
        meet = at[:-apart] == at[apart:]
        if not meet.any():
            break
        meet &= (directions[:-apart] * directions[apart:]).sum(1) > _CREASE
        total[:-apart][meet] += areas[apart:][meet]
        total[apart:][meet] += areas[:-apart][meet]
    normals = np.empty_like(total)
    normals[order] = _unit(total)
    return normals


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(lengths > 0, vectors / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
