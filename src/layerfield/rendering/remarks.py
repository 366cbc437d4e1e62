"""What a user may want to know of how a scene was put into a display."""

import math

from layerfield.rendering.job import Job
from layerfield.rendering.placement import Placement, in_disparities, view_step
from layerfield.rendering.variant import SAFE


def remarks(job: Job, variant: str) -> list[str]:
    """Return sentences on the scale, the depth and the renderer, for a terminal."""
    placement = job.placement
    lines = _of_disparities(placement) if in_disparities(job.display) else _of_lengths(placement)
    low, high = placement.disparities()
    if placement.geometry.grid is not None and len(placement.geometry.slopes) > 1:
        lines.append(f"disparities are {low:.2f} to {high:.2f} px between neighbouring views")
    if variant == SAFE and job.quality.samples:
        lines.append(
            "note: no library of LLVM fits Mitsuba here, so that rendering takes two to three "
            "times as long; docs/render.md says which does"
        )
    return lines


def _of_lengths(placement: Placement) -> list[str]:
    far, near = (1e3 * depth for depth in placement.depths)
    pitch = placement.geometry.pitch
    true = placement.gain / pitch
    unit = 1e3 * placement.scale * pitch
    depth = f"depth is {far:.1f} to {near:.1f} mm from the display plane"
    shape = (
        "as deep as it is"
        if math.isclose(true, 1)
        else f"{true:.0%} of its own depth ({(near - far) / true:.0f} mm)"
    )
    return [f"one unit of the model is {unit:.4g} mm; {depth}, {shape}"]


def _of_disparities(placement: Placement) -> list[str]:
    angle = math.degrees(math.atan(placement.gain * abs(view_step(placement.geometry))))
    return [
        f"one unit of the model is {placement.scale:.4g} px; one pixel of disparity stands for "
        f"{1 / placement.gain:.0f} px of depth, neighbouring views being {angle:.2f} degrees apart"
    ]
