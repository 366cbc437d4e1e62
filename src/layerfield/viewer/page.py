"""The page: a shell, a style sheet and a handful of modules, with an exhibit in it."""

import base64
import html
import json
from collections.abc import Callable, Mapping
from importlib.resources import files
from string import Template
from typing import Any

_FOLDER = files("layerfield.viewer") / "page"
_MODULES = ("main", "eye", "loading", "map", "optics", "shaders", "stack", "stage")

# The page asks nobody but the one who served it; in one file, not even that one.
SERVED_POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'self' "
    "'unsafe-inline'; script-src 'self' 'unsafe-inline'"
)
ALONE_POLICY = (
    "default-src 'none'; img-src data:; connect-src data:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' data:"
)


def served_page(exhibit: Mapping[str, Any], title: str) -> dict[str, tuple[str, bytes]]:
    """Return what a server offers of the page, `path: (media type, bytes)`."""
    offered = {f"/page/{name}.js": ("text/javascript", _read(f"{name}.js")) for name in _MODULES}
    offered["/page/style.css"] = ("text/css", _read("style.css"))
    shell = _shell(
        exhibit,
        title,
        policy=SERVED_POLICY,
        style='<link rel="stylesheet" href="/page/style.css">',
        address=lambda name: f"/page/{name}.js",
    )
    return offered | {"/": ("text/html", shell)}


def page_alone(exhibit: Mapping[str, Any], title: str) -> bytes:
    """Return the page as one file that needs nothing else."""
    return _shell(
        exhibit,
        title,
        policy=ALONE_POLICY,
        style=f"<style>{_read('style.css').decode()}</style>",
        address=lambda name: data_address("text/javascript", _read(f"{name}.js")),
    )


def data_address(media_type: str, content: bytes) -> str:
    """Return an address that is its own content."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"


def _shell(
    exhibit: Mapping[str, Any],
    title: str,
    *,
    policy: str,
    style: str,
    address: Callable[[str], str],
) -> bytes:
    # Modules name each other as "layerfield/...", wherever they lie.
    imports = {"imports": {f"layerfield/{name}.js": address(name) for name in _MODULES}}
    text = Template(_read("index.html").decode()).substitute(
        policy=html.escape(policy),
        title=html.escape(title),
        style=style,
        imports=_within_script(imports),
        exhibit=_within_script(exhibit),
    )
    return text.encode()


def _within_script(data: Mapping[str, Any]) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")


def _read(name: str) -> bytes:
    return (_FOLDER / name).read_bytes()
