"""The five light fields that methods are judged on, read the same way everywhere."""

import os
from pathlib import Path

from layerfield import FieldOptions, LightField, load_light_field

OPTIONS = {
    "toys_9x9": {"step": 2, "views": "5x5"},
    "lytro_translucent": {"views": "5x5"},
    "snu_buildings": {"shift": 5, "views": "5x5"},
    "stanford_cards": {"scale": 0.5, "views": "5x5"},
    "mit_dragons": {"views": "5x5"},
}


def five_fields() -> dict[str, LightField]:
    """Return the fields found in LAYERFIELD_FIELDS, ../shared/lightfields if not set."""
    default = Path(__file__).parents[2] / "shared" / "lightfields"
    folder = Path(os.environ.get("LAYERFIELD_FIELDS") or default)
    return {
        name: load_light_field(folder / name, FieldOptions.parse(**options))
        for name, options in OPTIONS.items()
        if (folder / name).is_dir()
    }
