"""The working point: when the means must be removed before a linear model is fitted.

A model without a constant term describes deviations. Data recorded around a working point
(20 degrees, half throttle) need it removed; data that obey the model as they stand must not
be touched, or the estimate would change for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from swimid.blackbox.arx import EXACT, Regression, covariance, directions, regression
from swimid.blackbox.difference import INTEGRATING, Orders, Record, poles, simulate_all
from swimid.fitting import noise as rt

#: |t| of a constant term from which on the working point is removed.
CLEAR_T = 5.0
#: |t| that is enough when the free run gains clearly. By chance alone, data that need no constant
#: reach both less than once in a hundred records, those of slow systems included.
LIKELY_T = 3.5
#: |t| that is enough where the data sit far from zero and the free run gains at all. There a
#: missing constant hides in the other coefficients (A(1) goes to zero: a pole at 1 that is not
#: in the robot), and shows weakly or not at all in t.
WEAK_T = 2.0
#: Gain of the free run, as a share of its error, that is clear.
CLEAR_GAIN = 0.1
#: Mean of the output over its standard deviation from which on that counts as far.
FAR = 3.0


@dataclass(frozen=True)
class WorkingPoint:
    """Means removed from the data, and why.

    Attributes
    ----------
    source, output : float
        Removed from u and y; zero where nothing was removed.
    constant, t : float
        The constant term of the regression on raw data (NaN where it was not tested), and over its standard
        error.
    removed : bool
    """

    source: float
    output: float
    constant: float
    t: float
    removed: bool


def centre(records: Sequence[Record], orders: Orders, mode: str = "auto") -> WorkingPoint:
    """Decide whether the working point must be removed; ``records`` are the fit part.

    Mode ``auto`` removes the means when a constant term beside A and B has a t value above
    :data:`CLEAR_T` in size, or above :data:`LIKELY_T` when the free run over the fit part gets
    better by :data:`CLEAR_GAIN`. Where the output's mean is more than :data:`FAR` deviations
    from zero, it also does when the free run gets better by that much whatever t is, at all
    with t above :data:`WEAK_T`, or when a pole at 1 of the raw model goes away by it. Data
    without an offset stay as they are. ``none`` and ``mean``: never, and always.
    """
    source, output = _mean([r.source for r in records]), _mean([r.output for r in records])
    data = regression(records, replace(orders, nc=0))
    constant, t = _constant(data)
    point = WorkingPoint(source, output, constant, t, True)
    removed = mode != "none"
    level = float(np.sqrt(np.mean(data.outputs**2))) if len(data) else 0.0
    size = abs(t) if abs(constant) > EXACT * level else 0.0
    if mode == "auto" and size <= CLEAR_T:
        far = len(data) > 0 and abs(output) > FAR * float(np.std(data.outputs))
        worth_trying = len(data) > orders.count and (far or size > LIKELY_T)
        removed = worth_trying and _helps(records, orders, point, far=far, likely=size > WEAK_T)
    return point if removed else WorkingPoint(0.0, 0.0, constant, t, False)


def _helps(
    records: Sequence[Record], orders: Orders, point: WorkingPoint, *, far: bool, likely: bool
) -> bool:
    """Whether removing the working point betters the free run, or takes away a spurious integrator.

    ``far`` and ``likely``: the output sits far from zero; a constant term is likely.
    """
    plain = replace(orders, nc=0)
    rms, largest = [], []
    for part in (list(records), shifted(records, point)):
        data = regression(part, plain)
        theta = np.linalg.lstsq(data.rows, data.outputs, rcond=None)[0]
        errors = np.subtract(*simulate_all(part, plain, theta))
        rms.append(float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else float("inf"))
        roots = poles(theta[: orders.na], None, 1.0)
        largest.append(roots[0].magnitude if roots else 0.0)
    if far and largest[0] > INTEGRATING >= largest[1]:
        return True
    return rms[1] < rms[0] * (1.0 if far and likely else 1.0 - CLEAR_GAIN)


def _mean(parts: list[np.ndarray]) -> float:
    values = np.concatenate(parts) if parts else np.empty(0)
    values = values[np.isfinite(values)]
    return float(np.mean(values)) if len(values) else 0.0


def _constant(data: Regression) -> tuple[float, float]:
    """Constant term beside the regression (NaN where undetermined), and that over its standard error."""
    n, p = data.rows.shape
    rows = np.hstack((data.rows, np.ones((n, 1))))
    if n <= p + 1 or not directions(rows, np.zeros(p + 1)).determined[-1]:
        return float("nan"), 0.0
    theta = np.linalg.lstsq(rows, data.outputs, rcond=None)[0]
    residuals = data.outputs - rows @ theta
    white = rt.ljung_box(data.spread(residuals, gap=rt.default_lags(n))).passed
    spread, _ = covariance(rows, residuals, np.ones(n), 0.0, None if white else data)
    constant, stderr = float(theta[-1]), float(np.sqrt(max(spread[-1, -1], 0.0)))
    if stderr > 0:
        return constant, constant / stderr
    return constant, 0.0 if constant == 0 else float("inf")


def shifted(records: Sequence[Record], point: WorkingPoint) -> list[Record]:
    """The records relative to a working point; the given ones are not touched."""
    if not point.removed:
        return list(records)
    return [replace(r, source=r.source - point.source, output=r.output - point.output) for r in records]
