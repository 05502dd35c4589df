"""Difference equation of an ARX or ARMAX model: orders, records, free run (simulation) and poles.

    A(z^-1) y(k) = B(z^-1) u(k) + C(z^-1) e(k)
    A = 1 + a1 z^-1 + ... + a_na z^-na
    B = b1 z^-nk + b2 z^-(nk+1) + ... + b_nb z^-(nk+nb-1)
    C = 1 + c1 z^-1 + ... + c_nc z^-nc

Eqs 4 to 7 of the long-fin paper (Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159),
with a delay and a noise polynomial added. y is the output, u the input and e white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

#: Minimum magnitude of a pole that counts as integrating, whatever its standard error is.
INTEGRATING = 0.999
#: Maximum standard error of a pole's magnitude for a test of integration. Larger standard errors are not
#: reliable, because the linearisation behind them fails, above all for nearly double poles.
MAX_POLE_STDERR = 0.05
#: Maximum distance of a free run from the measured output, divided by the range of that output. At a larger
#: distance the free run is stopped.
MAX_DISTANCE = 100.0


@dataclass(frozen=True)
class Record:
    """Input and output on a grid of constant rate, each of shape (n,); NaN where a sample is missing."""

    #: Name of the log.
    name: str
    time_s: np.ndarray
    #: Input u.
    source: np.ndarray
    #: Output y.
    output: np.ndarray

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Orders:
    """Numbers of coefficients of A, B and C (``na``, ``nb``, ``nc``), and delay ``nk`` of b1 in samples."""

    na: int
    nb: int
    nk: int = 1
    nc: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients: a1, ..., b1, ..., c1, ..."""
        counts = {"a": self.na, "b": self.nb, "c": self.nc}
        return tuple(f"{letter}{i}" for letter, count in counts.items() for i in range(1, count + 1))

    @property
    def count(self) -> int:
        """Total number of coefficients."""
        return self.na + self.nb + self.nc

    @property
    def lag(self) -> int:
        """Number of past samples that a row of the regression contains."""
        return max(self.na, self.nk + self.nb - 1)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coefficients of A, of B and of C, from one vector of all coefficients."""
        theta = np.asarray(theta, dtype=float)
        return theta[: self.na], theta[self.na : self.na + self.nb], theta[self.na + self.nb :]

    def __str__(self) -> str:
        noise = f", nc={self.nc}" if self.nc else ""
        return f"na={self.na}, nb={self.nb}, nk={self.nk}{noise}"


@dataclass(frozen=True)
class Pole:
    """Pole in the z plane, with natural frequency and damping of the continuous-time pole log(z) / Ts."""

    value: complex
    magnitude: float
    #: Standard error of the magnitude; NaN for a repeated pole.
    stderr: float
    #: Natural frequency, Hz; NaN for z = 0, as is the damping ratio.
    frequency_hz: float
    damping_ratio: float

    @property
    def integrating(self) -> bool:
        """Whether the magnitude differs from 1 by at most two standard errors, or is very close to 1."""
        near = self.stderr < MAX_POLE_STDERR and abs(self.magnitude - 1.0) <= 2.0 * self.stderr
        return bool(near or INTEGRATING < self.magnitude < 2.0 - INTEGRATING)

    @property
    def state(self) -> Literal["stable", "integrating", "unstable"]:
        """Effect of the pole on a free run. A pole on or outside the unit circle is unstable."""
        if self.magnitude >= 1.0:
            return "unstable"
        return "integrating" if self.integrating else "stable"


def poles(a: np.ndarray, covariance: np.ndarray | None, sample_time_s: float) -> list[Pole]:
    """Return the roots of A with the standard errors of their magnitudes, the largest magnitude first.

    Parameters
    ----------
    a : ndarray, shape (na,)
        Coefficients a1 to a_na.
    covariance : ndarray, shape (na, na), or None
        Covariance of the coefficients.
    sample_time_s : float
        Sample time, s.

    Notes
    -----
    The standard errors follow from ``dz/da_i = -z^(n-i) / p'(z)``, for a simple root z of the polynomial
    ``p(z) = z^n + a1 z^(n-1) + ...``.
    """
    polynomial = np.concatenate(([1.0], a))
    result = []
    for z in np.roots(polynomial):
        stderr = damping = np.nan
        continuous = complex(np.nan, np.nan)
        slope = np.polyval(np.polyder(polynomial), z)
        if covariance is not None and abs(z) > 0 and abs(slope) > 1e-12:
            gradient = -(z ** np.arange(len(a) - 1, -1, -1)) / slope
            along = np.real(np.conj(z) / abs(z) * gradient)
            stderr = float(np.sqrt(max(along @ covariance @ along, 0.0)))
        if abs(z) > 0:
            continuous = np.log(complex(z)) / sample_time_s
        size = abs(continuous)
        if size > 0:
            damping = float(-continuous.real / size)
        result.append(Pole(complex(z), float(abs(z)), stderr, float(size / (2 * np.pi)), damping))
    return sorted(result, key=lambda pole: (-pole.magnitude, -pole.value.imag))


def free_run(
    a: np.ndarray, b: np.ndarray, delay: int, source: np.ndarray, measured: np.ndarray, limit: float
) -> np.ndarray:
    """Simulate A(z^-1) y = B(z^-1) u from the input and the first measured outputs.

    Parameters
    ----------
    a, b : ndarray, shape (na,) and (nb,)
        Coefficients a1 to a_na and b1 to b_nb.
    delay : int
        Delay of b1, samples.
    source : ndarray, shape (n,)
        Input u, NaN where missing.
    measured : ndarray, shape (n,)
        Measured output y, NaN where missing. Only na consecutive samples are used, to start the simulation at
        the beginning and again after each gap in the input.
    limit : float
        Maximum magnitude of the simulated output. If it is exceeded, the result is NaN until the next start.

    Returns
    -------
    ndarray, shape (n,)
        Simulated output; NaN at the samples that start the simulation and where nothing is simulated.
    """
    from scipy.signal import lfilter, lfiltic

    na = len(a)
    driven = np.zeros(len(source))
    for j, value in enumerate(b):
        driven = driven + value * lagged(source, delay + j)
    started = np.isfinite(driven)
    for i in range(1, na + 1):
        started &= np.isfinite(lagged(measured, i))
    result = np.full(len(source), np.nan)
    for piece in np.ma.clump_unmasked(np.ma.masked_invalid(driven)):
        first = piece.start + int(np.argmax(started[piece]))
        if not started[first]:
            continue
        state = lfiltic([1.0], np.append(1.0, a), measured[first - na : first][::-1])
        run, _ = lfilter([1.0], np.append(1.0, a), driven[first : piece.stop], zi=state)
        # a comparison with an overflowed (NaN) value is false
        within = np.logical_and.accumulate(np.abs(run) <= limit)
        result[first : piece.stop] = np.where(within, run, np.nan)
    return result


def lagged(x: np.ndarray, lag: int) -> np.ndarray:
    """Return a series delayed by ``lag`` samples, shape (n,). The first ``lag`` samples are NaN."""
    return np.concatenate((np.full(lag, np.nan), x))[: len(x)]


def simulate(record: Record, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """Return the free run of a record from its first ``na`` outputs, shape (n,).

    The free run is NaN after its distance from the measured output exceeds :data:`MAX_DISTANCE` ranges of
    that output.
    """
    a, b, _ = orders.split(theta)
    values = record.output[np.isfinite(record.output)]
    limit = 1e150  # prevents overflow if the output has no range (a start from rest)
    if len(values) and np.ptp(values) > 0:
        limit = float(np.max(np.abs(values))) + MAX_DISTANCE * float(np.ptp(values))
    return free_run(a, b, orders.nk, record.source, record.output, limit)


def simulate_all(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the measured outputs and the free runs of several records, each concatenated."""
    runs = [simulate(r, orders, theta) for r in records]
    return np.concatenate([r.output for r in records]), np.concatenate(runs)


def best_level(measured: np.ndarray, run: np.ndarray, raised: np.ndarray) -> float:
    """Return the output level that minimises the sum of squared errors of the free run.

    The result is 0 if the level has no effect. A free run is linear in its initial samples, so that at level
    L it is ``run + L (raised - run)``.

    Parameters
    ----------
    measured, run, raised : ndarray, shape (n,)
        Measured output, free run at level 0, and free run at level 1.
    """
    slope, error = raised - run, measured - run
    use = np.isfinite(slope) & np.isfinite(error)
    weight = float(np.sum(slope[use] ** 2))
    if weight == 0:
        return 0.0
    return float(np.sum(slope[use] * error[use])) / weight
