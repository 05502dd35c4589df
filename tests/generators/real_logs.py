"""Recordings made by others, as swimid logs with a trials file.

The tail-actuated fish of Michigan State University (DerivativeBasedKoopman, MIT licence), the single
and double pendulum of MultiArm-Pendulum (dynamicslab, MIT licence), the roll decay of a ship model and
of a simulator without viscosity (10.17632/2stvkyngj9.1, MIT licence), a drive with a screw (EMPS,
forgi86/sysid-neural-continuous, Apache 2.0 licence), two tanks in a cascade
(forgi86/sysid-neural-structures-fitting, MIT licence), and a block on a ramp, from tracked films
(PhysTrack, GPL 2 licence).
As a program it writes all of them, the ramp where its films are tracked:
``python -m tests.generators.real_logs DATA FOLDER``.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

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
    lines = ["format: swimid-trials/1", "experiment: free-swim", f"robot: {robot}", "trials:"]
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
        _write(folder / f"{run.name}.csv", {name: columns[name] for name in kept})
        role = "validate" if run.amplitude_deg == HELD_OUT_DEG else "fit"
        drive = (
            f"frequency_hz: {run.frequency_hz:.4f}, amplitude_deg: {run.amplitude_deg}, "
            f"bias_deg: {run.bias_deg}, ramp_s: 0"
        )
        lines.append(f"  - {{id: {run.name}, log: {run.name}.csv, role: {role}, drive: {{{drive}}}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    return folder / "trials.yaml"


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
    lines = ["format: swimid-trials/1", "experiment: multibody", f"robot: {robot}", "trials:"]
    for window in windows:
        arms = window.rows.shape[1] - 1
        np.savetxt(
            folder / f"{window.name}.csv",
            window.rows,
            delimiter=",",
            header=",".join(["t_s", *(f"joint{k + 1}_rad" for k in range(arms))]),
            comments="",
        )
        lines.append(f"  - {{id: {window.name}, log: {window.name}.csv, role: {window.role}}}")
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    return folder / "trials.yaml"


#: A model that rolls: nothing about the ship is known but what its decay tells.
SHIP = """
format: swimid-robot/1
name: ship
"""


def write_roll(folder: Path, data: Path) -> tuple[Path, Path]:
    """Roll decay of a ship model: trials files of the simulator's and the basin's record.

    Both are cut to some 24 swings from 10 degrees on, and to 20 or 25 samples a second.

    Returns
    -------
    simulated, measured : Path
        The trials files.
    """
    (folder / "ship.yaml").write_text(SHIP)
    source = data / "kvlcc2_rolldecay"
    files = []
    for name, record, every in (
        ("simulator", "fnpf_kvlcc2_rolldecay_0kn.csv", 2),
        ("basin", "model_test_21337.csv", 5),
    ):
        with (source / record).open() as stream:
            header = stream.readline().strip().split(",")
        rows = np.loadtxt(source / record, delimiter=",", skiprows=1)
        time = rows[:, 0]
        roll = rows[:, header.index("phi")]
        begin = int(np.argmax(np.abs(roll)))
        use = slice(begin, begin + int(np.searchsorted(time[begin:] - time[begin], 62.0)), every)
        _write(folder / f"{name}.csv", {"t_s": time[use], "roll_rad": roll[use]})
        files.append(_trials(folder / f"{name}.yaml", "free-decay", "ship.yaml", [f"log: {name}.csv"]))
    return files[0], files[1]


#: The carriage moves as one mass; its drive turns along, which makes up the rest.
CARRIAGE = """
format: swimid-robot/1
name: carriage
body: {inertial_mass_kg: 60}
"""


def read_screw_drive(data: Path) -> tuple[Array, Array, Array]:
    """The electro-mechanical positioning system at 1 kHz.

    Returns
    -------
    time, position, force : ndarray, shape (n,)
        s, m and N; the force is the drive's voltage times its stated gain.
    """
    record = loadmat(data / "emps" / "DATA_EMPS.mat")
    force = record["gtau"].item() * record["vir"].ravel()
    return record["t"].ravel(), record["qm"].ravel(), force


def smoothed(values: Array, *, cutoff_hz: float = 20.0, rate_hz: float = 1000.0) -> Array:
    """Low-passed without delay (Butterworth, fourth order, forwards and backwards)."""
    return np.asarray(filtfilt(*butter(4, 2 * cutoff_hz / rate_hz), values))


def write_screw_drive(folder: Path, data: Path, *, every: int = 20) -> Path:
    """Log and trials file of the positioning system, position and force low-passed alike."""
    (folder / "carriage.yaml").write_text(CARRIAGE)
    time, position, force = read_screw_drive(data)
    rows = {"t_s": time, "x_m": smoothed(position), "force_N": smoothed(force)}
    _write(folder / "drive.csv", {name: values[::every] for name, values in rows.items()})
    return _trials(folder / "drive.yaml", "towed", "carriage.yaml", ["log: drive.csv"])


def write_tanks(folder: Path, data: Path) -> Path:
    """Logs of the two cascaded tanks (pump voltage, level), and a trials file of both records."""
    rows = np.genfromtxt(data / "cascaded_tanks" / "dataBenchmark.csv", delimiter=",", skip_header=1)
    (folder / "tanks.yaml").write_text("format: swimid-robot/1\nname: tanks\n")
    for name, u, y in (("estimation", 0, 2), ("validation", 1, 3)):
        _write(folder / f"{name}.csv", {"t_s": 4.0 * np.arange(len(rows)), "u": rows[:, u], "y": rows[:, y]})
    entries = ["log: estimation.csv", "log: validation.csv"]
    return _trials(folder / "levels.yaml", "arma", "tanks.yaml", entries)


#: No length is known in the films: this many pixels are called a metre.
RAMP_PX_M = 700.0
#: A block of one kilogram in air; only ratios to its mass tell.
BLOCK = """
format: swimid-robot/1
name: block
fluid: {density_kg_m3: 1.2, gravity_m_s2: 9.81}
body: {inertial_mass_kg: 1.0}
"""


def write_ramp(folder: Path, tracked: dict[str, Path]) -> Path:
    """Logs and trials file of a block that slides down ramps, from tracked films.

    The slope is that of the track in the picture; the weight along it drives the block.

    Parameters
    ----------
    tracked : dict of name to Path
        Tracked logs with columns ``t_s``, ``found``, ``x_px``, ``y_px``.
    """
    (folder / "block.yaml").write_text(BLOCK)
    entries = []
    for name, path in tracked.items():
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        rows = np.genfromtxt(lines, delimiter=",", names=True)
        seen = rows["found"] == 1
        start = rows["x_px"][seen][0]
        sliding = np.flatnonzero(seen & (np.abs(rows["x_px"] - start) > 8) & (rows["x_px"] > 30))
        part = slice(sliding[0], sliding[-1] + 1)
        place = np.column_stack([rows["x_px"][part], rows["y_px"][part]])
        there = np.isfinite(place).all(axis=1)
        along = np.linalg.svd(place[there] - place[there].mean(axis=0), full_matrices=False)[2][0]
        along *= np.sign(place[there][-1] - place[there][0]) @ along or 1.0
        along /= np.linalg.norm(along)
        distance = (place - place[there][0]) @ along / RAMP_PX_M
        time = rows["t_s"][part] - rows["t_s"][part][0]
        _write(folder / f"{name}.csv", {"t_s": time, "x_m": distance})
        push = 9.81 * abs(along[1])
        entries.append(f"log: {name}.csv, driving_force_N: {push:.4f}")
    return _trials(folder / "ramps.yaml", "falling-weight", "block.yaml", entries)


def _write(path: Path, columns: dict[str, Array]) -> None:
    header = ",".join(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=header, comments="")


def _trials(path: Path, experiment: str, robot: str, entries: list[str]) -> Path:
    lines = ["format: swimid-trials/1", f"experiment: {experiment}", f"robot: {robot}", "trials:"]
    path.write_text("\n".join([*lines, *(f"  - {{{entry}}}" for entry in entries)]) + "\n")
    return path


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
    more = {
        "roll": write_roll,
        "drive": write_screw_drive,
        "tanks": write_tanks,
    }
    for name, write in more.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        print(write(folder / name, data))
    (folder / "ramp").mkdir(parents=True, exist_ok=True)
    tracked = {name: folder / "ramp" / f"{name}-px.csv" for name in ("R1", "R3")}
    if all(path.is_file() for path in tracked.values()):
        print(write_ramp(folder / "ramp", tracked))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
