"""Fixtures every test may use."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Read when numpy and OpenCV are loaded, here and in the programs that tests start: threads within threads
# of several workers take half as much again of the processors' time.
for _library in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_library, "1")


import numpy as np
import pytest
from click.testing import CliRunner, Result

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_logs"


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """Ctrl-C as in a terminal: what a shell starts in the background ignores it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@dataclass(frozen=True)
class Ran:
    """A command that ended."""

    status: int
    out: str
    stderr: str

    @property
    def err(self) -> str:
        """What stands on stderr, with each wrapped warning on one line."""
        return re.sub(r"\n    (?=\S)", " ", self.stderr)

    @property
    def json(self) -> dict[str, Any]:
        """Its ``--json`` document."""
        return json.loads(self.out)


def command(*words: str | Path) -> Ran:
    """Run the command line in this process: ``command("fit-drag", path, "-o", out)``."""
    from swimid.cli.main import main

    result = CliRunner().invoke(main, [str(w) for w in words], prog_name="swimid")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Ran(result.exit_code, result.stdout, result.stderr)


def track(*words: Any, status: int = 0) -> Result:
    """Run ``swimid track``, which must end with a status."""
    from swimid.cli.main import track_group

    result = CliRunner().invoke(track_group, [str(w) for w in words])
    assert result.exit_code == status, result.output
    return result


@pytest.fixture
def swimid() -> Callable[..., Ran]:
    """Return `command`."""
    return command


@pytest.fixture
def imported(swimid: Callable[..., Ran], tmp_path: Path) -> Callable[..., tuple[Any, Ran]]:
    """Import a file with options; return the log and what the command said."""
    from swimid.logs import log

    def run(path: Path, *options: str) -> tuple[Any, Ran]:
        ran = swimid("import", path, *options, "-o", tmp_path / "out.csv", "--force", "--json")
        assert ran.status == 0, ran.err
        return log.read(tmp_path / "out.csv"), ran

    return run


@pytest.fixture(scope="session")
def samples() -> Path:
    """The folder of sample logs."""
    return SAMPLES


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings; the test skips without it."""
    folder = os.environ.get("SWIMID_DATA")
    if not folder:
        pytest.skip("SWIMID_DATA is unset: no real recordings to test on")
    path = Path(folder)
    if not path.is_dir():
        pytest.skip(f"SWIMID_DATA is no folder: {folder}")
    return path


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded source of random numbers."""
    return np.random.default_rng(12345)


def interrupting(steps: int) -> Callable[..., Any]:
    """Return a progress display that raises KeyboardInterrupt, as Ctrl-C does, after a number of steps."""
    count = 0

    def step(amount: int = 1) -> None:
        nonlocal count
        count += amount
        if count == steps:
            raise KeyboardInterrupt

    return lambda _description, total=None: nullcontext(step)
