"""Which of Mitsuba's variants runs here.

`llvm_ad_rgb` is two to three times as fast and needs a library of LLVM. With one that does not fit
it aborts the whole process, which no Python can catch, so that a process of its own tries it first.
"""

import importlib
import subprocess
import sys
from typing import Any

FAST, SAFE = "llvm_ad_rgb", "scalar_rgb"
_TRIAL_SECONDS = 120
_TRIAL = f"""import mitsuba as mi
mi.set_variant({FAST!r})
mi.render(mi.load_dict(mi.cornell_box()), spp=1).numpy()"""
_EXTRA = ("mitsuba", "trimesh")


def mitsuba() -> Any:
    """Return the package, an extra that takes a while to import; its stubs miss what it takes."""
    return importlib.import_module("mitsuba")


def refuse_missing_extra() -> None:
    """Refuse to go on without the packages that render.

    Raises:
        ValueError: one of them is not installed, or cannot be loaded.
    """
    for name in _EXTRA:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise ValueError(
                f"rendering needs the package {name} ({error}); install it with pip install "
                "'layerfield[render]'"
            ) from None


def choose_variant() -> str:
    """Set the fastest variant of Mitsuba that works here, for the whole process; return its name.

    One that is set already stays.
    """
    mi = mitsuba()
    chosen = mi.variant()
    if chosen not in (FAST, SAFE):
        chosen = FAST if _works() else SAFE
        mi.set_variant(chosen)
    mi.set_log_level(mi.LogLevel.Error)
    return chosen


def _works() -> bool:
    try:
        tried = subprocess.run(
            [sys.executable, "-c", _TRIAL],
            check=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_TRIAL_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return tried.returncode == 0
