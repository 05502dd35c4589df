"""Cascaded tanks: pump voltage and level, with an outflow as the root of the level, and an overflow."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Row, Sources, write_log, write_robot, write_trials

#: Columns of input and output of the two records.
RECORDS = {"estimation": (0, 2), "validation": (1, 3)}
STEP_S = 4.0


def write(sources: Sources, folder: Path) -> None:
    """Logs, and a trials file of both records."""
    path = sources.recording("cascaded_tanks/dataBenchmark.csv")
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    write_robot(folder / "tanks.yaml")
    for name, (u, y) in RECORDS.items():
        write_log(
            folder / f"{name}.csv",
            {"t_s": np.arange(0.0, STEP_S * len(rows), STEP_S), "u": rows[:, u], "y": rows[:, y]},
        )
    trials = [{"log": f"{name}.csv"} for name in RECORDS]
    write_trials(folder / "levels.yaml", "arma", "tanks.yaml", trials)


ROWS = (
    Row(
        name="tanks",
        model="two tanks, linear",
        lacks="an outflow as a root, and overflow",
        source="forgi86/sysid-neural-structures-fitting",
        licence="MIT",
        steps=(
            write,
            "rwls estimation.csv --input u --output y --na 2 --nb 2 -o arx.yaml",
            "diagnose levels.yaml --params arx.yaml -o gap.yaml",
        ),
        causes=frozenset(),
    ),
)
