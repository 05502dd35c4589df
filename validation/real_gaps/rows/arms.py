"""Single and double pendulum that swing freely (MultiArm-Pendulum), modelled without friction."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_pendulum, write_trials

SOURCE = {"source": "dynamicslab/MultiArm-Pendulum", "licence": "MIT"}
#: Samples of a record at 1 kHz between two that are kept, and duration of a window, s.
EVERY, SPAN_S = 10, 2.5
#: Windows of the single pendulum: number of the record, and begin in s. The last is held out.
SINGLE = ((0, 0.0), (1, 3.0), (2, 0.0), (3, 3.0))
#: Records of the double pendulum, which are shorter than a window. The last is held out.
DOUBLE = ((0, 0.0), (3, 0.0), (6, 0.0), (9, 0.0), (12, 0.0), (15, 0.0))


def write_robot(path: Path, count: int, published: dict[str, float]) -> None:
    """Robot file without damping; only ratios to the published masses can be estimated."""
    coefficients, arms, hinges = {}, [], []
    for k in range(1, count + 1):
        inertia = round(published[f"I{k}"], 6)
        coefficients[f"I_{k}"] = {"value": inertia, "unit": "kg m2", "bounds": [1e-6, 0.01]}
        mass, centre = (round(published[f"{name}{k}"], 5) for name in "ma")
        arms.append({"length_m": 0.25, "mass_kg": mass, "com_m": centre, "inertia_kg_m2": f"I_{k}"})
        place = 0.0 if k == 1 else round(published["L1"], 5)
        hinges.append({"at_m": place, "passive": {"damping_N_m_s_rad": 0.0}})
    write_pendulum(path, coefficients, arms, hinges)


def write(arms: int, sources: Sources, folder: Path) -> None:
    """Robot file without damping, logs and trials file; every start is estimated.

    The angles of the record are absolute, zero upright.
    """
    word, names, windows = {
        1: ("Single", ("a1", "m1", "I1", "k1", "g"), SINGLE),
        2: ("Double", ("m1", "m2", "a1", "a2", "L1", "I1", "I2", "k1", "k2", "g"), DOUBLE),
    }[arms]
    place = sources.recording("multiarm_pendulum")
    values = loadmat(place / f"EstimatedParameters_{word}Pendulum.mat")["EstimatedParameters"].ravel()
    write_robot(folder / "arms.yaml", arms, dict(zip(names, map(float, values), strict=True)))
    record = loadmat(place / f"{word}PendulumDataForParameterEstimation.mat")
    step, trials = float(record["dt"][0, 0]), []
    for index, (number, begin) in enumerate(windows):
        angles = record["Y_id"].ravel()[number][:arms].copy()
        angles[0] -= np.pi
        joints = np.vstack([angles[:1], np.diff(record["Y_id"].ravel()[number][:arms], axis=0)])
        use = slice(round(begin / step), round((begin + SPAN_S) / step), EVERY)
        columns = {f"joint{k + 1}_rad": joints[k, use] for k in range(arms)}
        time = np.linspace(0.0, step * EVERY * (len(columns["joint1_rad"]) - 1), len(columns["joint1_rad"]))
        write_log(folder / f"swing{index}.csv", {"t_s": time, **columns})
        role = "validate" if index == len(windows) - 1 else "fit"
        trials.append({"log": f"swing{index}.csv", "role": role, "start_state": "estimate"})
    write_trials(folder / "trials.yaml", "multibody", "arms.yaml", trials)


STEPS = (
    "fit-graybox trials.yaml -o frictionless.yaml",
    "diagnose trials.yaml --params frictionless.yaml -o gap.yaml",
)
CAUSES = frozenset({"joint-damping"})
ROWS = (
    Row(
        name="single-arm-damping",
        model="pendulum without friction",
        lacks="the friction of its hinge",
        steps=(partial(write, 1), *STEPS),
        causes=CAUSES,
        known=Known(2.24e-4, "N m s/rad", "published parameters", size_of("damping_N_m_s_rad")),
        **SOURCE,
    ),
    Row(
        name="double-arm-damping",
        model="double pendulum without friction",
        lacks="the friction of its hinges",
        steps=(partial(write, 2), *STEPS),
        causes=CAUSES,
        known=Known(
            1.24e-4, "N m s/rad", "published parameters, mean of both hinges", size_of("damping_N_m_s_rad")
        ),
        **SOURCE,
    ),
)
