"""The server of `desim play`: one page for one user of this machine.

It listens on the loopback interface only. Its address has a secret token, and a request is refused if it is for another
host, as under DNS rebinding, or if a page of another origin makes it. The server ends when it is interrupted, or a few
seconds after its last page was closed.
"""

import json
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, cast

from desim.config.json_numbers import to_json
from desim.view.pages.answers import Answer
from desim.view.pages.play_page import play_page
from desim.view.pages.session import Session, is_request

LINGER = 5.0
"""The time, s, for which the server waits for another page after the last one was closed, for example by a reload."""
BEAT = 1.0
"""The time between two lines that the server sends to each browser with open pages, s.

The server notices that the last page was closed when it cannot send the next line.
"""
MAX_BODY = 1_000_000
"""The largest body of a request, bytes."""
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; connect-src 'self';"
    " worker-src 'self'; form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
)
"""The content security policy: the page loads nothing from elsewhere, and connects to this server only.

The policy does not require a nonce for scripts. The frame of the replay inherits the policy, and the scripts of the
replay have no nonce, because the same page is also written to files.
"""
PATIENCE = 10.0
"""The time in which a browser must have sent its whole request, s."""
MAX_COMPARISONS = 100
"""The largest number of comparisons that are kept; the oldest are dropped, because their pages may be closed."""


