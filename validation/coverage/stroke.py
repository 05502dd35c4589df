"""Coverage of the stroke frequency and the advance speed of noisy tracks, with and without held samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.jumps import clean_track
from swimid.kinematics.speed import measure_speed
from swimid.kinematics.stroke import find_stroke

Array = NDArray[np.float64]
REPEATS = 400


def recording(
    rng: np.random.Generator, strokes: float, held: float | None
) -> tuple[Array, Array, dict[str, float]]:
    """Return stamps, positions, shape (n, 2), and the truth of a swimmer on a straight course.

    ``held`` is the rate of the camera over the rate of the log, which repeats the last picture.
    """
    truth = {"frequency_hz": rng.uniform(0.5, 2.0), "speed_m_s": rng.uniform(0.05, 0.4)}
    rate = rng.choice([25.0, 30.0, 60.0])
    stamps = np.arange(0.0, strokes / truth["frequency_hz"], 1.0 / rate)
    late = rng.uniform(0.0, 1.0)
    picture = (
        np.arange(len(stamps)) if held is None else np.floor(held * np.arange(len(stamps)) + late).astype(int)
    )
    seen = stamps if held is None else (picture - late) / (held * rate)
    phase = 2 * np.pi * truth["frequency_hz"] * seen
    sway = rng.uniform(0.01, 0.03)
    along = truth["speed_m_s"] * seen + 0.15 * sway * np.sin(2 * phase + rng.uniform(0, 6))
    across = sway * np.sin(phase + rng.uniform(0, 6))
    noise = rng.normal(0.0, rng.uniform(0.0003, 0.001), (2, picture[-1] + 2))[:, picture]
    course = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(course), -np.sin(course)], [np.sin(course), np.cos(course)]])
    return stamps, (turn @ (np.array([along, across]) + noise)).T, truth


def one(seed: int) -> dict[str, float]:
    """Return by quantity whether the stated interval holds the true value."""
    rng = np.random.default_rng(seed)
    hits = {}
    for kind, held in (("every sample", None), ("held samples", rng.uniform(0.4, 0.95))):
        for length, strokes in (("short", rng.uniform(1.5, 3.8)), ("long", rng.uniform(5.0, 30.0))):
            stamps, place, truth = recording(rng, strokes, held)
            cleaning = clean_track(stamps, list(place.T))
            good = cleaning.good
            columns = dict(zip(("x_m", "y_m"), place[good].T, strict=True))
            times = cleaning.held.measured_s[good]
            stroke = find_stroke(times, columns, time_sd_s=cleaning.held.measured_sd_s)
            if stroke.beat is not None:
                low, high = stroke.beat.interval_hz
                hits[f"{length}, {kind}: frequency"] = float(low <= truth["frequency_hz"] <= high)
            elif length == "long":
                hits[f"{length}, {kind}: frequency"] = 0.0
            periodic_hz = stroke.frequency_hz or stroke.slow_hz
            stamp_sd_s = cleaning.held.measured_sd_s
            speed = measure_speed(times, place[good], periodic_hz, stamp_sd_s=stamp_sd_s)
            if speed is not None:
                inside = speed.line.low <= truth["speed_m_s"] <= speed.line.high
                hits[f"{length}, {kind}: speed"] = float(inside)
    return hits
