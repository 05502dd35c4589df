"""Recursive weighted least squares, and the estimation of ARX and ARMAX models from records with gaps.

The recursion is Eq 9 of the long-fin paper [1]_,

    K(k)     = P(k-1) h(k) / (h(k)' P(k-1) h(k) + 1 / weight)
    theta(k) = theta(k-1) + K(k) (z(k) - h(k)' theta(k-1))
    P(k)     = (I - K(k) h(k)') P(k-1)          [divided by ``forgetting`` afterwards]

with P(0) = a^2 I. The recursion updates the factors U D U' of P instead of P (Bierman [2]_). The results
are the same, P stays symmetric and positive definite, and a large value of a causes no loss of digits.

``weight`` is constant and multiplies every row. The result equals ordinary least squares with the prior P(0)
scaled by ``weight``. Old samples are discounted only if ``forgetting`` is below 1.

The model is defined in :mod:`swimid.blackbox.model`. The regression has a row for each output sample whose
past samples are all known, so that only the rows around a gap are lost. See L. Ljung, "System Identification:
Theory for the User", 2nd ed. (1999), ch. 7-9 and 11.

The coefficients of the noise polynomial C minimise the squared one-step errors (Gauss-Newton). SARIMAX of
statsmodels is an alternative, with a Kalman filter across the gaps. On 60 simulated records of 600 samples of
an ARMAX(2, 2, nc 2) model, both methods are about equally accurate: with 30 % of the samples missing, SARIMAX
reduces the standard deviation of one coefficient by 13 %, and without gaps the standard deviations are equal.
SARIMAX takes 40 to 70 times as long, one search in ten does not converge, and old samples cannot be
discounted.

References
----------
.. [1] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic
   underwater vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, Eq 6-9.
   doi:10.1017/S0263574711001159
.. [2] G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), ch. 5.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from swimid.blackbox.model import ArxRecord, Orders, delay_series
from swimid.errors import NoTrustworthyResult
from swimid.files.kernels import numba
from swimid.fitting import uncertainty as rt
from swimid.logs.sampling import rounding

#: Maximum magnitude of a zero of the noise polynomial C. Below 1 the filter 1 / C, which computes the
#: one-step errors, is stable.
MAX_ZERO = 0.999
#: Number of missing samples that are inserted where records are joined, in addition to the lags of the model.
#: It exceeds the lags of all residual tests, so that no test relates samples of different records.
GAP = 100
#: Maximum number of Gauss-Newton steps in the search for the coefficients of an ARMAX model, and maximum
#: number of halvings of one step.
MAX_STEPS, MAX_HALVINGS = 100, 30
#: Maximum ratio of the root-mean-square residual to the standard deviation of the output at which the data
#: are assumed to be free of noise. The residuals are then rounding errors.
EXACT = 1e-9
#: Limit below which a singular value of the scaled regression matrix counts as zero, as a fraction of the
#: largest singular value.
REGRESSOR_RTOL = 1e-10
#: Limit above which a singular value of the scaled regression matrix counts as information even if the data
#: are coarsely rounded, as a fraction of the largest singular value.
MAX_ROUNDING = 0.01
#: Minimum share of a coefficient in the directions about which the data have no information, at which the
#: coefficient is not identifiable. The share is the sum of its squared components in these directions. It is
#: 1 if the data have no information about the coefficient at all.
MIN_COMBINATION_SHARE = 1e-3
#: Minimum variance inflation factor at which a column of a regression counts as nearly dependent on the other
#: columns. The standard error of its coefficient is then 100 times that of an independent column.
NEARLY_DEPENDENT = 1e4
#: Default value of ``a`` in the initial matrix P(0) = a^2 I of recursive least squares. The long-fin paper
#: recommends values above 10^3.
PRIOR_SCALE = 1e6
#: Maximum of the elements of the factor D of the matrix P = U D U' in recursive least squares, in units of
#: a^2 of P(0) = a^2 I. Without a limit, forgetting lets P grow in directions that the input does not excite.
#: In excited directions D stays below this limit.
MAX_GROWTH = 1e6


@dataclass(frozen=True)
class Recursion:
    """Result of recursive least squares over n rows with p coefficients."""

    #: Estimate of the coefficients after the last row, shape (p,).
    theta: np.ndarray
    #: Matrix P of the recursion after the last row, shape (p, p). Without forgetting, the covariance of the
    #: estimate is P multiplied by the noise variance and the weight.
    covariance: np.ndarray
    #: One-step prediction errors ``z(k) - h(k)' theta(k-1)`` of the rows, shape (n,).
    innovations: np.ndarray
    #: Number of rows after which an element of the factor D of P = U D U' was limited by :data:`MAX_GROWTH`.
    limited: int


def recursive_least_squares(
    regressors: np.ndarray,
    outputs: np.ndarray,
    *,
    weight: float = 1.0,
    forgetting: float = 1.0,
    prior_scale: float = PRIOR_SCALE,
) -> Recursion:
    """Estimate theta in ``outputs = regressors @ theta + noise`` by recursive least squares.

    The recursion starts from theta(0) = 0.

    Parameters
    ----------
    regressors : ndarray, shape (n, p)
        Regression vectors; row k is h(k)'. All elements must be finite.
    outputs : ndarray, shape (n,)
        Outputs z; all elements must be finite.
    weight : float
        Weight of every row (lambda in the paper), above 0.
    forgetting : float
        Factor by which P is divided after every row, above 0 and at most 1.
    prior_scale : float
        Value of a in P(0) = a^2 I, above 0.

    Raises
    ------
    ValueError
        A regressor or an output is not finite.

    Examples
    --------
    >>> h = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    >>> recursive_least_squares(h, np.array([1.0, 3.0, 5.0])).theta.round(6)
    array([1., 2.])
    """
    h, z = np.ascontiguousarray(regressors, dtype=float), np.ascontiguousarray(outputs, dtype=float)
    if not (np.isfinite(z).all() and np.isfinite(h).all()):
        raise ValueError("regressors and outputs must be finite; leave rows with gaps out")
    theta, factors, diagonal, innovations, limited = _run(
        h, z, 1.0 / weight, 1.0 / forgetting, prior_scale**2
    )
    covariance = (factors.T * diagonal) @ factors
    return Recursion(theta, covariance, innovations, limited)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
def _run(h, z, variance, growth, prior):  # type: ignore[no-untyped-def]
    """Run recursive least squares over all rows of a regression in one compiled loop.

    The loop calls no functions, because calls would cost time. Row j of ``factors`` holds column j of the
    factor U of P = U D U'.
    """
    n, p = h.shape
    ceiling = MAX_GROWTH * prior
    theta = np.zeros(p)
    factors, diagonal = np.eye(p), np.full(p, prior)
    innovations = np.empty(n)
    gain, f = np.empty(p), np.empty(p)
    limited = 0
    for k in range(n):
        # Compute the one-step prediction error (innovation) of row k, and the vector f = U' h.
        error = z[k]
        for j in range(p):
            error -= h[k, j] * theta[j]
            total = h[k, j]
            for i in range(j):
                total += factors[j, i] * h[k, i]
            f[j] = total
        # Update the factors U and D of P = U D U' column by column (Bierman).
        alpha = variance
        for j in range(p):
            v = diagonal[j] * f[j]
            old = alpha
            alpha += f[j] * v
            inverse = 1.0 / alpha
            ratio = old * inverse
            diagonal[j] *= ratio
            push = -f[j] / old
            gain[j] = v
            for i in range(j):
                u = factors[j, i]
                factors[j, i] = u + gain[i] * push
                gain[i] += u * v
        step = error / alpha
        innovations[k] = error
        for j in range(p):
            theta[j] += gain[j] * step
        if growth > 1.0:
            held = False
            for j in range(p):
                diagonal[j] *= growth
                if diagonal[j] > ceiling:
                    diagonal[j] = ceiling
                    held = True
            limited += held
    return theta, factors, diagonal, innovations, limited


def warm_up() -> None:
    """Compile the numba function of this module before its first use."""
    recursive_least_squares(np.ones((2, 1)), np.ones(2))


@dataclass(frozen=True)
class Regression:
    """Linear regression ``z = H theta + e`` for the coefficients of A and B of an ARX or ARMAX model.

    The columns of H are measured past outputs and inputs. H has no columns for the coefficients of the noise
    polynomial C, because the noise is not measured.
    """

    orders: Orders
    #: Matrix H, shape (n, na + nb), and vector z, shape (n,), of the regression.
    rows: np.ndarray
    outputs: np.ndarray
    #: Index of the sample that each row of the regression predicts, in the joined records, shape (n,).
    sample: np.ndarray
    #: Input signal of all records joined to one series, with NaN between two records.
    source: np.ndarray
    #: Number of rows that the regression would have if no sample were missing.
    possible: int

    def __len__(self) -> int:
        return len(self.outputs)

    @cached_property
    def fresh(self) -> np.ndarray:
        """Boolean array, true for each row whose sample does not directly follow that of the previous row."""
        return np.diff(self.sample, prepend=-2) != 1

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """Place values of the rows of the regression on the time grid of the joined records.

        Samples without a row are NaN. The shape of ``values`` is (n,) or (n, p).
        """
        result = np.full((len(self.source), *np.shape(values)[1:]), np.nan)
        result[self.sample] = values
        return result

    def past_errors(self, residuals: np.ndarray) -> np.ndarray:
        """Return the m residuals before each of n samples, which the test of whiteness uses, shape (n, m)."""
        lags = range(1, rt.default_lags(len(self)) + 1)
        return rt.lag_matrix(self.on_grid(residuals), lags)


def regression(records: Sequence[ArxRecord], orders: Orders) -> Regression:
    """Return the regression for the coefficients of A and B from records with the same sample time.

    Row k is ``[-y(k-1) .. -y(k-na), u(k-nk) .. u(k-nk-nb+1)]`` (Eq 7 of the long-fin paper). Rows with a
    missing sample are left out.
    """
    y = rt.join_series([r.output for r in records], gap=orders.lag + GAP)
    u = rt.join_series([r.source for r in records], gap=orders.lag + GAP)
    past = [-delay_series(y, lag) for lag in range(1, orders.na + 1)]
    h = np.column_stack(past + [delay_series(u, orders.nk + j) for j in range(orders.nb)])
    k = np.flatnonzero(np.isfinite(y) & np.isfinite(h).all(axis=1))
    possible = sum(max(len(r) - orders.lag, 0) for r in records)
    return Regression(orders, h[k], y[k], k, u, possible)


def errors_and_gradient(theta: np.ndarray, data: Regression) -> tuple[np.ndarray, np.ndarray]:
    """Return the one-step prediction errors of an ARMAX model and the derivatives of its predictions.

    The derivatives are those with respect to the coefficients. If the sample of a row does not directly
    follow that of the previous row, the past errors of this row are assumed to be zero.

    Parameters
    ----------
    theta : ndarray, shape (m + nc,)
        Coefficients: m of A and B, then nc of C.

    Returns
    -------
    errors : ndarray, shape (n,)
        ``e(k) = z(k) - h(k)' theta_AB - sum_j c_j e(k-j)``.
    gradient : ndarray, shape (n, m + nc)
        Negative derivative of the errors with respect to theta: the regression vector filtered by 1 / C.
    """
    from scipy.signal import lfilter

    (n, m), nc = data.rows.shape, data.orders.nc
    errors = data.outputs - data.rows @ theta[:m]
    gradient = np.hstack((data.rows, np.zeros((n, nc))))
    noise = np.append(1.0, theta[m:])
    for first, end in itertools.pairwise([*np.flatnonzero(data.fresh).tolist(), n]):
        part = slice(first, end)
        errors[part] = lfilter([1.0], noise, errors[part])
        for j in range(1, nc + 1):
            gradient[first + j : end, m + j - 1] = errors[first : max(end - j, first)]
        gradient[part] = lfilter([1.0], noise, gradient[part], axis=0)
    return errors, gradient


def invertible(c: np.ndarray) -> np.ndarray:
    """Return the coefficients of the noise polynomial C with zeros outside the unit circle reflected into it.

    The given and the reflected polynomial describe noise with the same spectrum. Only the reflected
    polynomial has a stable inverse.
    """
    roots = np.roots(np.concatenate(([1.0], c)))
    roots = roots / np.maximum(np.abs(roots), 1.0) ** 2
    roots = roots * np.minimum(MAX_ZERO / np.maximum(np.abs(roots), MAX_ZERO), 1.0)
    coefficients = np.real(np.poly(roots))[1:]
    # Append the last coefficients, which are zero and missing because np.roots drops zeros at the origin.
    return np.pad(coefficients, (0, len(c) - len(coefficients)))


def refine(theta: np.ndarray, data: Regression, weights: np.ndarray) -> np.ndarray:
    """Return the coefficients of A, B and C with the minimum weighted sum of squared one-step errors.

    The search uses Gauss-Newton steps with step halving.

    Parameters
    ----------
    theta : ndarray, shape (m + nc,)
        Initial values of the m coefficients of A and B and the nc coefficients of C.
    weights : ndarray, shape (n,)
        Weights of the squared errors.

    Raises
    ------
    NoTrustworthyResult
        The search does not converge.
    """
    m, root = data.rows.shape[1], np.sqrt(weights)

    def cost(candidate: np.ndarray) -> float:
        errors, _ = errors_and_gradient(candidate, data)
        return float(np.nan_to_num(np.sum(weights * errors**2), nan=np.inf, posinf=np.inf))

    best = np.concatenate((theta[:m], invertible(theta[m:])))
    value = cost(best)
    for _ in range(MAX_STEPS):
        errors, gradient = errors_and_gradient(best, data)
        step = np.linalg.lstsq(gradient * root[:, None], errors * root, rcond=None)[0]
        for halving in range(MAX_HALVINGS):
            candidate = best + step / 2**halving
            candidate[m:] = invertible(candidate[m:])
            tried = cost(candidate)
            if tried < value:
                break
        else:
            return best  # No step reduces the cost, so that the current coefficients are the minimum.
        gained = value - tried
        best, value = candidate, tried
        if gained <= 1e-13 * value:
            return best
    raise NoTrustworthyResult(
        f"the noise polynomial C did not converge in {MAX_STEPS} steps",
        hint="lower --nc, or give longer logs",
    )


@dataclass(frozen=True)
class Identifiability:
    """Information of the data of a regression about its p coefficients."""

    #: Whether the data determine each coefficient, shape (p,).
    determined: np.ndarray
    #: Numerical rank of the regression: the number of independent combinations of coefficients that the data
    #: determine.
    rank: int
    #: Condition number of the regression matrix with columns scaled to length one, without the directions
    #: about which the data have no information.
    condition: float
    #: Factor R of the QR decomposition of the regression matrix with scaled columns, shape (p, p).
    factor: np.ndarray
    #: Rank of those columns of the regression matrix that hold past inputs (order of persistent excitation).
    input_rank: int = 0


def find_directions(rows: np.ndarray, steps: np.ndarray) -> Identifiability:
    """Find the coefficients that a regression determines, by a singular value decomposition of its matrix.

    Parameters
    ----------
    rows : ndarray, shape (n, p)
        Regression matrix of n samples and p coefficients.
    steps : ndarray, shape (p,)
        Rounding step of each column of the regression; 0 for a column that is not rounded.

    Notes
    -----
    The columns are scaled to length one. Rounding of n samples to a step q adds a random vector of length ``q
    sqrt(n / 12)`` to a column. The regression has no information about a direction if its singular value is
    below three times the length of these random vectors in that direction. A singular value above
    :data:`MAX_ROUNDING` of the largest singular value always counts as information.
    """
    n, p = rows.shape
    scale = _lengths(rows)
    factor = np.asarray(np.linalg.qr(rows / scale, mode="r"))
    _, singular, vectors = np.linalg.svd(factor, full_matrices=True)
    singular = np.append(singular, np.zeros(p - len(singular)))
    largest = max(singular[0], 1e-300)
    noise = np.minimum(3.0 * np.sqrt(vectors**2 @ (steps**2 * n / 12 / scale**2)), MAX_ROUNDING * largest)
    empty = singular <= np.maximum(REGRESSOR_RTOL * largest, noise)
    condition = np.inf
    if not empty.all():
        condition = float(singular[0] / singular[~empty][-1])
    share = np.sum(vectors[empty] ** 2, axis=0)
    return Identifiability(share < MIN_COMBINATION_SHARE, int(np.count_nonzero(~empty)), condition, factor)


def _lengths(rows: np.ndarray) -> np.ndarray:
    """Return the Euclidean length of each column of a regression matrix; 1 for a column of zeros."""
    length = np.linalg.norm(rows, axis=0)
    return np.where(length > 0, length, 1.0)


def find_determined(data: Regression, quanta: tuple[float, float]) -> Identifiability:
    """Find the coefficients of an ARX or ARMAX model that the data of a regression determine.

    The coefficients of the noise polynomial C always count as determined.

    Parameters
    ----------
    quanta : (float, float)
        Rounding step of the input, and rounding step of the output.
    """
    orders = data.orders
    steps = np.repeat([quanta[1], quanta[0]], [orders.na, orders.nb])
    both = find_directions(data.rows, steps)
    inputs = find_directions(data.rows[:, orders.na :], steps[orders.na :])
    determined = np.append(both.determined, np.ones(orders.nc, dtype=bool))
    return replace(both, determined=determined, input_rank=inputs.rank)


def exclude_collinear(
    known: Identifiability, data: Regression, theta: np.ndarray, stderr: np.ndarray, noise_sd: float
) -> Identifiability:
    """Mark coefficients of A and B as not determined if only noise in the data distinguishes them.

    If the input is a measured sine, its sensor noise weakly excites every coefficient of B, so that the
    regression has full rank. The estimates are then large and cancel each other. A coefficient of A or B is a
    candidate if its column is nearly dependent on the other columns (:data:`NEARLY_DEPENDENT`) and its
    standard error, times the length of its column, exceeds the contribution of the whole polynomial to the
    prediction. All candidates of a polynomial are marked if any of them has a standard error above half of
    its magnitude. A coefficient that is known to be small is not marked.
    """
    orders, count = data.orders, data.rows.shape[1]
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
    """Estimate of an ARX or ARMAX model with p coefficients from n rows of a regression."""

    orders: Orders
    #: Estimates of the coefficients, and their standard errors, shape (p,). Standard errors are NaN for
    #: coefficients that the data do not determine.
    theta: np.ndarray
    stderr: np.ndarray
    #: Covariance matrix of the estimates of the coefficients, shape (p, p).
    covariance: np.ndarray
    #: Standard deviation of the white noise e of the model, in the unit of the output.
    noise_sd: float
    #: One-step prediction errors of the model on the fitted rows, shape (n,).
    residuals: np.ndarray
    #: Derivatives of the one-step predictions with respect to the coefficients, shape (n, p).
    jacobian: np.ndarray
    data: Regression
    recursion: Recursion
    known: Identifiability
    #: Result of the test of the one-step errors for whiteness. For an ARX model with forgetting, the
    #: innovations of the recursion are tested instead.
    whiteness: rt.TestResult
    #: Whether the covariance of the estimates takes autocorrelated residuals into account (sandwich form).
    robust: bool
    #: Whether the model fits the data exactly, so that the residuals are rounding errors only.
    exact: bool

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the estimates of the m coefficients that the data determine, shape (m, m)."""
        use = np.isfinite(self.stderr)
        sd = np.where(self.stderr[use] > 0, self.stderr[use], 1.0)
        matrix = self.covariance[np.ix_(use, use)] / np.outer(sd, sd)
        np.fill_diagonal(matrix, 1.0)
        return np.clip(matrix, -1.0, 1.0)


