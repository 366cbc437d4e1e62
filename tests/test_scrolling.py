"""Views that move give layers that move alike: nothing flickers when a scene scrolls."""

import pytest

from layerfield import Display, LightField, procedural_light_field, synthesize
from layerfield.metrics import decibels

SIZE, BORDER = (224, 240), 64  # near the border layers depend on what comes into the picture


@pytest.mark.parametrize(
    ("method", "iterations", "shift"),
    [
        *(("fourier-admm", 10, shift) for shift in (1, 6, 15)),
        *(("fast", steps, shift) for shift in (1, 3, 6, 15) for steps in (1, 4)),
        ("unet", None, 6),
    ],
)
def test_layers_move_as_the_views_do(method, iterations, shift):
    height, width = SIZE
    size = (height + shift, width + shift)
    whole = procedural_light_field(size=size, disparity_range=(-1.5, 1.5), seed=7)
    first, later = (
        synthesize(
            LightField(whole.stored[..., n : n + height, n : n + width].contiguous(), whole.grid),
            Display.load("additive-3"),
            method=method,
            iterations=iterations,
        ).layers
        for n in (0, shift)
    )
    there = first[..., shift:, shift:]
    here = later[..., : there.shape[-2], : there.shape[-1]]
    error = (there - here)[..., BORDER:-BORDER, BORDER:-BORDER]
    assert decibels(error.square().mean().item()) > 45
