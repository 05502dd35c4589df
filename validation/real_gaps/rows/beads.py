"""Beads that fall in glycerol, in the middle of a vessel and close to its wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_robot, write_trials

REPOSITORY, COMMIT = "kyleyhw/PHY324_motion_in_fluids", "1f0af8edd894918a9f2bfe2f41e6664ce6924090"
#: Logs of one bead: in the middle, and by the wall in two parts.
MIDDLE = (
    "glycerolbead3tcenter",
    "glycerol/glycerolbead3t1",
    "glycerol/glycerolbead3t2",
    "glycerol/glycerolbead3t3",
)
HELD_OUT = "glycerol/glycerolbead3t3"
WALL, PARTS_S = "glycerolbead3tedge", ((0.0, 7.0), (7.0, 14.0))
#: The first centimetre, where the bead leaves the tweezers, and the end near the floor are left out.
BEGIN_MM, END_MM = 10.0, 160.0
#: Glass bead of 3.1 mm in glycerol. Only the ratio of weight to drag shows in the speed.
RADIUS_M, BEAD_KG_M3, GLYCEROL_KG_M3, GRAVITY_M_S2 = 1.55e-3, 2500.0, 1260.0, 9.81
VOLUME_M3 = 4 / 3 * np.pi * RADIUS_M**3
#: Speeds of the bead in the middle and by the wall, mm/s: straight lines through the two files of one minute.
MIDDLE_MM_S, WALL_MM_S = 12.12, 10.35


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files. The weight in glycerol pulls, and half the displaced mass moves along."""
    force = (BEAD_KG_M3 - GLYCEROL_KG_M3) * VOLUME_M3 * GRAVITY_M_S2
    fluid = {"density_kg_m3": GLYCEROL_KG_M3, "gravity_m_s2": GRAVITY_M_S2}
    body = {"inertial_mass_kg": float(f"{BEAD_KG_M3 * VOLUME_M3:.4g}")}
    write_robot(folder / "bead.yaml", fluid=fluid, body=body)
    pull = {"driving_force_N": float(f"{force:.5g}")}
    trials = []
    for name in (*MIDDLE, WALL):
        rows = np.loadtxt(sources.repository(REPOSITORY, COMMIT, f"data/{name}.txt"), skiprows=2)
        rows = rows[(rows[:, 1] > BEGIN_MM) & (rows[:, 1] < END_MM)]
        log = f"{Path(name).name}.csv"
        write_log(folder / log, {"t_s": rows[:, 0] - rows[0, 0], "x_m": 1e-3 * (rows[:, 1] - rows[0, 1])})
        if name != WALL:
            trials.append({"log": log, **pull, "role": "validate" if name == HELD_OUT else "fit"})
    write_trials(folder / "middle.yaml", "falling-weight", "bead.yaml", trials)
    write_trials(
        folder / "wall.yaml",
        "falling-weight",
        "bead.yaml",
        [
            {"id": f"part{k}", "log": f"{WALL}.csv", **pull, "start_s": begin, "end_s": end, "role": role}
            for k, ((begin, end), role) in enumerate(zip(PARTS_S, ("fit", "validate"), strict=True))
        ],
    )


#: Drag in the middle, N s/m.
DRAG_N_S_M = (BEAD_KG_M3 - GLYCEROL_KG_M3) * VOLUME_M3 * GRAVITY_M_S2 / (1e-3 * MIDDLE_MM_S)
ROWS = (
    Row(
        name="bead-wall",
        model="bead that sinks in the middle of a vessel",
        lacks="the wall",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="none",
        steps=(
            write,
            "fit-drag middle.yaml --fix quadratic_drag=0 --fix added_mass=9.8e-6 --free linear_drag"
            " --bounds linear_drag=1e-4,1 --start-state estimate -o middle_params.yaml",
            "diagnose wall.yaml --params middle_params.yaml -o gap.yaml",
        ),
        causes=frozenset({"parameter:linear_drag", "linear-drag", "wall"}),
        known=Known(
            DRAG_N_S_M * (MIDDLE_MM_S / WALL_MM_S - 1),
            "N s/m",
            "ratio of the two speeds",
            size_of("linear_drag", "linear_N_s_m"),
        ),
    ),
)
