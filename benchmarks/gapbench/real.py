"""Recordings made by others whose gap has a known cause, as cases (``docs/real-gaps.md``)."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import swimid
from validation.real_gaps.row import Sources
from validation.real_gaps.rows import ramp, roll_decay, screw_drive, tanks


class Recording(NamedTuple):
    """A recording and the model that lacks something.

    Attributes
    ----------
    source : str
        Its folder among the recordings.
    robot : str
    effects : tuple of str
        Names that are right for what is lacking; none where nothing of the catalogue is.
    write : (folder, data) -> trials file
        Writes logs, robot and trials file, and the model's parameters as ``params_prior.yaml``.
    """

    source: str
    robot: str
    effects: tuple[str, ...]
    write: Callable[[Path, Path], Path]


PRIOR = "params_prior.yaml"


def _roll(folder: Path, data: Path) -> Path:
    """A simulator of potential flow has no viscous roll damping; the basin does."""
    roll_decay.write(_sources(data), folder)
    simulated, measured = folder / "simulator.yaml", folder / "basin.yaml"
    waves = swimid.fit_drag(simulated, fixed={"quadratic_damping": 0.0})
    damping = round(float(waves.parameters["value"]["linear_damping"]), 5)
    fixed = {"quadratic_damping": 0.0, "linear_damping": damping}
    swimid.fit_drag(simulated, fixed=fixed, output=folder / PRIOR)
    for path in (simulated, folder / "simulator.csv"):
        path.unlink()
    return measured


def _drive(folder: Path, data: Path) -> Path:
    """A drive with a screw, modelled with viscous friction only."""
    screw_drive.write(_sources(data), folder)
    trials = folder / "drive.yaml"
    free = ("linear_drag", "force_offset")
    swimid.fit_drag(trials, fixed={"quadratic_drag": 0.0}, freed=free, output=folder / PRIOR)
    return trials


def _ramp(folder: Path, data: Path) -> Path:
    """Blocks that slide down ramps without friction, from two films."""
    for name in ramp.FILMS:
        video = data / "phystrack" / f"{name}.MP4"
        setup, log = folder / f"{name}-setup.yaml", folder / f"{name}-px.csv"
        _run("track", "setup", video, "-o", setup)
        _run("track", "video", video, "--setup", setup, "--fps", "240", "-o", log)
    ramp.write(_sources(data), folder)
    trials = folder / "ramps.yaml"
    swimid.fit_drag(trials, fixed={"quadratic_drag": 0.0}, output=folder / PRIOR)
    return trials


def _tanks(folder: Path, data: Path) -> Path:
    """A linear black box of two tanks whose outflow is not linear and which overflow."""
    tanks.write(_sources(data), folder)
    trials = folder / "levels.yaml"
    orders = ("--input", "u", "--output", "y", "--na", "2", "--nb", "2")
    _run("rwls", folder / "estimation.csv", *orders, "-o", folder / PRIOR)
    return trials


def _sources(data: Path) -> Sources:
    return Sources(data, data / "repositories")


def _run(*words: str | Path) -> None:
    from swimid.cli.main import main

    with contextlib.redirect_stdout(io.StringIO()):
        main([str(w) for w in words], standalone_mode=False)


RECORDINGS = (
    Recording("kvlcc2_rolldecay", "ship", ("linear-drag", "quadratic-drag"), _roll),
    Recording("emps", "carriage", ("pulley-friction",), _drive),
    Recording("phystrack", "block", ("pulley-friction",), _ramp),
    Recording("cascaded_tanks", "tanks", (), _tanks),
)


def plan(data: Path, number: int) -> list[dict[str, Any]]:
    """The cases of the recordings that are there, numbered from ``number`` on."""
    found = [r for r in RECORDINGS if (data / r.source).is_dir()]
    for missing in set(RECORDINGS) - set(found):
        print(f"{missing.source} is not among the recordings: left out", file=sys.stderr)
    return [
        {"number": number + k, "robot": r.robot, "kind": "real", "effects": list(r.effects), "size": None}
        for k, r in enumerate(found)
    ]


def write(case: dict[str, Any], folder: Path, label: Path, data: Path) -> None:
    """Write a case's folder and label."""
    recording = next(r for r in RECORDINGS if r.robot == case["robot"])
    shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / "case"
        made.mkdir()
        trials = recording.write(made, data)
        trials.rename(made / "trials.yaml")
        # a log that is no trial's belongs to how the case was made
        listed = (made / "trials.yaml").read_text() + PRIOR
        folder.mkdir(parents=True)
        for path in made.iterdir():
            if path.name in listed or path.name == "trials.yaml":
                shutil.copy2(path, folder)
    label.parent.mkdir(exist_ok=True)
    label.write_text(json.dumps({**case, "source": recording.source, "gap": None}, indent=1) + "\n")
