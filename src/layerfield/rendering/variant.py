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


def start_trial() -> subprocess.Popen | None:
    """Start to try the fast variant in a process of its own, which takes about a second.

    None where a variant is set already, or no process can be started.
    """
    loaded = sys.modules.get("mitsuba")
    if loaded is not None and loaded.variant() in (FAST, SAFE):
        return None
    quiet = subprocess.DEVNULL
    try:
        return subprocess.Popen([sys.executable, "-c", _TRIAL], stdout=quiet, stderr=quiet)
    except OSError:
        return None


def choose_variant(trial: subprocess.Popen | None = None) -> str:
    """Set the fastest variant of Mitsuba that works here, for the whole process; return its name.

    One that is set already stays.

    Args:
        trial: that was started earlier, to save time.
    """
    mi = mitsuba()
    chosen = mi.variant()
    if chosen not in (FAST, SAFE):
        chosen = FAST if _works(trial or start_trial()) else SAFE
        mi.set_variant(chosen)
    mi.set_log_level(mi.LogLevel.Error)
    return chosen


def _works(trial: subprocess.Popen | None) -> bool:
    if trial is None:
        return False
    try:
        return trial.wait(timeout=_TRIAL_SECONDS) == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        trial.kill()
        trial.wait()
