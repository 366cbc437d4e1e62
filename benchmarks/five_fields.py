"""The five light fields that methods are judged on, read the same way everywhere."""

import os
import sys
from pathlib import Path

from layerfield import FieldOptions, LightField, load_light_field

OPTIONS = {
    "toys_9x9": {"step": 2, "views": "5x5"},
    "lytro_translucent": {"views": "5x5"},
    "snu_buildings": {"shift": 5, "views": "5x5"},
    "stanford_cards": {"scale": 0.5, "views": "5x5"},
    "mit_dragons": {"views": "5x5"},
}


def five_fields(*chosen: str) -> dict[str, LightField]:
    """Return the fields of LAYERFIELD_FIELDS, ../shared/lightfields if not set; or those chosen.

    Where they are not there the process ends, with one line and status 2.
    """
    default = Path(__file__).parents[2] / "shared" / "lightfields"
    folder = Path(os.environ.get("LAYERFIELD_FIELDS") or default)
    known = {name: OPTIONS[name] for name in chosen or OPTIONS}
    if missing := [name for name in known if not (folder / name).is_dir()]:
        print(
            f"found no {', '.join(missing)} among the light fields; "
            "set LAYERFIELD_FIELDS to the folder that holds them",
            file=sys.stderr,
        )
        sys.exit(2)
    return {
        name: load_light_field(folder / name, FieldOptions.parse(**options))
        for name, options in known.items()
    }
