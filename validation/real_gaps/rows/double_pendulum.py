"""Double pendulum on two quasi-direct drives, in recordings without friction compensation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_pendulum, write_trials

REPOSITORY = "dfki-ric-underactuated-lab/double_pendulum"
COMMIT = "1e8544e67f3da72a51ee52fbbb278e131ce2a43f"
FOLDER = "data/experiment_records/design_A.0/20220815/sys_id"
#: Windows: number of the recording, and begin in s; the last two are held out.
WINDOWS = (
    (0, 0.1),
    (0, 2.0),
    (1, 0.1),
    (2, 0.1),
    (2, 2.0),
    (12, 0.1),
    (12, 2.0),
    (13, 0.1),
    (1, 2.0),
    (3, 0.1),
)
HELD_OUT = 2
STEP_S, SPAN_S = 0.01, 1.5
#: Mass (kg), length (m), centre (m) and inertia about the hinge (kg m2) as the authors identified them.
ARMS = ((0.608, 0.3, 0.275, 0.05472), (0.630, 0.2, 0.166, 0.02522))


def write_robot(path: Path) -> None:
    """Robot file with inertias, centres and damping as coefficients, without dry friction."""
    coefficients, arms, hinges = {}, [], []
    for k, (mass, length, centre, about_hinge) in enumerate(ARMS, 1):
        inertia = round(about_hinge - mass * centre**2, 5)
        coefficients[f"r_{k}"] = {"value": centre, "unit": "m", "bounds": [0.05, 0.35]}
        coefficients[f"I_{k}"] = {"value": inertia, "unit": "kg m2", "bounds": [1e-4, 0.2]}
        coefficients[f"k_{k}"] = {"value": 0.02, "unit": "N m s/rad", "bounds": [0, 1]}
        arms.append({"length_m": length, "mass_kg": mass, "com_m": f"r_{k}", "inertia_kg_m2": f"I_{k}"})
        torque = {"input": f"motor{k}", "gain_N_m": 1.0}
        place = 0.0 if k == 1 else ARMS[0][1]
        hinges.append({"at_m": place, "passive": {"damping_N_m_s_rad": f"k_{k}"}, "torque": torque})
    inputs = {f"motor{k}": {"column": f"torque{k}_N_m", "measured": True} for k in (1, 2)}
    write_pendulum(path, coefficients, arms, hinges, **inputs)


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files. The drives follow the commanded torque up to their friction."""
    write_robot(folder / "arms.yaml")
    trials = []
    for index, (number, begin) in enumerate(WINDOWS):
        path = sources.repository(REPOSITORY, COMMIT, f"{FOLDER}/trajectory_{number:02d}.csv")
        with path.open() as stream:
            header = stream.readline().strip().split(",")
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        time = np.arange(begin, begin + SPAN_S, STEP_S)
        columns = {"t_s": time - begin}
        for k in (1, 2):
            for label, source in ((f"joint{k}_rad", f"pos_meas{k}"), (f"torque{k}_N_m", f"tau_con{k}")):
                columns[label] = np.interp(time, rows[:, 0], rows[:, header.index(source)])
        write_log(folder / f"swing{index}.csv", columns)
        role = "validate" if index >= len(WINDOWS) - HELD_OUT else "fit"
        trials.append({"log": f"swing{index}.csv", "role": role, "start_state": "estimate"})
    write_trials(folder / "swings.yaml", "multibody", "arms.yaml", trials)


COMMON = {"source": f"{REPOSITORY} @{COMMIT[:8]}", "licence": "BSD 3"}
ROWS = (
    Row(
        name="double-pendulum-friction",
        model="motor double pendulum, viscous friction only",
        lacks="dry friction of the drives",
        steps=(
            write,
            "fit-graybox swings.yaml -o viscous_params.yaml",
            "diagnose swings.yaml --params viscous_params.yaml -o gap.yaml",
        ),
        causes=frozenset({"joint-friction", "stribeck", "joint-damping"}),
        known=Known(0.093, "N m", "identified by the authors, first drive", size_of("friction_N_m")),
        **COMMON,
    ),
)
