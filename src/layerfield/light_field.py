"""The light field: views of one scene and the grid they were taken on."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class LightField:
    """Views of one scene, row by row from the top left.

    Args:
        views: values, 0 to 1.
        grid: (rows, columns) of the viewpoints.
        name: what tables and reports call it.
        notes: what a reader had to do that its user may want to know, one sentence each.
        bits: of the whole numbers that the views were stored as; None if those were floats.

    Raises:
        ValueError: the number of views is not rows times columns.
    """

    views: Float[Tensor, "*batch view c y x"]
    grid: tuple[int, int]
    name: str = "light field"
    notes: tuple[str, ...] = ()
    bits: int | None = None

    def __post_init__(self) -> None:
        rows, columns = self.grid
        if self.views.shape[-4] != rows * columns:
            raise ValueError(
                f"found {self.views.shape[-4]} views, expected {rows}x{columns} = {rows * columns}"
            )

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a view in pixels."""
        return self.views.shape[-2], self.views.shape[-1]
