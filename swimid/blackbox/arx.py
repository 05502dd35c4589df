"""ARX and ARMAX models from records with gaps: regression, noise polynomial, estimate, uncertainty.

The model is that of :mod:`swimid.blackbox.difference`. A row of the regression exists only where every
sample it needs is there; a gap costs the rows around it and nothing else. See L. Ljung, "System
Identification: Theory for the User", 2nd ed. (1999), ch. 7-9, 11.

The noise polynomial C is searched for the least one-step error by Gauss-Newton steps. statsmodels' SARIMAX
can be given the same rows, as regressors of a moving average, with a Kalman filter across the gaps. On 60
records of 600 samples of an ARMAX(2, 2, nc 2) model its estimates are as good (as much as 13 % less scatter
of one coefficient with 30 % of the samples missing, none without gaps), it takes 40 to 70 times as long, one
in ten does not converge, and it cannot discount old samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from swimid.blackbox import recursive
from swimid.blackbox.difference import Orders, Record, lagged
from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as rt
from swimid.logs.sampling import rounding

#: Zeros of C are kept this far inside the unit circle, where its inverse is stable.
EDGE = 0.999
#: Gauss-Newton steps, at most.
MOST_STEPS = 100


@njit(cache=True, error_model="numpy")
def errors_and_gradient(
    theta: np.ndarray, rows: np.ndarray, outputs: np.ndarray, fresh: np.ndarray, nc: int
) -> tuple[np.ndarray, np.ndarray]:
    """One-step errors of an ARMAX model and the derivative of its prediction.

    Parameters
    ----------
    theta : ndarray, shape (m + nc,)
        Coefficients of A, B and C.
    rows, outputs : ndarray, shape (n, m) and (n,)
        Regression vectors of A and B, and z.
    fresh : ndarray of bool, shape (n,)
        True where a row does not continue the one before: the past errors are taken as zero.

    Returns
    -------
    errors : ndarray, shape (n,)
        ``e(k) = z(k) - h(k)' theta_AB - sum_j c_j e(k-j)``.
    gradient : ndarray, shape (n, m + nc)
        Minus its derivative: the regression vector filtered by 1 / C.
    """
    n, m = rows.shape
    p = m + nc
    errors = np.zeros(n)
    gradient = np.zeros((n, p))
    start = 0
    for k in range(n):
        if fresh[k]:
            start = k
        past = min(k - start, nc)
        error = outputs[k]
        for i in range(m):
            error -= rows[k, i] * theta[i]
            gradient[k, i] = rows[k, i]
        for j in range(past):
            error -= errors[k - 1 - j] * theta[m + j]
            gradient[k, m + j] = errors[k - 1 - j]
        for j in range(past):
            for i in range(p):
                gradient[k, i] -= theta[m + j] * gradient[k - 1 - j, i]
        errors[k] = error
    return errors, gradient


def invertible(c: np.ndarray) -> np.ndarray:
    """C with its zeros outside the unit circle mirrored to the inside."""
    roots = np.roots(np.concatenate(([1.0], c)))
    size = np.abs(roots)
    roots = np.where(size > 1, roots / np.maximum(size, 1.0) ** 2, roots)
    size = np.abs(roots)
    roots = np.where(size > EDGE, roots / np.maximum(size, EDGE) * EDGE, roots)
    # np.roots drops leading zeros of the reversed polynomial: a trailing c of zero stays zero.
    coefficients = np.real(np.poly(roots))[1:]
    return np.concatenate((coefficients, np.zeros(len(c) - len(coefficients))))


def refine(
    theta: np.ndarray,
    rows: np.ndarray,
    outputs: np.ndarray,
    fresh: np.ndarray,
    nc: int,
    weights: np.ndarray,
) -> np.ndarray:
    """The coefficients of least weighted one-step error, from those of the extended recursion.

    Gauss-Newton with step halving; C is kept invertible. See :func:`errors_and_gradient`; ``weights`` are
    those of the squared errors, shape (n,).

    Raises
    ------
    NoTrustworthyResult
        When the search does not converge.
    """
    m = rows.shape[1]
    root = np.sqrt(weights)

    def cost(candidate: np.ndarray) -> float:
        errors, _ = errors_and_gradient(candidate, rows, outputs, fresh, nc)
        total = float(np.sum(weights * errors**2))
        return total if np.isfinite(total) else float("inf")

    best = np.concatenate((theta[:m], invertible(theta[m:])))
    value = cost(best)
    for _ in range(MOST_STEPS):
        errors, gradient = errors_and_gradient(best, rows, outputs, fresh, nc)
        step = np.linalg.lstsq(gradient * root[:, None], errors * root, rcond=None)[0]
        for halving in range(30):
            candidate = best + step / 2**halving
            candidate[m:] = invertible(candidate[m:])
            tried = cost(candidate)
            if tried < value:
                break
        else:
            return best  # no step makes it smaller: the minimum, to rounding
        gained = value - tried
        best, value = candidate, tried
        if gained <= 1e-13 * value:
            return best
    raise NoTrustworthyResult(
        f"the noise polynomial C did not converge in {MOST_STEPS} steps",
        hint="lower --nc, or give longer logs",
    )


def warm_up() -> None:
    """Compile the kernels of this module."""
    errors_and_gradient(np.zeros(2), np.ones((3, 1)), np.ones(3), np.array([True, False, False]), 1)


#: Residuals below this share of the output's deviation are rounding, not noise.
EXACT = 1e-9
#: A singular value of the scaled regression below this share of the largest is zero.
RANK_TOLERANCE = 1e-10
#: Rounding never empties a direction whose singular value is above this share of the largest.
ROUNDING_LIMIT = 0.01
#: Variance inflation (scaled columns) from which on columns count as nearly dependent: standard
#: errors a hundred times those of independent columns.
NEARLY_DEPENDENT = 1e4


@dataclass(frozen=True)
class Regression:
    """The rows of ``z = H theta + e``, for A and B (C has no data columns).

    Attributes
    ----------
    rows, outputs : ndarray, shape (n, na + nb) and (n,)
        H and z.
    record, sample : ndarray of int, shape (n,)
        Which record and which of its samples each row predicts.
    fresh : ndarray of bool, shape (n,)
        True where a row does not continue the one before.
    possible : int
        Number of rows without any missing sample or gap.
    """

    rows: np.ndarray
    outputs: np.ndarray
    record: np.ndarray
    sample: np.ndarray
    fresh: np.ndarray
    possible: int

    def __len__(self) -> int:
        return len(self.outputs)

    def spread(self, values: np.ndarray, *, gap: int) -> np.ndarray:
        """Values of the rows, shape (n,) or (n, p), on the time grid: NaN where a row is missing.

        Between records there are ``gap`` samples of NaN.
        """
        if len(self) == 0:
            return np.asarray(values, dtype=float)
        lengths = [int(self.sample[self.record == i].max()) + 1 for i in np.unique(self.record)]
        starts = np.cumsum([0] + [length + gap for length in lengths])
        _, order = np.unique(self.record, return_inverse=True)
        shape = (int(starts[-1]), *np.shape(values)[1:])
        result = np.full(shape, np.nan)
        result[starts[order] + self.sample] = values
        return result


def columns(record: Record, orders: Orders) -> np.ndarray:
    """The regression vectors of every sample of a record, NaN where they are not whole.

    ``[-y(k-1) .. -y(k-na), u(k-nk) .. u(k-nk-nb+1)]`` (Eq 7), shape (n, na + nb).
    """
    past = [-lagged(record.output, i) for i in range(1, orders.na + 1)]
    return np.column_stack(past + [lagged(record.source, orders.nk + j) for j in range(orders.nb)])


def regression(records: Sequence[Record], orders: Orders) -> Regression:
    """Every whole row of several records of one rate; C plays no part."""
    none = np.empty(0, dtype=int)
    rows, outputs, number, sample = [np.empty((0, orders.na + orders.nb))], [np.empty(0)], [none], [none]
    possible = 0
    for i, record in enumerate(records):
        h = columns(record, orders)
        whole = np.isfinite(record.output) & np.isfinite(h).all(axis=1)
        k = np.flatnonzero(whole)
        possible += max(len(record) - orders.lag, 0)
        rows.append(h[k])
        outputs.append(record.output[k])
        number.append(np.full(len(k), i))
        sample.append(k)
    record_of, samples = np.concatenate(number), np.concatenate(sample)
    fresh = np.ones(len(samples), dtype=bool)
    fresh[1:] = (np.diff(record_of) != 0) | (np.diff(samples) != 1)
    return Regression(np.vstack(rows), np.concatenate(outputs), record_of, samples, fresh, possible)


@dataclass(frozen=True)
class Identifiability:
    """Which parameters a regression determines.

    Attributes
    ----------
    determined : ndarray of bool, shape (p,)
    rank, input_rank : int
        Number of determined directions, and of those that the input columns alone excite (the order of
        excitation).
    condition : float
        Condition number of the determined part with columns scaled to length one.
    factor : ndarray, shape (p, p)
        R of the scaled regression's QR factors.
    """

    determined: np.ndarray
    rank: int
    condition: float
    factor: np.ndarray
    input_rank: int = 0


def directions(rows: np.ndarray, steps: np.ndarray) -> Identifiability:
    """Find the directions in which a regression says nothing.

    Parameters
    ----------
    rows : ndarray, shape (n, p)
    steps : ndarray, shape (p,)
        Rounding step of each column as it was logged.

    Notes
    -----
    Singular values of the regression with columns scaled to length one. The rounding of n
    samples with step q adds a column of length ``q sqrt(n / 12)`` to each; a direction v is
    empty when its singular value is below three times the length of that in its direction,
    and below :data:`ROUNDING_LIMIT` of the largest: a well-conditioned regression is never empty.
    """
    n, p = rows.shape
    scale = _lengths(rows)
    factor = np.asarray(np.linalg.qr(rows / scale, mode="r"))
    _, singular, vectors = np.linalg.svd(factor, full_matrices=True)
    singular = np.append(singular, np.zeros(p - len(singular)))
    largest = max(singular[0], 1e-300)
    noise = np.minimum(3.0 * np.sqrt(vectors**2 @ (steps**2 * n / 12 / scale**2)), ROUNDING_LIMIT * largest)
    empty = singular <= np.maximum(RANK_TOLERANCE * largest, noise)
    # A parameter is undetermined when an empty direction has a real part of it.
    share = np.sum(vectors[empty] ** 2, axis=0) if np.any(empty) else np.zeros(p)
    smallest = singular[~empty][-1] if np.any(~empty) else 0.0
    condition = float(singular[0] / smallest) if smallest > 0 else float("inf")
    return Identifiability(share < 1e-3, int(np.count_nonzero(~empty)), condition, factor)


def _lengths(rows: np.ndarray) -> np.ndarray:
    """Lengths of the columns, 1 for those of zeros."""
    length = np.linalg.norm(rows, axis=0)
    return np.where(length > 0, length, 1.0)


def identifiability(data: Regression, orders: Orders, quanta: tuple[float, float]) -> Identifiability:
    """What the rows of A and B determine; of C, all. ``quanta``: rounding step of input and output."""
    steps = np.concatenate((np.full(orders.na, quanta[1]), np.full(orders.nb, quanta[0])))
    both = directions(data.rows, steps)
    inputs = directions(data.rows[:, orders.na :], steps[orders.na :])
    determined = np.append(both.determined, np.ones(orders.nc, dtype=bool))
    return replace(both, determined=determined, input_rank=inputs.rank)


def without_indistinct(
    known: Identifiability,
    data: Regression,
    orders: Orders,
    theta: np.ndarray,
    stderr: np.ndarray,
    noise_sd: float,
) -> Identifiability:
    """Leave out coefficients the noise does not let tell apart, though the regression has full rank.

    Sensor noise on a single sine excites every coefficient of B a little, and their estimates
    become huge numbers that cancel. A coefficient of A or B is one of those when its column
    is nearly dependent on the others (:data:`NEARLY_DEPENDENT`) and its standard error alone moves
    the prediction by more than the whole polynomial does; they are left out together when
    the standard error of any is above half its size. A coefficient that is known to be small stays.
    """
    count = orders.na + orders.nb
    inflation = np.sum(np.linalg.pinv(known.factor) ** 2, axis=1)
    length = np.linalg.norm(data.rows, axis=0)
    determined = known.determined.copy()
    rank, input_rank = known.rank, known.input_rank
    for block in (slice(0, orders.na), slice(orders.na, count)):
        effect = float(np.linalg.norm(data.rows[:, block] @ theta[block]))
        lost = determined[block] & (inflation[block] > NEARLY_DEPENDENT)
        lost &= stderr[block] * length[block] > effect
        if not np.any(stderr[block][lost] > 0.5 * np.abs(theta[block][lost])):
            continue
        determined[block] &= ~lost
        scaled = data.rows[:, block] / _lengths(data.rows[:, block])
        singular = np.linalg.svd(np.linalg.qr(scaled, mode="r"), compute_uv=False)
        empty = int(np.clip(np.count_nonzero(noise_sd > effect * singular), 1, len(singular) - 1))
        rank = min(rank, count - max(empty, 1))
        if block.stop == count:
            input_rank = min(input_rank, orders.nb - empty)
    return replace(known, determined=determined, rank=rank, input_rank=input_rank)


@dataclass(frozen=True)
class ArxEstimate:
    """A fitted model.

    Attributes
    ----------
    theta, stderr : ndarray, shape (p,)
        Coefficients and standard errors; NaN for a parameter the data do not determine.
    covariance : ndarray, shape (p, p)
    noise_sd : float
        Standard deviation of e.
    residuals : ndarray, shape (n,)
        One-step errors of the final model at every row, z - h' theta.
    whiteness : residual_tests.TestResult
        Of the one-step errors (with forgetting: of the recursion's innovations).
    robust : bool
        Whether the covariance is the sandwich for correlated residuals.
    exact : bool
        Whether the residuals are no more than rounding.
    """

    orders: Orders
    theta: np.ndarray
    stderr: np.ndarray
    covariance: np.ndarray
    noise_sd: float
    residuals: np.ndarray
    data: Regression
    recursion: recursive.Recursion
    determined: Identifiability
    whiteness: rt.TestResult
    robust: bool
    exact: bool

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the parameters the data determine, shape (m, m)."""
        use = self.determined.determined
        sd = self.stderr[use]
        sd = np.where(sd > 0, sd, 1.0)
        matrix = self.covariance[np.ix_(use, use)] / np.outer(sd, sd)
        np.fill_diagonal(matrix, 1.0)
        return np.clip(matrix, -1.0, 1.0)


def check_enough(data: Regression, orders: Orders) -> None:
    """Refuse a regression that cannot give a result.

    Raises
    ------
    NoTrustworthyResult
        Fewer usable rows than parameters plus one, or an output that never changes.
    """
    if len(data) <= orders.count:
        text = f"{len(data)} usable rows for {orders.count} parameters ({orders})"
        hint = "a row needs na outputs and nb inputs without a gap: give longer logs or lower orders"
        raise NoTrustworthyResult(f"{text}; at least {orders.count + 1} are needed", hint=hint)
    span = float(np.ptp(data.outputs))
    if span <= 1e-12 * float(np.max(np.abs(data.outputs), initial=0.0)) or span == 0:
        text = f"the output is constant ({data.outputs[0]:.6g}) in all {len(data)} usable rows"
        raise NoTrustworthyResult(f"{text}: there is nothing to identify")


def estimate(
    records: Sequence[Record],
    orders: Orders,
    *,
    weight: float = 1.0,
    forgetting: float = 1.0,
    prior_scale: float = recursive.PRIOR_SCALE,
    stride: int = 1,
) -> ArxEstimate:
    """Fit a model to one or several records.

    Parameters
    ----------
    records : sequence of Record
        All at the same rate, working point removed where there is one
        (:func:`swimid.blackbox.identified.centre`).
    weight, forgetting, prior_scale, stride
        See :func:`swimid.blackbox.recursive.recursive_least_squares`. The recursion runs
        through the records one after the other.

    Raises
    ------
    NoTrustworthyResult
        Too few rows, a constant output, or a regression that determines no parameter of A
        and B, or nothing of the input's effect.

    Notes
    -----
    With ``nc`` = 0 theta is the recursion's last estimate, equal to batch weighted least
    squares with the prior. With ``nc`` > 0 the extended recursion gives the start of a
    Gauss-Newton search for the least one-step error (:func:`refine`), whose
    standard errors are known.

    Standard errors: with weights w_k = forgetting^(n-1-k), J the derivative of the one-step
    prediction and S = J'WJ + prior, the covariance is ``sigma^2 S^-1 (J'W^2 J) S^-1``; where the
    residuals are not white, ``S^-1 M S^-1`` with M of
    :func:`swimid.fitting.noise.long_run_covariance`.
    """
    data = regression(records, orders)
    check_enough(data, orders)
    quanta = (max(rounding(r.source) for r in records), max(rounding(r.output) for r in records))
    known = identifiability(data, orders, quanta)
    _check_determined(known, orders)
    padded = np.hstack((data.rows, np.zeros((len(data), orders.nc))))
    run = recursive.recursive_least_squares(
        padded,
        data.outputs,
        weight=weight,
        forgetting=forgetting,
        prior_scale=prior_scale,
        noise_terms=orders.nc,
        fresh=data.fresh,
        stride=stride,
    )
    # Ages in rows: forgetting counts rows, not gaps.
    weights = forgetting ** np.arange(len(data) - 1, -1, -1.0)
    theta = run.theta
    if orders.nc:
        theta = refine(theta, data.rows, data.outputs, data.fresh, orders.nc, weights)
        residuals, jacobian = errors_and_gradient(theta, data.rows, data.outputs, data.fresh, orders.nc)
    else:
        residuals, jacobian = data.outputs - data.rows @ theta, data.rows
    prior = forgetting ** (len(data) - 1) / (weight * prior_scale**2)
    tested = residuals
    if forgetting < 1:
        settled = min(int(max(5 * orders.count, 1 / (1 - forgetting))), len(data) // 2)
        tested = np.where(np.arange(len(data)) < settled, np.nan, run.innovations)
    deviation = float(np.std(data.outputs))
    exact = float(np.sqrt(np.mean(residuals**2))) <= EXACT * deviation
    gap = rt.default_lags(len(data))
    white = rt.ljung_box(data.spread(tested, gap=gap), fitted=orders.na + orders.nc)
    robust = not (white.passed or exact)
    matrix, noise_sd = covariance(jacobian, residuals, weights, prior, data if robust else None)
    stderr = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    known = without_indistinct(known, data, orders, theta, stderr, noise_sd)
    _check_determined(known, orders)
    stderr = np.where(known.determined, stderr, np.nan)
    return ArxEstimate(
        orders, theta, stderr, matrix, noise_sd, residuals, data, run, known, white, robust, exact
    )


def _check_determined(known: Identifiability, orders: Orders) -> None:
    if not np.any(known.determined[: orders.na + orders.nb]):
        text = (
            f"the regression is singular: its columns span {known.rank} of {orders.na + orders.nb} directions"
        )
        hint = "lower the orders, or excite the robot with more than one frequency"
        raise NoTrustworthyResult(f"{text}, and no coefficient of the model is determined", hint=hint)
    if known.input_rank == 0:
        text = "the input does not move: nothing can be said of its effect"
        raise NoTrustworthyResult(text, hint="check the input column, or give --input-model")


def covariance(
    jacobian: np.ndarray,
    residuals: np.ndarray,
    weights: np.ndarray,
    prior: float,
    correlated: Regression | None,
) -> tuple[np.ndarray, float]:
    """Covariance of a least-squares estimate and standard deviation of its noise.

    With ``correlated`` (the regression the rows belong to) it is the sandwich for correlated
    residuals; see the notes of :func:`estimate`.
    """
    n, p = jacobian.shape
    root = np.sqrt(weights)[:, None]
    r = np.linalg.qr(np.vstack((jacobian * root, np.sqrt(prior) * np.eye(p))), mode="r")
    inverse = np.linalg.pinv(r)
    whitened = (jacobian * weights[:, None]) @ inverse
    middle = whitened.T @ whitened
    # Samples that remain for the noise after p parameters; n - p without forgetting.
    remaining = max(float(np.sum(weights)) - float(np.trace(middle)), 1e-12)
    variance = float(np.sum(weights * residuals**2)) / remaining
    if correlated is None:
        middle = middle * variance
    else:
        scores = correlated.spread(whitened * residuals[:, None], gap=rt.default_lags(n))
        middle = rt.long_run_covariance(scores) * (n / max(n - p, 1))
    matrix = inverse @ middle @ inverse.T
    return (matrix + matrix.T) / 2, float(np.sqrt(variance))
