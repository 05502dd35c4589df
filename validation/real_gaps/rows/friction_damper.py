"""Band brake as a friction damper: a hydraulic actuator moves it as a sine, and the force is measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_robot, write_trials

REPOSITORY, COMMIT = (
    "ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash",
    "0e09aa9d950760277e31c08cd93fd01f39a5af09",
)
FILE = "data/dataset-2/characterization datasets/{}Hz{}lbtension{}amplitude.json"
#: Frequency (Hz) and amplitude (in) of the tests, and the one that is held out.
SETTINGS = ((0.25, 1), (0.5, 0.5), (0.5, 1), (0.5, 1.5), (1, 1))
HELD_OUT = (0.5, 0.5)
#: Tension of the band by trials file, lb.
TENSIONS = {"loose": 30, "tight": 36}
KIP_N, INCH_M = 4448.2216, 0.0254
EVERY = 20
#: Mass that the actuator moves, kg; it is not stated, and its inertia is small against the friction.
MASS_KG = 50.0
#: Friction at the two tensions: mean over both directions where the damper slides, kip.
LOOSE_KIP, TIGHT_KIP = 2.15, 3.65


def write(sources: Sources, folder: Path) -> None:
    """Robot, logs and trials files. The band resists, so the force on the body is that of the actuator."""
    write_robot(folder / "damper.yaml", body={"inertial_mass_kg": MASS_KG})
    for name, tension in TENSIONS.items():
        trials = []
        for number, (frequency, amplitude) in enumerate(SETTINGS):
            path = sources.repository(REPOSITORY, COMMIT, FILE.format(frequency, tension, amplitude))
            rows = np.array(json.loads(path.read_text())["data"])[::EVERY]
            columns = {
                "t_s": rows[:, 0] - rows[0, 0],
                "x_m": INCH_M * rows[:, 1],
                "force_N": KIP_N * rows[:, 2],
            }
            log = f"{name}{number}.csv"
            write_log(folder / log, columns)
            role = "validate" if (frequency, amplitude) == HELD_OUT else "fit"
            trials.append({"log": log, "role": role})
        write_trials(folder / f"{name}.yaml", "towed", "damper.yaml", trials)


ROWS = (
    Row(
        name="damper-tension",
        model="friction damper with a band under 30 lb",
        lacks="the friction of 6 lb more",
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="CC BY-SA 4.0",
        steps=(
            write,
            "fit-drag loose.yaml --fix quadratic_drag=0 --fix added_mass=0 --free dry_friction -o band.yaml",
            "diagnose tight.yaml --params band.yaml -o gap.yaml",
        ),
        causes=frozenset({"parameter:dry_friction", "pulley-friction"}),
        known=Known(
            round((TIGHT_KIP - LOOSE_KIP) * KIP_N),
            "N",
            "sliding friction in the force records, by hand",
            size_of("dry_friction", "friction_N"),
        ),
    ),
)
