"""Electro-mechanical positioning system of Janot et al.: a carriage that a screw drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

from tests.real_gaps.row import Array, Known, Row, Sources, size_of, write_log, write_trials, write_yaml

#: The carriage moves as one mass; its drive turns along, which makes up the rest, kg.
MASS_KG = 60
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
    """Log and trials file, position and force low-passed alike."""
    body = {"inertial_mass_kg": MASS_KG}
    write_yaml(folder / "carriage.yaml", {"format": "swimid-robot/1", "name": "carriage", "body": body})
    time, position, force = read(sources.recording("emps/DATA_EMPS.mat"))
    rows = {"t_s": time, "x_m": smoothed(position), "force_N": smoothed(force)}
    write_log(folder / "drive.csv", {name: values[::EVERY] for name, values in rows.items()})
    write_trials(folder / "drive.yaml", "towed", "carriage.yaml", [{"log": "drive.csv"}])


ROWS = (
    Row(
        name="drive-friction",
        model="drive with a screw, viscous friction only",
        lacks="dry friction",
        source="forgi86/sysid-neural-continuous",
        licence="Apache 2.0",
        steps=(
            write,
            "fit-drag drive.yaml --fix quadratic_drag=0 --free linear_drag --free force_offset"
            " -o viscous.yaml",
            "diagnose drive.yaml --params viscous.yaml -o gap.yaml",
        ),
        causes=frozenset({"pulley-friction", "stribeck"}),
        known=Known(20.394, "N", "published by Janot et al. 2019", size_of("friction_N")),
    ),
)
