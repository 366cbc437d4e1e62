"""Count the operations of a run as PyTorch is asked for them, whatever the method."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import flop_registry

from layerfield.kernels.compiled import plain
from layerfield.kernels.transforms import Transform, transform_, transforms_made

_REAL, _COMPLEX = 1.0, 2.0  # operations of an element of the result, unless listed here
_PER_ELEMENT = {"mul": (1, 6), "div": (1, 6), "addcmul": (2, 8), "addcdiv": (2, 8), "lerp": (2, 4)}
_REDUCTIONS = {"sum", "mean", "max", "min", "amax", "amin", "prod", "cumsum", "var", "std"}
_MOVES = {"clone", "copy", "fill", "zero", "alias", "detach", "_to_copy", "lift_fresh", "_conj"}
_TRANSFORMS = {"_fft_r2c": 2.5, "_fft_c2r": 2.5, "_fft_c2c": 5.0}


class _Array(NamedTuple):
    """What an array of other values is made from."""

    shape: torch.Size
    dtype: torch.dtype
    device: torch.device

    @classmethod
    def of(cls, values: Tensor) -> "_Array":
        return cls(values.shape, values.dtype, values.device)

    def made(self) -> Tensor:
        return torch.ones(self.shape, dtype=self.dtype, device=self.device)


class _Watcher(TorchDispatchMode):
    """Watches what PyTorch is asked for inside a `with`, and enters another one for it.

    Args:
        around: makes the other; what it gives is `entered`.
    """

    def __init__(self, around: Callable[[], AbstractContextManager[Any]]) -> None:
        super().__init__()
        self.entered: Any = None
        self._around, self._inside = around, ExitStack()

    def __enter__(self) -> Any:
        self.entered = self._inside.enter_context(self._around())
        return super().__enter__()

    def __exit__(self, *why: Any) -> None:
        super().__exit__(*why)
        self._inside.close()


class OperationCounter(_Watcher):
    """Counts additions, multiplications and function values inside a `with`.

        convolutions, matrix products    2 for every multiply-add (PyTorch's own formulas)
        Fourier transform                2.5 n log2 n for n real values, 5 n log2 n for complex
        element by element               1 for every result, 2 for a multiply-add; complex: 2 for a
                                         sum, 6 for a product, 8 for both
        sums, means and extremes         1 for every value that goes in

    Copies, views of memory and changes of type count as nothing. Compiled loops stand aside for
    what they replace; what else is done past PyTorch's operators is not seen. `operations` is their
    number.
    """

    def __init__(self) -> None:
        super().__init__(plain)
        self.operations = 0.0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        made = func(*args, **(kwargs or {}))
        self._count(func, args, kwargs or {}, made)
        return made

    def _count(self, func: Any, args: tuple, kwargs: dict, made: Any) -> None:
        name = func.overloadpacket.__name__.removesuffix("_")
        if func.overloadpacket in flop_registry:
            self.operations += flop_registry[func.overloadpacket](*args, **kwargs, out_val=made)
        elif name in _TRANSFORMS:
            self.operations += _transform(name, args, made)
        elif name in _REDUCTIONS:
            self.operations += _numel(args[0])
        elif torch.Tag.pointwise in func.tags and name not in _MOVES:
            self.operations += _of_elements(name, kwargs, made)


class TransformRecorder(_Watcher):
    """Keeps the Fourier transforms made inside a `with`: PyTorch's, and those in place past it.

    Their number is its length.
    """

    def __init__(self) -> None:
        super().__init__(transforms_made)
        self._calls: list[tuple[Any, _Array, tuple]] = []

    def __len__(self) -> int:
        return len(self._calls) + len(self.in_place)

    @property
    def in_place(self) -> list[Transform]:
        """Those past PyTorch."""
        return self.entered

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        if func.overloadpacket.__name__ in _TRANSFORMS:
            self._calls.append((func, _Array.of(args[0]), args[1:]))
        return func(*args, **(kwargs or {}))

    def again(self) -> Callable[[], None]:
        """Return what makes all Fourier transforms of the run again, and nothing else."""
        arrays = {array: array.made() for _, array, _ in self._calls}
        shapes = {each.shape for each in self.in_place}
        values = {shape: torch.zeros(shape, dtype=torch.complex64) for shape in shapes}

        def transform() -> None:
            for func, array, rest in self._calls:
                func.overloadpacket(arrays[array], *rest)
            for shape, by_row, back in self.in_place:
                transform_(values[shape], by_row=by_row, back=back)

        return transform


def _transform(name: str, args: tuple, made: Tensor) -> float:
    values = made if name == "_fft_c2r" else args[0]
    points = math.prod(values.shape[axis] for axis in args[1])
    return _TRANSFORMS[name] * values.numel() * math.log2(max(points, 2))


def _of_elements(name: str, kwargs: dict, made: Any) -> float:
    scaled = 1 if name in ("add", "sub") and kwargs.get("alpha", 1) != 1 else 0
    real, complex_ = _PER_ELEMENT.get(name, (_REAL, _COMPLEX))
    is_complex = isinstance(made, Tensor) and made.is_complex()
    return (scaled + (complex_ if is_complex else real)) * _numel(made)


def _numel(values: Any) -> int:
    return sum(leaf.numel() for leaf in tree_leaves(values) if isinstance(leaf, Tensor))
