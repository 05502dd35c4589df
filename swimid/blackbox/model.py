"""Difference equation of ARX and ARMAX models: orders, records, free run, poles, and the model of swimid.

    A(z^-1) y(k) = B(z^-1) u(k) + C(z^-1) e(k)
    A = 1 + a1 z^-1 + ... + a_na z^-na
    B = b1 z^-nk + b2 z^-(nk+1) + ... + b_nb z^-(nk+nb-1)
    C = 1 + c1 z^-1 + ... + c_nc z^-nc

Eqs 4 to 7 of the long-fin paper (Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159),
with a delay and a noise polynomial added. y is the output, u the input and e white noise. The folder
``published`` contains the models of Tables II and III of this paper.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from swimid.errors import InputError
from swimid.fitting.model import Array, Channel, Hooks, Model, Parameter, Trial
from swimid.logs import sampling
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile

if TYPE_CHECKING:
    import control

#: Name of the model in parameter files.
NAME = "arma"
#: Source of the equations, for the parameters.
PAPER = (
    "Shang, Wang, Tan, Cheng: Swimming locomotion modeling for biomimetic underwater vehicle with two "
    "undulating long-fins, Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159"
)
#: Folder of the published parameter files.
PUBLISHED = Path(__file__).with_name("published")
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


def find_poles(a: np.ndarray, covariance: np.ndarray | None, sample_time_s: float) -> list[Pole]:
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


class ArxModel(Model):
    """Discrete-time model from one input column to one output column.

    Parameters
    ----------
    orders : Orders
        Orders na, nb and nk. The order nc is ignored, because a simulation does not use the noise polynomial.
    sample_time_s : float
        Sample time, s.
    source, output : str
        Names of the input and the output column.
    source_level, output_level : float
        Working point. ``source_level`` is subtracted from the input, ``output_level`` is added to the
        simulated output.
    sine : tuple of float, optional
        Amplitude, frequency (Hz) and phase (rad) of a computed input, if no column holds the input.
    start : ndarray, shape (na + nb,), optional
        Initial values of the coefficients a1, ..., b1, ...
    unit, gain_unit : str
        Unit of the output, and unit of the b coefficients.
    """

    name = NAME
    offers = frozenset({"command", "output", "clock"})
    has_gaps = True

    def __init__(
        self,
        orders: Orders,
        sample_time_s: float,
        *,
        source: str,
        output: str,
        source_level: float = 0.0,
        output_level: float = 0.0,
        sine: tuple[float, float, float] | None = None,
        start: Array | None = None,
        unit: str = "1",
        gain_unit: str = "1",
    ) -> None:
        self.orders = Orders(orders.na, orders.nb, orders.nk)
        self.sample_time_s = sample_time_s
        self.source, self.output = source, output
        self.source_level, self.output_level = source_level, output_level
        self.sine = sine
        values = np.zeros(self.orders.count)
        if start is not None:
            values = np.asarray(start, dtype=float)
        na, nb, nk = self.orders.na, self.orders.nb, self.orders.nk
        places = [("1", f"past output, z^-{i}") for i in range(1, na + 1)]
        places += [(gain_unit, f"input, z^-{nk + j}") for j in range(nb)]
        self.parameters = tuple(
            Parameter(
                name, unit_of, -np.inf, np.inf, float(value), scale=max(abs(float(value)), 1e-3),
                meaning=f"coefficient of {place}", source=f"{PAPER}, Eq 5",
            )
            for name, (unit_of, place), value in zip(self.orders.names, places, values, strict=True)
        )  # fmt: skip
        self.channels = (Channel(output, unit, "output of the model"),)

    @classmethod
    def from_file(cls, parameters: ParameterFile, path: Path | None = None) -> ArxModel:
        """Return the model of a parameter file; ``path`` is the path of the file in error messages.

        Raises
        ------
        InputError
            The file is of another model, or the delay, the sample time or coefficients are missing.
        """
        if parameters.model != NAME:
            raise InputError(f"model '{parameters.model}' is not '{NAME}'", file=path, column="model")
        orders, sample_time_s, start = _coefficients(parameters, path)
        settings = parameters.settings
        sine = settings.get("input_model")
        return cls(
            orders,
            sample_time_s,
            source=str(settings.get("input", "u")),
            output=str(settings.get("output", "y")),
            source_level=float(settings.get("input_level", 0.0)),
            output_level=float(settings.get("output_level", 0.0)),
            sine=sine and (sine["amplitude"], sine["frequency_hz"], sine["phase_rad"]),
            start=start,
            unit=str(settings.get("output_unit", "1")),
            gain_unit=parameters.parameters["b1"].unit,
        )

    def commanded(self, trial: Trial) -> bool:
        """Return whether the input column is a command, and not a measured joint angle."""
        return not self.source.startswith("joint")

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Yield times, values and 0.0 (the rate of change is unknown) of the known input samples."""
        time = np.asarray(trial.time_s, dtype=float)
        signal = self.input_of(trial, time)
        known = np.isfinite(signal)
        yield time[known], signal[known], 0.0

    def onset(self, trial: Trial) -> float:
        """Return minus infinity, because the model has no body that starts from rest."""
        return -np.inf

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """Return the frequency of a computed input, Hz; empty for an input column."""
        return [self.sine[1]] if self.sine else []

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Return the free run of one trial: the simulation from the input and the first outputs.

        The simulation starts from the first na measured outputs, which are returned unchanged. Without a
        measured output it starts from the working point. The result is NaN after a missing input until the
        simulation can start again, and where an unstable model diverges.

        Raises
        ------
        InputError
            The sample time of the trial differs from that of the model, or the trial has no input.
        """
        time = np.asarray(trial.time_s, dtype=float)
        step = sampling.rate(time).step_s
        if abs(step / self.sample_time_s - 1) > sampling.SAME_RATE:
            text = (
                f"trial {trial.id} is sampled every {step:.6g} s, the model every {self.sample_time_s:.6g} s"
            )
            raise InputError(text, column="t_s", hint="resample the log to the model's sample time")
        source = self.input_of(trial, time) - self.source_level
        measured = trial.measured.get(self.output)
        result = np.full(len(time), np.nan)
        for piece in sampling.pieces(time, self.sample_time_s):
            u = piece.take(source)
            if measured is None:
                y = np.where(np.arange(len(u)) < max(self.orders.lag, 1), 0.0, np.nan)
            else:
                y = piece.take(np.asarray(measured, dtype=float)) - self.output_level
            run = simulate(Record(trial.id, piece.time_s, u, y), self.orders, np.asarray(values, dtype=float))
            first = np.flatnonzero(np.isfinite(run))
            if len(first):
                run[: first[0]] = y[: first[0]]
            measured_rows = piece.rows >= 0
            result[piece.rows[measured_rows]] = run[measured_rows] + self.output_level
        return {self.output: result}

    def at_own_level(self, values: Array, trial: Trial) -> tuple[ArxModel, dict[str, float]]:
        """Return the model with an output level estimated from one trial, and this level.

        The level minimises the sum of squared errors of the free run. A model without a working point is
        unchanged.
        """
        if not (self.output_level or self.source_level):
            return self, {}
        levels = (self.output_level, self.output_level + 1.0)
        run, raised = (self._at_level(level).simulate(values, trial)[self.output] for level in levels)
        level = self.output_level + best_level(trial.measured[self.output], run, raised)
        return self._at_level(level), {"output_level": level}

    def _at_level(self, level: float) -> ArxModel:
        moved = copy.copy(self)
        moved.output_level = level
        return moved

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return the free run with effects on the input column, on the clock and on the output.

        See :meth:`Model.hooked`. A delay of the clock is applied to the output by linear interpolation.
        """
        time = np.asarray(trial.time_s, dtype=float)
        if hooks.command:
            column = hooks.actuated(time, self.input_of(trial, time))
            trial = replace(trial, inputs={**trial.inputs, self.source: column})
        channels = self.simulate(values, trial)
        if hooks.late:
            run = channels[self.output]
            known = np.isfinite(run)
            if known.any():
                late = np.interp(hooks.happened(time), time[known], run[known])
                channels[self.output] = np.where(known, late, np.nan)
        return hooks.seen(channels, trial.time_s)

    def input_of(self, trial: Trial, time: Array) -> Array:
        """Return the input of a trial at ``time`` (s), shape (n,), NaN where missing.

        Raises
        ------
        InputError
            The trial has no input column, and the model has no computed input.
        """
        column = trial.inputs.get(self.source)
        if column is not None:
            return np.asarray(column, dtype=float)
        if self.sine is None:
            hint = f"it has: {', '.join(trial.inputs) or 'no inputs'}"
            raise InputError(f"trial {trial.id} lacks the model's input", column=self.source, hint=hint)
        return sine_input(time, *self.sine)


