"""Quadcopter of 37 g, and of 44.4 g with a payload on a cable: height, and speeds of the four rotors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps import quadcopter
from validation.real_gaps.row import Array, Known, Row, Sources

REPOSITORY, COMMIT = "IMRCLab/crazyflie-data-collection", "4d777a5aef86ec45fb957f70dddb5b7fec2dfbe5"
#: Flights along a figure of eight, by trials file: folder, logs that are fitted and log that is held out.
FLIGHTS = {
    "bare": ("brushless_flights", ("00", "01", "02", "06", "07"), "08"),
    "payload": ("brushless_flights_payload", ("06", "07", "08", "11", "12"), "13"),
}
MASS_KG, PAYLOAD_MASS_KG = 0.037, 0.0444
#: Begin of the windows of each flight, s.
BEGINS_S = (1.0, 4.0)
#: Weights of the mean over 10 ms, the time between two poses.
MEAN = np.full(5, 0.2)
#: Unit of the sum of the squared speeds, 1/min^2.
SPEEDS = 1e9


def read_flight(path: Path) -> tuple[Array, Array, Array]:
    """Times (s) and heights (m) of the cameras' poses, and the upward share of the squared rotor speeds."""
    log = quadcopter.read_log(path)
    state, pose = log["fixedFrequency"], log["estPose"]
    start = state["timestamp"][0]
    squared = np.sum([state[f"rpm.m{k}"] ** 2 for k in (1, 2, 3, 4)], axis=0) / SPEEDS
    upward = 1 - 2 * (state["stateEstimate.qx"] ** 2 + state["stateEstimate.qy"] ** 2)
    lift = np.interp(pose["timestamp"], state["timestamp"], np.convolve(squared * upward, MEAN, "same"))
    return 1e-3 * (pose["timestamp"] - start), pose["locSrv.z"], lift


def write(sources: Sources, folder: Path) -> None:
    """Robot file, logs and trials files."""

    def read(place: str, flight: str) -> tuple[Array, Array, Array]:
        return read_flight(sources.repository(REPOSITORY, COMMIT, f"{place}/data/eckart{flight}"))

    quadcopter.write(folder, MASS_KG, FLIGHTS, BEGINS_S, read)


ROWS = (
    Row(
        name="quadcopter-payload",
        model="quadcopter of 37 g without payload",
        lacks="a payload on a cable",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="none",
        steps=(
            write,
            "fit-graybox bare.yaml -o thrust.yaml",
            "diagnose payload.yaml --params thrust.yaml -o gap.yaml",
        ),
        causes=quadcopter.HEAVIER,
        known=Known(
            PAYLOAD_MASS_KG - MASS_KG, "kg", "README of the repository", quadcopter.mass_reader(MASS_KG)
        ),
    ),
)
