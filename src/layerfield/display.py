"""The display: geometry and link. Layers go in, the light field that viewers see comes out."""

from importlib.resources import files
from pathlib import Path

from jaxtyping import Float
from torch import Tensor, nn

from layerfield.composition import compose_view, compose_views
from layerfield.display_spec import PhysicalSpec, Spec, parse_spec, read_spec
from layerfield.geometry import Point
from layerfield.links import LINKS
from layerfield.nearest import did_you_mean
from layerfield.panel_spec import PanelSpec
from layerfield.warped_projection import nearest, project, projection_of, reach

_PRESETS = files("layerfield") / "displays"
_DIMENSIONS = 5  # of layers: subframe, layer, channel, y, x


class Display(nn.Module):
    """A layered light field display; differentiable, on any device and in any precision.

    L_i(x) = mean over subframes of link_k P_k(x + d_ik)

    Layers and views are light here; `transfer` says what the values in their files stand for.

    Args:
        spec: the display as data; see `Display.load` for presets and files.
    """

    def __init__(self, spec: Spec) -> None:
        super().__init__()
        self.spec = spec
        self.geometry = spec.geometry()
        self.link = LINKS[spec.link]
        self.transfer = spec.transfer
        self.projection = projection_of(self.geometry)

    @classmethod
    def load(cls, name: str | Path) -> "Display":
        """Return the preset of that name, or the display of a TOML file.

        Raises:
            ValueError: no such preset or file, or a file that describes no display.
        """
        text = str(name)
        if text in preset_names():
            return cls(parse_spec((_PRESETS / f"{text}.toml").read_text("utf-8"), text))
        if Path(name).suffix == ".toml" or Path(name).is_file():
            return cls(read_spec(Path(name)))
        raise ValueError(f"unknown display '{text}'{did_you_mean(text, preset_names())}")

    @property
    def name(self) -> str:
        """The name in tables and results."""
        return self.spec.name

    @property
    def panels(self) -> tuple[PanelSpec, ...]:
        """What shows the layers, front to back; none if the display does not say."""
        return self.spec.panels if isinstance(self.spec, PhysicalSpec) else ()

    @property
    def layer_count(self) -> int:
        """Number of layers."""
        return len(self.geometry.depths)

    @property
    def subframes(self) -> int:
        """Pictures that every layer shows one after the other; viewers see the mean."""
        return self.spec.subframes

    @property
    def view_count(self) -> int:
        """Number of viewpoints."""
        return len(self.geometry.slopes)

    @property
    def margin(self) -> tuple[int, int]:
        """Pixels (y, x) by which layers exceed the views on each side."""
        return self.geometry.margin

    def forward(
        self, layers: Float[Tensor, "*batch subframe layer c ly lx"]
    ) -> Float[Tensor, "*batch view c y x"]:
        """Return the views that layers show, unclipped.

        Raises:
            ValueError: not as many layers as the display has.
        """
        self._refuse_other(layers)
        return compose_views(layers, self.projection, self.link)

    def view(
        self, layers: Float[Tensor, "*batch subframe layer c ly lx"], index: int
    ) -> Float[Tensor, "*batch c y x"]:
        """Return one view that layers show, unclipped: `forward` takes the memory of all.

        Raises:
            ValueError: not as many layers as the display has.
        """
        self._refuse_other(layers)
        return compose_view(layers, self.projection, self.link, index)

    def adjoint(
        self, views: Float[Tensor, "*batch view c y x"]
    ) -> Float[Tensor, "*batch layer c ly lx"]:
        """Return A^T views, the adjoint of the linear part (shift, interpolate, crop)."""
        return self.projection.adjoint(views)

    def look(
        self,
        layers: Float[Tensor, "*batch subframe layer c ly lx"],
        eye: Point,
        distance: float | None = None,
    ) -> Float[Tensor, "*batch c y x"]:
        """Return what an eye anywhere in front of the display sees, unclipped.

        Args:
            layers: with the margin of this display; outside them light paths stay as they are.
            eye: (x, y) as slopes X / Z; in view steps for displays in pixel disparities.
            distance: Z of the eye in metres; for displays in pixel disparities, the pixels between
                neighbouring viewpoints at that distance. As far as the viewpoints if not given.

        Raises:
            ValueError: the eye is at or behind the front layer, or no distance is given and those
                of the viewpoints differ; or not as many layers as the display has.
        """
        self._refuse_other(layers)
        magnifications = self.geometry.magnifications_from(self._distance(distance))
        size = self.projection.view_size(layers)
        shifts = tuple(
            (nearest(x, m, size[1], self.margin[1]), nearest(y, m, size[0], self.margin[0]))
            for (x, y), m in zip(self.geometry.shifts_toward(eye), magnifications, strict=True)
        )
        margin = self.margin
        for (x, y), m in zip(shifts, magnifications, strict=True):
            margin = max(margin[0], reach(y, m, size[0])), max(margin[1], reach(x, m, size[1]))
        wider = self.surround(layers, margin, self.margin)
        return compose_view(wider, project((shifts,), (magnifications,), margin), self.link, 0)

    def _refuse_other(self, layers: Tensor) -> None:
        if layers.dim() < _DIMENSIONS or layers.shape[-4] != self.layer_count:
            raise ValueError(
                f"the layers have shape {tuple(layers.shape)}, display '{self.name}' expects "
                f"(subframes, {self.layer_count} layers, channels, height, width)"
            )

    def _distance(self, given: float | None) -> float:
        distances = self.geometry.distances
        if given is None and len(set(distances)) > 1:
            raise ValueError(
                f"the viewpoints of display '{self.name}' lie {min(distances):g} to "
                f"{max(distances):g} m away; say how far the eye is"
            )
        return distances[0] if given is None else given

    def surround(
        self, layers: Tensor, margin: tuple[int, int], has: tuple[int, int] = (0, 0)
    ) -> Tensor:
        """Widen layers from the margin they have to another, with the link's neutral value."""
        (y, x), (has_y, has_x) = margin, has
        pad = (x - has_x, x - has_x, y - has_y, y - has_y)
        return nn.functional.pad(layers, pad, value=self.link.neutral)


def preset_names() -> list[str]:
    """Names of the displays that come with the package, sorted."""
    return sorted(entry.name.removesuffix(".toml") for entry in _PRESETS.iterdir())
