"""Materials of files, as trimesh hands them over, in the terms of the renderer."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from layerfield.rendering.model import Colour, Material, decode_srgb

_BLACK, _WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
_DULL = 1.0  # roughness of OBJ materials that do not shine
_CUTOFF = 0.5  # of glTF: opacity below which a masked surface is not there


def material_of(mesh: Any) -> Material:
    """Return the material of a mesh; light grey matter where the file names none."""
    visual: Any = mesh.visual
    if visual.kind in ("vertex", "face"):
        return Material(colour=_WHITE)
    material = getattr(visual, "material", None)
    if material is None:
        return Material()
    pbr = hasattr(material, "baseColorFactor")
    made = _of_gltf(material) if pbr else _of_obj(material)
    return made if getattr(visual, "uv", None) is not None else _without_textures(made)


def vertex_colours(mesh: Any, *, linear: bool) -> Float[np.ndarray, "vertex 3"] | None:
    """Return the colours of vertices as light.

    Args:
        mesh: as read.
        linear: whether they are light in the file, too.
    """
    visual: Any = mesh.visual
    found = getattr(visual, "vertex_attributes", {}).get("color")
    if visual.kind == "vertex":
        found = visual.vertex_colors
    if found is None or len(found) != len(mesh.vertices):
        return None
    colours = np.asarray(found)[:, :3]
    if colours.dtype.kind == "f":
        return np.clip(colours.astype(np.float64), 0, 1)
    scaled = colours / np.iinfo(colours.dtype).max
    return scaled if linear else decode_srgb(scaled * 255)


def face_colours(mesh: Any) -> Float[np.ndarray, "face 3"] | None:
    """Return the colours of faces as light, where a file has colours of faces."""
    visual: Any = mesh.visual
    return decode_srgb(visual.face_colors[:, :3]) if visual.kind == "face" else None


def _without_textures(material: Material) -> Material:
    plain = dict.fromkeys(("texture", "metallic_roughness", "bumps", "glow_texture", "cutout"))
    return replace(material, **plain)


def _of_gltf(material: Any) -> Material:
    """Factors are light by the standard; where one is missing there it is 1."""
    colour, opacity = _factors(material.baseColorFactor)
    alpha = material.alphaMode or "OPAQUE"
    base = material.baseColorTexture
    metallic, rough = material.metallicFactor, material.roughnessFactor
    glow = material.emissiveFactor
    solid = alpha == "OPAQUE"
    return Material(
        colour=colour,
        texture=_pixels(base),
        metallic=1.0 if metallic is None else float(metallic),
        roughness=1.0 if rough is None else float(rough),
        metallic_roughness=_pixels(material.metallicRoughnessTexture),
        bumps=_pixels(material.normalTexture),
        glow=_BLACK if glow is None else _colour(glow),
        glow_texture=_pixels(material.emissiveTexture),
        opacity=1.0 if solid else opacity,
        cutout=None if solid else _cutout(base, alpha, material.alphaCutoff),
    )


def _of_obj(material: Any) -> Material:
    """The map of Kd, or Kd, taken as a colour of pictures, sRGB; a gloss from Ns, and d.

    Kd beside a map is left out, as exporters write anything there.
    """
    said = getattr(material, "kwargs", {})
    picture = getattr(material, "image", None)
    diffuse = _colour(decode_srgb(np.asarray(material.diffuse)))
    shines = max(np.ravel(said.get("ks", 0.0))) > 0.05
    gloss = float(np.ravel(said.get("ns", 0.0))[0])
    opacity = np.ravel(said.get("d", 1.0))[0]
    return Material(
        colour=diffuse if picture is None else _WHITE,
        texture=_pixels(picture),
        roughness=min(_DULL, math.sqrt(2 / (gloss + 2))) if shines else _DULL,
        opacity=float(opacity) if _is_number(opacity) else 1.0,
        cutout=_cutout(picture, "BLEND", None),
    )


def _factors(found: Any) -> tuple[Colour, float]:
    """Return colour and opacity: trimesh keeps these factors, light from 0 to 1, as bytes."""
    factors = np.ones(4) if found is None else np.asarray(found) / 255
    return _colour(factors), float(factors[3])


def _colour(numbers: Any) -> Colour:
    red, green, blue = (float(number) for number in numbers[:3])
    return red, green, blue


def _pixels(image: Image.Image | None) -> UInt8[np.ndarray, "y x 3"] | None:
    return None if image is None else np.asarray(image.convert("RGB"))


def _cutout(
    image: Image.Image | None, alpha: str, cutoff: float | None
) -> Float[np.ndarray, "y x"] | None:
    if image is None or not image.has_transparency_data:
        return None
    opacity = np.asarray(image.convert("RGBA"))[..., 3] / 255
    if (opacity == 1).all():
        return None
    if alpha == "MASK":
        return (opacity >= (_CUTOFF if cutoff is None else cutoff)).astype(np.float64)
    return opacity


def _is_number(text: Any) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
