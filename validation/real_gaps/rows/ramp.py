"""Block that slides down ramps of two slopes, in films of 240 pictures a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from validation.real_gaps.row import (
    AIR,
    Gap,
    Known,
    Row,
    Sources,
    size_of,
    write_log,
    write_robot,
    write_trials,
)

#: No length is known in the films: this many pixels are called a metre.
PX_M = 700.0
#: Films, and the slope of their ramp, deg.
FILMS = {"R1": 21.9, "R3": 26.6}
#: The block slides if it is this far from its first place and this far from the edge of the picture, px.
AWAY_PX, EDGE_PX = 8, 30


def write(_sources: Sources, folder: Path) -> None:
    """Logs and trials file from the tracked films; the weight along the track drives the block."""
    write_robot(folder / "block.yaml", fluid=AIR, body={"inertial_mass_kg": 1.0})
    trials = []
    for name in FILMS:
        tracked = (folder / f"{name}-px.csv").read_text().splitlines()
        rows = np.genfromtxt([line for line in tracked if line[0] != "#"], delimiter=",", names=True)
        seen = rows["found"] == 1
        start = rows["x_px"][seen][0]
        sliding = np.flatnonzero(seen & (np.abs(rows["x_px"] - start) > AWAY_PX) & (rows["x_px"] > EDGE_PX))
        part = slice(sliding[0], sliding[-1] + 1)
        place = np.column_stack([rows["x_px"][part], rows["y_px"][part]])
        there = np.isfinite(place).all(axis=1)
        along = np.linalg.svd(place[there] - place[there].mean(axis=0), full_matrices=False)[2][0]
        if (place[there][-1] - place[there][0]) @ along < 0:
            along = -along
        time = rows["t_s"][part] - rows["t_s"][part][0]
        write_log(folder / f"{name}.csv", {"t_s": time, "x_m": (place - place[there][0]) @ along / PX_M})
        trials.append(
            {"log": f"{name}.csv", "driving_force_N": round(AIR["gravity_m_s2"] * abs(float(along[1])), 4)}
        )
    write_trials(folder / "ramps.yaml", "falling-weight", "block.yaml", trials)


def coefficient(gap: Gap) -> tuple[float, float | None]:
    """Friction over the mean weight across the two slopes."""
    across = AIR["gravity_m_s2"] * np.cos(np.radians(list(FILMS.values()))).mean()
    return size_of("friction_N", factor=float(1 / across))(gap)


ROWS = (
    Row(
        name="ramp-friction",
        model="block on a ramp, no friction",
        lacks="dry friction",
        source="umartechboy/PhysTrack",
        licence="GPL 2",
        steps=(
            *(
                step.replace("FILM", film)
                for film in FILMS
                for step in (
                    "track setup {data}/phystrack/FILM.MP4 -o FILM.yaml",
                    "track video {data}/phystrack/FILM.MP4 --setup FILM.yaml --fps 240 -o FILM-px.csv",
                )
            ),
            write,
            "fit-drag ramps.yaml --fix quadratic_drag=0 -o frictionless.yaml",
            "diagnose ramps.yaml --params frictionless.yaml -o gap.yaml",
        ),
        causes=frozenset({"pulley-friction"}),
        known=Known(0.33, "1", "accelerations of both films by hand", coefficient),
    ),
)
