"""Body wave in ``swimid compare``: measured beside simulated, on motions whose wave is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import swimid as package
from swimid.logs import log as log_format
from swimid.results import evidence
from swimid.results.parameters import Estimate, ParameterFile
from swimid.simulation.compare import Comparison
from tests.generators import swimmer, three_link

Array = np.ndarray
BEAT_HZ, RATE_HZ, DURATION_S, COURSE = 1.2, 40.0, 20.0, 0.5
TURN = 2 * np.pi * BEAT_HZ
NOISE = {"x_m": 0.001, "y_m": 0.001, "yaw_rad": 0.003, "joint1_rad": 0.01, "joint2_rad": 0.01}
LENGTH_M = three_link.LINK_M
POSE, JOINTS = ("x_m", "y_m", "yaw_rad"), ("joint1_rad", "joint2_rad")


def _motion(time: Array, lag_deg: float = 70.0) -> dict[str, Array]:
    """Swim straight at 0.2 m/s: pose of the nose and both joint angles, a wave of equal amplitudes."""
    turn, step = TURN * time, 0.2 * time
    sway = 0.012 * np.sin(turn + 0.9)
    return {
        "x_m": step * np.cos(COURSE) - sway * np.sin(COURSE),
        "y_m": step * np.sin(COURSE) + sway * np.cos(COURSE),
        "yaw_rad": COURSE + 0.1 * np.sin(turn + 0.4),
        "joint1_rad": np.radians(25.0) * np.sin(turn),
        "joint2_rad": np.radians(25.0) * np.sin(turn - np.radians(lag_deg)),
    }


def _lateral(columns: dict[str, Array], course: float) -> Array:
    """Return the distance of nose, joints and tail to the left of a course, shape (4, n)."""
    found = [columns["y_m"] * np.cos(course) - columns["x_m"] * np.sin(course)]
    heading = columns["yaw_rad"] - course
    for joint in (0.0, columns["joint1_rad"], columns["joint2_rad"]):
        heading = heading + joint
        found.append(found[-1] - LENGTH_M * np.sin(heading))
    return np.array(found)


def _phasors(columns: dict[str, Array], course: float) -> Array:
    """Return amplitude and phase of the beat at each station: the Fourier integral over one period."""
    return 2 * (_lateral(columns, course) * np.exp(-1j * TURN * PERIOD)).mean(axis=1)


PERIOD = np.arange(4000) / 4000 / BEAT_HZ


def _compared(
    folder: Path, columns: dict[str, Array], noise: dict[str, float] = NOISE, drive: bool = True
) -> Comparison:
    """Write a trial of the three-link fish with noise, and compare it."""
    rng = np.random.default_rng(11)
    noisy = {
        name: values + noise.get(name, 0.0) * rng.normal(size=values.shape)
        for name, values in columns.items()
    }
    log_format.write(folder / "run.csv", noisy)
    three_link.robot(folder)
    entry = "{id: run, log: run.csv}"
    if drive:
        entry = f"{{id: run, log: run.csv, drive: {{frequency_hz: {BEAT_HZ}, amplitude_deg: 25}}}}"
    trials = folder / "trials.yaml"
    trials.write_text(
        f"format: swimid-trials/1\nexperiment: free-swim\nrobot: fish.yaml\ntrials:\n  - {entry}\n"
    )
    values = {n: Estimate(value=three_link.TRUTH[n], unit="1", status="fixed") for n in ("c_d", "c_f")}
    ParameterFile(model="multilink", robot="three-link", parameters=values).write(folder / "p.yaml")
    return package.compare(trials, params=folder / "p.yaml", output=folder / "c.yaml", refit_start=False)


def _record(columns: dict[str, Array], *names: str) -> dict[str, Array]:
    return {"t_s": np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ} | {n: columns[n] for n in names}


def _deviations(one: Any, truth: float, windows: int) -> float:
    """Return the error of a measured quantity in its standard errors."""
    half = (one.high - one.low) / 2
    return abs(one.measured - truth) / (half / stats.t.ppf(0.975, windows - 1) + 1e-12)


@pytest.mark.kernels
def test_the_measured_wave_is_the_true_one(tmp_path: Path) -> None:
    time = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    result = _compared(tmp_path, _record(_motion(time), *POSE, *JOINTS))
    (trial,) = result.file.trials
    wave = trial.wave
    assert wave is not None
    assert (wave.frame, wave.frequency_hz, wave.reference) == ("world", BEAT_HZ, "rear end")
    assert [s.name for s in wave.stations] == ["front end", "joint1", "joint2", "rear end"]
    assert [s.behind_m for s in wave.stations] == pytest.approx([0, 0.12, 0.24, 0.36])
    truth = _phasors(_motion(PERIOD), COURSE)
    for station, phasor in zip(wave.stations, truth, strict=True):
        lag = float(np.angle(truth[-1] / phasor))
        lag += 2 * np.pi * round((station.phase_rad.measured - lag) / (2 * np.pi))
        assert _deviations(station.amplitude_m, abs(phasor), wave.windows) < 3, station.name
        assert _deviations(station.phase_rad, lag, wave.windows) < 3, station.name
    # the evidence shows the numbers of the file
    shown = evidence.read(evidence.sidecar(tmp_path / "c.yaml"))
    table = next(t for t in shown.tables if t.id == "wave")
    assert len(table.rows) == 2 + 2 * 4
    figure = next(f for f in shown.figures if f.id == "wave")
    measured, simulated = figure.panels[0].traces
    assert measured.y == pytest.approx([1e3 * s.amplitude_m.measured for s in wave.stations])
    assert simulated.y == pytest.approx([1e3 * s.amplitude_m.simulated for s in wave.stations])
    assert measured.y_error is not None


@pytest.mark.kernels
def test_the_simulated_wave_is_that_of_an_independent_simulation(tmp_path: Path) -> None:
    """A fish that the model describes: each difference is within three standard errors."""
    fish = swimmer.eel(
        three_link.TRUTH,
        links=3,
        link_length_m=LENGTH_M,
        link_mass_kg=three_link.MASS_KG,
        height_m=three_link.HEIGHT_M,
        lag_deg=three_link.LAG_DEG,
    )
    drive = {"frequency_hz": BEAT_HZ, "amplitude_deg": 25.0}
    columns = swimmer.swim(fish, drive, DURATION_S, rate_hz=RATE_HZ, rtol=1e-6)
    result = _compared(tmp_path, {n: columns[n] for n in ("t_s", *POSE, *JOINTS)})
    wave = result.file.trials[0].wave
    assert wave is not None
    for station in wave.stations:
        for one in (station.amplitude_m, station.phase_rad):
            assert _deviations(one, one.simulated, wave.windows) < 3, station.name
            assert one.difference == pytest.approx(one.simulated - one.measured, abs=1e-12)
    size, true = wave.stations[-1].amplitude_m, _lateral(columns, 0.0)[-1]
    assert size.simulated == pytest.approx(np.sqrt(2) * true[columns["t_s"] > 4].std(), rel=0.05)


@pytest.mark.kernels
@pytest.mark.parametrize("lag_deg", [50.0, 95.0])
def test_a_known_lag_is_the_difference(lag_deg: float, tmp_path: Path) -> None:
    """The second joint of the robot file lags by 70 degrees, and that of the trial by another angle.

    Without the pose, the wave is relative to the base.
    """
    time = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    columns = _motion(time, lag_deg)
    record = _record(columns | {"u_m_s": np.full(len(time), 0.2)}, "u_m_s", *JOINTS)
    wave = _compared(tmp_path, record).file.trials[0].wave
    assert wave is not None
    assert wave.frame == "base"
    assert [s.name for s in wave.stations] == ["joint2", "rear end"]
    still = dict.fromkeys(POSE, np.zeros_like(PERIOD))
    trial, model = (_phasors(_motion(PERIOD, lag) | still, 0.0)[2:] for lag in (lag_deg, 70.0))
    (station, reference) = wave.stations
    assert reference.phase_rad.difference == 0
    known = float(np.angle(model[1] / model[0] * trial[0] / trial[1]))
    assert abs(known) > 0.09
    # the simulation has no noise, so that the error of the difference is that of the measurement
    phase = station.phase_rad
    assert _deviations(phase, phase.simulated - known, wave.windows) < 3
    assert phase.simulated == pytest.approx(float(np.angle(model[1] / model[0])), abs=0.002)
    assert reference.amplitude_m.simulated == pytest.approx(abs(model[1]), rel=0.002)


@pytest.mark.kernels
@pytest.mark.parametrize("case", ["no joints", "one joint", "short", "joints are the input"])
def test_no_wave(case: str, tmp_path: Path) -> None:
    """Without measured joints, without six cycles, or if joints drive the run and no pose is known."""
    time = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    columns = _motion(time) | {"u_m_s": np.full(len(time), 0.2)}
    names = {"no joints": POSE, "one joint": (*POSE, "joint1_rad"), "short": (*POSE, *JOINTS)}
    record = _record(columns, *names.get(case, ("u_m_s", *JOINTS)))
    if case == "short":
        record = {name: values[: int(5 * RATE_HZ)] for name, values in record.items()}
    result = _compared(tmp_path, record, drive=case != "joints are the input")
    assert result.file.trials[0].wave is None
    shown = evidence.read(evidence.sidecar(tmp_path / "c.yaml"))
    assert "wave" not in [t.id for t in shown.tables] + [f.id for f in shown.figures]


@pytest.mark.kernels
def test_joints_that_drive_the_run_are_compared_with_the_recoil(tmp_path: Path) -> None:
    time = np.arange(round(DURATION_S * RATE_HZ)) / RATE_HZ
    result = _compared(tmp_path, _record(_motion(time), *POSE, *JOINTS), drive=False)
    trial = result.file.trials[0]
    assert not set(JOINTS) & set(trial.channels)
    assert trial.wave is not None
    assert trial.wave.frame == "world"
    assert trial.wave.frequency_hz == pytest.approx(BEAT_HZ, rel=0.01)
