"""A panel as it is written down: its pixels, where it is mounted, and what its codes make of light.

The centre of a panel's pixels lies `offset_mm` from the axis of the display; the panel is turned
about it. From layer pixels x, on the layer's scaled grid, to panel pixels u, with F the flip and R
the rotation:

    u = centre of the panel + F R^T (layer pitch * (x - centre of the layer) - offset) / panel pitch
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from layerfield.panel_projection import Matrix
from layerfield.toml_model import Number
from layerfield.transfer import WrittenTransfer

PixelCount = Annotated[int, Field(strict=True, ge=1, le=32768)]
Row = tuple[Number, Number, Number]

_SINGULAR = 1e-9  # a determinant, relative to the lengths of the columns
_MOUNTING = ("pitch_um", "offset_mm", "rotation_deg", "flip")


class PanelSpec(BaseModel):
    """One panel.

    Args:
        resolution: [width, height] in pixels.
        pitch_um: pixel pitch, micrometres.
        offset_mm: [x, y] of its centre from the axis of the display, right and down.
        rotation_deg: turned clockwise about its centre, as viewers see it.
        flip: mounted so that its columns run from right to left ("horizontal"), or its rows from
            bottom to top ("vertical").
        homography: instead of these four, (x, y, 1) of a pixel of `layers/layer_K.png` to a panel
            pixel; the centre of the top left pixel of either is (0, 0).
        bits: of its codes, 8 or 16.
        transfer: what light they make; that of the display if not given.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    resolution: tuple[PixelCount, PixelCount]
    pitch_um: Annotated[Number, Field(gt=0)] | None = None
    offset_mm: tuple[Number, Number] = (0.0, 0.0)
    rotation_deg: Number = 0.0
    flip: Literal["none", "horizontal", "vertical"] = "none"
    homography: tuple[Row, Row, Row] | None = None
    bits: Literal[8, 16] = 8
    transfer: WrittenTransfer | None = None

    @field_validator("homography")
    @classmethod
    def _invertible(cls, rows: Matrix | None) -> Matrix | None:
        if rows is not None:
            lengths = np.linalg.norm(rows, axis=0).prod()
            if abs(np.linalg.det(rows)) <= _SINGULAR * lengths:
                raise ValueError("the matrix is singular: it maps the layer onto a line or a point")
        return rows

    @model_validator(mode="after")
    def _placed_once(self):
        given = [key for key in _MOUNTING if key in self.model_fields_set]
        if self.homography is None and self.pitch_um is None:
            raise ValueError("expected either 'pitch_um' or 'homography', found neither")
        if self.homography is not None and given:
            raise ValueError(f"'homography' says where the panel is; leave out '{given[0]}'")
        return self

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.resolution[1], self.resolution[0]

    def mapping(self, layer_pitch: float, layer_size: tuple[int, int]) -> Matrix:
        """Return the homography from layer pixels to panel pixels.

        Args:
            layer_pitch: of the layer's scaled grid, in metres.
            layer_size: height and width of the layer, margin included.
        """
        if self.homography is not None or self.pitch_um is None:
            return self.homography  # pyright: ignore[reportReturnType]  one of the two is given
        turn = math.radians(self.rotation_deg)
        back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        mirror = np.diag([1 - 2 * (self.flip == "horizontal"), 1 - 2 * (self.flip == "vertical")])
        onto = mirror @ back / (self.pitch_um * 1e-6)  # metres to panel pixels
        (height, width), (rows, columns) = layer_size, self.size
        corner = layer_pitch * np.array([width - 1, height - 1]) / 2 + np.multiply(
            self.offset_mm, 1e-3
        )
        start = np.array([columns - 1, rows - 1]) / 2 - onto @ corner
        linear = onto * layer_pitch
        return (
            (float(linear[0, 0]), float(linear[0, 1]), float(start[0])),
            (float(linear[1, 0]), float(linear[1, 1]), float(start[1])),
            (0.0, 0.0, 1.0),
        )
