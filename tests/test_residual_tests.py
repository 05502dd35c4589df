"""Tests of residual tests: formulas by hand, simulated truth and rates of false alarms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from swimid.fitting import uncertainty as rt


def test_autocorrelation_of_a_known_autoregression():
    rng = np.random.default_rng(1)
    x = lfilter([1.0], [1.0, -0.8], rng.normal(size=50_000))
    got = rt.autocorrelation(x, max_lag=5)
    # Bartlett: the standard error of r_k of this process stays below 0.02 at n = 50 000.
    assert got.values == pytest.approx(0.8 ** np.arange(6), abs=0.03)
    assert got.bound[1] == pytest.approx(1.96 / np.sqrt(49_999))


def test_ljung_box_equals_the_textbook_formula_without_gaps():
    x = np.random.default_rng(2).normal(size=300)
    c = x - x.mean()
    n, lags = len(c), 10
    r = np.array([np.dot(c[k:], c[:-k]) for k in range(1, lags + 1)]) / np.dot(c, c)
    expected = n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1)))
    got = rt.ljung_box(x, lags=lags, fitted=2)
    assert got.statistic == pytest.approx(expected, rel=1e-12)
    assert got.degrees == 8
    # the variance of the statistic of 300 white samples is 1 + 2 (10 - 3) / 300 times that of chi-square
    assert got.p_value == pytest.approx(stats.chi2.sf(expected / (1 + 14 / 300), 8 / (1 + 14 / 300)))


@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_ljung_box_false_alarm_rate(missing):
    """White noise is rejected at 5 % in about 5 % of 400 series, with and without gaps."""
    rng = np.random.default_rng(3)
    p = []
    for _ in range(400):
        x = rng.normal(size=400)
        x[rng.random(400) < missing] = np.nan
        p.append(rt.ljung_box(x).p_value)
    rate = np.mean(np.array(p) < 0.05)
    assert 0.02 < rate < 0.09  # binomial: 0.05 +- 3 x 0.011


def test_ljung_box_false_alarm_rate_of_short_series():
    """White series of 150 samples are rejected at the 1 % level in about 1 % of 2000 cases."""
    rng = np.random.default_rng(14)
    rate = np.mean([not rt.ljung_box(rng.normal(size=150)).is_passed for _ in range(2000)])
    assert 0.003 < rate < 0.0165  # binomial: 0.01 +- 3 x 0.0022; without the variance of a short series 0.024


def test_a_pure_autoregression_absorbs_one_degree_for_each_coefficient():
    x = lfilter([1.0], [1.0, -1.2, 0.5], np.random.default_rng(15).normal(size=5000))
    h = rt.lag_matrix(x, [1, 2])
    e = x - h @ np.linalg.lstsq(h, x, rcond=None)[0]
    assert rt.count_absorbed(h, rt.lag_matrix(e, range(1, 26))) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("noise, least, most", [(0.01, 0.0, 0.1), (100.0, 1.9, 2.1)])
def test_an_input_that_explains_the_output_leaves_the_degrees(noise, least, most):
    """The coefficients of an ARX model follow from the input, or from the noise, whichever is larger."""
    rng = np.random.default_rng(16)
    u, e = rng.normal(size=(2, 5000))
    y = lfilter([0.0, 1.0], [1.0, -1.2, 0.5], u) + lfilter([1.0], [1.0, -1.2, 0.5], noise * e)
    h = np.column_stack((rt.lag_matrix(y, [1, 2]), rt.lag_matrix(u, [1])))
    residuals = y - h @ np.linalg.lstsq(h, y, rcond=None)[0]
    assert least <= rt.count_absorbed(h, rt.lag_matrix(residuals, range(1, 26))) <= most


def test_ljung_box_detects_weak_colour():
    x = lfilter([1.0], [1.0, -0.2], np.random.default_rng(4).normal(size=2000))
    assert not rt.ljung_box(x).is_passed


def test_constant_and_empty_series_pass():
    assert rt.ljung_box(np.zeros(100)).p_value == 1.0
    assert rt.ljung_box(np.empty(0)).p_value == 1.0
    assert rt.ljung_box(np.full(50, np.nan)).p_value == 1.0
    assert rt.independence(np.zeros(100), np.ones(100)).p_value == 1.0


def test_independence_finds_a_missed_delay():
    rng = np.random.default_rng(5)
    u = rng.normal(size=3000)
    e = 0.3 * np.roll(u, 7) + rng.normal(size=3000)
    assert not rt.independence(e, u).is_passed


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_independence_false_alarm_rate(colour):
    """Coloured residuals and a coloured source are rejected at 5 % in about 5 % of 400 pairs."""
    rng = np.random.default_rng(6)
    p = []
    for _ in range(400):
        e = lfilter([1.0], [1.0, -colour], rng.normal(size=1000))[200:]
        u = lfilter([1.0], [1.0, -0.9], rng.normal(size=1000))[200:]
        p.append(rt.independence(e, u, lags=10).p_value)
    assert 0.02 < np.mean(np.array(p) < 0.05) < 0.10


def test_a_single_sine_has_two_degrees_of_freedom():
    rng = np.random.default_rng(7)
    u = np.sin(0.3 * np.arange(5000))
    got = rt.independence(rng.normal(size=5000), u, lags=12)
    assert got.degrees == 2
    assert got.is_passed


def test_autoregression_recovers_order_and_coefficients():
    rng = np.random.default_rng(8)
    x = lfilter([1.0], [1.0, -1.2, 0.5], 0.3 * rng.normal(size=20_000))
    x[5000:5100] = np.nan
    got = rt.fit_autoregression(x)
    assert len(got) == 2
    # Standard error of an AR(2) coefficient: sqrt((1 - a2^2) / n) = 0.0061.
    assert got == pytest.approx([-1.2, 0.5], abs=0.02)
    innovations = np.convolve(x, np.r_[1.0, got])[: len(x)]
    assert np.nanvar(innovations) == pytest.approx(0.09, rel=0.05)
    assert rt.ljung_box(innovations, fitted=2).is_passed


def test_autoregression_of_white_noise_has_order_zero():
    got = rt.fit_autoregression(np.random.default_rng(9).normal(size=4000))
    assert len(got) == 0


def test_autoregression_refuses_too_little():
    with pytest.raises(ValueError, match="at least three"):
        rt.fit_autoregression(np.array([1.0, np.nan, 2.0]))


def test_long_run_covariance_gives_the_variance_of_a_mean():
    """Compare sums of repeated AR(1) series with the estimate from each."""
    rng = np.random.default_rng(12)
    sums, guesses = [], []
    for _ in range(300):
        x = lfilter([1.0], [1.0, -0.6], rng.normal(size=2100))[100:]
        sums.append(x.sum())
        guesses.append(rt.long_run_covariance(x[:, None])[0, 0])
    # the variance of 300 sums has an error of 8 %; the Bartlett window underestimates a little
    assert np.mean(guesses) == pytest.approx(np.var(sums), rel=0.25)


def test_long_run_covariance_is_positive_semidefinite_with_gaps():
    rng = np.random.default_rng(13)
    s = rng.normal(size=(500, 3)).cumsum(axis=0)
    s[100:120] = np.nan
    assert np.linalg.eigvalsh(rt.long_run_covariance(s)).min() > -1e-9


def test_joined_records_stay_separate():
    parts = [np.ones(3), np.ones(2)]
    both = rt.join_series(parts, gap=4)
    assert np.flatnonzero(np.isfinite(both)).tolist() == [0, 1, 2, 7, 8]
