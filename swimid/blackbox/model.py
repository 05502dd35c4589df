"""ARX and ARMAX models: difference equation, simulation, and the data to which they are fitted.

    A(z^-1) y(k) = B(z^-1) u(k) + C(z^-1) e(k)
    A = 1 + a1 z^-1 + ... + a_na z^-na
    B = b1 z^-nk + b2 z^-(nk+1) + ... + b_nb z^-(nk+nb-1)
    C = 1 + c1 z^-1 + ... + c_nc z^-nc

These are Eqs 4 to 7 of the long-fin paper (Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159),
with a delay and a noise polynomial added. y is the output, u the input and e white noise. The folder
``published`` contains the models of Tables II and III of this paper.

The module also reads logs and trials files as records of input and output on a time grid, which the command
``swimid rwls`` fits or holds out. The step of the grid is the time between two measurements of the output.
"""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from swimid.blackbox.options import RwlsOptions
from swimid.errors import InputError, UsageError
from swimid.files.provenance import Input
from swimid.fitting import uncertainty as rt
from swimid.fitting.fit_common import read_trial_log
from swimid.fitting.model import Array, Channel, Hooks, Model, Parameter, Trial
from swimid.logs import sampling
from swimid.logs import trials as trials_format
from swimid.logs.experiments import TrialEntry
from swimid.logs.log import TIME, Log
from swimid.logs.sampling import SAME_RATE, Held, find_held, quantum, step_of, usual_step
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile

if TYPE_CHECKING:
    import control

#: Name that ARX and ARMAX models have in parameter files.
NAME = "arma"
#: Keys of the amplitude, frequency and phase of a sine that replaces an input column, in parameter files.
SINE_SETTINGS = ("amplitude", "frequency_hz", "phase_rad")
#: Citation of the long-fin paper, the source of the model equations.
PAPER = (
    "Shang, Wang, Tan, Cheng: Swimming locomotion modeling for biomimetic underwater vehicle with two "
    "undulating long-fins, Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159"
)
#: Folder with the parameter files of the models that the long-fin paper published.
PUBLISHED = Path(__file__).with_name("published")
#: Magnitude above which a pole in the z plane counts as integrating, whatever its standard error is.
INTEGRATING = 0.999
#: Maximum standard error of a pole's magnitude at which the standard error is used to test whether the pole
#: is integrating. Larger standard errors are unreliable, because their linearisation fails for nearly double
#: poles.
MAX_POLE_STDERR = 0.05
#: Limit at which a diverging simulation is stopped. It is the distance of the simulated output from the
#: measured values, divided by the range of the measured output.
MAX_DISTANCE = 100.0
#: Minimum fraction of the measurements that a log repeats the same number of times. From this fraction on,
#: the rate of the measurements counts as constant.
REGULAR_SHARE = 0.9
#: Minimum median change between successive measurements, in rounding steps, at which equal successive samples
#: count as one measurement that was logged several times. With smaller changes, rounding alone causes many
#: equal samples.
MIN_CHANGE = 5.0
#: Maximum fraction of missing samples in an interval over which the input is averaged.
MAX_MISSING_INPUT = 1e-3


@dataclass(frozen=True)
class ArxRecord:
    """Samples of input and output of a model on a time grid, shape (n,). Missing samples are NaN."""

    #: Name of the log from which the record was read.
    name: str
    time_s: np.ndarray
    #: Samples of the input u of the model.
    source: np.ndarray
    #: Samples of the output y of the model.
    output: np.ndarray

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Orders:
    """Orders of an ARX or ARMAX model.

    ``na``, ``nb`` and ``nc`` are the numbers of coefficients of the polynomials A, B and C. ``nk`` is the
    delay of the input in samples.
    """

    na: int
    nb: int
    nk: int = 1
    nc: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all coefficients of the model: ``a1``, ..., ``b1``, ..., ``c1``, ..."""
        counts = {"a": self.na, "b": self.nb, "c": self.nc}
        return tuple(f"{letter}{i}" for letter, count in counts.items() for i in range(1, count + 1))

    @property
    def count(self) -> int:
        """Total number of coefficients of the polynomials A, B and C."""
        return self.na + self.nb + self.nc

    @property
    def lag(self) -> int:
        """Number of past samples of output and input that the prediction of one output sample needs."""
        return max(self.na, self.nk + self.nb - 1)

    def split(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Split the vector of all coefficients into those of the polynomial A, of B and of C."""
        theta = np.asarray(theta, dtype=float)
        return theta[: self.na], theta[self.na : self.na + self.nb], theta[self.na + self.nb :]

    def __str__(self) -> str:
        noise = f", nc={self.nc}" * bool(self.nc)
        return f"na={self.na}, nb={self.nb}, nk={self.nk}{noise}"


