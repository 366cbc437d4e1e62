"""The light field: views of one scene and the grid they were taken on."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from jaxtyping import Float, Num
from torch import Tensor

from layerfield.geometry import Point
from layerfield.kept_views import KeptViews


@dataclass(frozen=True, eq=False)
class EyeViews:
    """What eyes in and around a grid of viewpoints see of a scene.

    Args:
        views: values, 0 to 1.
        positions: (x, y) of every eye, in view steps from the centre of the grid.
        weight: how much each counts beside a view of the grid, where layers are made for both.

    Raises:
        ValueError: not as many views as positions, or a weight that is no number above 0.
    """

    views: Float[Tensor, "*batch view c y x"]
    positions: tuple[Point, ...]
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.views.shape[-4] != len(self.positions):
            raise ValueError(
                f"found {self.views.shape[-4]} views, expected one for each of "
                f"{len(self.positions)} eyes"
            )
        if not 0 < self.weight < math.inf:
            raise ValueError(f"the weight of eyes is {self.weight:g}, expected more than 0")

    def chosen(self, keep: Callable[[Point], bool]) -> "EyeViews":
        """Return the eyes whose position is wanted."""
        places = [i for i, position in enumerate(self.positions) if keep(position)]
        positions = tuple(self.positions[i] for i in places)
        return replace(self, views=self.views[..., places, :, :, :], positions=positions)


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of one scene, row by row from the top left.

    Args:
        stored: the views as whole numbers, uint8 or uint16, or as floats 0 to 1; `views` and `view`
            return values 0 to 1 of either.
        grid: (rows, columns) of the viewpoints.
        name: what tables and reports call it.
        notes: what a reader had to do that its user may want to know, one sentence each.
        between: what eyes between the viewpoints see, if layers are made for them, too.
        bits: of the whole numbers in the files; None if those held floats.

    Raises:
        ValueError: the number of views is not rows times columns.
    """

    stored: Num[Tensor, "*batch view c y x"]
    grid: tuple[int, int]
    name: str = "light field"
    notes: tuple[str, ...] = ()
    between: EyeViews | None = None
    bits: int | None = None

    def __post_init__(self) -> None:
        rows, columns = self.grid
        if len(self) != rows * columns:
            raise ValueError(
                f"found {len(self)} views, expected {rows}x{columns} = {rows * columns}"
            )

    def __len__(self) -> int:
        """Number of views."""
        return self.stored.shape[-4]

    @property
    def kept(self) -> KeptViews:
        """The views, to be turned into values one at a time."""
        return KeptViews(self.stored)

    @property
    def views(self) -> Float[Tensor, "*batch view c y x"]:
        """Values of all views, 0 to 1; of whole numbers made anew at every call."""
        return self.kept.all()

    def view(self, index: int) -> Float[Tensor, "*batch c y x"]:
        """Return the values of one view, 0 to 1."""
        return self.kept.view(index)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a view in pixels."""
        return self.stored.shape[-2], self.stored.shape[-1]
