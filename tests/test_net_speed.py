"""Mean speed of a track: net speed and its interval against ordinary least squares, and path speed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from swimid.kinematics.speed import TrackEstimate, measure_speed

#: Residuals that alternate, so that no correlation of successive samples widens the interval.
SIZE = 1e-4


def net_speed(t: np.ndarray, place: np.ndarray, hz: float | None = None, sd_s: float = 0.0) -> TrackEstimate:
    found = measure_speed(t, place, hz, stamp_sd_s=sd_s)
    assert found is not None
    return found.line


def half_width(design: np.ndarray, contrast: np.ndarray, freedom: int, parts: int = 1) -> float:
    """Return the half width of the 95 % interval of a contrast of coefficients, by textbook formulas."""
    wave = SIZE * (-1.0) ** np.arange(len(design))
    left = wave - design @ np.linalg.lstsq(design, wave, rcond=None)[0]
    variance = left @ left / (len(design) - design.shape[1])
    own = variance * contrast @ np.linalg.inv(design.T @ design) @ contrast
    return float(student.ppf(0.975, freedom) * np.sqrt(parts * own))


def test_a_short_track_with_a_slow_motion() -> None:
    """The displacement is that of the cubic, without the oscillation of four cycles."""
    n, duration, hz = 301, 10.0, 0.4
    t = np.linspace(0.0, duration, n)
    u, turn = t / duration, 2 * np.pi * hz * t
    noise = SIZE * (-1.0) ** np.arange(n)
    x = 3.0 * u + 0.5 * u**3 - 0.3 * u**2 + 0.2 * np.sin(turn + 0.3) + noise
    y = 1.0 * u - 0.4 * u**3 + 0.1 * np.cos(2 * turn) + noise
    found = net_speed(t, np.column_stack([x, y]), hz)
    assert found.value == pytest.approx(np.hypot(3.2, 0.6) / duration, rel=1e-6)
    swings = [f(k * turn) for k in (1, 2) for f in (np.cos, np.sin)]
    design = np.column_stack([u**0, u, u**2, u**3, *swings, (u - 0.5) * swings[0], (u - 0.5) * swings[1]])
    expected = half_width(design, np.array([0.0, 1, 1, 1, *np.zeros(6)]), n - 10) / duration
    assert found.high - found.value == pytest.approx(expected, rel=1e-6)
    assert found.value - found.low == pytest.approx(expected, rel=1e-6)


def test_a_long_track_is_measured_at_its_ends() -> None:
    """Each eighth is fitted by a parabola; what lies between does not matter."""
    n, duration = 801, 20.0
    t = np.linspace(0.0, duration, n)
    noise = SIZE * (-1.0) ** np.arange(n)
    place = np.column_stack([0.3 * t + noise, 0.1 * t + noise])
    place[200:600, 1] += 0.5 * np.sin(np.pi * np.arange(400) / 400)
    found = net_speed(t, place)
    assert found.value == pytest.approx(np.hypot(0.3, 0.1), rel=1e-4)
    end = np.vander(np.linspace(0.0, 1.0, 100), 3, increasing=True)
    expected = half_width(end, np.array([1.0, 0.0, 0.0]), 2 * (100 - 3), parts=2) / duration
    # an end has 100 or 101 samples
    assert found.high - found.value == pytest.approx(expected, rel=0.01)
    # errors of the time stamps of 20 ms at either end move it by 0.3 m/s times 20 ms
    late = net_speed(t, place, sd_s=0.02)
    added = student.ppf(0.975, 194) * np.sqrt(2.0) * 0.02 * found.value / duration
    assert late.high - late.value == pytest.approx(np.hypot(expected, added), rel=0.01)


def test_few_samples_have_no_speed() -> None:
    t = np.arange(11.0)
    assert measure_speed(t, np.column_stack([t, t])) is None


def test_the_interval_of_the_speed_at_rest_begins_at_zero() -> None:
    t, rng = np.arange(0.0, 10.0, 0.04), np.random.default_rng(0)
    found = net_speed(t, rng.normal(0.0, 1e-3, (len(t), 2)))
    assert found.low == 0.0
    assert 0.0 < found.value < found.high < 1e-3


def test_the_speed_along_a_swaying_path_is_larger_than_its_net_speed() -> None:
    """The path of 0.2 m/s along and 30 mm at 0.5 Hz across, with 0.1 mm of noise and a gap."""
    time, rng = np.arange(0.0, 40.0, 0.04), np.random.default_rng(3)
    x = 0.2 * time + rng.normal(0, 1e-4, len(time))
    y = 0.03 * np.sin(np.pi * time) + rng.normal(0, 1e-4, len(time))
    fine = np.linspace(0.0, 2.0, 2001)
    truth = np.mean(np.hypot(0.2, 0.03 * np.pi * np.cos(np.pi * fine)))
    gap = (time > 10.0) & (time < 14.0)
    found = measure_speed(time, np.where(gap[:, None], np.nan, np.column_stack([x, y])), 0.5)
    assert found is not None
    assert found.path.value == pytest.approx(truth, rel=1e-3)
    assert found.path.high - found.path.low < 1e-3
    assert found.line.value == pytest.approx(0.2, rel=1e-3)
    # errors of 0.1 mm at the ends of 40 s
    assert found.line.high - found.line.low < 1e-4
    assert found.noise == pytest.approx(1e-4, rel=0.2)
    assert found.covered_s == pytest.approx(35.96, abs=0.1)
