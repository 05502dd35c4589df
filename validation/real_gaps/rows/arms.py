"""Single and double pendulum that swing freely (MultiArm-Pendulum), modelled without friction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_trials, write_yaml

SOURCE = {"source": "dynamicslab/MultiArm-Pendulum", "licence": "MIT"}
#: Samples of a record at 1 kHz between two that are kept, and duration of a window, s.
EVERY, SPAN_S = 10, 2.5
#: Windows of the single pendulum: number of the record, and begin in s. The last is held out.
SINGLE = ((0, 0.0), (1, 3.0), (2, 0.0), (3, 3.0))
#: Records of the double pendulum, which are shorter than a window. The last is held out.
DOUBLE = ((0, 0.0), (3, 0.0), (6, 0.0), (9, 0.0), (12, 0.0), (15, 0.0))


def robot(arms: int, damping: float, published: dict[str, float]) -> dict[str, object]:
    """Robot file of arms that hang from a block; only ratios to the published masses can be estimated."""
    block = {"length_m": 0.1, "mass_kg": 1.0, "com_m": 0.05, "inertia_kg_m2": 8e-4, "inertia_about": "com"}
    links: list[dict[str, object]] = [{"name": "block", **block}]
    joints, coefficients, parent = [], {}, "block"
    for k in range(1, arms + 1):
        inertia = published[f"I{k}"]
        coefficients[f"I_{k}"] = {"value": round(inertia, 6), "unit": "kg m2", "bounds": [1e-6, 0.01]}
        links.append(
            {
                "name": f"arm{k}",
                "length_m": 0.25,
                "mass_kg": round(published[f"m{k}"], 5),
                "com_m": round(published[f"a{k}"], 5),
                "inertia_kg_m2": f"I_{k}",
                "inertia_about": "com",
            }
        )
        place = 0.0 if k == 1 else round(published["L1"], 5)
        hinge = {"name": f"hinge{k}", "parent": parent, "child": f"arm{k}", "at_m": place}
        joints.append({**hinge, "passive": {"damping_N_m_s_rad": damping}})
        parent = f"arm{k}"
    return {
        "format": "swimid-robot/1",
        "name": f"arms{arms}",
        "fluid": {"density_kg_m3": 1.2, "gravity_m_s2": 9.81},
        "multilink": {
            "plane": "vertical",
            "base": "fixed",
            "heading_deg": 90,
            "coefficients": coefficients,
            "links": links,
            "joints": joints,
            "elements": [{"kind": "hydrostatics", "link": f"arm{k}"} for k in range(1, arms + 1)],
        },
    }


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
    write_yaml(folder / "arms.yaml", robot(arms, 0.0, dict(zip(names, map(float, values), strict=True))))
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


def write_single(sources: Sources, folder: Path) -> None:
    """Write the single pendulum."""
    write(1, sources, folder)


def write_double(sources: Sources, folder: Path) -> None:
    """Write the double pendulum."""
    write(2, sources, folder)


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
        steps=(write_single, *STEPS),
        causes=CAUSES,
        known=Known(2.24e-4, "N m s/rad", "published parameters", size_of("damping_N_m_s_rad")),
        **SOURCE,
    ),
    Row(
        name="double-arm-damping",
        model="double pendulum without friction",
        lacks="the friction of its hinges",
        steps=(write_double, *STEPS),
        causes=CAUSES,
        known=Known(
            1.24e-4, "N m s/rad", "published parameters, mean of both hinges", size_of("damping_N_m_s_rad")
        ),
        **SOURCE,
    ),
)
