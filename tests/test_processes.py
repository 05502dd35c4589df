"""Parallel processes of a diagnosis: results in order, and no process that outlives a terminated run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from swimid.fitting.problem import map_in_processes

PROGRAM = """
import os, sys, time
from pathlib import Path
from swimid.fitting.problem import map_in_processes

def work(name):
    Path(name).write_text(str(os.getpid()))
    time.sleep(120)

list(map_in_processes(work, sys.argv[1:], 2))
"""


def running(pid: int) -> bool:
    """Return whether a process runs; a process that has ended and waits for its parent does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until(condition: object, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():  # type: ignore[operator]
            return True
        time.sleep(0.05)
    return False


def test_results_come_in_the_order_of_the_items() -> None:
    def work(k: int) -> tuple[int, int]:
        time.sleep(0.02 * (4 - k))
        return k, os.getpid()

    found = list(map_in_processes(work, range(4), 2))
    assert [k for k, _ in found] == [0, 1, 2, 3]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems use one process")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_a_terminated_run(how: signal.Signals, tmp_path: Path) -> None:
    names = [tmp_path / "first", tmp_path / "second"]
    with subprocess.Popen([sys.executable, "-c", PROGRAM, *map(str, names)]) as run:
        try:
            assert until(lambda: all(n.exists() and n.read_text() for n in names), 60)
            workers = [int(n.read_text()) for n in names]
            assert all(running(pid) for pid in workers)
        finally:
            run.send_signal(how)
    assert until(lambda: not any(running(pid) for pid in workers), 20)
