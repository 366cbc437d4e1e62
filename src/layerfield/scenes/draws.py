"""Random numbers of a batch in which every element has a seed of its own."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


class Draws:
    """Uniform and normal numbers `[batch, *shape]`; element b is what seed + b draws alone.

    Drawn on the CPU, so that a seed means the same scene on every device.

    Args:
        count: batch elements.
        seed: seed of element 0.
        device: where the numbers are needed.
    """

    def __init__(self, count: int, *, seed: int, device: torch.device) -> None:
        self.device = device
        self.count = count
        self._generators = [torch.Generator().manual_seed(seed + b) for b in range(count)]

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Float[Tensor, "..."]:
        """Return numbers spread evenly over [low, high)."""
        numbers = torch.empty(self.count, *shape)
        for out, generator in zip(numbers, self._generators, strict=True):
            out.uniform_(low, high, generator=generator)
        return numbers.to(self.device)

    def log_uniform(self, *shape: int, low: float, high: float) -> Float[Tensor, "..."]:
        """Return numbers whose logarithm is spread evenly from log(low) to log(high)."""
        return low * (high / low) ** self.uniform(*shape)

    def normal(self, *shape: int) -> Float[Tensor, "..."]:
        """Return standard normal numbers."""
        numbers = torch.empty(self.count, *shape)
        for out, generator in zip(numbers, self._generators, strict=True):
            out.normal_(generator=generator)
        return numbers.to(self.device)

    def choice(self, shares: tuple[float, ...], *shape: int) -> Int[Tensor, "..."]:
        """Return indices, i with probability shares[i] (they sum to 1)."""
        bounds = torch.tensor(shares, device=self.device).cumsum(0)[:-1]
        return torch.bucketize(self.uniform(*shape), bounds)

    def chance(self, share: float, *shape: int) -> Float[Tensor, "..."]:
        """Return 1 with probability `share`, otherwise 0."""
        return (self.uniform(*shape) < share).float()
