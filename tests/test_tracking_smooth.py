"""Filter and smoother compared with filterpy and with the statistics of noise."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from swimid.tracking import pose as module

pytestmark = pytest.mark.kernels


def _white_acceleration(rng, times, power):
    """Return exact draws of position and velocity of a body with white acceleration."""
    x, v = np.zeros(len(times)), np.zeros(len(times))
    for k in range(1, len(times)):
        dt = times[k] - times[k - 1]
        noise = power * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        kick = np.linalg.cholesky(noise) @ rng.normal(size=2)
        x[k] = x[k - 1] + v[k - 1] * dt + kick[0]
        v[k] = v[k - 1] + kick[1]
    return x, v


@pytest.mark.parametrize("order", [2, 3])
def test_filter_and_smoother_equal_filterpy(order):
    """Steps are uneven and samples are missing; the smoother of filterpy allows both."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.01, 0.08, 80))
    values = np.sin(times) + rng.normal(0, 0.02, 80)
    values[30:42] = np.nan
    variances = rng.uniform(1, 4, 80) * 4e-4
    q, start = 0.7, np.diag([1.0, 2.0, 3.0][:order])
    means, covariances, _ = module.kalman(times, values, variances, q, order, start)
    smooth, spread = module.rts(times, means, covariances, q, order)

    oracle = KalmanFilter(dim_x=order, dim_z=1)
    oracle.x = np.r_[values[0], np.zeros(order - 1)]
    oracle.P, oracle.H = start.copy(), np.eye(1, order)
    xs, ps, fs, qs = [], [], [], []
    for k, t in enumerate(times):
        dt = 0.0 if k == 0 else t - times[k - 1]
        # numerical integral of Van Loan, independent of the closed form under test
        s = np.linspace(0, dt, 2001)
        impulse = np.array([s ** (order - 1 - i) / np.prod(range(1, order - i)) for i in range(order)])
        oracle.F = np.array(
            [
                [dt ** (j - i) / np.prod(range(1, j - i + 1)) if j >= i else 0.0 for j in range(order)]
                for i in range(order)
            ]
        )
        oracle.Q = q * np.trapezoid(impulse[:, None, :] * impulse[None, :, :], s, axis=2)
        oracle.R = np.array([[variances[k]]])
        fs.append(oracle.F)
        qs.append(oracle.Q)
        oracle.predict()
        oracle.update(None if np.isnan(values[k]) else values[k])
        xs.append(oracle.x.copy().ravel())
        ps.append(oracle.P.copy())
    np.testing.assert_allclose(means, xs, atol=1e-8)
    np.testing.assert_allclose(covariances, ps, atol=1e-8)
    # filterpy takes the matrices of the step after k from Fs[k + 1].
    back, back_cov, _, _ = oracle.rts_smoother(np.array(xs), np.array(ps), fs, qs)
    np.testing.assert_allclose(smooth, back, atol=1e-6)
    np.testing.assert_allclose(spread, back_cov, atol=1e-6)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("missing", [(), (0, 1, 2), (1, 3, 4), (78, 79)])
def test_a_diffuse_start_does_not_lose_digits(order, missing):
    """Positions and velocities from a diffuse start equal the least-squares solution."""
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.02, 0.04, 80))
    values = np.sin(times) + rng.normal(0, 0.02, 80)
    values[[*range(30, 42), *missing]] = np.nan
    variances, q = rng.uniform(1, 4, 80) * 4e-4, 0.7
    start = module.make_start_covariance(order, 4e-4, 0.03)
    means, covariances, _ = module.kalman(times, values, variances, q, order, start)
    means, covariances = module.rts(times, means, covariances, q, order)
    # the information of all states is the sum over start, steps and measurements
    seen = np.flatnonzero(~np.isnan(values))
    information = np.zeros((80 * order, 80 * order))
    wanted = np.zeros(80 * order)
    information[:order, :order] = np.linalg.inv(start)
    wanted[:order] = information[:order, 0] * values[seen[0]]
    for k, (transition, noise) in enumerate(zip(*module.compute_steps(times, q, order), strict=True)):
        both = np.hstack([-transition, np.eye(order)])
        here = slice(k * order, (k + 2) * order)
        information[here, here] += both.T @ np.linalg.inv(noise) @ both
    for k in seen:
        information[k * order, k * order] += 1 / variances[k]
        wanted[k * order] += values[k] / variances[k]
    exact = np.linalg.inv(information)
    for state in range(2):
        deviation = np.sqrt(np.diag(exact)[state::order])
        np.testing.assert_allclose(
            means[:, state] / deviation, (exact @ wanted)[state::order] / deviation, atol=1e-3
        )
        np.testing.assert_allclose(np.sqrt(covariances[:, state, state]) / deviation, 1.0, atol=1e-3)


def test_the_noise_is_recovered_and_errors_agree_with_it():
    """The likelihood estimates both noises within 20 %, and normalised errors have a size of one."""
    rng = np.random.default_rng(11)
    times = np.cumsum(rng.choice([0.02, 0.033, 0.05], 3000))
    x, v = _white_acceleration(rng, times, 0.5)
    values = x + rng.normal(0, 0.01, len(times))
    out = module.smooth_path(times, values[None], np.ones(len(times)), [(0, len(times))])
    assert out.order == 2
    assert out.measurement_sd == pytest.approx(0.01, rel=0.2)
    assert out.process_noise == pytest.approx(0.5, rel=0.35)
    inner = slice(20, -20)
    for error, sd in (
        ((out.position[0] - x)[inner], out.position_sd[0][inner]),
        ((out.velocity[0] - v)[inner], out.velocity_sd[0][inner]),
    ):
        assert np.sqrt(np.mean((error / sd) ** 2)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("longer", [1.0, 1000.0])
@pytest.mark.parametrize("slower", [1.0, 50.0])
def test_a_smoothed_path_does_not_depend_on_units(longer, slower):
    """Bursts of strokes between glides, with a gap in a burst, in m or mm and in s or frames."""
    rng = np.random.default_rng(4)
    times = np.arange(300) / 50
    truth = np.where(times % 3 < 2, 0.0, np.sin(4 * np.pi * times))
    values = truth + rng.normal(0, 0.01, (1, 300))
    values[:, 100:104] = values[:, 250:270] = np.nan
    plain = module.smooth_path(times, values, np.ones(300), [(0, 150), (150, 300)])
    found = module.smooth_path(slower * times, longer * values, np.ones(300), [(0, 150), (150, 300)])
    np.testing.assert_allclose(found.position, longer * plain.position, rtol=1e-5, atol=1e-6 * longer)
    np.testing.assert_allclose(found.position_sd, longer * plain.position_sd, rtol=1e-4)
    np.testing.assert_allclose(found.velocity_sd, longer / slower * plain.velocity_sd, rtol=1e-4)
    assert found.measurement_sd == pytest.approx(longer * plain.measurement_sd, rel=1e-5)