def check_enough(data: Regression, orders: Orders) -> None:
    """Raise an error if a regression has too few rows for its coefficients, or if its output is constant.

    Raises
    ------
    NoTrustworthyResult
        There are not more rows than coefficients, or the output is constant.
    """
    if len(data) <= orders.count:
        text = f"{len(data)} usable rows for {orders.count} parameters ({orders})"
        hint = "a row needs na outputs and nb inputs without a gap: give longer logs or lower orders"
        raise NoTrustworthyResult(f"{text}; at least {orders.count + 1} are needed", hint=hint)
    if np.ptp(data.outputs) <= 1e-12 * np.max(np.abs(data.outputs)):
        text = f"the output is constant ({data.outputs[0]:.6g}) in all {len(data)} usable rows"
        raise NoTrustworthyResult(f"{text}: there is nothing to identify")


def fit_arx(
    records: Sequence[ArxRecord],
    orders: Orders,
    *,
    weight: float = 1.0,
    forgetting: float = 1.0,
    prior_scale: float = PRIOR_SCALE,
) -> ArxEstimate:
    """Fit an ARX or ARMAX model to one or several records.

    Parameters
    ----------
    records : sequence of ArxRecord
        Records with one sample time. A working point must already be subtracted
        (:func:`swimid.blackbox.rwls.find_working_point`).
    weight, forgetting, prior_scale
        See :func:`recursive_least_squares`. The recursion runs through the records
        one after the other.

    Raises
    ------
    NoTrustworthyResult
        There are too few rows, the output is constant, or the data determine no coefficient of A and B, or no
        effect of the input.

    Notes
    -----
    With ``nc = 0`` theta is the last estimate of the recursion, which equals batch weighted least squares
    with the prior. With ``nc > 0`` this estimate, with zeros for the coefficients of C, is the starting point
    of a search for the minimum of the squared one-step errors (:func:`refine`).

    Let W have the weights ``w_k = forgetting^(n-1-k)`` on its diagonal, let J be the derivative of the
    one-step prediction, and ``S = J'WJ + prior``. For white residuals the covariance is ``sigma^2 S^-1 (J'W^2
    J) S^-1``. For other residuals it is ``S^-1 M S^-1``, with M from
    :func:`swimid.fitting.uncertainty.long_run_covariance`.
    """
    data = regression(records, orders)
    check_enough(data, orders)
    quanta = (max(rounding(r.source) for r in records), max(rounding(r.output) for r in records))
    known = find_determined(data, quanta)
    _check_determined(known, orders)
    run = recursive_least_squares(
        data.rows, data.outputs, weight=weight, forgetting=forgetting, prior_scale=prior_scale
    )
    # Discount each row by its age. The age is counted in rows, so that gaps do not count.
    weights = forgetting ** np.arange(len(data) - 1, -1, -1.0)
    theta = run.theta
    residuals, jacobian = data.outputs - data.rows @ theta, data.rows
    if orders.nc:
        theta = np.append(theta, np.zeros(orders.nc))
        theta = refine(theta, data, weights)
        residuals, jacobian = errors_and_gradient(theta, data)
    prior = forgetting ** (len(data) - 1) / (weight * prior_scale**2)
    tested, absorbed = residuals, rt.count_absorbed(data.on_grid(jacobian), data.past_errors(residuals))
    if forgetting < 1 and not orders.nc:
        # A prediction does not depend on the sample that it predicts.
        absorbed = 0.0
        skipped = min(int(max(5 * orders.count, 1 / (1 - forgetting))), len(data) // 2)
        tested = np.where(np.arange(len(data)) < skipped, np.nan, run.innovations)
    exact = bool(np.sqrt(np.mean(residuals**2)) <= EXACT * np.std(data.outputs))
    white = rt.ljung_box(data.on_grid(tested), fitted=absorbed)
    robust = not (white.is_passed or exact)
    matrix, noise_sd = compute_arx_covariance(jacobian, residuals, weights, prior, data, robust=robust)
    stderr = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    known = exclude_collinear(known, data, theta, stderr, noise_sd)
    _check_determined(known, orders)
    stderr = np.where(known.determined, stderr, np.nan)
    return ArxEstimate(
        orders, theta, stderr, matrix, noise_sd, residuals, jacobian, data, run, known, white, robust, exact
    )


def _check_determined(known: Identifiability, orders: Orders) -> None:
    count = orders.na + orders.nb
    if not np.any(known.determined[:count]):
        text = f"the regression is singular: its columns span {known.rank} of {count} directions"
        hint = "lower the orders, or excite the robot with more than one frequency"
        raise NoTrustworthyResult(f"{text}, and no coefficient of the model is determined", hint=hint)
    if known.input_rank == 0:
        text = "the input is constant, so its effect cannot be identified"
        raise NoTrustworthyResult(text, hint="check the input column, or give --input-sine")


def compute_arx_covariance(
    jacobian: np.ndarray,
    residuals: np.ndarray,
    weights: np.ndarray,
    prior: float,
    data: Regression,
    *,
    robust: bool,
) -> tuple[np.ndarray, float]:
    """Return the covariance of a least-squares estimate and the standard deviation of its noise.

    Parameters
    ----------
    jacobian, residuals, weights : ndarray, shape (n, p), (n,) and (n,)
        Derivatives of the predictions, one-step errors and weights of the n rows.
    prior : float
        Prior information about each coefficient: the diagonal of the prior information matrix.
    data : Regression
        Regression to which the rows belong.
    robust : bool
        Whether to account for autocorrelated residuals; see the notes of :func:`fit_arx`.
    """
    n, p = jacobian.shape
    root = np.sqrt(weights)[:, None]
    r = np.linalg.qr(np.vstack((jacobian * root, np.sqrt(prior) * np.eye(p))), mode="r")
    inverse = np.linalg.pinv(r)
    whitened = (jacobian * weights[:, None]) @ inverse
    middle = whitened.T @ whitened
    # Compute the effective number of degrees of freedom of the residuals. It is n - p without forgetting.
    remaining = max(float(np.sum(weights)) - float(np.trace(middle)), 1e-12)
    variance = float(np.sum(weights * residuals**2)) / remaining
    middle = middle * variance
    if robust:
        scores = data.on_grid(whitened * residuals[:, None])
        middle = rt.long_run_covariance(scores) * (n / max(n - p, 1))
    matrix = inverse @ middle @ inverse.T
    return (matrix + matrix.T) / 2, float(np.sqrt(variance))
