"""Swims with a hidden cause of one's choice, made without swimid: what a diagnosis is to find."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.generators.marks import mark
from validation.blind import swim_actuation, swim_files, swimmers
from validation.blind.swim_case import Act, Trial
from validation.blind.swim_sensing import UP
from validation.blind.swimmers import Noise

#: Tracking noise: a camera's position and angle, a gyroscope.
PLACE_M, ANGLE_RAD, RATE_RAD_S = 0.0015, 0.008, 0.015
#: Frequency (Hz), amplitude (deg) and bias (deg) of the sample's trials; the first setting comes twice.
SETTINGS = ((1.0, 25, 0), (1.0, 25, 0), (1.0, 32, 10), (1.4, 20, -12), (1.4, 30, 0), (1.8, 25, 8))
#: What is hidden in the sample, how large, and where in the chain.
CAUSE, STAGE, SIZE = "servo-backlash", "actuation", 2.0
SEED = 20261122


def tracking(robot: str) -> Noise:
    """Noise of which a third of the variance is coloured."""
    up, angle, rate = UP[robot]
    total = {"x_m": PLACE_M, up: PLACE_M, angle: ANGLE_RAD, rate: RATE_RAD_S}
    white = {name: sd * np.sqrt(2.0 / 3.0) for name, sd in total.items()}
    return Noise(white, {name: sd * np.sqrt(1.0 / 3.0) for name, sd in total.items()}, 0.75)


def plan(
    robot: str,
    settings: Sequence[tuple[float, float, float]],
    duration_s: float,
    rate_hz: float,
    seed: int,
    scatter: float = 1.0,
) -> list[Trial]:
    """One trial of each setting, no two alike: amplitude, thrust, trim and clock scatter a little.

    ``scatter`` 0 leaves that out: nothing but the start differs between trials of one setting.
    """
    rng = np.random.default_rng(seed)
    trials = []
    for i, (frequency, amplitude, bias) in enumerate(settings):
        drive = {"frequency_hz": frequency, "amplitude_deg": amplitude}
        drive |= {"bias_deg": bias} if bias else {}
        turn = rng.uniform(-np.pi, np.pi) if robot == "tfish" else rng.uniform(-0.05, 0.05)
        start = (rng.uniform(-1.0, 1.0), rng.uniform(-0.5, 0.5), turn)
        trial = Trial(f"run{i + 1:02d}", i, robot, drive, duration_s, rate_hz, start, seed)
        trial.amplitude, trial.thrust = scatter * 0.005 * rng.normal(size=2)
        trial.trim = scatter * float(np.radians(0.2) * rng.normal())
        trial.late = scatter * float(0.002 * rng.normal())
        trials.append(trial)
    return trials


def write(
    folder: Path,
    robot: str,
    acts: Sequence[Act] = (),
    *,
    settings: Sequence[tuple[float, float, float]] = SETTINGS,
    duration_s: float = 10.0,
    rate_hz: float = 25.0,
    gyro: bool = False,
    seed: int = SEED,
    scatter: float = 1.0,
) -> None:
    """Trials file, one log of each setting, and ``params.yaml``: the coefficients as of another day.

    Parameters
    ----------
    robot : {"tfish", "dolphin"}
    acts : sequence of Act
        What is hidden.
    settings : sequence of (frequency in Hz, amplitude in deg, bias in deg)
    gyro : bool
        Whether the robot logs its turn rate.
    scatter : float
        Of what differs between trials by chance; see :func:`plan`.
    """
    rng = np.random.default_rng([seed, 1])
    trials, noise = plan(robot, settings, duration_s, rate_hz, seed, scatter), tracking(robot)
    coefficients = swimmers.truth(robot, rng)
    columns = ["x_m", *UP[robot][: 3 if gyro else 2]]
    logs = {}
    for trial in trials:
        for act in acts:
            if act.start is not None:
                act.start(trial, rng)
        clean, own = swimmers.swim(trial, coefficients, acts), trial.rng("noise")
        log = {"t_s": clean["t_s"]}
        log |= {name: clean[name] + noise.draw(name, len(clean["t_s"]), own) for name in columns}
        for act in acts:
            log = log if act.broken is None else act.broken(trial, log, log["t_s"])
        logs[trial.id] = log
    swim_files.write_case(Path(folder), robot, trials, logs)
    swim_files.write_prior(Path(folder) / "params.yaml", robot, coefficients, swimmers.FITTED[robot], rng)


def write_sample(folder: Path) -> None:
    """Six 10 s runs of a tendon fish with play between its servos and its joints."""
    write(folder, "tfish", [swim_actuation.servo_backlash(np.random.default_rng(SEED), SIZE, "tfish")])
    mark(folder)
