"""Headless Chromium that tests drive through a pipe, by the DevTools protocol: no library is needed.

https://chromedevtools.github.io/devtools-protocol describes the commands.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Self

#: Names under which systems install the browser.
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
#: Maximum time for one answer of the browser, and for a condition on a page, s.
TIMEOUT_S = 60.0
#: Program that starts another program, which reads from descriptor 3 and writes to descriptor 4.
LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(word), fcntl.F_DUPFD, 10) for word in sys.argv[1:3]]
for descriptor, end in enumerate(ends, 3):
    os.dup2(end, descriptor)
    os.close(end)
os.execv(sys.argv[3], sys.argv[3:])
"""


def find() -> str | None:
    """Return the path of Chromium on this machine; None if there is none, or on Windows."""
    if os.name != "posix":
        return None
    return next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """Page in a headless Chromium that runs during a ``with`` block.

    Attributes
    ----------
    problems : list of str
        Errors that the page wrote to its console.
    """

    def __init__(self, address: str, width: int = 1400, height: int = 900, *, dark: bool = False) -> None:
        self._address, self._size, self._dark = address, (width, height), dark
        self._number, self._session = 0, ""
        self.problems: list[str] = []

    def __enter__(self) -> Self:
        self._profile = tempfile.mkdtemp()
        program = find()
        assert program is not None
        to_browser, self._to = os.pipe()
        self._from, from_browser = os.pipe()
        flags = ("headless=new", "no-sandbox", "disable-gpu", "no-first-run", "remote-debugging-pipe")
        words = [program, *(f"--{flag}" for flag in flags), f"--user-data-dir={self._profile}"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", LAUNCH, str(to_browser), str(from_browser), *words, "about:blank"],
            pass_fds=(to_browser, from_browser),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._answers = os.fdopen(self._from, "rb")
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        width, height = self._size
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        if self._dark:
            scheme = [{"name": "prefers-color-scheme", "value": "dark"}]
            self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call("Page.navigate", url=self._address)
        self.until("document.readyState === 'complete'")
        return self

    def __exit__(self, *_: object) -> None:
        self._session = ""
        try:
            self.call("Browser.close")
            self._process.wait(TIMEOUT_S)
        finally:
            self._process.kill()
            self._process.wait()
            os.close(self._to)
            self._answers.close()
            shutil.rmtree(self._profile, ignore_errors=True)

    def call(self, method: str, **parameters: Any) -> Any:
        """Execute a command of the protocol, and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def _receive(self) -> dict[str, Any]:
        text = bytearray()
        while (byte := self._answers.read(1)) != b"\0":
            assert byte, "Chromium has ended"
            text += byte
        event = json.loads(text)
        if event.get("method") == "Runtime.exceptionThrown":
            self.problems.append(str(event["params"]["exceptionDetails"]))
        if event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            self.problems.append(str(event["params"]["entry"]))
        return event

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, as plain data."""
        made = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in made, made["exceptionDetails"]
        return made["result"].get("value")

    def until(self, expression: str) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + TIMEOUT_S
        while not self.value(f"Boolean({expression})"):
            assert time.monotonic() < end, f"never true: {expression}\n{self.problems}"
            time.sleep(0.05)

    def click(self, selector: str, x: float | None = None, y: float | None = None) -> None:
        """Click in the middle of an element, or at a point relative to its upper left corner."""
        box = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({ block: 'nearest' }); const b = e.getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height]; })()"
        )
        left, top, width, height = box
        at = {"x": left + (width / 2 if x is None else x), "y": top + (height / 2 if y is None else y)}
        self.mouse("mouseMoved", **at)
        self.mouse("mousePressed", **at, button="left", clickCount=1)
        self.mouse("mouseReleased", **at, button="left", clickCount=1)

    def mouse(self, kind: str, **more: Any) -> None:
        """Send an event of the mouse, in pixels of the window."""
        self.call("Input.dispatchMouseEvent", type=kind, **more)

    def key(self, name: str, *, shift: bool = False) -> None:
        """Press a key, by its name in JavaScript."""
        codes = {"Enter": 13, "Tab": 9, "Escape": 27}
        more = {"text": "\r"} if name == "Enter" else {"text": name} if len(name) == 1 else {}
        event = {"key": name, "modifiers": 8 * shift, "windowsVirtualKeyCode": codes.get(name, 0), **more}
        self.call("Input.dispatchKeyEvent", type="keyDown", **event)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=name)

    def fill(self, selector: str, text: str) -> None:
        """Type a text into a field in place of its value, and leave the field."""
        quoted = json.dumps(selector)
        self.value(f"(() => {{ const e = document.querySelector({quoted}); e.focus(); e.select(); }})()")
        self.call("Input.insertText", text=text)
        self.value(f"document.querySelector({quoted}).blur()")

    def choose(self, selector: str, value: str) -> None:
        """Choose an entry of a list."""
        self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            f"e.value = {json.dumps(value)};"
            "e.dispatchEvent(new Event('change', { bubbles: true })); })()"
        )

    def text(self, selector: str) -> str:
        """Return the visible text of an element."""
        return str(self.value(f"document.querySelector({json.dumps(selector)}).innerText"))

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write a screenshot of the window, or of the whole page, as PNG."""
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))
