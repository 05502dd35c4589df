"""The page of ``swimid track setup --pick`` for tests: the command in another process, and requests to it.

``python -m tests.pick_page docs/figures/pick.png`` draws the picture of the manual.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tests.chromium import Page
from tests.conftest import ROOT, SAMPLES

POOL = SAMPLES / "pool" / "pool.mp4"
#: Pixels of the red disc on the nose and of the yellow disc behind it in the first frame of the sample film,
#: and corners of the floor of the pool in pixels.
NOSE, TAIL = (179, 254), (182, 205)
CORNERS = ((67.2, 43.2), (579.2, 33.6), (608.0, 446.4), (25.6, 441.6))
#: Condition under which the page shows the film and the answer to its first request.
READY = "typeof image !== 'undefined' && image && checks && get('prompt').textContent"
PICKS = [{"name": name, "x": x, "y": y} for name, (x, y) in (("nose", NOSE), ("tail", TAIL))]


class Served:
    """Command that serves the page.

    Attributes
    ----------
    address : str
        Address of the page.
    process : Popen
        Process of the command.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        line = ""
        self.process, self.told = process, ""
        while "to stop" not in line:
            line = process.stderr.readline()
            assert line, f"the command ended: {self.told}"
            self.told += line
        self.address = re.search(r"http://\S+", self.told)[0]  # type: ignore[index]

    def request(
        self, method: str, name: str, body: bytes | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Return status, header fields and body of the answer; ``name`` may be a whole path."""
        parts = urlsplit(self.address)
        path = name if name.startswith("/") else parts.path + name
        connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=60)
        fields = {key.replace("_", "-"): value for key, value in headers.items()}
        connection.request(method, path, body, {"Content-Type": "application/json", **fields})
        answer = connection.getresponse()
        read = answer.read()
        connection.close()
        return answer.status, dict(answer.headers), read

    def post(self, name: str, content: Any, status: int = 200) -> Any:
        """Send a JSON document, and return that of the answer."""
        got, _, body = self.request("POST", name, json.dumps(content).encode())
        assert got == status, body
        return json.loads(body)

    def end(self) -> tuple[int, str, str]:
        """Wait for the end of the command, and return its status, standard output and standard error."""
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err

    def interrupt(self) -> tuple[int, str, str]:
        """Press Ctrl-C in the terminal of the command, and wait for its end."""
        self.process.send_signal(signal.SIGINT)
        return self.end()


@contextmanager
def served(film: Path, *options: object, **environment: str) -> Iterator[Served]:
    """Run the command in the background, without a display."""
    words = [sys.executable, "-m", "swimid", "track", "setup", str(film), "--pick", *map(str, options)]
    inherited = {key: value for key, value in os.environ.items() if "DISPLAY" not in key and key != "BROWSER"}
    inherited |= {"PYTHONPATH": str(ROOT), **environment}
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True, env=inherited
    )
    try:
        yield Served(process)
    finally:
        process.kill()
        process.communicate()


def click(page: Page, x: float, y: float) -> None:
    """Click on a pixel of the film."""
    factor = page.value("canvas.clientWidth / film.width")
    page.click("#picture", (x + 0.5) * factor, (y + 0.5) * factor)


def draw(path: Path) -> None:
    """Write a screenshot of the page with two markers, a scale and a trial on the sample film."""
    from PIL import Image

    with (
        tempfile.TemporaryDirectory() as folder,
        served(POOL, "-o", Path(folder) / "setup.yaml") as run,
        Page(run.address, 1180, 760) as page,
    ):
        page.until(READY)
        for pixel in (NOSE, TAIL):
            click(page, *pixel)
        page.until("proposal.markers.length === 2")
        page.click("#next")
        page.choose("#kind", "two")
        for pixel in CORNERS[:2]:
            click(page, *pixel)
        page.fill("#distance", "1.8")
        page.until("proposal.scale")
        page.click("#next")
        page.click("#next")
        page.until("trial && !playing")
        page.value("show(120).then(() => scrollTo(0, 0))")
        page.picture(path)
    whole = Image.open(path).convert("RGB")
    colours = whole.quantize(250, Image.Quantize.MAXCOVERAGE)
    whole.quantize(palette=colours).save(path, optimize=True)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
