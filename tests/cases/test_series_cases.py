"""Recorded inputs of ``rwls`` and ``track imu``, with the values that should come out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Ran

Run = Callable[..., Ran]
Case = Callable[..., Path]


def codes(ran: Ran) -> list[str]:
    """Return the codes of the warnings on stderr."""
    return [line.split()[1].rstrip(":") for line in ran.err.splitlines() if line.startswith("warning SWM")]


# ---------------------------------------------------------------- rwls


# ---------------------------------------------------------------- track imu


def yaw_error(output: str) -> np.ndarray:
    """Return the heading less the true one, from the same start, rad."""
    truth = np.loadtxt("truth.csv", delimiter=",")
    found = pd.read_csv(output, comment="#")
    error = found["yaw_rad"] - np.interp(found["t_s"], truth[:, 0], truth[:, 3])
    return np.asarray(error - error.iloc[0])


@pytest.mark.slow
@pytest.mark.parametrize("log", ["mag_sparse.csv", "mag_hold.csv"])
def test_a_slow_magnetometer_holds_the_heading(log: str, case: Case, swimid: Run) -> None:
    case("c-29-magnetometer-at-a-fifth-of-the-rate", "gen.py")
    ran = swimid("track", "imu", log, "-o", "o.csv")
    assert "SWM080" not in codes(ran)
    assert "attitude gyroscope, accelerometer and magnetometer" in " ".join(ran.out.split())
    assert np.abs(yaw_error("o.csv")).max() < 0.02