class ArxPole(parameters_format.Pole):
    """Pole of an ARX or ARMAX model in the z plane.

    The standard error of its magnitude is None for a repeated pole.
    """

    @property
    def is_integrating(self) -> bool:
        """Whether the pole is integrating, because its magnitude is 1 within two standard errors.

        A pole with a magnitude above :data:`INTEGRATING` also counts, whatever its standard error is.
        """
        stderr = self.stderr_magnitude
        near = stderr is not None and stderr < MAX_POLE_STDERR and abs(self.magnitude - 1.0) <= 2.0 * stderr
        return near or INTEGRATING < self.magnitude < 2.0 - INTEGRATING

    @property
    def state(self) -> Literal["stable", "integrating", "unstable"]:
        """Class of the pole: unstable (on or outside the unit circle), integrating (near 1), or stable."""
        if self.magnitude >= 1.0:
            return "unstable"
        return "integrating" if self.is_integrating else "stable"


def find_poles(a: np.ndarray, covariance: np.ndarray) -> list[ArxPole]:
    """Return the poles of an ARX model, the roots of its polynomial A, sorted by descending magnitude.

    Parameters
    ----------
    a : ndarray, shape (na,)
        Coefficients a1 to a_na.
    covariance : ndarray, shape (na, na)
        Covariance of the coefficients.

    Notes
    -----
    The standard errors follow from ``dz/da_i = -z^(n-i) / p'(z)``, for a simple root z of the polynomial
    ``p(z) = z^n + a1 z^(n-1) + ...``.
    """
    polynomial = np.concatenate(([1.0], a))
    result = []
    for z in np.roots(polynomial):
        pole = ArxPole(real=float(z.real), imag=float(z.imag), magnitude=float(abs(z)), stderr_magnitude=None)
        slope = np.polyval(np.polyder(polynomial), z)
        if abs(z) > 0 and abs(slope) > 1e-12:
            gradient = -(z ** np.arange(len(a) - 1, -1, -1)) / slope
            along = np.real(np.conj(z) / abs(z) * gradient)
            pole.stderr_magnitude = float(np.sqrt(max(along @ covariance @ along, 0.0)))
        result.append(pole)
    return sorted(result, key=lambda pole: (-pole.magnitude, -pole.imag))


def delay_series(x: np.ndarray, lag: int) -> np.ndarray:
    """Return a copy of a series that is delayed by ``lag`` samples. Its first ``lag`` samples are NaN."""
    return np.concatenate((np.full(lag, np.nan), x))[: len(x)]


