"""Run the tests of mutants: a process that reads one job a line and forks for each.

The working folder is the root of a copy of the tree. A job names the module, its mutated text, the tests and
a time limit. The answer states whether a test failed, or whether the tests did not end.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numba
import pytest

MEMORY_BYTES = 12 * 2**30
LIBRARIES = (
    "click.testing", "control", "cv2", "jinja2", "matplotlib.figure", "pandas", "pydantic", "ruamel.yaml",
    "scipy.integrate", "scipy.optimize", "scipy.signal", "scipy.stats",
)  # fmt: skip


class FirstFailure:
    """Plugin of pytest that keeps the first failed test."""

    test = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.test:
            self.test = report.nodeid


def _run(job: dict[str, Any], answer: Path) -> None:
    """Run the tests in this process, which is a fork, and write the answer."""
    os.setsid()
    null = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(null, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.environ["NUMBA_CACHE_DIR"] = job["cache"]
    numba.config.CACHE_DIR = job["cache"]
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    failure = FirstFailure()
    words = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", f"--basetemp={job['scratch']}/pytest"]
    status = pytest.main([*words, *job["tests"]], plugins=[failure])
    answer.write_text(json.dumps({"status": int(status), "test": failure.test}))
    os._exit(0)


def run(job: dict[str, Any]) -> dict[str, Any]:
    """Put the mutated text in place, run the tests, and restore the module."""
    path = Path(job["path"])
    original, stat = path.read_bytes(), path.stat()
    scratch = Path(job["scratch"])
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    answer = scratch / "answer.json"
    begun = time.monotonic()
    path.write_text(job["source"], encoding="utf-8")
    # an equal size within one second would make Python read the compiled module of before
    os.utime(path, (stat.st_atime, stat.st_mtime + 3600.0))
    child = os.fork()
    if child == 0:
        try:
            _run(job, answer)
        finally:
            os._exit(1)
    ended = 0
    while not ended and time.monotonic() - begun < job["limit_s"]:
        time.sleep(0.02)
        ended, _ = os.waitpid(child, os.WNOHANG)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    if not ended:
        os.waitpid(child, 0)
    path.write_bytes(original)
    os.utime(path, (stat.st_atime, stat.st_mtime))
    if not ended:
        result: dict[str, Any] = {"status": "hang", "test": ""}
    elif answer.exists():
        result = json.loads(answer.read_text())
    else:
        result = {"status": "crash", "test": ""}
    shutil.rmtree(scratch, ignore_errors=True)
    return {**result, "seconds": round(time.monotonic() - begun, 1)}


def main() -> None:
    """Answer one job a line."""
    # what every test needs, loaded once; swimid itself is loaded by each fork
    for name in LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
