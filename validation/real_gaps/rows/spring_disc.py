"""Masses that swing on a spring, with a net and with a disc below them: the disc moves air along.

The disc is a CD of 12 cm, by the names of the recordings. Its diameter is not stated.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_robot, write_trials

REPOSITORY, COMMIT = "Mattia04/Smorzamento", "794f446870f50866e98f4d0ea32bcca1b39475e7"
#: Recordings on the spring without pretension, and the masses below it, g, as in the notebook of the authors.
RECORDINGS = {
    "net": ("Data/Oscillazioni non_pretensionata_rete_3e1masse.csv", (90.18, 50.63)),
    "disc": ("Data/Oscillazioni non_pretensionata_cd_3e1masse.csv", (94.72, 55.19)),
}
#: A third of the mass of the spring swings along, g.
SPRING_G = 15.43 / 3
RATE_HZ = 100.0
#: A decay begins at its first extreme; the swings of the first seconds are the largest, s.
SPAN_S = 18.0
#: Radius of a disc of 12 cm, and density of air.
RADIUS_M, AIR_KG_M3 = 0.06, 1.2


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files; each trial has its own mass."""
    fluid = {"density_kg_m3": AIR_KG_M3, "gravity_m_s2": 9.805}
    write_robot(folder / "spring.yaml", fluid=fluid, body={"inertial_mass_kg": 0.08})
    for name, (record, masses) in RECORDINGS.items():
        path = sources.repository(REPOSITORY, COMMIT, record)
        lines = path.read_text(encoding="utf-8-sig").replace(",", ".").splitlines()[1:]
        table = np.genfromtxt(lines, delimiter=";")
        trials = []
        for column, mass in enumerate(masses):
            position = 1e-3 * table[np.isfinite(table[:, column]), column]
            begin = int(np.argmax(np.abs(position[: int(RATE_HZ)])))
            position = position[begin : begin + int(SPAN_S * RATE_HZ)]
            log = f"{name}{column}.csv"
            write_log(folder / log, {"t_s": np.arange(len(position)) / RATE_HZ, "x_m": position})
            trials.append({"log": log, "inertial_mass_kg": round(1e-3 * (mass + SPRING_G), 6)})
        write_trials(folder / f"{name}.yaml", "free-decay", "spring.yaml", trials)


ROWS = (
    Row(
        name="spring-disc",
        model="mass on a spring with a net",
        lacks="the air that a disc moves along",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="none",
        steps=(
            write,
            "fit-drag net.yaml -o net_params.yaml",
            "diagnose disc.yaml --params net_params.yaml -o gap.yaml",
        ),
        causes=frozenset(
            {"added-mass", "parameter:added_mass", "quadratic-drag", "linear-drag"}
            | {"parameter:quadratic_drag", "parameter:linear_drag"}
        ),
        known=Known(
            8 / 3 * AIR_KG_M3 * RADIUS_M**3,
            "kg",
            "added mass of a thin disc of 12 cm in air, own calculation",
            size_of("added_mass", "added_kg", "mass_kg"),
        ),
    ),
)
