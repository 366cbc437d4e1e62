"""Surfaces and materials as Mitsuba takes them."""

from typing import Any

import numpy as np
from jaxtyping import Float, Num

from layerfield.rendering.model import Material, Surface, decode_srgb
from layerfield.rendering.variant import mitsuba

_COLOURS = "vertex_color"  # of the attribute; Mitsuba asks for the first word
_SMOOTHEST = 0.05  # a perfect mirror would show the lights as points


def mesh_of(surface: Surface, to_scene: Float[np.ndarray, "4 4"]) -> Any:
    """Return a mesh of Mitsuba.

    Args:
        surface: with positions in units of the model.
        to_scene: a similarity from there to the scene.
    """
    mi = mitsuba()

    corners = surface if surface.normals is not None else surface.by_corners()
    vertices = corners.vertices @ to_scene[:3, :3].T + to_scene[:3, 3]
    turn = to_scene[:3, :3] / np.linalg.norm(to_scene[:3, 0])
    assert corners.normals is not None
    made = mi.Mesh(
        "surface",
        len(vertices),
        len(corners.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=corners.texture_at is not None,
        props=_properties(corners),
    )
    if corners.colours is not None:
        colours = corners.colours * corners.material.colour
        made.add_attribute(_COLOURS, 3, _flat(colours))
    buffers = mi.traverse(made)
    buffers["vertex_positions"] = _flat(vertices)
    buffers["vertex_normals"] = _flat(corners.normals @ turn.T)
    buffers["faces"] = np.ravel(corners.faces).astype(np.uint32)
    if corners.texture_at is not None:
        buffers["vertex_texcoords"] = _flat(corners.texture_at)
    buffers.update()
    return made


def _properties(surface: Surface) -> Any:
    mi = mitsuba()

    properties, material = mi.Properties(), surface.material
    properties["bsdf"] = mi.load_dict(_bsdf(material, coloured=surface.colours is not None))
    if max(material.glow) > 0:
        radiance = _picture(material.glow_texture, material.glow)
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    return properties


def _bsdf(material: Material, *, coloured: bool) -> dict[str, Any]:
    colour = _picture(material.texture, material.colour)
    if coloured and material.texture is None:
        colour = {"type": "mesh_attribute", "name": _COLOURS}
    if _is_chalk(material):  # with far less noise than the general model
        made: dict[str, Any] = {"type": "diffuse", "reflectance": colour}
    else:
        rough, metallic = _gloss(material)
        made = {"type": "principled", "base_color": colour}
        made |= {"roughness": rough, "metallic": metallic}
    if material.bumps is not None:
        made = {"type": "normalmap", "normalmap": _raw(material.bumps / 255), "bsdf": made}
    made = {"type": "twosided", "bsdf": made}
    if material.cutout is None and material.opacity >= 1:
        return made
    opacity: Any = material.opacity
    if material.cutout is not None:
        opacity = _raw(material.opacity * material.cutout[..., None])
    return {"type": "mask", "opacity": opacity, "bsdf": made}


def _is_chalk(material: Material) -> bool:
    plain = material.metallic_roughness is None
    return plain and material.roughness >= 1 and material.metallic == 0


def _gloss(material: Material) -> tuple[Any, Any]:
    if material.metallic_roughness is None:
        return max(material.roughness, _SMOOTHEST), material.metallic
    values = material.metallic_roughness / 255
    rough = np.maximum(values[..., 1:2] * material.roughness, _SMOOTHEST)
    return _raw(rough), _raw(values[..., 2:3] * material.metallic)


def _picture(texture: np.ndarray | None, colour: tuple[float, ...]) -> dict[str, Any]:
    """A colour, or a texture of colours times it."""
    mi = mitsuba()

    if texture is None:
        return {"type": "rgb", "value": list(colour)}
    if colour == (1.0, 1.0, 1.0):
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.array(texture))}
    return _raw(decode_srgb(texture) * colour)


def _raw(values: Num[np.ndarray, "y x c"]) -> dict[str, Any]:
    """A texture of plain numbers."""
    mi = mitsuba()

    bitmap = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True}


def _flat(values: Num[np.ndarray, "n c"]) -> Num[np.ndarray, " m"]:
    return np.ravel(values).astype(np.float32)
