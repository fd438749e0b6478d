"""Chromium without a window, driven over a pipe: the DevTools protocol needs no more than `json` and two pipes."""

import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""The program; None if there is none."""
TIMEOUT = 30.0
"""How long an answer may take, s."""


class Page:
    """A page of a browser, with its warnings, errors and requests since it was opened."""

    def __init__(self, commands: int, answers: int, session: int = 0):
        self.session = session
        """The session of the processes of the browser; see `cpu_time`."""
        self.commands, self.answers, self._unread, self._number = commands, answers, b"", 0
        self._session: str | None = None
        self.errors: list[Any] = []
        self.requests: list[str] = []
        self._target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **params: Any) -> Any:
        """Send a command and return its result."""
        self._number += 1
        command: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            command["sessionId"] = self._session
        os.write(self.commands, json.dumps(command).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def _next(self) -> dict[str, Any]:
        """Return the next answer or event; keep errors and requests."""
        until = time.monotonic() + TIMEOUT
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self.answers], [], [], max(until - time.monotonic(), 0.0))
            chunk = os.read(self.answers, 1 << 20) if ready else b""
            assert chunk, "the browser does not answer"
            self._unread += chunk
        line, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(params["exceptionDetails"])
        elif method == "Runtime.consoleAPICalled" and params["type"] in {"error", "warning", "assert"}:
            self.errors.append(params["args"])
        elif method == "Log.entryAdded" and params["entry"]["level"] in {"error", "warning"}:
            self.errors.append(params["entry"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        return message

    def to_front(self) -> None:
        """Show the page: the browser draws no frames of a hidden one, and a replay waits for its first frame."""
        self.send("Page.bringToFront")

    def close(self) -> None:
        """Close the page."""
        self._session = None
        self.send("Target.closeTarget", targetId=self._target)

    def open(
        self, path: Path, width: int = 1200, height: int = 850, theme: str = "light", motion: str = "reduce"
    ) -> None:
        """Open a file, in a window of a size (px)."""
        self.visit(path.resolve().as_uri(), width, height, theme, motion)

    def visit(
        self, address: str, width: int = 1280, height: int = 800, theme: str = "light", motion: str = "reduce"
    ) -> None:
        """Open an address, in a window of a size (px)."""
        self.to_front()
        self.resize(width, height, theme, motion)
        self.errors.clear()
        self.requests.clear()
        self.send("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def resize(self, width: int, height: int, theme: str = "light", motion: str = "reduce") -> None:
        """Set the size of the window (px), and the preferred theme and motion; with "reduce", replays wait."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        wishes = {"prefers-color-scheme": theme, "prefers-reduced-motion": motion}
        self.send(
            "Emulation.setEmulatedMedia", features=[{"name": name, "value": value} for name, value in wishes.items()]
        )

    def value(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript; a promise is awaited."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        """Wait until a condition in JavaScript holds."""
        until = time.monotonic() + TIMEOUT
        while not self.value(condition):
            assert time.monotonic() < until, f"never: {condition}"
            time.sleep(0.02)

    def press(self, key: str, text: str = "") -> None:
        """Press a key and release it; with the text that it types, it also presses the button that has the focus."""
        code = {"windowsVirtualKeyCode": ord(text)} if text else {}
        self.send("Input.dispatchKeyEvent", type="keyDown", key=key, text=text, **code)
        self.send("Input.dispatchKeyEvent", type="keyUp", key=key, **code)


@contextmanager
def page() -> Iterator[Page]:
    """Yield a page of a browser of its own; afterwards end the browser and delete its folder."""
    to_browser, commands = os.pipe()
    answers, from_browser = os.pipe()

    def at_3_and_4() -> None:  # where the browser looks for its pipes
        high = os.dup(to_browser), os.dup(from_browser)  # copies, in case one of the two already is 3 or 4
        os.dup2(high[0], 3)
        os.dup2(high[1], 4)

    with TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True) as folder:
        program = [CHROMIUM or "chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        program += ["--no-first-run", "--disable-background-networking", f"--user-data-dir={folder}/profile"]
        browser = subprocess.Popen(
            [*program, "--remote-debugging-pipe"],
            close_fds=False,
            start_new_session=True,
            preexec_fn=at_3_and_4,
            env=os.environ | {"TMPDIR": folder},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        try:
            yield Page(commands, answers, browser.pid)
        finally:
            os.close(commands)
            os.close(answers)
            browser.terminate()
            try:
                browser.wait(10)
            except subprocess.TimeoutExpired:
                browser.kill()
                browser.wait()


def cpu_time(page: Page) -> float:
    """Return the CPU time, s, that all processes of a browser have taken so far, on Linux."""
    ticks = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text().rpartition(")")[2].split()
        except OSError:  # the process has ended
            continue
        if int(fields[3]) == page.session:
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")
