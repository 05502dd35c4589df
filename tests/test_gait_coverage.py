"""Coverage of the interval of the best gait, over forty fits of noisy trials.

The trials are made by ``tests/generators/swimmer.py``, which shares no code with the package.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import swimid as package
from swimid.errors import NoTrustworthyResult
from tests.generators import swimmer

REPEATS = 40
#: A poor camera: what it leaves open of the coefficients moves the best gait.
NOISE = {"x_m": 0.015, "y_m": 0.015, "yaw_rad": np.radians(4.0)}
DRIVES = (
    {"frequency_hz": 1.0, "amplitude_deg": 20},
    {"frequency_hz": 1.6, "amplitude_deg": 30, "bias_deg": 10},
)
BEAT = {"amplitude_deg": 30.0, "duration_s": 8.0}
#: The fastest spring; and the slowest beat that is fast enough.
SPRING = {**BEAT, "frequency_hz": 1.5, "vary": {"d_p": (0.0, 0.15)}}
SLOWEST = {**BEAT, "goal": "power", "reach_speed_m_s": 0.25, "vary": {"frequency_hz": (0.8, 2.2)}}
HELD = {name: swimmer.SAMPLE[name] for name in ("c_Ia", "c_d13", "c_f0", "c_f13", "c_f4")}


def repeats(folder: Path) -> Iterator[tuple[int, package.Fitted]]:
    """Yield the fits of REPEATS repeats, without those that fail."""
    runs = [
        swimmer.Run(f"run{k}", dict(drive), swimmer.simulate("tfish", swimmer.SAMPLE, drive, 6.0))
        for k, drive in enumerate(DRIVES)
    ]
    count = 0
    for seed in itertools.count():
        if count == REPEATS:
            return
        trials = swimmer.write_trials(
            folder / f"{seed}", "tfish", runs, NOISE, seed, columns=["x_m", "y_m", "yaw_rad"]
        )
        try:
            fitted = package.fit_graybox(trials, fixed=HELD)
        except NoTrustworthyResult:
            continue
        count += 1
        yield seed, fitted


@pytest.mark.slow
def test_the_interval_covers_the_true_optimum(tmp_path: Path) -> None:
    """It does in 36 of 40 repeats."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", package.SwimidWarning)
        place = package.optimise_gait(robot="tfish", chosen=dict(swimmer.SAMPLE), **SPRING).at["d_p"]
        beat = package.optimise_gait(robot="tfish", chosen=dict(swimmer.SAMPLE), **SLOWEST).at["frequency_hz"]
        given = {"starts": 2}
        inside, width = [], []
        for seed, fitted in repeats(tmp_path):
            spring = package.optimise_gait(params=fitted, draws=60, seed=seed, **given, **SPRING).file
            slowest = package.optimise_gait(params=fitted, draws=60, seed=seed, **given, **SLOWEST).file
            ends = [spring.at_ci95["d_p"], slowest.at_ci95["frequency_hz"]]
            inside.append([low <= x <= high for (low, high), x in zip(ends, (place, beat), strict=True)])
            width.append([high - low for low, high in ends])
    held = np.sum(inside, axis=0)
    middle = np.median(width, axis=0)
    print(f"\n{held[0]} of {REPEATS} intervals hold {1e3 * place:.1f} mm, {1e3 * middle[0]:.1f} mm wide")
    print(f"{held[1]} of {REPEATS} intervals hold {beat:.3f} Hz, {middle[1]:.3f} Hz wide")
    assert held.min() >= 0.9 * REPEATS
