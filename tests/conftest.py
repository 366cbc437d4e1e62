"""Shapes are checked at run time in tests, and only there; the light fields to judge on."""

import math
import os
import signal
import sys
from pathlib import Path

os.environ.setdefault("GOMP_SPINCOUNT", "2000")  # before torch, as layerfield itself does

import pytest
import shape_checks
import torch
from jaxtyping import install_import_hook

if not torch.cuda.is_available():  # before Triton is imported: kernels run on the processor
    os.environ["TRITON_INTERPRET"] = "1"

hook = install_import_hook("layerfield", "shape_checks.checked")
hook.__enter__()

FIELDS = Path(
    os.environ.get("LAYERFIELD_FIELDS") or Path(__file__).parents[2] / "shared" / "lightfields"
)


# Small tensors and shared machines: more threads cost more than they bring. Now, and not in a
# fixture: fixtures of modules come before those of tests, and sums depend on the threads.
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _one_thread():
    yield
    torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _same_draws():
    """What a test draws does not depend on those before it."""
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _check_shapes_anew():
    shape_checks.calls.clear()


@pytest.fixture(autouse=True, scope="session")
def _interruptible():
    """A job in the background of a shell ignores Ctrl-C, and so would all it starts."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    """References of the tests stay with the tests."""
    os.environ["LAYERFIELD_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def quick_references(monkeypatch, tmp_path_factory):
    """The first round passes for the reference: for tests of what is said of one."""
    module = sys.modules["layerfield.reference"]
    monkeypatch.setattr(module, "GAP_DB", math.inf)
    monkeypatch.setattr(module, "_STAGNATION", 1.0)
    monkeypatch.setenv("LAYERFIELD_CACHE", str(tmp_path_factory.mktemp("quick")))


@pytest.fixture(scope="session")
def fields() -> Path:
    """The folder of light fields to judge on."""
    if not FIELDS.is_dir():
        pytest.skip(f"no light fields in {FIELDS}; set LAYERFIELD_FIELDS")
    return FIELDS
