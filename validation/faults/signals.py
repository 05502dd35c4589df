"""Attack on long computations: Ctrl-C and SIGKILL at random times, and two processes on one output.

The same command must afterwards give the file of an undisturbed run, apart from its time of creation.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from functools import cache, partial
from pathlib import Path

import numpy as np

from tests.conftest import ROOT, SAMPLES
from validation.faults.runner import Attack, Finding, check_ending

GAP = SAMPLES / "gap"
#: Arguments of each long computation.
COMMANDS = {
    "fit-drag": ["fit-drag", str(SAMPLES / "rig" / "trials.yaml")],
    "rwls": ["rwls", str(SAMPLES / "longfin" / "longfin_marching.csv"), "--input", "cmd1_rad",
             "--output", "u_m_s", "--na", "4", "--nb", "3"],
    "map": ["map", "--params", str(GAP / "params.yaml"), "--over", "frequency_hz=0.8:1.6:4",
            "--over", "amplitude_deg=15:25:3"],
    "optimise gait": ["optimise", "gait", "--params", str(GAP / "params.yaml"),
                      "--vary", "frequency_hz=0.8,1.6", "--amplitude-deg", "20"],
    "diagnose": ["diagnose", str(SAMPLES / "rig" / "trials.yaml"), "--params", "drag.yaml"],
}  # fmt: skip


def _start(words: list[str], folder: Path) -> subprocess.Popen[str]:
    given = {**os.environ, "PYTHONPATH": str(ROOT), "SWIMID_LANES": "never", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "swimid", *words, "-o", "out.yaml", "--force"],
        cwd=folder,
        env=given,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def _finish(process: subprocess.Popen[str]) -> int:
    _, messages = process.communicate()
    if process.returncode >= 0:
        check_ending(process.returncode, messages)
    return process.returncode


def _content(folder: Path) -> str:
    return re.sub(r"created: .*", "", (folder / "out.yaml").read_text(encoding="utf-8"))


@cache
def _undisturbed(name: str) -> tuple[str, float]:
    """Return the file of an undisturbed run, and its time, s."""
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        _empty(Path(folder))
        began = time.monotonic()
        status = _finish(_start(COMMANDS[name], Path(folder)))
        if status:
            raise Finding(f"the undisturbed {name} ends with status {status}")
        return _content(Path(folder)), time.monotonic() - began


def _empty(folder: Path) -> None:
    """Leave only the parameter file that the diagnosis needs in a folder."""
    for path in folder.iterdir():
        path.unlink()
    (folder / "drag.yaml").write_bytes(drag_parameters())


@cache
def drag_parameters() -> bytes:
    """Return the parameter file of an undisturbed ``fit-drag``."""
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        _finish(_start(COMMANDS["fit-drag"], Path(folder)))
        return (Path(folder) / "out.yaml").read_bytes()


def _stop(rng: np.random.Generator, folder: Path, *, name: str, how: signal.Signals) -> bool:
    expected, time_s = _undisturbed(name)
    _empty(folder)
    process = _start(COMMANDS[name], folder)
    time.sleep(float(rng.uniform(0.3, 1.0)) * time_s)
    process.send_signal(how)
    status = _finish(process)
    if status and (folder / "out.yaml").exists() and _content(folder) != expected:
        raise Finding("a partial file is left under the final name")
    again = _finish(_start(COMMANDS[name], folder))
    if again or _content(folder) != expected:
        raise Finding(f"the resumed {name} ends with status {again} or another file")
    return status == 0


def _twice(rng: np.random.Generator, folder: Path, *, name: str) -> bool:
    expected, _ = _undisturbed(name)
    _empty(folder)
    first = _start(COMMANDS[name], folder)
    time.sleep(float(rng.uniform(0.0, 0.5)))
    second = _start(COMMANDS[name], folder)
    ends = [_finish(first), _finish(second)]
    if 0 not in ends or not set(ends) <= {0, 2} or _content(folder) != expected:
        raise Finding(f"two processes end with {ends}, or leave another file")
    return ends == [0, 0]


ATTACKS = [
    *(
        Attack(f"{how.name} in {name}", partial(_stop, name=name, how=how), count=2, time_s=300.0)
        for name in COMMANDS
        for how in (signal.SIGINT, signal.SIGKILL)
    ),
    Attack("two processes on one output", partial(_twice, name="fit-drag"), count=6, time_s=120.0),
]
