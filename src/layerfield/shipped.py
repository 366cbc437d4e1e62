"""The networks whose weights come with the package.

The folder `trained` holds weight files and `registry.json`, a list of `Entry`; nothing is
downloaded.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from layerfield.display import Display, preset_names
from layerfield.display_spec import parse_spec
from layerfield.weights import (
    REMEDY,
    TrainedNetwork,
    described,
    from_json,
    kept_weights,
    same_light_paths,
)

TRAINED = Path(__file__).parent / "trained"


@dataclass(frozen=True)
class Entry:
    """One line of the registry of shipped weights.

    Args:
        name: in tables and results.
        file: in the folder `trained`.
        sha256: of the file; verified when it is loaded.
        network: key of `NETWORKS`.
        display: what it was trained for: TOML as in the file's card, or the name of a preset.
        recipe: name of the recipe.
        command: that trained it.
        megabytes: size of the file.
        storage: `float16` or `float32`.
        default: the one to take where several serve a display.
        metrics: what it reaches, by name; lists show numbers named `mean...` if there are any.
        trained_on: processor, seconds, steps.
        notes: anything else worth saying.
    """

    name: str
    file: str
    sha256: str
    network: str
    display: str
    recipe: str
    command: str
    megabytes: float
    storage: str
    default: bool
    metrics: dict[str, Any]
    trained_on: dict[str, Any]
    notes: str = ""

    @property
    def trained_for(self) -> Display:
        """The display, made from its description."""
        if self.display in preset_names():
            return Display.load(self.display)
        return Display(parse_spec(self.display, f"the display of the shipped '{self.name}'"))

    @property
    def scores(self) -> str:
        """The metrics in a line: the means, or all where none is called one."""
        numbers = {k: v for k, v in self.metrics.items() if isinstance(v, int | float)}
        means = {k: v for k, v in numbers.items() if k.startswith("mean")} or numbers
        return ", ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in means.items())


def shipped() -> list[Entry]:
    """Return the registry of weights that come with the package.

    Raises:
        ValueError: the registry is missing or damaged.
    """
    path = TRAINED / "registry.json"
    try:
        text = path.read_text("utf-8")
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}; install layerfield anew") from None
    return from_json(TypeAdapter(list[Entry]).validate_python, text, str(path))


def find_shipped(network: str, display: Display) -> Entry:
    """Return the shipped weights of a network for a display; the default if there are several.

    Raises:
        ValueError: there are none; says what is shipped for which display and view grid.
    """
    entries = [entry for entry in shipped() if entry.network == network]
    fitting = [e for e in entries if same_light_paths(e.trained_for, display)]
    if fitting:
        return max(fitting, key=lambda entry: entry.default)
    others = {f"'{e.trained_for.name}' ({described(e.trained_for)})": None for e in entries}
    raise ValueError(
        f"no weights of '{network}' are shipped for display '{display.name}' "
        f"({described(display)}), only for {' and '.join(others) or 'none'}; {REMEDY}"
    )


def shipped_networks(display: Display) -> list[str]:
    """Return the networks that have shipped weights for a display, sorted."""
    return sorted({e.network for e in shipped() if same_light_paths(e.trained_for, display)})


def load_shipped(entry: Entry) -> TrainedNetwork:
    """Return the shipped network of an entry, once; not to be changed.

    Raises:
        ValueError: as `read_weights`, or the file is not the one that was registered.
    """
    path = TRAINED / entry.file
    trained = kept_weights(path)
    if trained.sha256 != entry.sha256:
        raise ValueError(
            f"{path} has the sha256 {trained.sha256[:12]}..., the registry expects "
            f"{entry.sha256[:12]}...: it is damaged or was replaced; install layerfield anew"
        )
    return trained
