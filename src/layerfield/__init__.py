"""Layer images for compressive, tensor and layered light field displays.

>>> field = procedural_light_field(size=(48, 64))
>>> display = Display.load("additive-3")
>>> solution = synthesize(field, display)
>>> psnr(display(solution.layers), field.views) > 25
True
"""

import os

# Threads of PyTorch that wait for work spin by default. Where another program wants the same cores
# that makes everything up to a hundred times slower; a short spin costs next to nothing.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

from layerfield.display import Display, preset_names
from layerfield.display_spec import DisparitySpec, PhysicalSpec
from layerfield.evaluate import evaluate
from layerfield.geometry import Geometry
from layerfield.io import FieldOptions, load_light_field
from layerfield.light_field import LightField
from layerfield.metrics import excess, layer_figures, psnr, psnr_by_view, ssim
from layerfield.problem import Problem
from layerfield.reference import Reference, reference
from layerfield.scenes import procedural_light_field
from layerfield.solve import Solution, solve
from layerfield.stream import synthesize_frames
from layerfield.synthesizer import METHODS, synthesize
from layerfield.version import __version__

__all__ = [
    "METHODS",
    "DisparitySpec",
    "Display",
    "FieldOptions",
    "Geometry",
    "LightField",
    "PhysicalSpec",
    "Problem",
    "Reference",
    "Solution",
    "__version__",
    "evaluate",
    "excess",
    "layer_figures",
    "load_light_field",
    "preset_names",
    "procedural_light_field",
    "psnr",
    "psnr_by_view",
    "reference",
    "solve",
    "ssim",
    "synthesize",
    "synthesize_frames",
]
