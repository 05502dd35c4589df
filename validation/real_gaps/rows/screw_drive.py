"""Electro-mechanical positioning system of Janot et al.: a carriage that a screw drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

from validation.real_gaps.row import (
    AIR,
    Array,
    Known,
    Row,
    Sources,
    size_of,
    write_log,
    write_robot,
    write_trials,
)

#: The carriage moves as one mass; its drive turns along, which makes up the rest, kg.
MASS_KG = 60
#: Duration (s) and number of the trials. The position is integrated twice from the force, so that its errors
#: grow in time. One of three trials is held out.
SPAN_S, COUNT = 6.2, 4
RATE_HZ, CUTOFF_HZ, EVERY = 1000.0, 20.0, 20


def read(data: Path) -> tuple[Array, Array, Array]:
    """Time (s), position (m) and force (N) at 1 kHz; the force is the voltage times its stated gain."""
    record = loadmat(data)
    force = record["gtau"].item() * record["vir"].ravel()
    return record["t"].ravel(), record["qm"].ravel(), force


def smoothed(values: Array) -> Array:
    """Low-passed without delay (Butterworth, fourth order, forwards and backwards)."""
    return np.asarray(filtfilt(*butter(4, 2 * CUTOFF_HZ / RATE_HZ), values))


def write(sources: Sources, folder: Path) -> None:
    """Log and trials files of the whole record and of its parts; position and force are low-passed alike."""
    write_robot(folder / "carriage.yaml", fluid=AIR, body={"inertial_mass_kg": MASS_KG})
    time, position, force = read(sources.recording("emps/DATA_EMPS.mat"))
    rows = {"t_s": time, "x_m": smoothed(position), "force_N": smoothed(force)}
    write_log(folder / "drive.csv", {name: values[::EVERY] for name, values in rows.items()})
    trials = [
        {
            "id": f"part{k}",
            "log": "drive.csv",
            "start_s": round(SPAN_S * k, 1),
            "end_s": round(SPAN_S * (k + 1), 1),
            "role": "validate" if k % 3 == 2 else "fit",
        }
        for k in range(COUNT)
    ]
    write_trials(folder / "drive.yaml", "towed", "carriage.yaml", [{"log": "drive.csv"}])
    write_trials(folder / "parts.yaml", "towed", "carriage.yaml", trials)


ROWS = (
    Row(
        name="drive-friction",
        model="drive with a screw, viscous friction only",
        lacks="dry friction",
        source="forgi86/sysid-neural-continuous",
        licence="Apache 2.0",
        steps=(
            write,
            "fit-drag parts.yaml --fix quadratic_drag=0 --free linear_drag --free force_offset"
            " -o viscous.yaml",
            "diagnose parts.yaml --params viscous.yaml -o gap.yaml",
        ),
        causes=frozenset({"pulley-friction", "stribeck"}),
        known=Known(20.394, "N", "published by Janot et al. 2019", size_of("friction_N")),
    ),
)
