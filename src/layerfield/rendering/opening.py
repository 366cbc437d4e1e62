"""From the name of a scene to what can be rendered."""

import hashlib
from pathlib import Path

from layerfield.nearest import did_you_mean
from layerfield.rendering.model_files import UP, read_model
from layerfield.rendering.sample import sample_model
from layerfield.rendering.sources import MitsubaScene, Source, StagedModel
from layerfield.rendering.variant import mitsuba

SAMPLE = "sample"
"""The name of the scene that comes with the package."""

_MITSUBA = ".xml"


def open_scene(name: str, *, up: str | None = None, ground: bool = True) -> Source:
    """Open a model, a scene of Mitsuba, or the sample; `variant.choose_variant` comes first.

    Args:
        name: of a file with a suffix of `UP` or .xml, or `sample`.
        up: the axis of a model that points up, y or z; the usual one of its format if not given.
        ground: whether a model stands on something.

    Raises:
        ValueError: no such file, or one that cannot be rendered.
    """
    if up not in (None, "y", "z"):
        raise ValueError(f"up is '{up}', expected y or z, the axis of the model that points up")
    if name == SAMPLE:
        return StagedModel(sample_model(), ground)
    path = Path(name)
    refuse_unknown_scene(path)
    if path.suffix.lower() == _MITSUBA:
        if up is not None or not ground:
            raise ValueError(f"{path} has its own camera and ground; leave out up and no-ground")
        return _open_mitsuba(path)
    return StagedModel(read_model(path, up), ground)


def fingerprint(name: str) -> str:
    """Return the SHA-256 of the file of a scene, without the files that it names."""
    data = b"" if name == SAMPLE else Path(name).read_bytes()
    return hashlib.sha256(data).hexdigest()


def is_mitsuba(name: str) -> bool:
    """Whether a scene has its own lights and its own ground."""
    return Path(name).suffix.lower() == _MITSUBA


def refuse_unknown_scene(path: Path) -> None:
    """Refuse what is no file, or none of a known format.

    Raises:
        ValueError: it is not.
    """
    known = [*UP, _MITSUBA]
    if path.is_dir():
        raise ValueError(f"{path} is a folder, expected a file ({', '.join(known)})")
    if not path.exists():
        raise ValueError(f"cannot read {path}: no such file; give a model, or '{SAMPLE}'")
    if path.suffix.lower() not in known:
        hint = did_you_mean(path.suffix.lower(), known)
        raise ValueError(f"{path} has the unknown format '{path.suffix}'{hint}")


def _open_mitsuba(path: Path) -> MitsubaScene:
    mi = mitsuba()

    try:
        scene = mi.load_file(str(path))
    except Exception as error:  # of whatever plugin or file it stumbles over
        said = " ".join(str(error).split())
        raise ValueError(f"{path} cannot be read as a scene of Mitsuba ({said})") from None
    for what, found in (("camera", scene.sensors()), ("light", scene.emitters())):
        if len(found) == 0:
            raise ValueError(f"{path} has no {what}; add one to the scene")
    return MitsubaScene(scene, path.stem)
