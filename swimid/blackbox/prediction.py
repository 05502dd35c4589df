"""What an ARX or ARMAX model predicts, how well, and what its coefficients mean.

One step ahead, k steps ahead, and the free run (simulation), which sees no output after its
start. Poles, stability and frequency response come with uncertainty by the delta method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from swimid.blackbox import armax
from swimid.blackbox.arx import ArxEstimate, regression
from swimid.blackbox.difference import Orders, Pole, Record, best_level, lagged, simulate, simulate_all
from swimid.errors import NoTrustworthyResult
from swimid.fitting.metrics import Score, score


def predict(record: Record, orders: Orders, theta: np.ndarray, *, steps: int = 1) -> np.ndarray:
    """Return the prediction ``steps`` samples ahead, shape (n,).

    The input is known throughout; the output only up to the sample the prediction is made at, NaN where that
    is missing.
    """
    a, b, c = orders.split(theta)
    driven = np.zeros(len(record))
    for j, value in enumerate(b):
        driven = driven + value * lagged(record.source, orders.nk + j)
    errors = one_step_errors(record, orders, theta) if orders.nc else np.empty(0)
    # Before its first row a model with C knows no error; it takes zero, as the fit does.
    errors = np.nan_to_num(errors)
    done: list[np.ndarray] = []  # the predictions 1, 2, .. steps ahead so far
    for ahead in range(1, steps + 1):
        total = driven.copy()
        for i, value in enumerate(a, start=1):
            total -= value * lagged(done[ahead - i - 1] if ahead > i else record.output, i)
        for i in range(ahead, orders.nc + 1):
            total += c[i - 1] * np.nan_to_num(lagged(errors, i))
        done.append(total)
        if ahead > orders.na:
            done[ahead - orders.na - 1] = np.empty(0)  # no longer needed
    return done[-1]


def one_step_errors(record: Record, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """One-step errors on the record's samples, shape (n,); NaN where there is no whole row."""
    data = regression([record], orders)
    errors, _ = armax.errors_and_gradient(theta, data.rows, data.outputs, data.fresh, orders.nc)
    result = np.full(len(record), np.nan)
    result[data.sample] = errors
    return result


def about_own_level(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[list[Record], float]:
    """Return records relative to the output level about which they deviate, and that level.

    For a model of deviations on data with a working point of their own. The level is one number, best for the
    free run, so that ``y - level`` is simulated, initial samples included.
    """
    measured, run = simulate_all(records, orders, theta)
    _, raised = simulate_all([replace(r, output=r.output - 1.0) for r in records], orders, theta)
    level = best_level(measured, run, raised + 1.0)
    return [replace(r, output=r.output - level) for r in records], level


@dataclass(frozen=True)
class Scores:
    """Errors on one set of records.

    Attributes
    ----------
    strict : metrics.Score or None
        The free run at the level the fitted part predicts, where all else is about the data's
        own level.
    level : float
        That own level less the predicted one, unit of the output.
    """

    one_step: Score
    k_step: Score
    free_run: Score
    strict: Score | None
    level: float
    diverged: bool

    def as_dict(self, unit: str, steps: int) -> dict[str, Any]:
        """As the parameter file holds it."""
        block: dict[str, Any] = {
            "one_step": self.one_step.as_dict(unit),
            "k_step": {"steps": steps, **self.k_step.as_dict(unit)},
            "free_run": {**self.free_run.as_dict(unit), "diverged": self.diverged},
        }
        if self.strict is not None:
            block["free_run"]["level_shift"] = self.level
            block["free_run"]["at_predicted_level"] = self.strict.as_dict(unit)
        return block


def scores(records: list[Record], estimate: ArxEstimate, poles: list[Pole], horizon: int) -> Scores:
    """Return the errors one step ahead, ``horizon`` steps ahead and in free run.

    Raises
    ------
    NoTrustworthyResult
        When the records are shorter than the model looks back.
    """
    longest = max((len(r) for r in records), default=0)
    orders, theta = estimate.orders, estimate.theta
    if longest <= orders.lag:
        raise NoTrustworthyResult(
            f"a held-out part has {longest} samples, the model looks back over {orders.lag}",
            hint="hold out a larger share, or validate on a longer log",
        )
    measured = np.concatenate([r.output for r in records])
    one, many = (
        score(measured, np.concatenate([predict(r, orders, theta, steps=steps) for r in records]))
        for steps in (1, horizon)
    )
    runs = [simulate(r, orders, theta) for r in records]
    free = score(measured, np.concatenate(runs))
    at_risk = any(p.state != "stable" for p in poles)
    gave_up = any(
        np.isfinite(r.source[np.isfinite(run).nonzero()[0][-1] + 1 :]).any()
        for r, run in zip(records, runs, strict=True)
        if np.isfinite(run).any() and not np.isfinite(run[-1])
    )
    return Scores(one, many, free, None, 0.0, bool(at_risk and (gave_up or free.fit_percent < 0)))


def pooled(records: Sequence[Record], estimate: ArxEstimate) -> Score:
    """Return the free-run score over several records together."""
    return score(*simulate_all(records, estimate.orders, estimate.theta))


def held_out_scores(
    records: list[Record], estimate: ArxEstimate, poles: list[Pole], horizon: int, *, own_level: bool
) -> tuple[list[Record], Scores]:
    """Return held-out records with their errors.

    With ``own_level`` they are about their own level; their errors are those there and at the predicted one.
    """
    found = scores(records, estimate, poles, horizon)
    if not own_level:
        return records, found
    moved, level = about_own_level(records, estimate.orders, estimate.theta)
    return moved, replace(scores(moved, estimate, poles, horizon), strict=found.free_run, level=level)


def frequency_response(
    orders: Orders, theta: np.ndarray, covariance: np.ndarray, sample_time_s: float, omega_rad_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frequency response B / A with its standard errors.

    Parameters
    ----------
    theta, covariance : ndarray, shape (p,) and (p, p)
        Coefficients and their covariance.
    omega_rad_s : ndarray, shape (m,)

    Returns
    -------
    response : ndarray of complex, shape (m,)
    log_gain, phase_rad : ndarray, shape (m,)
        Standard errors of ln of the gain and of the phase, rad.
    """
    a, b, _ = orders.split(theta)
    backward = np.exp(-1j * np.asarray(omega_rad_s) * sample_time_s)
    denominator = 1.0 + sum(value * backward**i for i, value in enumerate(a, start=1))
    powers = [backward ** (orders.nk + j) for j in range(orders.nb)]
    numerator = sum(value * power for value, power in zip(b, powers, strict=True))
    # d ln G: -z^-i / A for a_i, z^-(nk+j) / B for b_j.
    gradient = np.array(
        [-(backward**i) / denominator for i in range(1, orders.na + 1)]
        + [power / numerator for power in powers]
    )
    used = covariance[: orders.na + orders.nb, : orders.na + orders.nb]

    def spread(part: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(np.einsum("im,ij,jm->m", part, used, part), 0.0))

    return numerator / denominator, spread(gradient.real), spread(gradient.imag)
