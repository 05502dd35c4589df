"""Linear difference equations: their orders, records, free run and poles.

    A(z^-1) y(k) = B(z^-1) u(k) + C(z^-1) e(k)
    A = 1 + a1 z^-1 + ... + a_na z^-na
    B = b1 z^-nk + b2 z^-(nk+1) + ... + b_nb z^-(nk+nb-1)
    C = 1 + c1 z^-1 + ... + c_nc z^-nc

Eqs 4 to 7 of the long-fin paper (Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159),
with a delay and a noise polynomial added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit

#: A pole at least this close to the unit circle integrates, whatever its uncertainty.
INTEGRATING = 0.999
#: The standard error of a pole that is less certain than this says nothing about integration:
#: the linearisation behind it fails, for nearly double poles above all.
BLURRED = 0.05
#: A free run that strays this many times the output's range from it is given up.
RUNAWAY = 100.0


@dataclass(frozen=True)
class Record:
    """Input u and output y on one grid of constant rate, from the log ``name``.

    Attributes
    ----------
    time_s, source, output : ndarray, shape (n,)
        NaN in u or y where the sample is missing.
    """

    name: str
    time_s: np.ndarray
    source: np.ndarray
    output: np.ndarray

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Orders:
    """Numbers of coefficients of A, B and C, and the delay of b1 in samples."""

    na: int
    nb: int
    nk: int = 1
    nc: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """a1 .. b1 .. c1 .."""
        counts = {"a": self.na, "b": self.nb, "c": self.nc}
        return tuple(f"{letter}{i}" for letter, count in counts.items() for i in range(1, count + 1))

    @property
    def count(self) -> int:
        """Number of parameters."""
        return self.na + self.nb + self.nc

    @property
    def lag(self) -> int:
        """Samples before the present one that a row needs."""
        return max(self.na, self.nk + self.nb - 1)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The coefficients of A, B and C."""
        theta = np.asarray(theta, dtype=float)
        return theta[: self.na], theta[self.na : self.na + self.nb], theta[self.na + self.nb :]

    def __str__(self) -> str:
        noise = f", nc={self.nc}" if self.nc else ""
        return f"na={self.na}, nb={self.nb}, nk={self.nk}{noise}"


@dataclass(frozen=True)
class Pole:
    """A pole in the z plane.

    Attributes
    ----------
    value : complex
    magnitude, stderr : float
        Modulus and its standard error (NaN for a repeated pole, where it has none).
    frequency_hz, damping_ratio : float
        Of the continuous pole log(z) / Ts; NaN for z = 0.
    """

    value: complex
    magnitude: float
    stderr: float
    frequency_hz: float
    damping_ratio: float

    @property
    def integrating(self) -> bool:
        """Whether the pole cannot be told from the unit circle, from inside or on it."""
        near = self.stderr < BLURRED and abs(self.magnitude - 1.0) <= 2.0 * self.stderr
        return bool(near or INTEGRATING < self.magnitude < 2.0 - INTEGRATING)

    @property
    def unstable(self) -> bool:
        """Whether it lies on or outside the unit circle."""
        return self.magnitude >= 1.0

    @property
    def state(self) -> Literal["stable", "integrating", "unstable"]:
        """What it makes of a free run."""
        return "unstable" if self.unstable else "integrating" if self.integrating else "stable"


def poles(a: np.ndarray, covariance: np.ndarray | None, sample_time_s: float) -> list[Pole]:
    """Roots of A, largest first, with the standard error of their modulus.

    Parameters
    ----------
    a : ndarray, shape (na,)
        a1 .. ana.
    covariance : ndarray, shape (na, na), or None
        Of a.
    sample_time_s : float, s

    Notes
    -----
    For a simple root z of ``p(z) = z^n + a1 z^(n-1) + ...``: ``dz/da_i = -z^(n-i) / p'(z)``.
    """
    n = len(a)
    polynomial = np.concatenate(([1.0], a))
    result = []
    for z in np.roots(polynomial):
        stderr = np.nan
        slope = np.polyval(np.polyder(polynomial), z)
        if covariance is not None and abs(z) > 0 and abs(slope) > 1e-12:
            gradient = -(z ** np.arange(n - 1, -1, -1)) / slope
            along = np.real(np.conj(z) / abs(z) * gradient)
            stderr = float(np.sqrt(max(along @ covariance @ along, 0.0)))
        continuous = np.log(complex(z)) / sample_time_s if abs(z) > 0 else complex(np.nan, np.nan)
        size = abs(continuous)
        damping = float(-continuous.real / size) if size > 0 else np.nan
        result.append(Pole(complex(z), float(abs(z)), stderr, float(size / (2 * np.pi)), damping))
    return sorted(result, key=lambda pole: (-pole.magnitude, -pole.value.imag))


