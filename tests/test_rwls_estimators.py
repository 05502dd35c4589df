"""The recursion against batch least squares and closed forms; estimates against known truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from swimid.blackbox import arx
from swimid.blackbox import model as difference
from swimid.blackbox import rwls as identified
from swimid.blackbox.arx import fit_arx, regression
from swimid.blackbox.model import ArxRecord, Orders
from swimid.blackbox.rwls import search_orders
from swimid.logs import sampling

pytestmark = pytest.mark.kernels

A, B = np.array([-1.5, 0.7]), np.array([0.5, 0.25])
TRUTH = np.concatenate((A, B))


def simulated(seed, *, n=400, noise=0.1, mean=0.0, a=A, b=B, c=(), offset=0.0, name="log"):
    """A(z) y = B(z) u + C(z) e + offset, by scipy's filter."""
    rng = np.random.default_rng(seed)
    u = mean + rng.normal(size=n + 200)
    e = noise * rng.normal(size=n + 200)
    polynomial = np.concatenate(([1.0], a))
    y = lfilter(np.concatenate(([0.0], b)), polynomial, u)
    y += lfilter(np.concatenate(([1.0], c)), polynomial, e) + offset / polynomial.sum()
    return ArxRecord(name, np.arange(n) * 0.1, u[200:], y[200:])


def batch(h, z, *, weight=1.0, forgetting=1.0, prior_scale=1e6):
    """Weighted least squares with the prior, by an orthogonal factorisation of stacked rows."""
    n, p = h.shape
    root = np.sqrt(weight * forgetting ** np.arange(n - 1, -1, -1.0))
    prior = np.sqrt(forgetting ** (n - 1)) / prior_scale * np.eye(p)
    stacked = np.vstack((h * root[:, None], prior))
    return np.linalg.lstsq(stacked, np.concatenate((z * root, np.zeros(p))), rcond=None)[0]


