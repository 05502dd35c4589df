"""ARX model with the interface of all swimid models, and its conversions (parameter file, python-control).

The folder ``published`` contains the models of Tables II and III of the long-fin paper.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swimid.blackbox.difference import Orders, Record, best_level, simulate
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
