"""Server of one page on this machine, whose requests are answered in the thread that waits for them.

The server listens on 127.0.0.1 only. The path of each address begins with a random token. Requests with
another token, from another site or with a large body are refused.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Empty, Queue
from typing import Any
from urllib.parse import parse_qsl

from swimid.errors import UsageError

HOST = "127.0.0.1"
#: Names of this machine in the address that a browser may send.
OWN_NAMES = (HOST, "localhost")
#: Maximum size of the body of a request, bytes.
MAX_BODY = 1_000_000
#: Maximum time that a connection may be silent, and maximum time to send the last answer, s.
CONNECTION_TIMEOUT_S = 30.0
#: Interval at which the waiting thread looks for Ctrl-C, s.
POLL_S = 0.5
#: Header fields of every answer. They prevent that the page loads anything from other servers, and that
#: another page embeds it.
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
NO_BROWSER = """\
No browser is opened. If the browser is on another machine, type there:
  ssh -N -L {port}:{host}:{port} USER@THIS-MACHINE
and open the address there."""


@dataclass(frozen=True)
class PageAnswer:
    """Answer to a request: body, media type, status, further header fields, and flag of the last answer."""

    body: bytes
    kind: str
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    last: bool = False

    @classmethod
    def of_json(cls, content: Any, status: int = 200, *, last: bool = False) -> PageAnswer:
        """Return an answer with a JSON document."""
        text = json.dumps(content, ensure_ascii=False, allow_nan=False)
        return cls(text.encode(), "application/json", status, last=last)


CLOSED = PageAnswer.of_json({"error": {"message": "the command has ended", "hint": "see its terminal"}}, 503)
BAD_JSON = PageAnswer.of_json({"error": {"message": "the body is not JSON", "hint": None}}, 400)


@dataclass
class PageRequest:
    """Request for one path of the page: its name, and its query or the JSON document in its body."""

    method: str
    name: str | None
    content: Any
    reply: Queue[PageAnswer] = field(default_factory=Queue)
    sent: threading.Event = field(default_factory=threading.Event)


class PageServer(ThreadingHTTPServer):
    """Server of one page. Its threads carry requests to the thread that calls :meth:`run`.

    Because only this thread answers, two windows of the browser cannot change anything at the same time.

    Parameters
    ----------
    port : int, optional
        Port; by default any free port.
    status : callable
        Function that returns the progress of the current computation as plain data. The server answers
        requests for ``status`` at once, also during a computation.

    Raises
    ------
    UsageError
        The port is in use or not allowed.
    """

    daemon_threads = True

    def __init__(self, port: int | None, status: Callable[[], Any]) -> None:
        try:
            super().__init__((HOST, port or 0), _Handler)
        except OSError as error:
            text = f"port {port} cannot be used: {error.strerror}"
            raise UsageError(text, hint="leave --port out for any free port") from error
        self.status = status
        self.token, self.folder = secrets.token_urlsafe(24), tempfile.TemporaryDirectory(prefix="swimid-")
        self.requests: Queue[PageRequest] = Queue()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    def announce(self, *, browser: bool) -> None:
        """Print the address on the standard error, and open it in the browser if there is one."""
        print(f"Pick markers at {self.address}", file=sys.stderr)
        if not (browser and _open_browser(self.address, self.folder)):
            print(NO_BROWSER.format(port=self.server_port, host=HOST), file=sys.stderr)
        print("Press Done in the page to write the setup, or Ctrl-C to stop.", file=sys.stderr, flush=True)

    def run(self, answer: Callable[[PageRequest], PageAnswer]) -> None:
        """Answer requests one after the other, until an answer is the last."""
        thread = threading.Thread(target=self.serve_forever, daemon=True)
        thread.start()
        last = False
        try:
            while not last:
                with suppress(Empty):
                    last = self._answer_next(answer)
        finally:
            self.shutdown()
            self.server_close()
            self.folder.cleanup()
            while not self.requests.empty():
                self.requests.get().reply.put(CLOSED)

    def _answer_next(self, answer: Callable[[PageRequest], PageAnswer]) -> bool:
        """Answer the next request; return whether this answer is the last. Raise ``Empty`` if none waits."""
        request = self.requests.get(timeout=POLL_S)
        given = CLOSED
        try:
            given = answer(request)
        finally:
            request.reply.put(given)
            if given.last or given is CLOSED:
                request.sent.wait(CONNECTION_TIMEOUT_S)
        return given.last

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a connection that the browser closed, or that is silent for too long."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version, sys_version = "swimid", ""
    timeout = CONNECTION_TIMEOUT_S

    def do_GET(self) -> None:
        """Answer a request for a picture or the page."""
        self._answer("GET", lambda: dict(parse_qsl(self.path.partition("?")[2])))

    def do_POST(self) -> None:
        """Answer a request with a JSON document."""
        self._answer("POST", lambda: json.loads(self.rfile.read(int(self.headers["Content-Length"]))))

    def _answer(self, method: str, read: Callable[[], Any]) -> None:
        refused = self._refusal(method)
        if refused is not None:
            self.close_connection = True
            return self._send(
                PageAnswer.of_json({"error": {"message": refused[1], "hint": None}}, refused[0])
            )
        name = self._parts[1]
        if (method, name) == ("GET", "status"):
            return self._send(PageAnswer.of_json(self.server.status()))
        try:
            request = PageRequest(method, name, read())
        except (ValueError, RecursionError):
            return self._send(BAD_JSON)
        self.server.requests.put(request)
        try:
            return self._send(request.reply.get())
        finally:
            request.sent.set()

    @property
    def _parts(self) -> tuple[str, str | None]:
        """Token and name in the path of the request; the name is None without a slash after the token."""
        path = self.path.partition("?")[0]
        token, slash, name = path.removeprefix("/").partition("/")
        return token, name if slash else None

    def _refusal(self, method: str) -> tuple[int, str] | None:
        """Return status and reason if the request is refused; None if it is answered."""
        token, name = self._parts
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if not secrets.compare_digest(token.encode(), self.server.token.encode()):
            return 403, "wrong token"
        if host.partition(":")[0] not in OWN_NAMES:
            return 403, "wrong host"
        if origin not in (None, f"http://{host}"):
            return 403, "wrong origin"
        if name is None:
            return 404, "no such page"
        if method == "GET":
            return None
        if self.headers.get_content_type() != "application/json":
            return 415, "the body must be application/json"
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            return 411, "the length of the body is missing"
        if int(length) > MAX_BODY:
            return 413, f"the body may have {MAX_BODY} bytes"
        return None

    def _send(self, answer: PageAnswer) -> None:
        self.send_response(answer.status)
        fields = {"Content-Type": answer.kind, "Content-Length": str(len(answer.body))}
        for name, value in (HEADERS | fields | dict(answer.headers)).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(answer.body)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for a request."""


def _open_browser(address: str, folder: tempfile.TemporaryDirectory[str]) -> bool:
    """Open an address in the browser, and return whether there is a browser with a window.

    The browser starts in another process, so that it cannot write to the standard output of the command. It
    opens a file in a private folder, which leads to the address. Other users of the machine see the commands
    of all processes, but not this file.
    """
    windows = sys.platform in ("win32", "darwin")
    if not windows and not any(map(os.environ.get, ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY"))):
        return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    page = Path(folder.name) / "pick.html"
    page.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    command = [sys.executable, "-m", "webbrowser", page.as_uri()]
    nothing = subprocess.DEVNULL
    subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True)
    return True
