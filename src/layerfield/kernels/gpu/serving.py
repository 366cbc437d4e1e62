"""Where kernels for a GPU serve."""

from functools import cache
from importlib.util import find_spec

import torch
from torch import Tensor

from layerfield.kernels.compiled import is_plain

DEVICES = {"cuda"}
_SINGLE = (torch.float32, torch.complex64)


def on_gpu(*values: Tensor | None) -> bool:
    """Whether kernels serve all of these: single precision on a GPU, contiguous, no derivatives.

    Of several GPUs it is the current one: kernels go there.
    """
    known = [each for each in values if each is not None]
    if is_plain() or not all(each.device.type in DEVICES for each in known):
        return False
    if any(each.is_cuda and each.get_device() != torch.cuda.current_device() for each in known):
        return False
    if torch.is_grad_enabled() and any(each.requires_grad for each in known):
        return False
    ready = all(each.dtype in _SINGLE and each.is_contiguous() for each in known)
    return ready and _has_triton()


@cache
def _has_triton() -> bool:
    return find_spec("triton") is not None
