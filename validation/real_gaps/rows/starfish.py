"""Tendon-driven soft limb in air and in water: contraction of the tendon and height of the tip.

A black box has no effect for water, so that `unexplained` is right.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Row, Sources, write_log, write_robot, write_trials

#: Recordings by log, with the same random motion of the tendon.
RECORDINGS = {"air": "data_airtest.csv", "water": "data_baseline.csv"}
#: The tendon moves from here on; the water's log is cut in two parts, one of which is held out, s.
BEGIN_S, END_S, STEP_S = 2.0, 36.0, 0.02
PARTS_S = ((0.0, 17.0, "fit"), (17.0, 34.0, "validate"))
#: Columns: time in ms, contraction, and heights of the first and the last marker in mm.
TIME, TENDON, FIRST, LAST = 0, 1, 3, 9


def write(sources: Sources, folder: Path) -> None:
    """Logs at 50 Hz of contraction and of the height of the tip above the base, in mm, and trials file."""
    write_robot(folder / "limb.yaml")
    for name, record in RECORDINGS.items():
        rows = np.genfromtxt(sources.recording(f"starfish/{record}"), delimiter=",", skip_header=1)
        rows = rows[np.isfinite(rows).all(axis=1)]
        time = np.arange(BEGIN_S, END_S, STEP_S)
        tendon = np.interp(time, 1e-3 * rows[:, TIME], rows[:, TENDON])
        tip = np.interp(time, 1e-3 * rows[:, TIME], rows[:, LAST] - rows[:, FIRST])
        columns = {"t_s": time - BEGIN_S, "u": tendon - tendon.mean(), "y": tip - tip.mean()}
        write_log(folder / f"{name}.csv", columns)
    trials = [
        {"id": f"part{k}", "log": "water.csv", "start_s": begin, "end_s": end, "role": role}
        for k, (begin, end, role) in enumerate(PARTS_S)
    ]
    write_trials(folder / "water.yaml", "arma", "limb.yaml", trials)


ROWS = (
    Row(
        name="starfish-water",
        model="linear model of a soft limb in air",
        lacks="water",
        source="mit-gfx/diff_pd_public",
        licence="MIT",
        steps=(
            write,
            "rwls air.csv --input u --output y --na 2 --nb 2 -o air.yaml",
            "diagnose water.yaml --params air.yaml -o gap.yaml",
        ),
        causes=frozenset(),
    ),
)
