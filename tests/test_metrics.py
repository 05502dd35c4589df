"""Errors of a simulation against closed forms and a direct dynamic programme."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.fitting import fit_common


def warped(a: np.ndarray, b: np.ndarray, band: int) -> float:
    """Return the least cost of a warping path, cell by cell."""
    cost = np.full((len(a) + 1, len(b) + 1), np.inf)
    cost[0, 0] = 0.0
    for i in range(1, len(a) + 1):
        for j in range(max(1, i - band), min(len(b), i + band) + 1):
            least = min(cost[i - 1, j], cost[i, j - 1], cost[i - 1, j - 1])
            cost[i, j] = np.sum((a[i - 1] - b[j - 1]) ** 2) + least
    return float(np.sqrt(cost[-1, -1] / len(a)))


@pytest.fixture
def pair(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.cumsum(rng.normal(size=80)), np.cumsum(rng.normal(size=80))


def test_rms_error(pair: tuple[np.ndarray, np.ndarray]) -> None:
    a, b = pair
    whole = fit_common.compute_score(a, b)
    absolute, normalised = whole.rmse, whole.nrmse
    assert absolute == pytest.approx(np.sqrt(np.mean((a - b) ** 2)))
    assert normalised == pytest.approx(absolute / (a.max() - a.min()))


def test_peak_error_takes_magnitudes() -> None:
    t = np.linspace(0, 1, 1001)
    absolute, normalised = fit_common.peak_error(-0.5 * np.sin(2 * np.pi * t), 0.4 * np.sin(2 * np.pi * t))
    assert absolute == pytest.approx(0.1)
    assert normalised == pytest.approx(0.2)
    assert np.isnan(fit_common.peak_error(np.zeros(3), np.ones(3))[1])


@pytest.mark.parametrize("band", [0, 1, 5, 79])
def test_dtw_is_the_least_warping(pair: tuple[np.ndarray, np.ndarray], band: int) -> None:
    a, b = pair
    assert fit_common.dtw_distance(a, b, band=band) == pytest.approx(warped(a, b, band), rel=1e-12)
    assert fit_common.dtw_distance(a, b, band=band) <= fit_common.compute_score(a, b).rmse * (1 + 1e-12)


def test_dtw_warps_several_series_as_one(rng: np.random.Generator) -> None:
    a, b = np.cumsum(rng.normal(size=(2, 60, 3)), axis=1)
    assert fit_common.dtw_distance(a, b, band=7) == pytest.approx(warped(a, b, 7), rel=1e-12)


def test_dtw_without_band_is_the_rmse(pair: tuple[np.ndarray, np.ndarray]) -> None:
    assert fit_common.dtw_distance(*pair, band=0) == pytest.approx(fit_common.compute_score(*pair).rmse)


def test_dtw_forgives_a_delay_within_its_band() -> None:
    bump = np.exp(-(((np.arange(200) - 100) / 15.0) ** 2))
    late = np.roll(bump, 5)
    assert fit_common.dtw_distance(bump, late, band=5) < 1e-9
    assert fit_common.dtw_distance(bump, late, band=0) == pytest.approx(
        fit_common.compute_score(bump, late).rmse
    )
    assert fit_common.dtw_distance(bump, late, band=4) > 1e-3


@pytest.mark.parametrize("shift", [-3.0, -0.4, 0.0, 1.2, 3.1])
def test_phase_error(rng: np.random.Generator, shift: float) -> None:
    t = np.sort(rng.uniform(0, 7.3, 400))
    angle = 2 * np.pi * 1.3 * t
    measured = 0.2 * np.sin(angle + 0.7) + 5.0 - 0.3 * t
    simulated = 0.9 * np.sin(angle + 0.7 + shift) + 0.1 * t
    measured[::7] = np.nan
    assert fit_common.phase_error(measured, simulated, t, frequency_hz=1.3) == pytest.approx(shift, abs=1e-9)


def test_phase_error_under_noise(rng: np.random.Generator) -> None:
    t = np.arange(0, 10, 0.02)
    sd = 0.1
    measured = np.sin(2 * np.pi * t) + rng.normal(0, sd, 500)
    simulated = np.sin(2 * np.pi * t + 0.3)
    # a phase of a unit sine is known to sd sqrt(2 / n)
    found = fit_common.phase_error(measured, simulated, t, frequency_hz=1.0)
    assert found == pytest.approx(0.3, abs=4 * sd * np.sqrt(2 / 500))


def test_nothing_to_compare() -> None:
    nothing = np.full(10, np.nan)
    t = np.arange(10.0)
    assert np.isnan(fit_common.compute_score(nothing, t).rmse)
    assert np.isnan(fit_common.peak_error(nothing, t)).all()
    assert np.isnan(fit_common.dtw_distance(nothing, t, band=2))
    assert np.isnan(fit_common.phase_error(nothing, t, t, frequency_hz=0.1))
    assert np.isnan(fit_common.phase_error(np.ones(10), np.sin(t), t, frequency_hz=0.1))