@pytest.mark.parametrize("prior_scale", [10.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("weight,forgetting", [(1.0, 1.0), (0.95, 1.0), (0.93, 0.99), (7.0, 0.9)])
def test_recursion_equals_batch_with_its_prior(prior_scale, weight, forgetting):
    data = regression([simulated(1)], Orders(2, 2))
    run = arx.recursive_least_squares(
        data.rows, data.outputs, weight=weight, forgetting=forgetting, prior_scale=prior_scale
    )
    expected = batch(data.rows, data.outputs, weight=weight, forgetting=forgetting, prior_scale=prior_scale)
    np.testing.assert_allclose(run.theta, expected, rtol=1e-8, atol=1e-8)


def test_recursion_follows_the_printed_equations():
    """Eq 9 written out with a full P, compared at every row."""
    data = regression([simulated(2, n=60)], Orders(2, 2))
    run = arx.recursive_least_squares(data.rows, data.outputs, weight=0.95, prior_scale=100.0)
    theta, p = np.zeros(4), 1e4 * np.eye(4)
    for k, (h, z) in enumerate(zip(data.rows, data.outputs, strict=True)):
        gain = p @ h / (h @ p @ h + 1 / 0.95)
        assert run.innovations[k] == pytest.approx(z - h @ theta, rel=1e-6, abs=1e-9)
        theta = theta + gain * (z - h @ theta)
        p = (np.eye(4) - np.outer(gain, h)) @ p
        begun = arx.recursive_least_squares(
            data.rows[: k + 1], data.outputs[: k + 1], weight=0.95, prior_scale=100.0
        )
        np.testing.assert_allclose(begun.theta, theta, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(np.diag(begun.covariance), np.diag(p), rtol=1e-5)
    np.testing.assert_allclose(run.covariance, p, rtol=1e-5, atol=1e-8)


def test_forgetting_follows_a_change_and_weight_does_not():
    before, after = simulated(4, n=1500), simulated(5, n=1500, a=np.array([-1.2, 0.5]))
    both = [before, after]
    followed = fit_arx(both, Orders(2, 2), forgetting=0.98).theta
    averaged = fit_arx(both, Orders(2, 2), weight=0.98).theta
    assert followed[0] == pytest.approx(-1.2, abs=0.03)
    assert abs(averaged[0] + 1.2) > 0.08


def test_growth_of_p_is_limited_and_counted():
    h = np.zeros((5000, 2))
    h[:, 0] = 1.0
    run = arx.recursive_least_squares(h, np.ones(5000), forgetting=0.9)
    assert run.limited > 1000
    assert np.isfinite(run.covariance).all()
    assert run.theta == pytest.approx([1.0, 0.0])


def test_offset_is_found_and_removed():
    record = simulated(8, n=2000, offset=2.0)
    point = identified.find_working_point([record], Orders(2, 2))
    assert point.removed
    assert identified.constant_term(regression([record], Orders(2, 2)))[0] == pytest.approx(2.0, abs=0.1)
    found = fit_arx(identified.subtract_levels([record], point), Orders(2, 2))
    assert np.all(np.abs(found.theta - TRUTH) < 3 * found.stderr + 0.02)


def test_subtracting_the_means_removes_a_spurious_pole_at_one():
    rng = np.random.default_rng(9)
    slow = lfilter([1.0], [1.0, -0.97], 0.02 * rng.normal(size=1500))
    record = simulated(10, n=1500, a=np.array([-0.9]), b=np.array([0.1]), noise=0.01)
    far = ArxRecord("far", record.time_s, record.source, record.output + slow + 40.0)
    assert identified.find_working_point([far], Orders(3, 2)).removed


def test_a_working_point_near_zero_is_removed_when_the_free_run_gains():
    """Two deviations from zero: the constant term alone is not clear, the free run is."""
    centred = 0
    for seed in range(20):
        record = simulated(60 + seed, n=600, a=np.array([-0.95]), b=np.array([0.05]), noise=0.05)
        level = 2.5 * np.std(record.output)
        moved = ArxRecord("moved", record.time_s, record.source + 3.0, record.output + level)
        centred += identified.find_working_point([moved], Orders(1, 1)).removed
    assert centred >= 18


def test_slow_systems_without_offset_seldom_lose_their_means():
    """16 of these 60 gain 10 % of free run by chance; the constant term must agree."""
    slow = {"a": np.array([-0.95]), "b": np.array([0.5])}
    centred = [
        identified.find_working_point([simulated(s, n=200, noise=0.5, **slow)], Orders(1, 1)).removed
        for s in range(60)
    ]
    assert sum(centred) <= 3


@pytest.mark.parametrize("forgetting", [1.0, 0.995])
def test_coverage_of_the_95_percent_intervals(forgetting):
    """300 repeats x 4 coefficients: 92 to 98 % of the intervals hold the truth."""
    inside = []
    for seed in range(300):
        found = fit_arx([simulated(1000 + seed, n=400)], Orders(2, 2), forgetting=forgetting)
        inside.append(np.abs(found.theta - TRUTH) <= 1.96 * found.stderr)
    assert 0.92 <= np.mean(inside) <= 0.98


def test_coverage_of_armax_intervals():
    inside = []
    truth = np.concatenate((TRUTH, [0.6]))
    for seed in range(200):
        found = fit_arx([simulated(5000 + seed, n=500, noise=0.3, c=(0.6,))], Orders(2, 2, nc=1))
        inside.append(np.abs(found.theta - truth) <= 1.96 * found.stderr)
    assert 0.92 <= np.mean(inside) <= 0.98


def test_armax_gradient_is_the_derivative():
    data = regression([simulated(13, n=80)], Orders(2, 2, nc=2))
    theta = np.append(TRUTH, [0.4, -0.2])
    _, gradient = arx.errors_and_gradient(theta, data)
    for i in range(6):
        step = np.zeros(6)
        step[i] = 1e-6
        up, _ = arx.errors_and_gradient(theta + step, data)
        down, _ = arx.errors_and_gradient(theta - step, data)
        np.testing.assert_allclose(gradient[:, i], -(up - down) / 2e-6, rtol=1e-5, atol=1e-6)


def test_gaps_cost_only_the_rows_around_them():
    record = simulated(14, n=2000)
    y, u = record.output.copy(), record.source.copy()
    y[500], u[900:905] = np.nan, np.nan
    holed = ArxRecord("holed", record.time_s, u, y)
    data = regression([holed], Orders(2, 2))
    # y(500) is needed by rows 500, 501, 502; u(900..904) by rows 901..906.
    assert data.possible - len(data) == 3 + 6
    found = fit_arx([holed], Orders(2, 2))
    expected = np.linalg.lstsq(data.rows, data.outputs, rcond=None)[0]
    np.testing.assert_allclose(found.theta, expected, rtol=1e-8, atol=1e-10)
    assert np.all(np.abs(found.theta - TRUTH) < 4 * found.stderr)


def test_a_measured_sine_leaves_b_undetermined():
    """Sensor noise on the input makes the regression regular and B no better known."""
    rng = np.random.default_rng(43)
    t = np.arange(1500) * 0.02
    u = np.sin(2 * np.pi * 0.3 * t)
    y = lfilter([0, 0.05], [1, -0.95], u) + 0.002 * rng.normal(size=len(t))
    for sd in (1e-6, 1e-4):
        record = ArxRecord("sine", t, u + sd * rng.normal(size=len(t)), y)
        found = fit_arx([record], Orders(2, 3))
        assert found.known.determined.tolist() == [True, True, False, False, False]
        assert found.known.input_rank == 2
        assert fit_arx([record], Orders(2, 2)).known.determined.all()


def test_a_small_coefficient_known_to_be_small_is_estimated():
    """Order one too many: a3 and b3 are zero within their errors, and determined."""
    found = fit_arx([simulated(44, n=800, a=np.array([-1.9, 0.9025]))], Orders(3, 3))
    assert found.known.determined.all()
    assert found.stderr[2] > 0.5 * abs(found.theta[2])


def test_free_run_equals_a_filter_and_restarts_after_gaps():
    record = simulated(22, n=300, noise=0.0)
    run = difference.simulate(record, Orders(2, 2), TRUTH)
    np.testing.assert_allclose(run[2:], record.output[2:], rtol=1e-9, atol=1e-9)
    assert np.isnan(run[:2]).all()
    u = record.source.copy()
    u[100:110] = np.nan
    run = difference.simulate(ArxRecord("g", record.time_s, u, record.output), Orders(2, 2), TRUTH)
    assert np.isnan(run[101:112]).all()
    np.testing.assert_allclose(run[112:], record.output[112:], rtol=1e-9, atol=1e-9)
    # A gap of the output alone does not stop a free run.
    y = record.output.copy()
    y[50:200] = np.nan
    run = difference.simulate(ArxRecord("g", record.time_s, record.source, y), Orders(2, 2), TRUTH)
    np.testing.assert_allclose(run[2:], record.output[2:], rtol=1e-9, atol=1e-9)


def test_a_diverging_free_run_does_not_overflow():
    record = simulated(23, n=5000)
    run = difference.simulate(record, Orders(1, 1), np.array([-1.5, 1.0]))
    assert np.isnan(run[-1])
    assert np.nanmax(np.abs(run)) < 1e5


def test_the_output_level_of_other_data_is_found():
    record = simulated(24, n=400, noise=0.0)
    moved = ArxRecord("m", record.time_s, record.source, record.output + 3.0)
    assert identified.about_own_level([moved], Orders(2, 2), TRUTH)[1] == pytest.approx(3.0, abs=1e-9)


def test_pole_uncertainty_matches_repeats():
    sizes, errors = [], []
    for seed in range(200):
        found = fit_arx([simulated(3000 + seed, n=500, a=np.array([-1.3, 0.4]))], Orders(2, 2))
        pole = difference.find_poles(found.theta[:2], found.covariance[:2, :2])[0]
        sizes.append(pole.magnitude)
        errors.append(pole.stderr_magnitude)
    assert np.mean(errors) == pytest.approx(np.std(sizes), rel=0.15)


def test_noise_free_data_do_not_favour_larger_orders():
    found = search_orders([simulated(27, noise=0.0)], 4, range(3))
    assert found[0][0] == Orders(2, 2, 1)


def test_time_stamps_are_placed_on_a_grid():
    time = np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.953, 1.053])
    assert sampling.rate(np.arange(100) * 0.02375).step_s == 0.02375
    parts = sampling.pieces(time, 0.1)
    assert [p.rows.tolist() for p in parts] == [[0, 1, 2, -1, 3, 4], [5, 6]]
    assert np.isnan(parts[0].take(np.arange(7.0))[3])
    late = np.arange(8) * 0.1
    late[4] += 0.045  # one stamp off: no cut
    assert len(sampling.pieces(late, 0.1)) == 1
    rng = np.random.default_rng(28)
    assert not sampling.rate(np.cumsum(rng.exponential(0.1, size=500))).uniform
    assert sampling.rate(np.round(np.arange(500) * 0.02375, 3)).uniform
    assert sampling.rate(np.round(np.arange(500) * 0.02375, 3)).step_s == pytest.approx(0.02375, rel=1e-3)


def test_the_search_with_weights_ends_where_the_weighted_gradient_vanishes():
    data = regression([simulated(18, c=(0.6,))], Orders(2, 2, nc=1))
    weights = np.random.default_rng(5).uniform(0.01, 1.0, len(data)) ** 2
    found = arx.refine(np.append(TRUTH, 0.0), data, weights)
    errors, gradient = arx.errors_and_gradient(found, data)
    slopes = gradient.T @ (weights * errors)
    root = np.sqrt(weights)
    sizes = np.linalg.norm(gradient * root[:, None], axis=0) * np.linalg.norm(errors * root)
    assert np.abs(slopes / sizes).max() < 1e-5
    assert found[4] == pytest.approx(0.6, abs=0.15)
