"""A small server: loopback only, a fixed set of answers held in memory, nothing written."""

import errno
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from layerfield.viewer.page import SERVED_POLICY

_HOST = "127.0.0.1"
_PATIENCE = 10  # seconds for a request to arrive
_LONGEST_PATH = 200  # letters


class Server(ThreadingHTTPServer):
    """Answer requests for a fixed set of paths.

    Nothing is looked up on disk, so no path leads out of anything; and no page of another site
    gets an answer under a name that merely resolves to this machine.

    Args:
        offered: `path: (media type, bytes)`.
        port: to listen on; 0 takes a free one.

    Raises:
        ValueError: the port is in use, not allowed, or no port.
    """

    daemon_threads = True  # a slow request does not delay the end
    allow_reuse_address = True

    def __init__(self, offered: Mapping[str, tuple[str, bytes]], port: int = 0) -> None:
        self.offered = offered
        if not 0 <= port <= 65535:
            raise ValueError(f"port is {port}, expected 0 (any free one) to 65535")
        try:
            super().__init__((_HOST, port), _Answer)
        except OSError as error:
            used = error.errno == errno.EADDRINUSE
            why = "is in use" if used else f"cannot be opened ({error.strerror})"
            raise ValueError(
                f"port {port} {why}; give another --port, or none for a free one"
            ) from None

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return f"http://{_HOST}:{self.server_port}/"

    def is_own_name(self, host: str | None) -> bool:
        """Say whether a request is addressed to this server by a name of its own."""
        return host in {f"{name}:{self.server_port}" for name in (_HOST, "localhost")}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that goes away is no event."""


class _Answer(BaseHTTPRequestHandler):
    server: Server  # pyright: ignore[reportIncompatibleVariableOverride]
    server_version, sys_version = "layerfield", ""
    timeout = _PATIENCE

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        path = self.path.partition("?")[0]
        if not self.server.is_own_name(self.headers.get("Host")):
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
        elif len(path) > _LONGEST_PATH:
            self.send_error(HTTPStatus.REQUEST_URI_TOO_LONG)
        elif path not in self.server.offered:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self._send(*self.server.offered[path], with_body=with_body)

    def _send(self, media_type: str, content: bytes, *, with_body: bool) -> None:
        text = media_type.startswith("text/")
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"{media_type}; charset=utf-8" if text else media_type)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", SERVED_POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if with_body:
            self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Keep quiet: requests are of no interest."""
