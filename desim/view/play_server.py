"""The server of `desim play`: one page for one user of this machine.

It listens on the loopback interface only. Its address has a secret token, and a request is refused if it is for another
host, as under DNS rebinding, or if a page of another origin makes it. The server ends when it is interrupted, or a few
seconds after its last page was closed.
"""

import json
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, cast

from desim.config.json_numbers import to_json
from desim.view.play import Answer, Playground, Session, is_request, style

LINGER = 5.0
"""The time, s, for which the server waits for another page after the last one was closed, for example by a reload."""
BEAT = 1.0
"""The time between two signs of life, s: lines that the server sends to each open page.

The server notices that a page was closed when it cannot send the next line.
"""
MAX_BODY = 1_000_000
"""The largest body of a request, bytes."""
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; connect-src 'self';"
    " form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
)
"""The content security policy: the page loads nothing from elsewhere, and connects to this server only.

The policy does not require a nonce for scripts. The frame of the replay inherits the policy, and the scripts of the
replay have no nonce, because the same page is also written to files.
"""
PATIENCE = 10.0
"""The time-out for a browser that does not send the rest of its request, s."""


class PlayServer(ThreadingHTTPServer):
    """The server of a session.

    Args:
        session: the scenario to play with, and the workers that perform its runs.
    """

    daemon_threads = True

    def __init__(self, session: Session):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.session = session
        self.token = secrets.token_urlsafe(16)
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}
        self._pages, self._closed_at = 0, float("inf")
        self._lock = threading.Lock()

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"

    def serve_until_closed(self) -> None:
        """Answer requests until the last page has been closed for `LINGER` s."""
        threading.Thread(target=self._watch, daemon=True).start()
        self.serve_forever(poll_interval=0.1)

    def page_opened(self) -> None:
        """Note that one more page is open."""
        with self._lock:
            self._pages += 1
            self._closed_at = float("inf")

    def page_closed(self) -> None:
        """Note that a page was closed."""
        with self._lock:
            self._pages -= 1
            if not self._pages:
                self._closed_at = time.monotonic()

    def _watch(self) -> None:
        while time.monotonic() < self._closed_at + LINGER:
            time.sleep(0.1)
        self.shutdown()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore an OSError, because it occurs when the browser has closed the connection. Report any other error."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


def page(playground: Playground) -> str:
    """Return the page of a playground; needs jinja2 (the extra `plot`)."""
    from jinja2 import Environment

    template, script = (
        files("desim.view").joinpath(f"play.{each}").read_text(encoding="utf-8") for each in ("html", "js")
    )
    environment = Environment(autoescape=True, keep_trailing_newline=True)
    return environment.from_string(template).render(
        name=playground.name,
        start=list(playground.start),
        values=playground.values,
        style=style(),
        script=script,
    )


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server_version, sys_version = "desim", ""
    timeout = PATIENCE

    @property
    def _play(self) -> PlayServer:
        return cast("PlayServer", self.server)

    def do_GET(self) -> None:
        """Answer with the page, or with signs of life as long as the page is open."""
        self._answer({"": self._page, "alive": self._alive})

    def do_POST(self) -> None:
        """Run the scenario, compare runs over seeds, save a run, or cancel a comparison; answer with the result."""
        self._answer({"run": self._run, "seeds": self._seeds, "save": self._save, "cancel": self._cancel})

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def _answer(self, routes: Mapping[str, Callable[[], None]]) -> None:
        refused = self._refusal()
        path = self.path.partition("?")[0]
        token, _, name = path.removeprefix("/").partition("/")
        if refused:
            self.send_error(HTTPStatus.FORBIDDEN, refused)
        elif not secrets.compare_digest(token.encode(), self._play.token.encode()) or name not in routes:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            routes[name]()

    def _refusal(self) -> str | None:
        """Return why a request is refused, by its headers; None if it is not."""
        if self.headers.get("Host") not in self._play.hosts:
            return "Other host"
        origin = self.headers.get("Origin")
        own = {f"http://{each}" for each in self._play.hosts}
        if origin not in own if self.command == "POST" else origin is not None and origin not in own:
            return "Other origin"
        return None

    def _body(self) -> Answer | None:
        """Return the body of a request, a JSON object; if the body is invalid, answer with an error and return None."""
        length = self.headers.get("Content-Length", "")
        if length.isdecimal() and len(length) < 10:
            body = self.rfile.read(min(int(length), MAX_BODY))
            left = int(length) - len(body)
            # If a part of the request stays unread, the client may miss the answer.
            while left > 0 and (rest := self.rfile.read(min(left, MAX_BODY))):
                left -= len(rest)
            try:
                found: Any = json.loads(body) if int(length) <= MAX_BODY else None
            except (ValueError, RecursionError):
                found = None
            if is_request(found):
                return dict(found)
        self.send_error(HTTPStatus.BAD_REQUEST)
        return None

    def _begin(self, kind: str, length: int | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def _send(self, kind: str, content: bytes) -> None:
        self._begin(kind, len(content))
        self.wfile.write(content)

    def _send_json(self, answer: Answer) -> None:
        self._send("application/json", json.dumps(to_json(answer), allow_nan=False).encode())

    def _page(self) -> None:
        self._send("text/html", page(self._play.session.playground).encode())

    def _alive(self) -> None:
        self._play.page_opened()
        try:
            self._begin("text/event-stream")
            while True:
                self.wfile.write(b":\n\n")
                time.sleep(BEAT)
        except OSError:
            pass
        finally:
            self._play.page_closed()

    def _run(self) -> None:
        if (body := self._body()) is not None:
            self._send_json(self._play.session.run(body["now"], body["pinned"], body["page"]))

    def _seeds(self) -> None:
        if (body := self._body()) is None:
            return
        self._begin("application/x-ndjson")
        found = self._play.session.compare(body["now"], body["pinned"], body["count"], body["page"])
        try:
            for line in _lines(found):
                self.wfile.write(line)
        except OSError:  # the page has been closed
            found.close()

    def _save(self) -> None:
        if (body := self._body()) is not None:
            self._send_json(self._play.session.save(body["now"]))

    def _cancel(self) -> None:
        if (body := self._body()) is not None:
            self._play.session.cancel(body["page"])
            self._send_json({})


def _lines(answers: Iterator[Answer]) -> Iterator[bytes]:
    """Yield answers as lines of JSON; if computing them raises an exception, the last line has the key `error`."""
    try:
        for each in answers:
            yield json.dumps(each, allow_nan=False).encode() + b"\n"
    except Exception as error:
        yield json.dumps({"error": f"{type(error).__name__}: {error}"}).encode() + b"\n"
