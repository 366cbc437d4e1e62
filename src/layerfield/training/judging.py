"""How good a network is while it trains: on scenes of training, validation and test."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from layerfield.display import Display
from layerfield.light_field import LightField
from layerfield.metrics import decibels
from layerfield.networks import Network
from layerfield.networks.frame import pixels
from layerfield.synthesizer import synthesize
from layerfield.training.objective import shown_by
from layerfield.training.recipe import Recipe
from layerfield.training.sources import Source

Scenes = Float[Tensor, "scene view c y x"]
_SOLVER = "fourier-admm"


@dataclass(frozen=True, eq=False)
class Judges:
    """Sets of scenes, and the display that shows them.

    Args:
        display: that is trained for.
        sets: views by name of the set: train (if it is finite), validation, test.
    """

    display: Display
    sets: dict[str, Scenes]

    @classmethod
    def of(cls, recipe: Recipe, display: Display, source: Source) -> "Judges":
        """Return the sets of a recipe."""
        return cls(display, source.sets(recipe))

    def psnr(self, network: Network, device: torch.device) -> dict[str, float]:
        """Return the mean over scenes of the PSNR of clamped layers as light, by set, dB."""
        return {
            f"{name}_psnr": self._mean([self._error(network, views.to(device)) for views in scenes])
            for name, scenes in self.sets.items()
        }

    def reference(self) -> dict[str, float | str]:
        """Return what the solver reaches on the same sets, dB; the yardstick of the figures."""
        iterations = 40 if self.display.link.is_sum else 10
        found: dict[str, float | str] = {"method": f"{_SOLVER}:{iterations}"}
        for name, scenes in self.sets.items():
            grid = self.display.geometry.grid or (1, self.display.view_count)
            field = LightField(scenes, grid)
            layers = synthesize(field, self.display, method=_SOLVER, iterations=iterations).layers
            light = self.display.transfer.decode(scenes)
            errors = (self.display(layers) - light).square().mean(dim=(1, 2, 3, 4))
            found[f"{name}_psnr"] = self._mean(errors.tolist())
        return found

    def _error(self, network: Network, views: Float[Tensor, "view c y x"]) -> float:
        channels = self.display.transfer.decode(views).transpose(0, 1)
        with torch.no_grad():
            layers = pixels(network, channels, self.display.margin).float().clamp(0, 1)
        return (shown_by(self.display, layers) - channels).square().mean().item()

    @staticmethod
    def _mean(errors: list[float]) -> float:
        return sum(map(decibels, errors)) / len(errors)