@njit(cache=True, error_model="numpy")
def free_run(
    a: np.ndarray, b: np.ndarray, delay: int, source: np.ndarray, measured: np.ndarray, limit: float
) -> np.ndarray:
    """Simulate A(z^-1) y = B(z^-1) u from its input and its first outputs alone.

    Parameters
    ----------
    a, b : ndarray, shape (na,) and (nb,)
        a1 .. ana and b1 .. bnb; the delay of b1 is ``delay`` samples.
    source : ndarray, shape (n,)
        u, NaN where missing.
    measured : ndarray, shape (n,)
        y, NaN where missing. Read only to start: the first na samples before which every
        sample needed is there, and again after a stretch of missing input.
    limit : float
        A run that leaves +-limit is given up: NaN from there until the next start.

    Returns
    -------
    ndarray, shape (n,)
        The simulated output; NaN where there is none, the starting samples included.
    """
    n, na, nb = len(source), len(a), len(b)
    result = np.full(n, np.nan)
    state = np.full(n, np.nan)
    running = False
    blown = False
    for k in range(n):
        known = k >= delay + nb - 1
        total = 0.0
        if known:
            for j in range(nb):
                total += b[j] * source[k - delay - j]
            known = total == total
        if not known:
            running = False
            blown = False
            continue
        if not running and not blown and k >= na:
            for i in range(1, na + 1):
                state[k - i] = measured[k - i]
            running = True
        if not running:
            continue
        for i in range(na):
            total -= a[i] * state[k - 1 - i]
        if total != total:
            running = False
            continue
        if abs(total) > limit:
            running = False
            blown = True
            continue
        state[k] = total
        result[k] = total
    return result


def lagged(x: np.ndarray, lag: int) -> np.ndarray:
    """A series so many samples later: NaN first."""
    return np.concatenate((np.full(lag, np.nan), x))[: len(x)]


def simulate(record: Record, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """Free run over a record from its first ``na`` outputs, shape (n,).

    A run that strays :data:`RUNAWAY` times the range of the output away is given up: NaN.
    """
    a, b, _ = orders.split(theta)
    values = record.output[np.isfinite(record.output)]
    span = float(np.ptp(values)) if len(values) else 0.0
    # Without a range (a start from rest) only overflow is kept away.
    limit = float(np.max(np.abs(values))) + RUNAWAY * span if span > 0 else 1e150
    return free_run(a, b, orders.nk, record.source, record.output, limit)


def simulate_all(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measured outputs and free runs of several records, one after the other."""
    runs = [simulate(r, orders, theta) for r in records]
    return np.concatenate([r.output for r in records]), np.concatenate(runs)


def best_level(measured: np.ndarray, run: np.ndarray, raised: np.ndarray) -> float:
    """The level of least squared error, of runs at level 0 and at level 1; 0 where none can tell.

    The free run is linear in its initial samples, so that with level L it is ``run + L (raised - run)``.
    """
    slope, error = raised - run, measured - run
    use = np.isfinite(slope) & np.isfinite(error)
    weight = float(np.sum(slope[use] ** 2))
    return float(np.sum(slope[use] * error[use])) / weight if weight > 0 else 0.0


def warm_up() -> None:
    """Compile the kernels of this module."""
    one = np.ones(3)
    free_run(one[:1], one[:1], 1, one, one, 1.0)
