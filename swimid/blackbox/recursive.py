"""Recursive weighted least squares, compiled with numba.

The recursion is Eq 9 of the long-fin paper [1]_,

    K(k)     = P(k-1) h(k) / (h(k)' P(k-1) h(k) + 1 / weight)
    theta(k) = theta(k-1) + K(k) (z(k) - h(k)' theta(k-1))
    P(k)     = (I - K(k) h(k)') P(k-1)          [divided by ``forgetting`` afterwards]

with P(0) = a^2 I. The recursion updates the factors U D U' of P instead of P (Bierman [2]_). The results
are the same, P stays symmetric and positive definite, and a large value of a causes no loss of digits.

``weight`` is constant and multiplies every row. The result equals ordinary least squares with the prior P(0)
scaled by ``weight``. Old samples are discounted only if ``forgetting`` is below 1.

References
----------
.. [1] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic
   underwater vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, Eq 6-9.
   doi:10.1017/S0263574711001159
.. [2] G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), ch. 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

#: Default of a in P(0) = a^2 I. The paper recommends values above 10^3.
PRIOR_SCALE = 1e6
#: Maximum of the elements of the diagonal factor D, in units of a^2. With forgetting, P grows without limit
#: in directions that the input does not excite. In excited directions D stays below this limit.
MAX_GROWTH = 1e6


@dataclass(frozen=True)
class Recursion:
    """Result of a recursion over n rows with p coefficients."""

    #: Last estimate of the coefficients, shape (p,).
    theta: np.ndarray
    #: P after the last row, shape (p, p). Without forgetting, the covariance of the estimate is P multiplied
    #: by the noise variance and the weight.
    covariance: np.ndarray
    #: One-step errors ``z(k) - h(k)' theta(k-1)``, shape (n,).
    innovations: np.ndarray
    #: Number of rows at which an element of D reached :data:`MAX_GROWTH`.
    limited: int


def recursive_least_squares(
    regressors: np.ndarray,
    outputs: np.ndarray,
    *,
    weight: float = 1.0,
    forgetting: float = 1.0,
    prior_scale: float = PRIOR_SCALE,
) -> Recursion:
    """Return the recursive estimate of theta in ``outputs = regressors @ theta + noise``, from theta(0) = 0.

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


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _run(h, z, variance, growth, prior):  # type: ignore[no-untyped-def]
    """Run the recursion as one compiled loop, because function calls and branches would cost time.

    Row j of ``factors`` holds column j of U.
    """
    n, p = h.shape
    ceiling = MAX_GROWTH * prior
    theta = np.zeros(p)
    factors, diagonal = np.eye(p), np.full(p, prior)
    innovations = np.empty(n)
    gain, f = np.empty(p), np.empty(p)
    limited = 0
    for k in range(n):
        # compute the innovation, and f = U' h
        error = z[k]
        for j in range(p):
            error -= h[k, j] * theta[j]
            total = h[k, j]
            for i in range(j):
                total += factors[j, i] * h[k, i]
            f[j] = total
        # update U and D column by column (Bierman)
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