def simulate(record: ArxRecord, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """Simulate the output of an ARX model from the input and the first measured outputs of a record.

    Returns
    -------
    ndarray, shape (n,)
        Simulated output. It is NaN at the samples that start the simulation, and at samples that depend on a
        missing input. It is also NaN after its distance from the measured output exceeds :data:`MAX_DISTANCE`
        times the range of the measured output.

    Notes
    -----
    Only ``na`` consecutive samples of the measured output are used, to start the simulation at the beginning
    and again after each gap in the input.
    """
    from scipy.signal import lfilter, lfiltic

    a, b, _ = orders.split(theta)
    measured, na = record.output, orders.na
    values = measured[np.isfinite(measured)]
    limit = 1e150  # This limit of the simulated output prevents overflow if the measured output is constant.
    if len(values) and np.ptp(values) > 0:
        limit = float(np.max(np.abs(values))) + MAX_DISTANCE * float(np.ptp(values))
    driven = np.zeros(len(record))
    for j, value in enumerate(b):
        driven = driven + value * delay_series(record.source, orders.nk + j)
    started = np.isfinite(driven)
    for i in range(1, na + 1):
        started &= np.isfinite(delay_series(measured, i))
    result = np.full(len(record), np.nan)
    for piece in np.ma.clump_unmasked(np.ma.masked_invalid(driven)):
        first = piece.start + int(np.argmax(started[piece]))
        if not started[first]:
            continue
        state = lfiltic([1.0], np.append(1.0, a), measured[first - na : first][::-1])
        run, _ = lfilter([1.0], np.append(1.0, a), driven[first : piece.stop], zi=state)
        # Simulated values that overflow to NaN count as diverged, because a comparison with NaN is false.
        within = np.logical_and.accumulate(np.abs(run) <= limit)
        result[first : piece.stop] = np.where(within, run, np.nan)
    return result


def simulate_all(
    records: Sequence[ArxRecord], orders: Orders, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the measured outputs of all records as one array, and their simulated outputs as another."""
    runs = [simulate(r, orders, theta) for r in records]
    return np.concatenate([r.output for r in records]), np.concatenate(runs)


def best_level(measured: np.ndarray, run: np.ndarray, raised: np.ndarray) -> float:
    """Return the output level of the working point at which a free run has the smallest squared error.

    A free run is a simulation that uses no measured output after its start. The free run is linear in its
    initial samples, so that at level L it is ``run + L (raised - run)``. The result is 0 if the level has no
    effect.

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
    """ARX or ARMAX model from one input column to one output column, with the interface of all models.

    Parameters
    ----------
    parameters : ParameterFile
        Parameter file of ``rwls``. A simulation does not use the noise polynomial.
    path : Path, optional
        Path of the file in error messages.

    Raises
    ------
    InputError
        The file has another model, or lacks the delay, the sample time or coefficients.
    """

    name = NAME
    offers = frozenset({"command", "output", "clock"})
    has_gaps = True

    def __init__(self, parameters: ParameterFile, path: Path | None = None) -> None:
        delay, step_s, found = parameters.delay, parameters.sample_time_s, parameters.parameters
        if parameters.model != NAME:
            raise InputError(f"'{parameters.model}' must be '{NAME}'", file=path, column="model")
        if delay is None or step_s is None:
            text = f"a model '{NAME}' needs 'delay' and 'sample_time_s'"
            raise InputError(text, file=path, column="delay")
        if "b1" not in found:
            raise InputError(f"is missing; '{NAME}' has at least b1", file=path, column="parameters.b1")
        na, nb = (next(k for k in itertools.count() if f"{x}{k + 1}" not in found) for x in "ab")
        self.orders, self.sample_time_s = Orders(na, nb, delay), step_s
        settings = parameters.settings
        self.source, self.output = str(settings.get("input", "u")), str(settings.get("output", "y"))
        #: Levels of the working point of the model. ``source_level`` is subtracted from the input, and
        #: ``output_level`` is added to the simulated output.
        self.source_level = float(settings.get("input_level", 0.0))
        self.output_level = float(settings.get("output_level", 0.0))
        #: Amplitude, frequency (Hz) and phase (rad) of the sine that is the input; None for an input column.
        self.sine: tuple[float, float, float] | None = None
        if settings.get("input_model"):
            self.sine = tuple(settings["input_model"][key] for key in SINE_SETTINGS)
        places = [f"past output, z^-{i + 1}" for i in range(na)]
        places += [f"input, z^-{delay + j}" for j in range(nb)]
        source = f"{PAPER}, Eq 5"
        made = []
        for name, place in zip(self.orders.names, places, strict=True):
            value, unit, meaning = parameters.value(name), found[name].unit, f"coefficient of {place}"
            scale = max(abs(value), 1e-3)
            made.append(Parameter(name, unit, -np.inf, np.inf, value, scale, meaning=meaning, source=source))
        self.parameters = tuple(made)
        unit = str(settings.get("output_unit", "1"))
        self.channels = (Channel(self.output, unit, "output of the model"),)

    def is_commanded(self, trial: Trial) -> bool:
        """Return whether the input column of the model holds commands instead of measured joint angles."""
        return not self.source.startswith("joint")

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Yield the times and values of the known input samples of a trial.

        The third item is the rate of change of the command, which is unknown and set to 0.0.
        """
        time = np.asarray(trial.time_s, dtype=float)
        signal = self.input_of(trial, time)
        known = np.isfinite(signal)
        yield time[known], signal[known], 0.0

    def onset(self, trial: Trial) -> float:
        """Return minus infinity as the time of the start from rest, because the model has no such start."""
        return -np.inf

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """Return the frequency of the sine input of the model, Hz, as a list; empty for an input column."""
        if self.sine is None:
            return []
        return [self.sine[1]]

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Return the free run of a trial: a simulation from its input and its first measured outputs.

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
            run = simulate(
                ArxRecord(trial.id, piece.time_s, u, y), self.orders, np.asarray(values, dtype=float)
            )
            first = np.flatnonzero(np.isfinite(run))
            if len(first):
                run[: first[0]] = y[: first[0]]
            measured_rows = piece.rows >= 0
            result[piece.rows[measured_rows]] = run[measured_rows] + self.output_level
        return {self.output: result}

    def at_own_level(self, values: Array, trial: Trial) -> tuple[ArxModel, dict[str, float]]:
        """Return a copy of the model whose working point has the output level of a trial, and this level.

        The level minimises the sum of squared errors of the free run of the trial. A model without a working
        point is returned unchanged.
        """
        if not (self.output_level or self.source_level):
            return self, {}
        levels = (self.output_level, self.output_level + 1.0)
        run, raised = (self._at_level(one).run(values, trial)[self.output] for one in levels)
        level = self.output_level + best_level(trial.measured[self.output], run, raised)
        return self._at_level(level), {"output_level": level}

    def _at_level(self, level: float) -> ArxModel:
        moved = copy.copy(self)
        moved.output_level = level
        return moved

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return the free run of a trial with effects on the input column, on the clock and on the output.

        See :meth:`Model.simulate_hooked`. A delay of the clock is applied to the output by linear
        interpolation.
        """
        time = np.asarray(trial.time_s, dtype=float)
        if hooks.command:
            column = hooks.actuate(time, self.input_of(trial, time))
            trial = replace(trial, inputs={**trial.inputs, self.source: column})
        channels = self.simulate(values, trial)
        if hooks.late:
            run = channels[self.output]
            known = np.isfinite(run)
            if known.any():
                late = np.interp(hooks.compute_event_times(time), time[known], run[known])
                channels[self.output] = np.where(known, late, np.nan)
        return hooks.sense(channels, trial.time_s)

    def input_of(self, trial: Trial, time: Array) -> Array:
        """Return the samples of the input of a trial at ``time`` (s), NaN where a sample is missing.

        Raises
        ------
        InputError
            The trial has no input column, and the model has no computed input.
        """
        column = trial.inputs.get(self.source)
        if column is not None:
            return np.asarray(column, dtype=float)
        if self.sine is None:
            hint = f"the trial has: {', '.join(trial.inputs) or 'no inputs'}"
            raise InputError(f"trial {trial.id} lacks the model's input", column=self.source, hint=hint)
        return sine_input(time, *self.sine)


def sine_input(time_s: Array, amplitude: float, frequency_hz: float, phase_rad: float) -> Array:
    """Return the sine ``A sin(2 pi f t + phase)`` as the input of a model without an input column.

    The input has the unit of the amplitude A. It is F_u in Eq 3 of the long-fin paper, without noise.
    """
    return amplitude * np.sin(2 * np.pi * frequency_hz * np.asarray(time_s, dtype=float) + phase_rad)


def to_control(parameters: ParameterFile) -> control.TransferFunction:
    """Return the model of a parameter file as a discrete-time transfer function of python-control.

    The transfer function is B / A in z, with the sample time ``dt``. Input and output are deviations from the
    working point.
    """
    import control

    model = ArxModel(parameters)
    orders = model.orders
    a, b, _ = orders.split(np.array([p.start for p in model.parameters]))
    denominator = np.concatenate(([1.0], a, np.zeros(orders.lag - orders.na)))
    numerator = np.concatenate((b, np.zeros(orders.lag - (orders.nk + orders.nb - 1))))
    return control.TransferFunction(numerator, denominator, model.sample_time_s)


def load_published(name: str) -> ParameterFile:
    """Return the parameter file of a model that the long-fin paper published (:func:`list_published`).

    The models have no standard errors. The model of the rotating motion is unstable.
    """
    if name not in list_published():
        raise KeyError(f"there is no published model {name!r}; there are {', '.join(list_published())}")
    return parameters_format.read(PUBLISHED / f"{name}.yaml")


def list_published() -> tuple[str, ...]:
    """Return the names of the models that the long-fin paper published."""
    return tuple(sorted(path.stem for path in PUBLISHED.glob("*.yaml")))


# ------------------------------------------------------------ trials and records


def at_own_rate(log: Log, source: str | None, output: str) -> tuple[Log, list[str]]:
    """Resample a log that repeats its measurements, so that it has one row for each measurement.

    Return the log and a sentence for each column with repeated samples. If a log contains each measurement
    several times, a discrete-time model fitted to it describes the logger, and its poles are wrong. Columns
    that have a value only in every n-th row are also resampled. An input with few levels, or with independent
    levels, is a command that is held on purpose. Such an input is resampled only together with the output.

    Parameters
    ----------
    log : Log
    source : str or None
        Name of the input column; None for a computed input.
    output : str
        Output column.

    Notes
    -----
    Each new measurement of the output gives one row, at its first sample. The input of a row is the mean of
    the input until the next row, as for a zero-order hold. If the measurements of the output have no constant
    rate, the repeated samples are set to NaN instead. An input with repeated samples is used
    as it is.
    """
    repeats, even, columns = [], None, dict(log.columns)
    for column in filter(None, (output, source)):
        values = log[column]
        held, empty = find_held(log.time_s, [values]), np.isnan(values)
        # Accept the repeated samples of an input whose levels are independent, because it is a random
        # command.
        if column == source and rt.ljung_box(values[~held.repeated & ~empty]).is_passed:
            continue
        own = _even_times(log.time_s, values, held)
        if own is None and (column == source or not _is_lossy(values[~empty], held.repeated[~empty])):
            continue
        what = ("are empty", "repeat the previous sample")[bool(held.repeated.any())]
        text = f"{int(np.sum(held.repeated | empty))} of {len(log)} samples of {column} {what}"
        if own is None:
            columns[column] = np.where(held.repeated, np.nan, values)
            text += (
                f" at an uneven rate and are left out; the other samples may be {held.lateness_s:.6g} s late"
            )
        else:
            text += f": it is measured every {usual_step(own[1]):.6g} s"
        if column == output and own is not None:
            even = own
            text += ", and the model is fitted at that rate"
        warn("SWM058", f"{log.path.name}: {text}; log each measurement once, with its own time")
        repeats.append(text)
    if even is not None:
        rows, times = even
        columns = {name: values[rows] for name, values in log.columns.items()} | {TIME: times}
        if source is not None:
            columns[source] = _means(log.time_s, log[source], times)
    return replace(log, columns=columns), repeats


def _even_times(time_s: np.ndarray, values: np.ndarray, held: Held) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the rows and the times (s) at which a column has a new measurement, at a constant rate.

    Return None if the measurements have no constant rate, or if every row has a new measurement.
    """
    rows = np.flatnonzero(~(held.repeated | np.isnan(values)))
    lasts = np.diff(rows)
    if not (lasts > 1).any():
        return None
    factor = int(np.median(lasts[lasts > 1]))
    # Estimate the rate without successive rows of equal values, which may be measurements of a robot at rest.
    shown = lasts[(lasts > 1) | (values[rows[1:]] != values[rows[1:] - 1])]
    if np.mean(shown == factor) >= REGULAR_SHARE:
        kept: list[int] = []
        for row, length in zip(rows.tolist(), [*lasts.tolist(), 1], strict=True):
            if length > 1 or not kept or row - kept[-1] >= factor:
                kept.append(row)
        return np.array(kept), time_s[kept]
    if held.even:
        times = held.measured_s[rows]
        return rows, times + float(np.min(time_s[rows] - times))
    return None


def _means(time_s: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the mean of a piecewise constant signal over the interval from each of ``times`` to the next.

    ``times`` are in s. The mean is NaN if too many samples are missing in an interval
    (:data:`MAX_MISSING_INPUT`).
    """
    steps, missing = np.diff(time_s), np.isnan(values)
    held = np.column_stack([np.where(missing, 0.0, values), missing])
    total = np.vstack([[0.0, 0.0], np.cumsum(held[:-1] * steps[:, None], axis=0)])
    ends = np.append(times, 2 * times[-1] - times[-2])
    row = np.clip(np.searchsorted(time_s, ends + 1e-6 * steps.min(), side="right") - 1, 0, None)
    integral = total[row] + held[row] * (ends - time_s[row])[:, None]
    mean, empty = (np.diff(integral, axis=0) / np.diff(ends)[:, None]).T
    return np.where(empty > MAX_MISSING_INPUT, np.nan, mean)


def _is_lossy(values: np.ndarray, repeated: np.ndarray) -> bool:
    """Return whether a signal repeats measurements, because its equal samples cannot be due to rounding.

    Rounding is excluded if the median change between the other samples is at least :data:`MIN_CHANGE`
    rounding steps.
    """
    changes = np.abs(np.diff(values[~repeated]))
    return bool(repeated.any() and np.median(changes) >= MIN_CHANGE * (step_of(values) or quantum(values)))


# ------------------------------------------------------------ records for rwls


@dataclass(frozen=True)
class Columns:
    """Names of the input and output columns of a model in its logs, and a sine that may replace the input."""

    source: str
    output: str
    #: Amplitude, frequency (Hz) and phase (rad) of the sine that replaces the input column; None if no sine.
    sine: tuple[float, float, float] | None

    @property
    def unit(self) -> str:
        """Unit of the output column, from the suffix of its name; ``"1"`` if the name has no unit."""
        return numbers.split_unit(self.output)[1] or "1"

    @property
    def gain_unit(self) -> str:
        """Unit of the coefficients of the polynomial B: unit of the output divided by that of the input."""
        source = numbers.split_unit(self.source)[1] or "1"
        if source == "1":
            return self.unit
        if source == self.unit:
            return "1"
        return "/".join(re.sub(r"(.*[/ ].*)", r"(\1)", unit) for unit in (self.unit, source))

    @property
    def input_column(self) -> str | None:
        """Name of the input column in the logs; None if a sine replaces the input column."""
        return None if self.sine else self.source


@dataclass(frozen=True)
class Data:
    """Data for the identification of an ARX or ARMAX model: fitted records and held-out records."""

    columns: Columns
    sample_time_s: float
    fit: list[ArxRecord]
    #: Held-out records. The key is the name of a held-out log, or of the held-out part of a log.
    held_out: dict[str, list[ArxRecord]]
    #: Names of the logs to which the model is fitted.
    logs: list[str]
    #: Paths or objects of all input files, which the provenance of the result lists.
    files: list[Input]
    robot: str | None
    #: Sentences on the columns of logs that repeat measurements, one for each such column.
    repeats: list[str]


#: Type of the data that the command accepts: a log, or trials of the experiment ``arma``. Both can be a file
#: or an object in memory.
Source = Any


def read(logs: Sequence[Source], options: RwlsOptions) -> Data:
    """Read logs or a trials file of the experiment ``arma``, and set the held-out data aside.

    Parameters
    ----------
    logs : sequence of paths, Log, DataFrame or TrialSet
    options : RwlsOptions
        Options that state the columns and the data to hold out.

    Raises
    ------
    UsageError
        If the options contradict each other.
    InputError
        A file is unreadable, columns are missing, the rate is not constant, or held-out rows are also fitted.
    """
    share, held_out = _split_held_out(options.held_out)
    listed, groups, files = _list_entries(logs, held_out)
    entries = [entry for group in groups for entry in group]
    _refuse_repeats(groups)
    columns = _columns(options, listed)
    if all(entry.role == "validate" for entry in entries):
        raise UsageError("all trials have role: validate: give role: fit to at least one trial")
    ids = [entry.id for entry in entries]
    names = [entry.id if ids.count(entry.id) == 1 else entry.log for entry in entries]
    required = tuple(name for name in (columns.input_column, columns.output) if name)
    contents, repeats = [], []
    for entry in entries:
        log = read_trial_log(entry, Path(), required=required)
        _check_distinct(log, columns)
        log, found_repeats = at_own_rate(log, columns.input_column, columns.output)
        contents.append(log)
        repeats += found_repeats
    step_s = _common_step(names, contents)
    fitted = {
        name: log for name, entry, log in zip(names, entries, contents, strict=True) if entry.role == "fit"
    }
    fit: list[ArxRecord] = []
    held: dict[str, list[ArxRecord]] = {}
    for name, log in zip(names, contents, strict=True):
        if name not in fitted:
            held[name] = _records(log, name, columns, step_s, slice(None))
            continue
        cut = len(log) - round(share * len(log))
        fit += _records(log, name, columns, step_s, slice(0, cut))
        if share:
            label = "held-out part" + f" of {name}" * (len(fitted) > 1)
            held[label] = _records(log, name, columns, step_s, slice(cut, None))
    files += [Path(entry.log) if entry._held is None else entry._held.source for entry in entries]
    return Data(columns, step_s, fit, held, list(fitted), files, getattr(listed, "robot", None), repeats)


def _list_entries(
    logs: Sequence[Source], held_out: Sequence[Source]
) -> tuple[Any, list[list[TrialEntry]], list[Input]]:
    """Return the trials file if there is one, the trials of each source, and the files besides the logs."""
    groups: list[list[TrialEntry]] = []
    files: list[Input] = []
    listed: Any = None
    for number, (source, role) in enumerate([(s, "fit") for s in logs] + [(s, "validate") for s in held_out]):
        is_file = isinstance(source, str | Path)
        if not (
            isinstance(source, TrialSet) or (is_file and Path(source).suffix.lower() in (".yaml", ".yml"))
        ):
            groups.append([_single(source, role, f"table {number + 1}")])
            continue
        if listed is not None:
            hint = "list logs to fit and logs to hold out (role: validate) in one trials file"
            raise UsageError("two trials files are given; only one trials file is allowed", hint=hint)
        path = trials_format.place(source)
        listed = trials_format.read(source, "rwls")
        files += [path] * (not listed._in_memory)
        groups.append([e.model_copy(update={"log": str(path.parent / e.log)}) for e in listed.trials])
    return listed, groups, files


def _refuse_repeats(groups: Sequence[Sequence[TrialEntry]]) -> None:
    """Refuse rows of one recording that are both fitted and held out.

    The trials of one trials file need no check, because the reader of the file has checked them.
    """
    pairs = [(number, entry) for number, group in enumerate(groups) for entry in group]
    entries = [entry for _, entry in pairs]
    for same in trials_format.same_recordings([(entry, Path(entry.log)) for entry in entries]):
        for first, second in itertools.combinations(same, 2):
            if pairs[first][0] != pairs[second][0]:
                trials_format.check_apart(entries[first], entries[second], Path(entries[first].log))


def _single(source: Source, role: Any, name: str) -> TrialEntry:
    """Return a trial entry for a log that no trials file lists.

    ``name`` is the name of the trial if the log is a table in memory that has no name.
    """
    if isinstance(source, str | Path):
        return TrialEntry(id=Path(source).name, log=str(source), role=role)
    held = source if isinstance(source, Log) else Log.from_frame(source, name=name)
    entry = TrialEntry(id=held.path.name, log=str(held.path), role=role)
    entry._held = held
    return entry


def _split_held_out(given: Sequence[Source | float]) -> tuple[float, list[Source]]:
    """Split the values of the option ``--validate`` into a fraction and a list of logs.

    The fraction is the held-out share of each fitted log, 0 if it is not given. The logs are held out whole.
    """
    shares: list[float] = []
    logs: list[Source] = []
    for item in given:
        try:
            shares.append(float(item))
        except (TypeError, ValueError):
            logs.append(item)
    if len(shares) > 1:
        shown = " ".join(f"{share:g}" for share in shares)
        raise UsageError(f"--validate has several shares, {shown}: give one share and any number of logs")
    for share in shares:
        if not 0 < share < 1:
            hint = "give 0.25 to hold out the last quarter"
            raise UsageError(f"--validate {share:g}: a share must lie between 0 and 1", hint=hint)
    return sum(shares), logs


def _columns(options: RwlsOptions, listed: Any) -> Columns:
    """Return the input and output columns that the options name, or else those that the trials file names."""
    source, output = options.input_column, options.output_column
    if listed is not None:
        source, output = source or listed.input, output or listed.output
    if output is None:
        raise UsageError("the output column is not named", hint="name it: --output COLUMN")
    if (options.input_sine is None) == (source is None):
        hint = "name the input column, --input COLUMN, or compute the input, --input-sine A F PHASE"
        raise UsageError("exactly one input column or input sine is needed", hint=hint)
    if source == output:
        raise UsageError(f"input and output are the same column '{source}': name two columns")
    return Columns(source or "F_u", output, options.input_sine)


def _check_distinct(log: Log, columns: Columns) -> None:
    """Raise an error if the output column of a log is a copy of the input column and is not constant."""
    if columns.sine:
        return
    u, y = log[columns.source], log[columns.output]
    both = np.isfinite(u) & np.isfinite(y)
    if np.any(both) and np.ptp(y[both]) > 0 and np.array_equal(u[both], y[both]):
        text = f"holds the same values as the input column '{columns.source}' in every row"
        hint = "name the measured output with --output"
        raise InputError(text, file=log.path, column=columns.output, hint=hint)


def _common_step(names: Sequence[str], logs: Sequence[Log]) -> float:
    """Return the common sample time of all logs, s. Raise an error if the sampling rates differ or vary."""
    rates = [sampling.rate(log.time_s) for log in logs]
    first_s = rates[0].step_s
    for name, log, rate in zip(names, logs, rates, strict=True):
        step = f"every {rate.step_s:.6g} s, the first log every {first_s:.6g} s"
        if not rate.uniform:
            step = (
                f"at a constant rate: only {100 * rate.on_grid:.0f} % of the steps are whole multiples of "
                f"{rate.step_s:.6g} s"
            )
        if not rate.uniform or abs(rate.step_s / first_s - 1) > SAME_RATE:
            text = f"is {'not ' * (not rate.uniform)}sampled {step}; a discrete-time model needs one rate"
            hint = "resample the logs to one sample time"
            raise InputError(text, file=log.path, column="t_s", hint=hint)
        if rate.jitter > sampling.NOTABLE_JITTER:
            text = f"time steps scatter by {100 * rate.jitter:.1f} % around {rate.step_s:.6g} s"
            warn("SWM003", f"{name}: {text}; the model assumes equal steps")
    return first_s


def _records(log: Log, name: str, columns: Columns, step_s: float, rows: slice) -> list[ArxRecord]:
    """Return the given rows of a log as records of input and output, with a new record after a long gap."""
    time = log.time_s[rows]
    if len(time) < 2:
        return []
    records = []
    for piece in sampling.pieces(time, step_s):
        y = piece.take(log[columns.output][rows])
        if columns.sine:
            u = sine_input(piece.time_s, *columns.sine)
        else:
            u = piece.take(log[columns.source][rows])
        records.append(ArxRecord(name, piece.time_s, u, y))
    return records
