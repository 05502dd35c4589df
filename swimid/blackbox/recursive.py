"""Recursive (weighted, extended) least squares, compiled.

The recursion is Eq 9 of the long-fin paper [1]_,

    K(k)     = P(k-1) h(k) / (h(k)' P(k-1) h(k) + 1 / weight)
    theta(k) = theta(k-1) + K(k) (z(k) - h(k)' theta(k-1))
    P(k)     = (I - K(k) h(k)') P(k-1)          [divided by ``forgetting`` afterwards]

with P(0) = a^2 I. P is never formed: its factors U D U' are carried (Bierman [2]_), which
gives the same numbers, keeps P symmetric and positive, and loses no digits to a large a.

A constant ``weight`` is not forgetting. It multiplies every row alike, so that the result
equals ordinary least squares with the prior P(0) scaled by ``weight``; only ``forgetting``
below 1 discounts old samples.

References
----------
.. [1] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic
   underwater vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, Eq 6-9.
   doi:10.1017/S0263574711001159
.. [2] G. J. Bierman, "Factorization Methods for Discrete Sequential Estimation" (1977), ch. 5.
.. [3] L. Ljung, "System Identification: Theory for the User", 2nd ed. (1999), section 11.7
   (extended least squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

#: a of P(0) = a^2 I. The paper asks for more than 10^3.
PRIOR_SCALE = 1e6
#: With forgetting, directions the input does not excite grow without limit; they are held at
#: this multiple of a^2, which no excited direction reaches.
WINDUP = 1e6


@dataclass(frozen=True)
class Recursion:
    """What a recursion leaves behind.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        The last estimate.
    covariance : ndarray, shape (p, p)
        P after the last row. Times the noise variance and the weight it is the covariance of
        the estimate, where nothing was forgotten.
    innovations : ndarray, shape (n,)
        z(k) - h(k)' theta(k-1): the one-step error before the row was used.
    kept : ndarray of int, shape (m,)
        Rows at which the trajectory was kept; the last row is always among them.
    thetas, spreads : ndarray, shape (m, p)
        Estimates and square roots of the diagonal of P after those rows.
    windup : int
        Number of rows after which a factor of P had to be held (see :data:`WINDUP`).
    """

    theta: np.ndarray
    covariance: np.ndarray
    innovations: np.ndarray
    kept: np.ndarray
    thetas: np.ndarray
    spreads: np.ndarray
    windup: int


def recursive_least_squares(
    regressors: np.ndarray,
    outputs: np.ndarray,
    *,
    weight: float = 1.0,
    forgetting: float = 1.0,
    prior_scale: float = PRIOR_SCALE,
    noise_terms: int = 0,
    fresh: np.ndarray | None = None,
    stride: int = 1,
) -> Recursion:
    """Run the recursion over rows ``outputs = regressors @ theta + noise``, from theta(0) = 0.

    Parameters
    ----------
    regressors : ndarray, shape (n, p)
        Row k is h(k)', finite.
    outputs : ndarray, shape (n,)
        z, finite.
    weight : float
        The paper's Lambda, > 0.
    forgetting : float
        P is divided by it after every row; 0 < forgetting <= 1.
    prior_scale : float
        a of P(0) = a^2 I, > 0.
    noise_terms : int
        The last ``noise_terms`` columns of ``regressors`` are replaced by the residuals of the
        rows before (extended least squares [3]_); what they hold is ignored.
    fresh : ndarray of bool, shape (n,), optional
        True where a row does not continue the one before: past residuals restart at zero.
    stride : int
        Keep every ``stride``-th row of the trajectory.

    Raises
    ------
    ValueError
        For shapes, weights or a stride that make no sense, and for NaN.

    Examples
    --------
    >>> h = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    >>> recursive_least_squares(h, np.array([1.0, 3.0, 5.0])).theta.round(6)
    array([1., 2.])
    """
    h = np.array(regressors, dtype=float, order="C", ndmin=2, copy=bool(noise_terms) or None)
    z = np.ascontiguousarray(outputs, dtype=float)
    n, p = h.shape
    for allowed, what in (
        (z.shape == (n,), f"outputs have shape {z.shape}, regressors {h.shape}"),
        (weight > 0, f"weight is {weight!r}; it must be positive"),
        (0 < forgetting <= 1, f"forgetting is {forgetting!r}; it must be above 0 and at most 1"),
        (prior_scale > 0, f"prior_scale is {prior_scale!r}; it must be positive"),
        (stride >= 1, f"stride is {stride}; it must be at least 1"),
        (0 <= noise_terms <= p, f"noise_terms is {noise_terms}, with {p} parameters"),
    ):
        if not allowed:
            raise ValueError(what)
    if noise_terms:
        h[:, p - noise_terms :] = 0.0
    if not (np.isfinite(z).all() and np.isfinite(h).all()):
        raise ValueError("regressors and outputs must be finite; leave rows with gaps out")
    breaks = np.zeros(n, dtype=np.bool_) if fresh is None else fresh
    kept = np.arange(stride - 1, n, stride)
    if n and (len(kept) == 0 or kept[-1] != n - 1):
        kept = np.append(kept, n - 1)
    thetas, spreads = np.empty((len(kept), p)), np.empty((len(kept), p))
    theta, factors, diagonal, innovations, windup = _run(
        h, z, breaks, noise_terms, 1.0 / weight, 1.0 / forgetting, prior_scale**2, stride, thetas, spreads
    )
    covariance = (factors.T * diagonal) @ factors
    return Recursion(theta, covariance, innovations, kept, thetas, spreads, windup)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _run(h, z, fresh, noise_terms, variance, growth, prior, stride, thetas, spreads):  # type: ignore[no-untyped-def]  # noqa: C901
    """One compiled loop: calls and branches cost time here."""
    n, p = h.shape
    ceiling = WINDUP * prior
    theta = np.zeros(p)
    factors, diagonal = np.eye(p), np.full(p, prior)  # row j of the factors holds column j of U
    innovations, residuals = np.empty(n), np.empty(n)
    gain, f = np.empty(p), np.empty(p)
    row = 0
    windup = 0
    first = p - noise_terms
    for k in range(n):
        if noise_terms:
            if fresh[k] or k == 0:
                for j in range(first, p):
                    h[k, j] = 0.0
            else:
                for j in range(p - 1, first, -1):
                    h[k, j] = h[k - 1, j - 1]
                h[k, first] = residuals[k - 1]
        # f = U' h and the innovation.
        error = z[k]
        for j in range(p):
            error -= h[k, j] * theta[j]
            total = h[k, j]
            for i in range(j):
                total += factors[j, i] * h[k, i]
            f[j] = total
        # Bierman's update of U and D, one column after the other.
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
        after = error
        for j in range(p):
            change = gain[j] * step
            theta[j] += change
            after -= h[k, j] * change
        residuals[k] = after
        if growth > 1.0:
            held = False
            for j in range(p):
                diagonal[j] *= growth
                if diagonal[j] > ceiling:
                    diagonal[j] = ceiling
                    held = True
            windup += held
        if (k + 1) % stride == 0 or k == n - 1:
            for i in range(p):
                thetas[row, i] = theta[i]
                total = diagonal[i]
                for j in range(i + 1, p):
                    total += factors[j, i] * factors[j, i] * diagonal[j]
                spreads[row, i] = np.sqrt(total)
            row += 1
    return theta, factors, diagonal, innovations, windup


def warm_up() -> None:
    """Compile the kernels of this module."""
    rows = np.ones((2, 1))
    recursive_least_squares(rows, np.ones(2))
