"""A scene ready to be rendered."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Take:
    """A scene ready to be rendered.

    Args:
        scene: of Mitsuba, with lights; its own cameras are not used.
        frame: from picture coordinates (see `placement`) to those of the scene.
        integrator: that the scene asks for; None leaves it to us.
        lamps_hidden: whether lights themselves cannot be seen.
        behind: light that is seen where there is nothing.
    """

    scene: Any
    frame: Float[np.ndarray, "4 4"]
    integrator: Any | None = None
    lamps_hidden: bool = True
    behind: float = 0.0
