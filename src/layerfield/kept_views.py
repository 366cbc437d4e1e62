"""Views as they are kept: whole numbers as read from files, or floats.

Whole numbers take a quarter of the memory of floats, or half. Only one view at a time need become
floats, and what a law makes of them it makes of a table of all codes: 256 or 65536 values.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from jaxtyping import Float, Num
from torch import Tensor

LARGEST = {torch.uint8: 255, torch.uint16: 65535}  # codes that stand for 1


@dataclass(frozen=True, eq=False)
class KeptViews:
    """Views whose values are made when they are asked for.

    Args:
        stored: codes, uint8 or uint16; or the values themselves, floats.
        table: what every code stands for; if not given, the code over the largest one.
    """

    stored: Num[Tensor, "*batch view c y x"]
    table: Float[Tensor, " code"] | None = None

    def __len__(self) -> int:
        """Number of views."""
        return self.stored.shape[-4]

    def __iter__(self) -> Iterator[Float[Tensor, "*batch c y x"]]:
        """Return the values of one view after the other."""
        return map(self.view, range(len(self)))

    @property
    def is_whole(self) -> bool:
        """Whether views are kept as whole numbers."""
        return self.stored.dtype in LARGEST

    @property
    def like(self) -> Float[Tensor, " none"]:
        """No value at all, in the precision and on the device of all of them."""
        if not self.is_whole:
            return self.stored.new_empty(0)
        dtype = torch.float32 if self.table is None else self.table.dtype
        return torch.empty(0, dtype=dtype, device=self.stored.device)

    @property
    def levels(self) -> Float[Tensor, " code"]:
        """What every code stands for, of views that are kept as whole numbers."""
        if self.table is not None:
            return self.table
        return _levels(self.stored.dtype, self.stored.device)

    def view(self, index: int) -> Float[Tensor, "*batch c y x"]:
        """Return the values of one view."""
        return self._values(self.stored[..., index, :, :, :])

    def all(self) -> Float[Tensor, "*batch view c y x"]:
        """Return the values of all views, at four bytes each and more."""
        if not self.is_whole:
            return self.stored
        values = self.like.new_empty(self.stored.shape)
        for i, view in enumerate(self):
            values[..., i, :, :, :] = view
        return values

    def mean(self) -> Float[Tensor, "*batch"]:
        """Return the mean of all values."""
        return torch.stack([view.mean(dim=(-3, -2, -1)) for view in self]).mean(dim=0)

    def then(self, law: Callable[[Tensor], Tensor]) -> "KeptViews":
        """Return the views after a law that acts on each value by itself, as `Transfer.decode`."""
        if not self.is_whole:
            return KeptViews(law(self.stored))
        levels = self.levels
        made = law(levels)
        return self if made is levels else replace(self, table=made)

    def show_as(self, other: "KeptViews") -> bool:
        """Whether both are the same values, kept alike."""
        if self is other:
            return True
        both = [(self.stored, other.stored), (self.table, other.table)]
        return all(a is b or (a is not None and b is not None and _are_same(a, b)) for a, b in both)

    def cut(self, channels: slice, rows: slice) -> "KeptViews":
        """Return a part of every view, which shares its memory with the whole."""
        return replace(self, stored=self.stored[..., channels, rows, :])

    def _values(self, stored: Tensor) -> Tensor:
        if not self.is_whole:
            return stored
        if self.table is None:
            return stored.to(torch.float32).div_(LARGEST[stored.dtype])
        # The quickest way to look up that every device has.
        return self.table.index_select(0, stored.flatten().int()).view(stored.shape)


@lru_cache
def _levels(dtype: torch.dtype, device: torch.device) -> Float[Tensor, " code"]:
    """Return all codes over the largest one."""
    largest = LARGEST[dtype]
    return torch.arange(largest + 1, dtype=torch.float32, device=device) / largest


def _are_same(one: Tensor, other: Tensor) -> bool:
    return one.dtype == other.dtype and one.device == other.device and torch.equal(one, other)