class PlayServer(ThreadingHTTPServer):
    """The server of a session.

    Args:
        session: the scenario to play with, and the workers that perform its runs.
    """

    daemon_threads = True
    request_queue_size = 128  # when a browser is started again, all its tabs ask at once

    def __init__(self, session: Session):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.session = session
        self.token = secrets.token_urlsafe(16)
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}
        self._pages, self._closed_at = 0, float("inf")
        """The number of open pages, or of browsers with open pages, and the time at which the last was closed, s."""
        self._lock = threading.Lock()
        self._comparisons: dict[str, SharedAnswers] = {}
        """By page, the comparison whose next answers the page will ask for."""
        self._incoming: dict[socket.socket, float] = {}
        """By connection, the time at which its request must have arrived."""

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"

    def serve_until_closed(self) -> None:
        """Answer requests until the last page has been closed for `LINGER` s."""
        threading.Thread(target=self._watch, daemon=True).start()
        self.serve_forever(poll_interval=0.1)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Handle a request in a thread of its own; it must arrive within `PATIENCE`."""
        self._incoming[request] = time.monotonic() + PATIENCE
        super().process_request(request, client_address)

    def arrived(self, request: socket.socket) -> None:
        """Note that a request has arrived as a whole."""
        self._incoming.pop(request, None)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.arrived(request)
        super().shutdown_request(request)

    def begin_comparison(self, page: str, answers: Iterator[Answer]) -> None:
        """Keep a comparison, in place of an earlier one of the same page."""
        with self._lock:
            self._comparisons.pop(page, None)
            self._comparisons[page] = SharedAnswers(answers)
            if len(self._comparisons) > MAX_COMPARISONS:
                del self._comparisons[next(iter(self._comparisons))]

    def next_of_comparison(self, page: str) -> Answer:
        """Return the next answer of the comparison of a page; after the last answer, an empty one."""
        comparison = self._comparisons.get(page)
        answer = {} if comparison is None else comparison.next_answer()
        with self._lock:
            if not answer and self._comparisons.get(page) is comparison is not None:  # no newer comparison has begun
                del self._comparisons[page]
        return answer

    def page_opened(self) -> None:
        """Note that one more page, or one more browser with pages, is open."""
        with self._lock:
            self._pages += 1
            self._closed_at = float("inf")

    def page_closed(self) -> None:
        """Note that a page, or all pages of a browser, were closed."""
        with self._lock:
            self._pages -= 1
            if not self._pages:
                self._closed_at = time.monotonic()

    def _watch(self) -> None:
        """Close connections whose request is late, and end the server `LINGER` s after its last page was closed."""
        while (now := time.monotonic()) < self._closed_at + LINGER:
            for request in [request for request, limit in list(self._incoming.items()) if limit < now]:
                self.arrived(request)
                with suppress(OSError):  # the browser may have closed the connection
                    request.shutdown(socket.SHUT_RDWR)
            time.sleep(0.1)
        self.shutdown()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore an OSError, because it occurs when the browser has closed the connection. Report any other error."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class SharedAnswers:
    """The answers of a comparison, of which requests in several threads may ask for the next: each gets another one.

    Args:
        answers: computed one by one.
    """

    def __init__(self, answers: Iterator[Answer]):
        self._answers, self._lock = answers, threading.Lock()

    def next_answer(self) -> Answer:
        """Return the next answer, when those that were asked for before are computed; after the last, an empty one."""
        with self._lock:
            return next(self._answers, {})


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server_version, sys_version = "desim", ""
    timeout = PATIENCE

    @property
    def _play(self) -> PlayServer:
        return cast("PlayServer", self.server)

    def do_GET(self) -> None:
        """Answer with the page or a script, or send lines (`BEAT`) for as long as a page is open."""
        self._play.arrived(self.connection)
        self._answer({"": self._page, "life.js": self._life, "alive": self._alive})

    def do_POST(self) -> None:
        """Run the scenario, compare runs over seeds, save a run, or cancel a comparison; answer with the result."""
        routes = {"run": self._run, "seeds": self._seeds, "more": self._more, "save": self._save}
        self._answer(routes | {"cancel": self._cancel})

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
        allowed_origins: set[str | None] = {f"http://{host}" for host in self._play.hosts}
        if self.command != "POST":  # a browser names no origin when it loads the page
            allowed_origins.add(None)
        return None if origin in allowed_origins else "Other origin"

    def _body(self) -> Answer | None:
        """Return the body of a request, a JSON object; if the body is invalid, answer with an error and return None."""
        length = self.headers.get("Content-Length", "")
        if length.isdecimal() and len(length) < 10:
            body = self.rfile.read(min(int(length), MAX_BODY))
            unread = int(length) - len(body)
            # If a part of the request stays unread, the client may miss the answer.
            while unread > 0 and (skipped := self.rfile.read(min(unread, MAX_BODY))):
                unread -= len(skipped)
            self._play.arrived(self.connection)
            try:
                content: Any = json.loads(body) if int(length) <= MAX_BODY else None
            except (ValueError, RecursionError):
                content = None
            if is_request(content):
                return dict(content)
        self.send_error(HTTPStatus.BAD_REQUEST)
        return None

    def _begin(self, kind: str, length: int | None = None) -> None:
        """Send the headers of an answer, given its content type and its length in bytes."""
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
        self._send("text/html", play_page(self._play.session.playground).encode())

    def _life(self) -> None:
        self._send("text/javascript", files("desim.view.pages").joinpath("play_life.js").read_bytes())

    def _alive(self) -> None:
        """Send a line each `BEAT` s until the browser closes the connection."""
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
        """Begin a comparison, and send its first answer; the page requests the others from `_more`."""
        if (body := self._body()) is None:
            return
        if body["pinned"] is None:
            self.send_error(HTTPStatus.BAD_REQUEST, "No pinned run")
            return
        answers = self._play.session.compare(body["now"], body["pinned"], body["count"], body["page"])
        self._play.begin_comparison(body["page"], _or_error(answers))
        self._send_json(self._play.next_of_comparison(body["page"]))

    def _more(self) -> None:
        if (body := self._body()) is not None:
            self._send_json(self._play.next_of_comparison(body["page"]))

    def _save(self) -> None:
        if (body := self._body()) is not None:
            self._send_json(self._play.session.save(body["now"]))

    def _cancel(self) -> None:
        if (body := self._body()) is not None:
            self._play.session.cancel(body["page"])
            self._send_json({})


def _or_error(answers: Iterator[Answer]) -> Iterator[Answer]:
    """Yield answers; if computing them raises an exception, the last answer has the key `error`."""
    try:
        yield from answers
    except Exception as error:
        yield {"error": f"{type(error).__name__}: {error}"}
