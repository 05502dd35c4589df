"""Coverage of the coefficients of a tendon fish, and false alarms of the checks of ``swimid fit-graybox``.

Three runs under a camera, from the independent simulation of the fish. One fit takes seconds, so that there
are few repeats.
"""

from __future__ import annotations

import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

import swimid
from tests.generators import swimmer
from validation.coverage.rows import alarms, inside

REPEATS = 40
TRUTH = {**swimmer.TFISH, "c_ma": 1.0, "c_Ia": 1.45, "c_d0": 4.1, "c_f13": 0.01}
DRIVES = ((0.8, 25.0, 0.0), (1.2, 20.0, 8.0), (1.6, 15.0, -8.0))
NOISE = {"x_m": 0.002, "y_m": 0.002, "yaw_rad": 0.01}
ESTIMATED = ("c_ma", "c_Ia", "c_d0")


@lru_cache(maxsize=1)
def runs() -> tuple[swimmer.Run, ...]:
    """Return the runs without noise."""
    found = []
    for k, (frequency, amplitude, bias) in enumerate(DRIVES):
        drive = {"frequency_hz": frequency, "amplitude_deg": amplitude, "bias_deg": bias, "ramp_s": 1.0}
        found.append(swimmer.Run(f"run{k}", drive, swimmer.simulate("tfish", TRUTH, drive, 6.0, rtol=1e-9)))
    return tuple(found)


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the true values for one set of trials, and the alarms of checks."""
    fixed = {name: TRUTH[name] for name in TRUTH if name not in ESTIMATED}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trials = swimmer.write_trials(Path(folder), "tfish", runs(), NOISE, seed, columns=list(NOISE))
        fit = swimid.fit_graybox(trials, fixed=fixed)
    found = {name: inside(fit.data["parameters"][name], TRUTH[name]) for name in ESTIMATED}
    return found | alarms(fit)
