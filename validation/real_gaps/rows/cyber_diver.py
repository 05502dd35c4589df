"""Programmed damping of an impactor: two masses joined by a motor that acts as spring and damper.

The impactor is dropped, and its masses swing against each other until it hits water. The controller programs
a spring of 15 or 45 N/mm and a damping of 0, 23.4 or 46.8 N s/m, which the header of each file states.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import Array, Known, Row, Sources, size_of, write_log, write_robot, write_trials

REPOSITORY, COMMIT = "harrislab-brown/CyberDiver", "85fb9d6bf7713ddb7f27512c77138f220afc4a3b"
#: Recordings by programmed damping ratio, and with a stiffer spring.
RECORDINGS = {
    "none": "linear undamped/15npmm_4mps_trial{}.dat",
    "quarter": "linear damped/15npmm_4mps_025damping_trial{}.dat",
    "half": "linear damped/15npmm_4mps_05damping_trial{}.dat",
    "stiff": "linear undamped/45npmm_4mps_trial{}.dat",
}
#: Programmed stiffness over that of the other recordings.
STIFFER = {"stiff": 3.0}
#: Programmed damping, N s/m.
QUARTER_N_S_M, HALF_N_S_M = 23.4, 46.8
TRIALS = (1, 2, 3, 4, 5)
HELD_OUT = 2
#: Fields of a sample: time in us, then current, force, position in mm, and others that are not used.
SAMPLE = np.dtype([("time_us", "<u4"), ("before", "<f4", 2), ("position_mm", "<f4"), ("after", "<u4", 7)])
#: Bytes before the samples in a file of firmware version 2.
SAMPLES_AT = 14720
#: The drop begins after this time; a log begins where the position passes the threshold.
DROP_S, THRESHOLD_MM = 0.39, 0.17
EVERY = 10
#: Duration of the logs, which end before the impact, s.
SPAN_S = 0.1
#: In the most damped runs the swing has decayed after this time, and the drift remains, s.
DECAYED_S = 0.045
#: Reduced mass of the two masses, from the frequency without damping and the programmed 15 N/mm, kg.
MASS_KG = 0.157


def read_position(path: Path) -> tuple[Array, Array]:
    """Time from the release (s) and relative position (m) of a drop, at 5 kHz."""
    content = path.read_bytes()
    samples = np.frombuffer(content, SAMPLE, (len(content) - SAMPLES_AT) // SAMPLE.itemsize, SAMPLES_AT)
    time, position = 1e-6 * samples["time_us"], samples["position_mm"]
    begin = int(np.flatnonzero((time > DROP_S) & (position > THRESHOLD_MM))[0])
    use = slice(begin, begin + int(SPAN_S / 2e-5), EVERY)
    return time[use] - time[begin], 1e-3 * position[use].astype(float)


def write(sources: Sources, folder: Path) -> None:
    """Logs of all drops, with the drift of the rest position removed, and one trials file per damping.

    The rest position drifts because the drag of the air grows during the fall. The drift is a parabola
    through the most damped runs after their swing has decayed.
    """
    root = sources.repository(REPOSITORY, COMMIT, "data")
    drops = {n: [read_position(root / p.format(k)) for k in TRIALS] for n, p in RECORDINGS.items()}
    time = np.concatenate([t[t > DECAYED_S] for t, _ in drops["half"]])
    drift = np.polyfit(time, np.concatenate([x[t > DECAYED_S] for t, x in drops["half"]]), 2)
    write_robot(folder / "diver.yaml", body={"inertial_mass_kg": MASS_KG})
    for name, records in drops.items():
        trials = []
        for number, (time, position) in zip(TRIALS, records, strict=True):
            log = f"{name}{number}.csv"
            write_log(
                folder / log,
                {"t_s": time, "x_m": position - np.polyval(drift, time) / STIFFER.get(name, 1.0)},
            )
            role = "validate" if number == HELD_OUT else "fit"
            trials.append({"log": log, "end_s": ENDS_S[name], "role": role})
        write_trials(folder / f"{name}.yaml", "free-decay", "diver.yaml", trials)


#: End of the part of the logs that is used: later the swing is smaller than what the drift leaves.
ENDS_S = {"none": 0.06, "quarter": 0.06, "half": 0.05, "stiff": 0.06}


DAMPING = (
    frozenset({"parameter:linear_drag", "linear-drag", "pulley-viscous"}),
    "N s/m",
    size_of("linear_drag", "linear_N_s_m", "friction_N_s_m", "damping_N_s_m"),
)
STIFFNESS = (frozenset({"parameter:stiffness"}), "N/m", size_of("stiffness"))
ROWS = tuple(
    Row(
        name=f"impactor-{name}",
        model="programmed spring of 15 N/mm",
        lacks=lacks,
        source=f"{REPOSITORY} @{COMMIT[:8]}",
        licence="CC BY-SA 4.0",
        steps=(
            write,
            "fit-drag none.yaml --fix quadratic_drag=0 -o spring.yaml",
            f"diagnose {trials}.yaml --params spring.yaml -o gap.yaml",
        ),
        causes=causes,
        known=Known(change, unit, "header of each file", read),
    )
    for name, lacks, trials, change, (causes, unit, read) in (
        ("damping-0.25", "programmed damping", "quarter", QUARTER_N_S_M, DAMPING),
        ("damping-0.5", "twice the programmed damping", "half", HALF_N_S_M, DAMPING),
        ("stiffness", "30 N/mm", "stiff", 30000.0, STIFFNESS),
    )
)
