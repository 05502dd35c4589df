"""The ARX model as a model: simulated by free run, read from parameter files, given to python-control.

The models the long-fin paper published (Tables II and III) lie in ``published``, ready to run.
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
from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Channel, Model, Parameter, Trial
from swimid.logs import sampling
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile

if TYPE_CHECKING:
    import control

#: ``model`` of the parameter file.
NAME = "arma"
_PAPER = (
    "Shang, Wang, Tan, Cheng: Swimming locomotion modeling for biomimetic underwater vehicle with two "
    "undulating long-fins, Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159"
)
#: Parameter files of the models of the long-fin vehicle that the paper published.
PUBLISHED = Path(__file__).with_name("published")


class ArxModel(Model):
    """A discrete-time model from one input column to one output column.

    Parameters
    ----------
    orders : Orders
        na, nb, nk; the noise polynomial plays no part in a simulation.
    source, output : str
        Names of the input and the output column.
    source_level, output_level : float
        Working point: subtracted from the input, added to the simulated output.
    sine : tuple of float, optional
        Amplitude, frequency (Hz) and phase (rad) of the input where no column holds it.
    start : ndarray, shape (na + nb,), optional
        Coefficients a1 .. b1 .. as start values.
    unit, gain_unit : str
        Of the output, and of the b coefficients.
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
        values = np.zeros(self.orders.count) if start is None else np.asarray(start, dtype=float)
        self.parameters = tuple(
            Parameter(
                name,
                gain_unit if name.startswith("b") else "1",
                -np.inf,
                np.inf,
                float(value),
                scale=max(abs(float(value)), 1e-3),
                meaning=f"coefficient of {_place(name, self.orders)}",
                source=f"{_PAPER}, Eq 5",
            )
            for name, value in zip(self.orders.names, values, strict=True)
        )
        self.channels = (Channel(output, unit, "output of the model"),)

    @classmethod
    def from_file(cls, parameters: ParameterFile) -> ArxModel:
        """The model a parameter file holds.

        Raises
        ------
        InputError
            When the file is of another model, or lacks delay, sample time or coefficients.
        """
        if parameters.model != NAME:
            raise InputError(f"model '{parameters.model}' is not '{NAME}'", column="model")
        if parameters.delay is None or parameters.sample_time_s is None:
            raise InputError(f"a model '{NAME}' needs 'delay' and 'sample_time_s'", column="delay")
        orders = _orders(parameters)
        settings = parameters.settings
        sine = settings.get("input_model")
        return cls(
            orders,
            parameters.sample_time_s,
            source=str(settings.get("input", "u")),
            output=str(settings.get("output", "y")),
            source_level=float(settings.get("input_level", 0.0)),
            output_level=float(settings.get("output_level", 0.0)),
            sine=sine and (sine["amplitude"], sine["frequency_hz"], sine["phase_rad"]),
            start=np.array([parameters.value(name) for name in orders.names]),
            unit=str(settings.get("output_unit", "1")),
            gain_unit=parameters.parameters["b1"].unit,
        )

    def commanded(self, trial: Trial) -> bool:
        """Whether the input column is a command, not a measured joint angle."""
        return not self.source.startswith("joint")

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """The input where it is there; its rate is not known beyond its samples."""
        time = np.asarray(trial.time_s, dtype=float)
        signal = self.input_of(trial, time)
        there = np.isfinite(signal)
        yield time[there], signal[there], 0.0

    def onset(self, trial: Trial) -> float:
        """Always: the input moves no body that would start from rest."""
        return -np.inf

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """The frequency of the sine, Hz, where no column holds the input."""
        return [] if self.sine is None else [self.sine[1]]

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Free run of one trial.

        It starts from the first na measured outputs (from the working point, at rest, when the
        trial has no measured output), which are returned as they are. Missing input ends the
        run until it can start again: NaN there, and where an unstable model runs away.

        Raises
        ------
        InputError
            When the trial's sample time is not the model's, or its input is missing.
        """
        time = np.asarray(trial.time_s, dtype=float)
        step = sampling.rate(time).step_s
        if abs(step / self.sample_time_s - 1) > 0.01:
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
            there = piece.rows >= 0
            result[piece.rows[there]] = run[there] + self.output_level
        return {self.output: result}

    def at_own_level(self, values: Array, trial: Trial) -> tuple[ArxModel, dict[str, float]]:
        """A model of deviations from a working point, at the level this trial's output has.

        The run is linear in the level, so two runs give the one with the least squared error.
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
        """The same with what else acts (see :meth:`Model.hooked`): on the input column, and on the output.

        The clock delays the output by straight lines between its samples; the run starts from the
        first measured outputs as before.
        """
        time = np.asarray(trial.time_s, dtype=float)
        if hooks.command:
            column = hooks.actuated(time, self.input_of(trial, time))
            trial = replace(trial, inputs={**trial.inputs, self.source: column})
        channels = self.simulate(values, trial)
        if hooks.late:
            run = channels[self.output]
            there = np.isfinite(run)
            if there.any():
                late = np.interp(hooks.happened(time), time[there], run[there])
                channels[self.output] = np.where(there, late, np.nan)
        return hooks.seen(channels, trial.time_s)

    def input_of(self, trial: Trial, time: Array) -> Array:
        """The input of a trial at ``time`` (s), NaN where missing: its column, or the sine without one.

        Raises
        ------
        InputError
            When there is neither.
        """
        column = trial.inputs.get(self.source)
        if column is not None:
            return np.asarray(column, dtype=float)
        if self.sine is None:
            hint = f"it has: {', '.join(trial.inputs) or 'no inputs'}"
            raise InputError(f"trial {trial.id} lacks the model's input", column=self.source, hint=hint)
        return sine_input(time, *self.sine)


