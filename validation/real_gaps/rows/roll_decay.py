"""Roll decay of a tanker model in a basin, and of the same test in a simulator without viscosity."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Known, Row, Sources, size_of, write_log, write_robot, write_trials

#: Records, and the samples between two that are kept.
RECORDS = {"simulator": ("fnpf_kvlcc2_rolldecay_0kn.csv", 2), "basin": ("model_test_21337.csv", 5)}
#: Some 24 swings from 10 degrees on, s.
SPAN_S = 62.0


def write(sources: Sources, folder: Path) -> None:
    """Logs and trials files of the simulator's and the basin's record."""
    write_robot(folder / "ship.yaml")
    for name, (record, every) in RECORDS.items():
        path = sources.recording(f"kvlcc2_rolldecay/{record}")
        with path.open() as stream:
            header = stream.readline().strip().split(",")
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        time, roll = rows[:, 0], rows[:, header.index("phi")]
        begin = int(np.argmax(np.abs(roll)))
        use = slice(begin, begin + int(np.searchsorted(time[begin:] - time[begin], SPAN_S)), every)
        write_log(folder / f"{name}.csv", {"t_s": time[use], "roll_rad": roll[use]})
        write_trials(folder / f"{name}.yaml", "free-decay", "ship.yaml", [{"log": f"{name}.csv"}])


ROWS = (
    Row(
        name="roll-damping",
        model="ship that rolls, from a simulator without viscosity",
        lacks="viscous roll damping",
        source="10.17632/2stvkyngj9.1",
        licence="MIT",
        steps=(
            write,
            "fit-drag simulator.yaml --fix quadratic_damping=0 -o waves.yaml",
            "fit-drag simulator.yaml --fix quadratic_damping=0 --fix linear_damping=0.00798 -o lacking.yaml",
            "diagnose basin.yaml --params lacking.yaml -o gap.yaml",
        ),
        causes=frozenset({"quadratic-drag", "linear-drag"}),
        known=Known(
            0.10,
            "N m s2/rad2 per kg m2",
            "least squares of the basin's record: B2/A44",
            size_of("quadratic_N_m_s2_rad2", "quadratic_damping"),
        ),
    ),
)
