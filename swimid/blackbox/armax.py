"""The noise polynomial C: one-step errors, their gradient, and the search for the least error.

statsmodels' SARIMAX can be given the same rows, as regressors of a moving average, with a Kalman filter
across the gaps. On 60 records of 600 samples of an ARMAX(2, 2, nc 2) model its estimates are as good (as much
as 13 % less scatter of one coefficient with 30 % of the samples missing, none without gaps), it takes 40 to
70 times as long, one in ten does not converge, and it cannot discount old samples.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from swimid.errors import NoTrustworthyResult

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
