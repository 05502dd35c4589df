"""Recordings made by others, as swimid logs with a trials file.

The tail-actuated fish of Michigan State University (DerivativeBasedKoopman, MIT licence), the single
and double pendulum of MultiArm-Pendulum (dynamicslab, MIT licence), and zig-zags of a model of the tanker
KVLCC2 by MARIN (SIMMAN 2008; martinlarsalbert/System-identification-of-Vessel-Manoeuvring-Models). As a
program it writes all of them: ``python -m tests.generators.real_logs DATA FOLDER``. Recordings with a known
gap are in ``validation.real_gaps``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

from tests.generators.files import write_log, write_trials

Array = NDArray[np.float64]

AMPLITUDES_DEG = (15, 20, 30)
BIASES_DEG = (-50, -40, -30, -20, 0, 20, 30, 40, 50)
#: The fish's trials that are held out.
HELD_OUT_DEG = 20
#: Largest bias of runs that turn gently.
MILD_DEG = 20
#: Beat frequencies among which each trial's own is sought, Hz.
BEATS_HZ = np.linspace(1.5, 2.6, 1101)
#: The tail is about this far ahead of the yaw rate, which starts the search for each trial's phase.
LAG_RAD = 1.65
#: Sample numbers between the rows kept of a pendulum's 1 kHz record.
EVERY = 10


@dataclass(frozen=True)
class FishRun:
    """One run of the fish.

    Attributes
    ----------
    amplitude_deg, bias_deg : int
        As commanded.
    frequency_hz, phase_rad : float
        Of the beat in its own yaw rate, which goes as ``sin(2 pi f t + phase)``.
    rows : ndarray, shape (n, 7)
        Time, surge, sway, yaw rate, yaw, x, y in SI.
    """

    name: str
    amplitude_deg: int
    bias_deg: int
    frequency_hz: float
    phase_rad: float
    rows: Array


def read_fish(data: Path) -> list[FishRun]:
    """All runs of the fish.

    Parameters
    ----------
    data : path
        The folder of real recordings.
    """
    runs = []
    for amplitude in AMPLITUDES_DEG:
        for bias in BIASES_DEG:
            for number in (1, 2):
                rows = np.loadtxt(
                    data / "msu_tail_fish" / f"Amp{amplitude}Bias{bias}" / f"STATES{number}.txt"
                )
                frequency, phase = beat(rows[:, 0], rows[:, 3])
                runs.append(
                    FishRun(f"a{amplitude}b{bias:+d}-{number}", amplitude, bias, frequency, phase, rows)
                )
    return runs


def mild(runs: list[FishRun]) -> list[FishRun]:
    """Runs that go straight or turn gently."""
    return [r for r in runs if abs(r.bias_deg) <= MILD_DEG]


def beat(time_s: Array, yaw_rate: Array) -> tuple[float, float]:
    """Frequency and phase of a beat: least squares of a cubic trend and two harmonics.

    Parameters
    ----------
    time_s, yaw_rate : ndarray, shape (n,)

    Returns
    -------
    frequency : float, Hz
    phase : float, rad
        The first harmonic is ``sin(2 pi f t + phase)``.
    """
    trend = np.vander((time_s - time_s[0]) / (time_s[-1] - time_s[0]), 4)

    def solve(frequency: float) -> tuple[float, Array]:
        angle = 2 * np.pi * frequency * time_s
        waves = [np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
        design = np.column_stack([trend, *waves])
        weights, *_ = np.linalg.lstsq(design, yaw_rate, rcond=None)
        return float(np.sum((yaw_rate - design @ weights) ** 2)), weights

    best = float(min(BEATS_HZ, key=lambda f: solve(f)[0]))
    weights = solve(best)[1]
    return best, float(np.arctan2(weights[4], weights[5]))


def write_fish(
    folder: Path, runs: list[FishRun], robot: Path, *, lag_rad: float, rates_only: bool = False
) -> Path:
    """Logs and trials file of the fish.

    When the tail passed its middle is not recorded. Each log's clock is therefore shifted, so that
    the tail beats as ``sin(2 pi f t)`` if it is ``lag_rad`` ahead of the yaw rate: what is left of
    the phase is the fit's ``drive_phase``.

    Parameters
    ----------
    folder : path
    runs : list of FishRun
    robot : path
        The robot file, named in the trials file.
    lag_rad : float
    rates_only : bool
        Surge and yaw rate alone: what the recordings tell wherever on the fish the marker sits.

    Returns
    -------
    Path
        The trials file.
    """
    lines = []
    for run in runs:
        time = run.rows[:, 0] + (run.phase_rad + lag_rad) / (2 * np.pi * run.frequency_hz)
        # by whole beats to after the start of the drive
        time = time - np.floor(time[0] * run.frequency_hz) / run.frequency_hz
        columns = {
            "t_s": time,
            "x_m": run.rows[:, 5],
            "y_m": run.rows[:, 6],
            "yaw_rad": np.unwrap(run.rows[:, 4]),
            "u_m_s": run.rows[:, 1],
            "v_m_s": run.rows[:, 2],
            "yaw_rate_rad_s": run.rows[:, 3],
        }
        kept = ("t_s", "u_m_s", "yaw_rate_rad_s") if rates_only else tuple(columns)
        write_log(folder / f"{run.name}.csv", {name: columns[name] for name in kept})
        role = "validate" if run.amplitude_deg == HELD_OUT_DEG else "fit"
        drive = (
            f"frequency_hz: {run.frequency_hz:.4f}, amplitude_deg: {run.amplitude_deg}, "
            f"bias_deg: {run.bias_deg}, ramp_s: 0"
        )
        lines.append(f"id: {run.name}, log: {run.name}.csv, role: {role}, drive: {{{drive}}}")
    return write_trials(folder / "trials.yaml", "free-swim", robot, lines)


@dataclass(frozen=True)
class Swing:
    """One window of a pendulum's record.

    Attributes
    ----------
    role : str
        ``fit`` or ``validate``.
    rows : ndarray, shape (n, 1 + arms)
        Time and joint angles: zero hanging, the second against the first arm.
    rates : ndarray, shape (arms,)
        Joint rates at the first row.
    """

    name: str
    role: str
    rows: Array
    rates: Array


def read_pendulum(data: Path, arms: int, *, every: int = EVERY) -> tuple[list[Swing], Array]:
    """Windows of the single or double pendulum, and the published parameters.

    The record's angles are absolute, zero upright.

    Parameters
    ----------
    data : path
        The folder of real recordings.
    arms : int
        1 or 2.
    every : int
        Keep every so many-th sample.

    Returns
    -------
    windows : list of Swing
    published : ndarray
        ``a1, m1, I1, k1, g`` or ``m1, m2, a1, a2, L1, I1, I2, k1, k2, g``, SI.
    """
    word = {1: "Single", 2: "Double"}[arms]
    folder = data / "multiarm_pendulum"
    record = loadmat(folder / f"{word}PendulumDataForParameterEstimation.mat")
    published = loadmat(folder / f"EstimatedParameters_{word}Pendulum.mat")["EstimatedParameters"].ravel()
    step = float(record["dt"][0, 0])
    windows = []
    for key, role in (("Y_id", "fit"), ("Y_vad", "validate")):
        for number, values in enumerate(record[key].ravel()):
            angles, rates = values[:arms].copy(), values[arms:]
            angles[0] -= np.pi
            joints = np.vstack([angles[:1], np.diff(values[:arms], axis=0)])[:, ::every]
            first = np.concatenate([rates[:1, 0], np.diff(rates[:, 0])])
            time = step * every * np.arange(joints.shape[1])
            windows.append(Swing(f"{role}{number:02d}", role, np.column_stack([time, *joints]), first))
    return windows, published


def write_pendulum(folder: Path, windows: list[Swing], robot: Path) -> Path:
    """Logs and trials file of a pendulum.

    Returns
    -------
    Path
        The trials file.
    """
    lines = []
    for window in windows:
        names = ["t_s", *(f"joint{k}_rad" for k in range(1, window.rows.shape[1]))]
        write_log(folder / f"{window.name}.csv", dict(zip(names, window.rows.T, strict=True)))
        lines.append(f"id: {window.name}, log: {window.name}.csv, role: {window.role}")
    return write_trials(folder / "trials.yaml", "multibody", robot, lines)


#: Scale of the KVLCC2's model, and time between the rows of its files in full scale, s. Their time stamps
#: have three digits only.
SHIP_SCALE, SHIP_STEP_S = 45.7, 0.135264
#: Zig-zags of the KVLCC2: name of the trial, and its rudder and heading angle.
ZIGZAGS = {"p20": "20", "s20": "-20", "p10": "10", "s10": "-10"}
#: Every so many rows of its files are kept: 10 Hz in the time of the model.
SHIP_EVERY = 5


def read_zigzag(path: Path) -> dict[str, Array]:
    """Read a zig-zag of the KVLCC2 by MARIN in the units of the model, with y to port.

    The files have y to starboard and full scale. A positive rudder angle turns the ship to port. The
    velocities are those along the axes of the world: their integrals are the positions within 1.4 m of 780 m.
    They are turned into the axes of the ship here. The positions have three digits, and are left out.
    """
    lines = path.read_text(encoding="latin-1").splitlines()[3:]
    rows = np.array([line.split() for line in lines if len(line.split()) == 11], dtype=float)[::SHIP_EVERY]
    _, _, _, _, yaw, ahead, starboard, _, rate, rudder, rpm = rows.T
    yaw, slow = np.radians(yaw), np.sqrt(SHIP_SCALE)
    return {
        "t_s": SHIP_EVERY * SHIP_STEP_S / slow * np.arange(len(rows)),
        "yaw_rad": -yaw,
        "u_m_s": (np.cos(yaw) * ahead + np.sin(yaw) * starboard) / slow,
        "v_m_s": (np.sin(yaw) * ahead - np.cos(yaw) * starboard) / slow,
        "yaw_rate_rad_s": -np.radians(rate) * slow,
        "rudder_rad": np.radians(rudder),
        "screw_rate_1_s": rpm / 60.0 * slow,
    }


def write_zigzags(folder: Path, data: Path, *, held_out: Collection[str] = ("p10", "s20")) -> Path:
    """Write logs of the KVLCC2's zig-zags, and a trials file that holds some of them out.

    By default the fit has one side of each angle, and the other sides are held out.
    """
    for name, angle in ZIGZAGS.items():
        write_log(
            folder / f"{name}.csv",
            read_zigzag(data / "kvlcc2_zigzag" / f"MARIN_FREE_KVLCC2_zz_{angle}_m.dat"),
        )
    robot = Path(__file__).parents[2] / "docs" / "examples" / "kvlcc2.yaml"
    entries = [f"log: {name}.csv" + ", role: validate" * (name in held_out) for name in ZIGZAGS]
    return write_trials(folder / "trials.yaml", "free-swim", os.path.relpath(robot, folder), entries)


def main(data: Path, folder: Path) -> None:
    """Write the logs, robots and trials files of all recordings below a folder."""
    examples = Path(__file__).parents[2] / "docs" / "examples"
    for name in ("fish", "pendulum"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    robot = os.path.relpath(examples / "msu-fish.yaml", folder / "fish")
    print(write_fish(folder / "fish", read_fish(data), Path(robot), lag_rad=LAG_RAD))
    (folder / "rates").mkdir(parents=True, exist_ok=True)
    print(write_fish(folder / "rates", mild(read_fish(data)), Path(robot), lag_rad=LAG_RAD, rates_only=True))
    robot = os.path.relpath(examples / "double-pendulum.yaml", folder / "pendulum")
    print(write_pendulum(folder / "pendulum", read_pendulum(data, 2)[0], Path(robot)))
    if (data / "kvlcc2_zigzag").is_dir():
        (folder / "ship").mkdir(parents=True, exist_ok=True)
        print(write_zigzags(folder / "ship", data))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
