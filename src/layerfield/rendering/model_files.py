"""Models in files: glTF, OBJ, PLY and STL, read by trimesh."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from layerfield.rendering.materials import face_colours, material_of, vertex_colours
from layerfield.rendering.model import Model, Surface

UP = {".glb": "y", ".gltf": "y", ".obj": "y", ".ply": "y", ".stl": "z"}
"""Suffixes of models, and the axis that points up where nobody says which."""

_UPRIGHT = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".tga", ".gif")
_LINEAR = (".glb", ".gltf")  # formats whose vertex colours are light


def read_model(path: Path, up: str | None = None) -> Model:
    """Read a model, turned so that its second axis points up.

    Args:
        path: of the file, whose suffix is in `UP`.
        up: the axis that points up in the file, y or z; the format's usual one if not given.

    Raises:
        ValueError: no such file, a damaged one, files that it names and that are not there, no
            faces, or numbers that are not finite.
    """
    turn = _UPRIGHT[up or UP[path.suffix.lower()]]
    loaded = _load(path)
    surfaces = []
    for node in loaded.graph.nodes_geometry:
        placed, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if len(getattr(mesh, "faces", ())) > 0:
            surfaces.append(_surface(mesh, np.asarray(placed), turn, path))
    if not surfaces:
        points = sum(len(getattr(mesh, "vertices", ())) for mesh in loaded.geometry.values())
        raise ValueError(
            f"{path} holds no faces ({points} points); expected a model with surfaces, export it "
            "with its triangles"
        )
    return Model.centred(surfaces, path.stem)


def _load(path: Path) -> Any:
    import trimesh  # noqa: PLC0415  an extra
    from trimesh.resolvers import FilePathResolver  # noqa: PLC0415

    missing: list[str] = []

    class Strict(FilePathResolver):
        """Note what is not there: trimesh goes on without it."""

        def get(self, name: str) -> bytes:
            for each in dict.fromkeys(
                (name, name.rsplit(maxsplit=1)[-1] if name.split() else name)
            ):
                try:
                    data = super().get(each)
                except (OSError, ValueError):
                    continue
                if Path(each).suffix.lower() in _PICTURES and not _is_picture(data):
                    missing.append(f"{each}, which is no picture")
                return data
            missing.append(f"{name}, which is not there")
            raise FileNotFoundError(name)

        def namespaced(self, namespace: str) -> "Strict":
            return Strict(str(Path(self.parent) / namespace))

    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    kind = path.suffix.lower()[1:]
    try:
        with np.errstate(all="ignore"):
            scene = trimesh.load_scene(
                io.BytesIO(data), file_type=kind, resolver=Strict(str(path)), process=False
            )
    except MemoryError:
        raise
    except Exception as error:  # on damaged files readers raise whatever they stumble over
        _refuse_missing(path, missing)
        said = str(error).partition("\n")[0] or type(error).__name__
        raise ValueError(f"{path} cannot be read as {kind.upper()} ({said})") from None
    _refuse_missing(path, missing)
    return scene


def _is_picture(data: bytes) -> bool:
    try:
        with Image.open(io.BytesIO(data)) as image:
            image.load()
    except Exception:  # decoders raise whatever they stumble over
        return False
    return True


def _refuse_missing(path: Path, missing: list[str]) -> None:
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ValueError(
            f"{path} names {missing[0]}{more}; put the file beside the model, or export the model "
            "with its textures inside (.glb)"
        )


def _surface(
    mesh: Any,
    placed: Float[np.ndarray, "4 4"],
    turn: Float[np.ndarray, "3 3"],
    path: Path,
) -> Surface:
    linear = turn @ placed[:3, :3]
    vertices = np.asarray(mesh.vertices, np.float64)
    faces = np.asarray(mesh.faces, np.int64)
    _refuse_damaged(vertices, faces, path)
    normals = _stored_normals(mesh)
    if normals is not None:
        normals = _normalised(normals @ np.linalg.pinv(linear))
    surface = Surface(
        vertices=vertices @ linear.T + turn @ placed[:3, 3],
        faces=faces if np.linalg.det(linear) > 0 else faces[:, ::-1],
        normals=normals,
        texture_at=_texture_at(mesh),
        colours=vertex_colours(mesh, linear=path.suffix.lower() in _LINEAR),
        material=material_of(mesh),
    )
    colours = face_colours(mesh)
    if colours is None:
        return surface
    apart = surface.by_corners()
    return Surface(
        vertices=apart.vertices,
        faces=apart.faces,
        normals=apart.normals,
        colours=np.repeat(colours, 3, axis=0),
        material=surface.material,
    )


def _refuse_damaged(vertices: Float[np.ndarray, "vertex 3"], faces: np.ndarray, path: Path) -> None:
    bad = int((~np.isfinite(vertices).all(1)).sum())
    if bad:
        raise ValueError(
            f"{path} has {bad} of {len(vertices)} vertices that are not finite numbers; repair or "
            "export the model again"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"{path} has faces of vertices {faces.min()} to {faces.max()}, but {len(vertices)} "
            "vertices; export the model again"
        )


def _stored_normals(mesh: Any) -> Float[np.ndarray, "vertex 3"] | None:
    """Return the normals of the file; trimesh would make others, without any edges."""
    if "vertex_normals" not in mesh._cache:
        return None
    normals = np.asarray(mesh.vertex_normals, np.float64)
    sound = normals.shape == mesh.vertices.shape and np.isfinite(normals).all()
    return normals if sound and (np.linalg.norm(normals, axis=1) > 0).all() else None


def _normalised(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _texture_at(mesh: Any) -> Float[np.ndarray, "vertex 2"] | None:
    found = getattr(mesh.visual, "uv", None)
    if found is None or len(found) != len(mesh.vertices) or not np.isfinite(found).all():
        return None
    return np.asarray(found, np.float64)[:, :2] * [1, -1] + [0, 1]
