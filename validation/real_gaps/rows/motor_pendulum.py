"""Pendulum on a quasi-direct drive with encoder and measured torque: swing-ups with 0.5 kg and with 1 kg."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_pendulum, write_trials

REPOSITORY = "dfki-ric-underactuated-lab/torque_limited_simple_pendulum"
COMMIT = "ed17ea2d32a35ad944944ca03ef57693e2986732"
STEP_S = 0.01
#: Windows of the recordings below `results/control_method_...` before the pendulum is balanced: name, begin
#: and end in s, and role.
HALF_KG = (
    ("energy_shaping/data_measured", 0.2, 2.0, "fit"),
    ("energy_shaping/data_measured", 2.0, 3.8, "validate"),
    ("direct_collocation/data_measured", 0.05, 1.7, "fit"),
    ("direct_collocation/data_measured", 1.7, 3.4, "fit"),
    ("sac/data_measured", 0.3, 2.6, "fit"),
    ("ilqr/data_measured", 0.2, 2.2, "fit"),
)
ONE_KG = (
    ("energy_shaping/data_measured_1kg", 0.3, 2.1, "fit"),
    ("energy_shaping/data_measured_1kg", 2.1, 3.9, "fit"),
    ("energy_shaping/data_measured_1kg", 3.9, 5.7, "validate"),
    ("energy_shaping/data_measured_1kg", 5.7, 7.5, "fit"),
)
ROD_M = 0.5


def write_robot(path: Path, friction: str | float) -> None:
    """Robot file of a mass at the end of a light rod."""
    coefficients = {
        "m": {"value": 0.6, "unit": "kg", "bounds": [0.1, 3], "meaning": "mass at the end of the rod"},
        "k": {"value": 0.1, "unit": "N m s/rad", "bounds": [0, 1], "meaning": "damping of the drive"},
        "f": {"value": 0.1, "unit": "N m", "bounds": [0, 1], "meaning": "dry friction of the drive"},
    }
    if not isinstance(friction, str):
        del coefficients["f"]
    rod = {"length_m": ROD_M, "mass_kg": "m", "com_m": ROD_M, "inertia_kg_m2": 2e-3}
    passive = {"damping_N_m_s_rad": "k", "friction_N_m": friction}
    hinge = {"at_m": 0.0, "passive": passive, "torque": {"input": "motor", "gain_N_m": 1.0}}
    motor = {"column": "torque_N_m", "measured": True}
    write_pendulum(path, coefficients, [rod], [hinge], motor=motor)


def write(sources: Sources, folder: Path) -> None:
    """Robot files with and without dry friction, logs and trials files; every start is estimated."""
    write_robot(folder / "pendulum.yaml", "f")
    write_robot(folder / "frictionless.yaml", 0.0)
    for name, windows in (("half", HALF_KG), ("one", ONE_KG)):
        trials = []
        for number, (record, begin, end, role) in enumerate(windows):
            path = sources.repository(REPOSITORY, COMMIT, f"results/control_method_{record}.csv")
            rows = np.loadtxt(path, delimiter=",", skiprows=1)
            time = np.arange(begin, end, STEP_S)
            columns = {"t_s": time - begin}
            for label, column in (("joint1_rad", 1), ("torque_N_m", 3)):
                columns[label] = np.interp(time, rows[:, 0], rows[:, column])
            write_log(folder / f"{name}{number}.csv", columns)
            trials.append({"log": f"{name}{number}.csv", "role": role, "start_state": "estimate"})
        write_trials(folder / f"{name}.yaml", "multibody", "pendulum.yaml", trials)
    # the same trials with the robot that has no dry friction
    text = (folder / "half.yaml").read_text().replace("pendulum.yaml", "frictionless.yaml")
    (folder / "half-frictionless.yaml").write_text(text)


COMMON = {"source": f"{REPOSITORY} @{COMMIT[:8]}", "licence": "BSD 3"}
ROWS = (
    Row(
        name="pendulum-mass",
        model="motor pendulum with 0.5 kg",
        lacks="another 0.5 kg",
        steps=(
            write,
            "fit-graybox half.yaml -o half_params.yaml",
            "diagnose one.yaml --params half_params.yaml -o gap.yaml",
        ),
        causes=frozenset({"parameter:m"}),
        known=Known(0.5, "kg", "names of the recordings", size_of("m")),
        **COMMON,
    ),
    Row(
        name="pendulum-friction",
        model="motor pendulum, viscous friction only",
        lacks="dry friction of the drive",
        steps=(
            write,
            "fit-graybox half-frictionless.yaml -o viscous.yaml",
            "diagnose half-frictionless.yaml --params viscous.yaml -o gap.yaml",
        ),
        causes=frozenset({"joint-damping", "stribeck", "joint-friction"}),
        known=Known(0.1839, "N m", "identified by the authors", size_of("friction_N_m", "dry_N_m")),
        **COMMON,
    ),
)
