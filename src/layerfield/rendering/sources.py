"""What is rendered: a model put on a stage, or a scene of Mitsuba as it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from layerfield.display import Display
from layerfield.rendering.mitsuba_shapes import mesh_of
from layerfield.rendering.model import Model
from layerfield.rendering.placement import Extent, Fit, Placement, Pose, extent_of, place
from layerfield.rendering.stage import Stage, lights
from layerfield.rendering.takes import Take
from layerfield.rendering.tracing import visible_points
from layerfield.rendering.variant import mitsuba

_MODEL_SHARE = 0.8  # of the picture that models take
_SCENE_SHARE = 1.0  # and what the camera of a scene of Mitsuba sees
_BACKGROUND = 0.8  # light behind models that stand on nothing
_SEEN = (1.0, 99.0)  # percentiles of the visible points within which a scene is said to lie


@runtime_checkable
class Source(Protocol):
    """What can be rendered."""

    def place(
        self, poses: Sequence[Pose], display: Display, size: tuple[int, int], fit: Fit
    ) -> Placement:
        """Return the place of the scene in the display, one for all poses."""
        ...

    def take(self, pose: Pose, placement: Placement) -> Take:
        """Return the scene in one pose."""
        ...


@dataclass(frozen=True, eq=False)
class StagedModel:
    """A model in the light of `stage`.

    Args:
        model: upright.
        ground: whether it stands on something, in front of a backdrop.
    """

    model: Model
    ground: bool = True

    @cached_property
    def _stage(self) -> Stage | None:
        return Stage(float(self.model.vertices[:, 1].min())) if self.ground else None

    def place(
        self, poses: Sequence[Pose], display: Display, size: tuple[int, int], fit: Fit
    ) -> Placement:
        vertices = self.model.vertices
        extents = [(pose, extent_of(vertices, pose.rotation)) for pose in poses]
        return place(extents, display, size, fit, share=_MODEL_SHARE, ground=self._stage)

    def take(self, pose: Pose, placement: Placement) -> Take:
        mi = mitsuba()

        unit = placement.size[1] / 2
        to_scene = np.diag([1 / unit, 1 / unit, 1 / unit, 1.0])
        turned = to_scene @ placement.to_picture(pose)
        shapes: dict[str, Any] = {
            f"surface_{i}": mesh_of(surface, turned)
            for i, surface in enumerate(self.model.surfaces)
        }
        if self._stage is not None:
            still = to_scene @ placement.to_picture(Pose())
            shapes["stage"] = mesh_of(self._stage.surface(pose, placement), still)
        scene = mi.load_dict({"type": "scene", **lights(placement.size), **shapes})
        glows = any(max(surface.material.glow) > 0 for surface in self.model.surfaces)
        return Take(scene, to_scene, lamps_hidden=not glows, behind=_BACKGROUND)


@dataclass(frozen=True, eq=False)
class MitsubaScene:
    """A scene of Mitsuba with its own lights, seen from the side of its first camera.

    Args:
        scene: as loaded, with a camera and lights.
        name: what tables call it.
    """

    scene: Any
    name: str

    @cached_property
    def _camera(self) -> Float[np.ndarray, "4 4"]:
        """From the scene to its camera: x to the right, y up, z toward the viewer, no scaling."""
        sensor = self.scene.sensors()[0]
        pose = np.array(sensor.world_transform().matrix, np.float64).reshape(4, 4)
        pose[:3, :3] = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0) * [-1, 1, -1]
        return np.linalg.inv(pose)

    @cached_property
    def _box(self) -> Extent:
        """What the camera sees, relative to it; as wide as it sees in the middle of the depth."""
        mi = mitsuba()

        sensor = self.scene.sensors()[0]
        points = visible_points(self.scene, sensor)
        if len(points) == 0:
            raise ValueError(
                f"the camera of scene '{self.name}' sees nothing; turn it to something"
            )
        seen = points @ self._camera[:3, :3].T + self._camera[:3, 3]
        low, high = np.percentile(seen, _SEEN, axis=0)
        fov = np.ravel(mi.traverse(sensor).get("x_fov", ()))
        if len(fov) > 0:
            width, height = sensor.film().size()
            half = math.tan(math.radians(fov[0]) / 2) * np.array([1, height / width])
            low[:2], high[:2] = np.array([[-1.0], [1.0]]) * half * abs(low[2] + high[2]) / 2
        return Extent(low, high)

    @cached_property
    def _upright(self) -> Float[np.ndarray, "4 4"]:
        """From the scene to the axes of its camera, the origin in the middle of what that sees."""
        moved = self._camera.copy()
        moved[:3, 3] -= (self._box.low + self._box.high) / 2
        return moved

    def place(
        self, poses: Sequence[Pose], display: Display, size: tuple[int, int], fit: Fit
    ) -> Placement:
        half = (self._box.high - self._box.low) / 2
        corners = np.stack(np.meshgrid(*zip(-half, half, strict=True)), axis=-1).reshape(-1, 3)
        extents = [(pose, extent_of(corners, pose.rotation)) for pose in poses]
        return place(extents, display, size, fit, share=_SCENE_SHARE)

    def take(self, pose: Pose, placement: Placement) -> Take:
        to_scene = np.linalg.inv(placement.to_picture(pose) @ self._upright)
        return Take(self.scene, to_scene, self.scene.integrator())