def sine_input(time_s: Array, amplitude: float, frequency_hz: float, phase_rad: float = 0.0) -> Array:
    """F_u of Eq 3 without its noise: ``A sin(2 pi f t + phase)``, in the unit of A."""
    return amplitude * np.sin(2 * np.pi * frequency_hz * np.asarray(time_s, dtype=float) + phase_rad)


def _place(name: str, orders: Orders) -> str:
    power = int(name[1:]) + (orders.nk - 1 if name.startswith("b") else 0)
    return f"{'past output' if name.startswith('a') else 'input'}, z^-{power}"


def _orders(parameters: ParameterFile) -> Orders:
    """Orders by the names present: a1 .. a_na, b1 .. b_nb, c1 .. c_nc."""

    def count(letter: str) -> int:
        return next(k for k in itertools.count() if f"{letter}{k + 1}" not in parameters.parameters)

    if count("b") == 0:
        raise InputError("this parameter is missing", column="parameters.b1")
    return Orders(count("a"), count("b"), parameters.delay if parameters.delay is not None else 1)


def to_control(parameters: ParameterFile) -> control.TransferFunction:
    """The model of a file of ``swimid rwls`` as a discrete-time transfer function B / A of python-control.

    In z, with ``dt`` the sample time. Between deviations from the working point, where one was removed.
    """
    import control

    orders = _orders(parameters)
    if parameters.sample_time_s is None:
        raise InputError("this key is missing", column="sample_time_s")
    a = [parameters.value(f"a{i}") for i in range(1, orders.na + 1)]
    b = [parameters.value(f"b{i}") for i in range(1, orders.nb + 1)]
    denominator = np.concatenate(([1.0], a, np.zeros(orders.lag - orders.na)))
    numerator = np.concatenate((b, np.zeros(orders.lag - (orders.nk + orders.nb - 1))))
    return control.TransferFunction(numerator, denominator, parameters.sample_time_s)


def published(name: str) -> ParameterFile:
    """A model the long-fin paper published, one of :func:`published_names`; it gives no uncertainties.

    The rotating model is unstable.
    """
    if name not in published_names():
        raise KeyError(f"no published model {name!r}; there are {', '.join(published_names())}")
    return parameters_format.read(PUBLISHED / f"{name}.yaml")


def published_names() -> tuple[str, ...]:
    """Names :func:`published` knows."""
    return tuple(sorted(path.stem for path in PUBLISHED.glob("*.yaml")))