def sine_input(time_s: Array, amplitude: float, frequency_hz: float, phase_rad: float) -> Array:
    """Return ``A sin(2 pi f t + phase)`` in the unit of A: the input F_u of Eq 3, without its noise."""
    return amplitude * np.sin(2 * np.pi * frequency_hz * np.asarray(time_s, dtype=float) + phase_rad)


def _coefficients(parameters: ParameterFile, path: Path | None = None) -> tuple[Orders, float, Array]:
    """Return the orders, the sample time (s) and the coefficients a1, ..., b1, ... of a parameter file."""
    delay, sample_time_s = parameters.delay, parameters.sample_time_s
    if delay is None or sample_time_s is None:
        text = f"a model '{NAME}' needs 'delay' and 'sample_time_s'"
        raise InputError(text, file=path, column="delay")
    if "b1" not in parameters.parameters:
        raise InputError("this parameter is missing", file=path, column="parameters.b1")
    na, nb = (
        next(k for k in itertools.count() if f"{letter}{k + 1}" not in parameters.parameters)
        for letter in "ab"
    )
    orders = Orders(na, nb, delay)
    return orders, sample_time_s, np.array([parameters.value(name) for name in orders.names])


def to_control(parameters: ParameterFile) -> control.TransferFunction:
    """Return the model of a parameter file as a discrete-time transfer function of python-control.

    The transfer function is B / A in z, with the sample time ``dt``. Input and output are deviations from the
    working point.
    """
    import control

    orders, sample_time_s, theta = _coefficients(parameters)
    a, b, _ = orders.split(theta)
    denominator = np.concatenate(([1.0], a, np.zeros(orders.lag - orders.na)))
    numerator = np.concatenate((b, np.zeros(orders.lag - (orders.nk + orders.nb - 1))))
    return control.TransferFunction(numerator, denominator, sample_time_s)


def published(name: str) -> ParameterFile:
    """Return a model of the long-fin paper by its name (see :func:`published_names`), without uncertainties.

    The model of the rotating motion is unstable.
    """
    if name not in published_names():
        raise KeyError(f"no published model {name!r}; there are {', '.join(published_names())}")
    return parameters_format.read(PUBLISHED / f"{name}.yaml")


def published_names() -> tuple[str, ...]:
    """Return the names of the published models."""
    return tuple(sorted(path.stem for path in PUBLISHED.glob("*.yaml")))
