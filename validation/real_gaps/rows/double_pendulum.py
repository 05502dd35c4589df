"""Double pendulum on two quasi-direct drives, in recordings without friction compensation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_trials, write_yaml

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
#: Masses and lengths as identified by the authors (model 1.0).
MASSES_KG, LENGTHS_M, CENTRES_M, INERTIAS_KG_M2 = (
    (0.608, 0.630),
    (0.3, 0.2),
    (0.275, 0.166),
    (0.05472, 0.02522),
)


def robot() -> dict[str, object]:
    """Robot file with inertias, centres and damping as coefficients, without dry friction."""
    coefficients: dict[str, object] = {}
    block = {"length_m": 0.1, "mass_kg": 1.0, "com_m": 0.05, "inertia_kg_m2": 8e-4, "inertia_about": "com"}
    links: list[dict[str, object]] = [{"name": "block", **block}]
    joints: list[dict[str, object]] = []
    for k in (1, 2):
        mass, centre = MASSES_KG[k - 1], CENTRES_M[k - 1]
        inertia = round(INERTIAS_KG_M2[k - 1] - mass * centre**2, 5)
        coefficients[f"r_{k}"] = {"value": centre, "unit": "m", "bounds": [0.05, 0.35]}
        coefficients[f"I_{k}"] = {"value": inertia, "unit": "kg m2", "bounds": [1e-4, 0.2]}
        coefficients[f"k_{k}"] = {"value": 0.02, "unit": "N m s/rad", "bounds": [0, 1]}
        links.append(
            {
                "name": f"arm{k}",
                "length_m": LENGTHS_M[k - 1],
                "mass_kg": mass,
                "com_m": f"r_{k}",
                "inertia_kg_m2": f"I_{k}",
                "inertia_about": "com",
            }
        )
        passive = {"damping_N_m_s_rad": f"k_{k}"}
        parent, place = ("block", 0.0) if k == 1 else ("arm1", LENGTHS_M[0])
        hinge = {"name": f"hinge{k}", "parent": parent, "child": f"arm{k}", "at_m": place}
        joints.append({**hinge, "passive": passive, "torque": {"input": f"motor{k}", "gain_N_m": 1.0}})
    return {
        "format": "swimid-robot/1",
        "name": "arms",
        "fluid": {"density_kg_m3": 1.2, "gravity_m_s2": 9.81},
        "multilink": {
            "plane": "vertical",
            "base": "fixed",
            "heading_deg": 90,
            "coefficients": coefficients,
            "links": links,
            "inputs": {f"motor{k}": {"column": f"torque{k}_N_m", "measured": True} for k in (1, 2)},
            "joints": joints,
            "elements": [{"kind": "hydrostatics", "link": f"arm{k}"} for k in (1, 2)],
        },
    }


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files. The drives follow the commanded torque up to their friction."""
    write_yaml(folder / "arms.yaml", robot())
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
