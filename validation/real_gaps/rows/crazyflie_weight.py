"""Quadcopter that flies alone, and with two bolts taped to it: height, motor commands and battery voltage.

The mass of the bolts is not stated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps import quadcopter
from validation.real_gaps.row import Array, Row, Sources

REPOSITORY, COMMIT = "AerialRoboticsUUST/CrazyPAD", "5448265fa1bbb3ce983a73a9336cc6e887886360"
#: Flights by trials file: fitted logs and the log that is held out.
FLIGHTS = {
    "normal": ("normal_flight", ("E8_log00", "E8_log01", "E8_log02"), "E8_log03"),
    "bolts": ("add_weight_W1_near_M3_M4", ("E8_log00", "E8_log01"), "E8_log02"),
}
#: Crazyflie 2.1 with battery, positioning deck and SD card deck, kg; only the ratio to the thrust matters.
MASS_KG = 0.034
#: Begin of the windows of each flight at constant height, s.
BEGINS_S = (6.0, 8.0, 20.0, 22.0)
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
    """Robot file, logs and trials files."""

    def read(place: str, flight: str) -> tuple[Array, Array, Array]:
        return read_flight(sources.repository(REPOSITORY, COMMIT, f"data/motor_data/{place}/{flight}"))

    quadcopter.write(folder, MASS_KG, FLIGHTS, BEGINS_S, read)


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
