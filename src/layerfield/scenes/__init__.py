"""Light fields made here."""

from layerfield.scenes.moving import animated, panned, travelled
from layerfield.scenes.procedural import procedural_light_field, random_scenes, scenes_for
from layerfield.scenes.scene import Scene, make_scene, render, spot_scene

__all__ = [
    "Scene",
    "animated",
    "make_scene",
    "panned",
    "procedural_light_field",
    "random_scenes",
    "render",
    "scenes_for",
    "spot_scene",
    "travelled",
]
