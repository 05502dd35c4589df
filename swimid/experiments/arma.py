"""Experiment ``arma``: a black-box model with one column of the logs as input and another as output."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from swimid.blackbox.model import ArxModel, at_own_rate
from swimid.errors import InputError, UsageError
from swimid.files.provenance import Input
from swimid.fitting.fit_common import Experiment, SimulationRun, read_trial_log
from swimid.fitting.model import Array, Trial
from swimid.logs import log as log_format
from swimid.logs.experiments import Params, TrialEntry, Trials
from swimid.logs.sampling import DURATION_S, even_times


class Arma(Trials):
    """Trials file for a black-box model from one input column to one output column of the logs.

    Example::

        format: swimid-trials/1
        experiment: arma
        robot: tfish
        input: cmd1_rad
        output: yaw_rate_rad_s
        trials:
          - {log: run1.csv}
          - {log: run2.csv, role: validate}
    """

    about = "a black-box model from one column to another; add input and output"
    models = (ArxModel.name,)
    commands = ("rwls",)
    robot_form = ""

    experiment: Literal["arma"]
    input: str | None = None
    output: str | None = None
    trials: Annotated[list[TrialEntry], Field(min_length=1)]

    def load(self, path: Path, *, params: Params | None = None, **options: Any) -> Experiment:
        """Read the trials for the model of a parameter file (see :meth:`Trials.load`).

        The input and output columns are those to which the model was fitted.

        Raises
        ------
        UsageError
            There is no parameter file.
        InputError
            The trials file names other columns, or a file cannot be used.
        """
        if params is None:
            raise UsageError(
                "a black-box model has no default parameters: give those of a fit with --params",
                hint="swimid rwls estimates them and writes the file",
            )
        model = ArxModel(params[1], params[0])
        read = [model.source] * (model.sine is None)
        for key, columns in (("input", read), ("output", [model.output])):
            named = getattr(self, key)
            if columns and named is not None and named != columns[0]:
                words = f"these trials name the {key} '{named}', the parameters are of '{columns[0]}'"
                raise InputError(words, file=path, column=key)
        logs: list[Input] = []
        trials = []
        for entry in self.trials:
            log = read_trial_log(entry, path.parent, required=(*read, model.output))
            log, _ = at_own_rate(log, next(iter(read), None), model.output)
            logs.append(log.source)
            measured, given = {model.output: log[model.output]}, {name: log[name] for name in read}
            trials.append(Trial(entry.id, entry.role, log.time_s, measured, given))
        return Experiment.of(self, path, model, trials, logs)

    @classmethod
    def prepare_run(cls, options: Any, params: Params, time_s: Array) -> SimulationRun:
        """Return a simulation from the input column of a log, or from the sine of the parameter file."""
        path, file = params
        model = ArxModel(file, path)
        metadata: dict[str, Any] = {}
        if options.input is not None:
            wanted: tuple[str, ...] = ()
            if not model.sine:
                wanted = (model.source,)
            log = log_format.read(options.input, required=wanted, optional=(model.output,))
            measured = {model.output: log[model.output]} if model.output in log else {}
            trial = Trial("run", "fit", log.time_s, measured, inputs={name: log[name] for name in wanted})
            metadata["input"] = options.input.name
        elif model.sine is not None:
            times = even_times(options.duration_s or DURATION_S, 1.0 / model.sample_time_s)
            trial = Trial("run", "fit", times, {})
        else:
            raise UsageError(
                f"this model runs on the column '{model.source}': give a log with --input run.csv"
            )
        return SimulationRun(model, trial, metadata=metadata, extra=trial.inputs)
