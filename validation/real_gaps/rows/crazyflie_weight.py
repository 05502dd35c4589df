"""Quadcopter that flies alone, and with two bolts taped to it: height, motor commands and battery voltage.

The mass of the bolts is not stated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps import quadcopter
from validation.real_gaps.row import Array, Row, Sources, write_trials, write_yaml

REPOSITORY, COMMIT = "AerialRoboticsUUST/CrazyPAD", "5448265fa1bbb3ce983a73a9336cc6e887886360"
#: Flights by trials file: fitted logs and the log that is held out.
FLIGHTS = {
    "normal": ("normal_flight", ("E8_log00", "E8_log01", "E8_log02"), "E8_log03"),
    "bolts": ("add_weight_W1_near_M3_M4", ("E8_log00", "E8_log01"), "E8_log02"),
}
#: Crazyflie 2.1 with battery, positioning deck and SD card deck, kg; only the ratio to the thrust matters.
MASS_KG = 0.034
#: Begin of the windows of each flight at constant height, and their duration, s.
BEGINS_S, SPAN_S = (6.0, 8.0, 20.0, 22.0), 1.5
STEP_S = 0.02
#: Full scale of the motor command, and the battery voltage in mV, at which the lift of a motor is 1.
FULL, VOLTAGE_MV = 65535, 3700
TURN = np.pi / 180


def read_flight(path: Path) -> tuple[Array, Array, Array]:
    """Time (s), height (m) as the quadcopter estimates it, and the sum of the squared motor voltages."""
    state = quadcopter.read_log(path)["fixedFrequency"]
    times = 1e-3 * (state["timestamp"] - state["timestamp"][0])
    voltage = state["pm.vbatMV"] / VOLTAGE_MV
    squared = np.sum([(state[f"pwm.m{k}_pwm"] / FULL * voltage) ** 2 for k in (1, 2, 3, 4)], axis=0)
    squared *= np.cos(TURN * state["stateEstimate.roll"])
    time = np.arange(0.0, times[-1], STEP_S)
    mean = np.convolve(squared, np.full(3, 1 / 3), "same")
    return time, np.interp(time, times, state["stateEstimate.z"]), np.interp(time, times, mean)


def write(sources: Sources, folder: Path) -> None:
    """Robot file, logs and trials files; every start is estimated."""
    write_yaml(folder / "quadcopter.yaml", quadcopter.robot(MASS_KG))
    for name, (place, fitted, held_out) in FLIGHTS.items():
        trials = []
        for flight in (*fitted, held_out):
            path = sources.repository(REPOSITORY, COMMIT, f"data/motor_data/{place}/{flight}")
            time, height, lift = read_flight(path)
            for index, begin in enumerate(BEGINS_S):
                log = f"{name}{flight[-2:]}-{index}.csv"
                quadcopter.write_window(folder / log, time, height, lift, begin, SPAN_S)
                role = "validate" if flight == held_out else "fit"
                trials.append({"log": log, "role": role, "start_state": "estimate"})
        write_trials(folder / f"{name}.yaml", "multibody", "quadcopter.yaml", trials)


ROWS = (
    Row(
        name="quadcopter-bolts",
        model="quadcopter without load",
        lacks="two bolts",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="MIT",
        steps=(
            write,
            "fit-graybox normal.yaml -o thrust.yaml",
            "diagnose bolts.yaml --params thrust.yaml -o gap.yaml",
        ),
        causes=quadcopter.HEAVIER,
    ),
)
