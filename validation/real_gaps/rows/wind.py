"""Quadcopter that flies a figure of eight without wind and in front of a wall of fans (Neural-Fly)."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np

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

REPOSITORY, COMMIT = "aerorobotics/neural-fly", "0ed50246b1f1db194e8f0726749351636d3501bf"
FLIGHTS = {"calm": "nowind", "wind": "35wind"}
#: Begin of the windows and their duration, s. The last one is held out. A figure takes 12.6 s.
BEGINS_S, SPAN_S = (12.0, 18.0, 24.0, 30.0, 36.0), 6.0
#: Mass of the quadcopter, kg; only ratios to it show in the motion.
MASS_KG = 2.53


def read_columns(path: Path) -> dict[str, Array]:
    """Return the columns of a flight, each of shape (n, ...)."""
    csv.field_size_limit(sys.maxsize)
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return {
        name: np.array([json.loads(row[name]) for row in rows], float)
        for name in ("t", "p", "R", "T_sp", "hover_throttle")
    }


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files of the motion along x, the direction of the wind.

    The thrust is the weight times throttle over throttle in hover. The robot stays level, and the part of the
    thrust along x is its input. A constant force takes up a small tilt of the axes.
    """
    tilt = "constant force by a tilt of the axes"
    coefficients = {
        "d": {"value": 0.5, "unit": "N s/m", "bounds": [0, 20], "meaning": "linear drag"},
        "b": {"value": 0.1, "unit": "N", "bounds": [-10, 10], "meaning": tilt},
    }
    link = {"name": "frame", "mass_kg": MASS_KG, "com_m": [0, 0, 0], "inertia_kg_m2": [0.02, 0.02, 0.04]}
    multibody = {"base": "free", "coefficients": coefficients, "links": [link]}
    multibody["inputs"] = {"thrust": {"column": "push_N", "measured": True}}
    multibody["elements"] = [
        {"kind": "load", "link": "frame", "input": "thrust", "force_N": [1, 0, 0]},
        {"kind": "force", "link": "frame", "force_N": ["b", 0, 0]},
        {"kind": "drag", "link": "frame", "linear_N_s_m": ["d", "d", "d"]},
    ]
    write_robot(folder / "quadcopter.yaml", fluid=AIR, multibody=multibody)
    for name, condition in FLIGHTS.items():
        path = f"data/experiment/custom_figure8_baseline_{condition}.csv"
        flight = read_columns(sources.repository(REPOSITORY, COMMIT, path))
        thrust = MASS_KG * AIR["gravity_m_s2"] * flight["T_sp"][:, 0] / flight["hover_throttle"][:, 0]
        push = thrust * flight["R"][:, 0, 2]
        trials = []
        for index, begin in enumerate(BEGINS_S):
            use = (flight["t"] >= begin) & (flight["t"] < begin + SPAN_S)
            columns = {"t_s": flight["t"][use] - begin, "x_m": flight["p"][use, 0], "push_N": push[use]}
            write_log(folder / f"{name}{index}.csv", columns)
            role = "validate" if index == len(BEGINS_S) - 1 else "fit"
            trials.append({"log": f"{name}{index}.csv", "role": role, "start_state": "estimate"})
        write_trials(folder / f"{name}.yaml", "multibody", "quadcopter.yaml", trials)


ROWS = (
    Row(
        name="quadcopter-wind",
        model="quadcopter in calm air",
        lacks="wind",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="none",
        steps=(
            write,
            "fit-graybox calm.yaml -o calm_params.yaml",
            "diagnose wind.yaml --params calm_params.yaml -o gap.yaml",
        ),
        causes=frozenset({"current"}),
        known=Known(-4.2, "m/s", "README of the repository: 35 % of the fans", size_of("cx_m_s")),
    ),
)
