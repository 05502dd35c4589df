"""The command ``diagnose``: locate the gap between a model and its trials, and find the cause."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from swimid.diagnosis import answer, evidence, nominal, power, readings, repaired, search
from swimid.diagnosis.evidence import Diagnosis
from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.held_out import HeldOutSeries
from swimid.diagnosis.nominal import Preparation
from swimid.diagnosis.options import DiagnoseOptions
from swimid.diagnosis.power import DetectionPower
from swimid.diagnosis.proposals import TrialLimits
from swimid.diagnosis.study import GapStudy
from swimid.effects import catalogue as effect_catalogue
from swimid.effects.base import Effect
from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.files.atomic import Checkpoint
from swimid.files.provenance import Input
from swimid.fitting.fit_common import TRIALS_FILE
from swimid.fitting.model import Model
from swimid.logs import trials as trials_format
from swimid.logs.trials import TrialSet
from swimid.notices import Notice, Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.results import parameters as parameters_format
from swimid.results.numbers import join_names
from swimid.results.parameters import ParameterFile
from swimid.simulation import catalogue as experiment_catalogue
from swimid.simulation import compare_series
from swimid.simulation.catalogue import Loaded
from swimid.simulation.compare_series import ChannelScore

#: Text that says why a diagnosis without a parameter file cannot find a changed parameter.
NOT_GIVEN = (
    "no parameter file was given: the refit began at the values of {}, which are not taken as known, so "
    "that no changed parameter can be named"
)
#: Text on an effect that has no form for a simulator of the user.
CANNOT_ACT = "the effect is not defined for this simulator, or its channels were not measured"
#: Text on changed parameters that are not among the requested effects.
NOT_REQUESTED = "changes of parameters were not requested and not tried: {}"
#: Text that says why there is no proposed trial if the answer leaves no alternative causes.
NO_RIVALS = "the diagnosis has no rival causes that a trial could distinguish"


def _compute_errors(loaded: Loaded) -> dict[str, ChannelScore]:
    """Return the error of the model in each channel, with the parameter values as given.

    The errors are those that the command ``compare`` computes.
    """
    experiment, applied = loaded
    try:
        done, _ = compare_series.compare_trials(applied, experiment.trials, refit=True)
    except NoTrustworthyResult:
        # The simulation diverges with the given parameters, so they have no errors. A refit may still work.
        return {}
    return compare_series.pool(done, experiment.model)


def _check_requested(effects: Sequence[str], names: list[str], model: Model) -> None:
    """Check that the effects that the user requests are hypotheses.

    Raises
    ------
    UsageError
        If an effect does not exist, or acts in the model already.
    """
    acting = [e.name for e in model.effects]
    for name in effects:
        if name in acting:
            raise UsageError(f"the effect '{name}' is part of the model in the parameter file: omit it")
        if name not in names:
            raise UsageError(f"there is no effect '{name}'", hint=suggestion(name, names))


def _check_outputs(
    options: DiagnoseOptions,
    output: Path | None,
    inputs: Sequence[Input],
    allow: Callable[[Path], object],
    ending: str,
) -> Path | None:
    """Check all outputs, and return the path of the parameter file with the causes; None if none is written.

    A simulator file with the causes has the same path with the suffix ``ending``.

    Raises
    ------
    InputError, UsageError
        If an output cannot be written, is an input or another output, or is given beside ``--power``.
    """
    if options.next is not None and options.power:
        raise UsageError("--next and --power cannot be combined: --power compares no causes; omit --next")
    if options.repaired is not None and options.power:
        raise UsageError("--repaired and --power cannot be combined: --power finds no cause; omit --repaired")
    repaired_path = options.repaired
    if repaired_path is None and output is not None and not (options.power or atomic.is_device(output)):
        repaired_path = output.with_name(evidence.REPAIRED)
    outputs = [output, repaired_path, options.next]
    if repaired_path is not None:
        _check_repaired(repaired_path, output, inputs)
        outputs.append(repaired_path.with_suffix(ending) if ending else None)
    for path in outputs:
        if path is not None:
            allow(atomic.check_writable(path, inputs=inputs))
    return repaired_path


def _check_repaired(path: Path, output: Path | None, inputs: Sequence[Input]) -> None:
    """Raise an error if the parameter file with the causes is the gap file or an input."""
    hint = "name another file for the model with the causes: --repaired FILE"
    if output is not None and path.resolve() == output.resolve():
        raise UsageError(f"two outputs would be written to {path}", hint=hint)
    if any(isinstance(i, str | Path) and Path(i).resolve() == path.resolve() for i in inputs):
        raise UsageError(f"{path} is an input of this diagnosis", hint=hint)


def _write_outputs(
    made: Diagnosis, output: Path | None, place: Path | None, command: Path | None
) -> Diagnosis:
    """Write all outputs of a diagnosis or none, and return it with their paths."""
    with atomic.write_together():
        if output is not None:
            made = made.save(output, place)
        elif place is not None:
            made = made.with_repaired(place)
        if command is not None and made.next is not None:
            made = made.with_command(command)
    return made


@dataclass(frozen=True)
class _Task:
    """Inputs of a diagnosis, before any fit.

    Attributes
    ----------
    effects : list of Effect
        Effects of the catalogue and of the user that are not part of the model.
    applicable : list of Effect
        Forms of these effects that apply to the model and its trials.
    asked : set of str or None
        Names of the requested effects; None for all effects.
    about : dict
        Entries that a gap file and a power file share.
    """

    options: DiagnoseOptions
    loaded: Loaded
    begun: Preparation
    study: GapStudy
    effects: list[Effect]
    applicable: list[Effect]
    asked: set[str] | None
    about: dict[str, Any]

    def is_asked(self, name: str) -> bool:
        """Return whether an effect may be a cause."""
        return self.asked is None or name in self.asked

    @property
    def reasons(self) -> list[str]:
        """Reasons why changes of parameters are no hypotheses."""
        reasons = []
        if self.options.params is None:
            reasons.append(NOT_GIVEN.format(self.loaded.experiment.values_from))
        names = [c.name for c in self.begun.changes if not self.is_asked(c.name)]
        if names:
            omitted = [name.removeprefix(nominal.PREFIX) for name in names]
            reasons.append(NOT_REQUESTED.format(join_names(omitted)))
        return reasons


def _prepare(loaded: Loaded, options: DiagnoseOptions, inputs: Sequence[Input]) -> _Task:
    """Return the inputs of a diagnosis.

    Raises
    ------
    UsageError
        If a requested effect does not exist, or acts in the model already.
    NoTrustworthyResult
        If there is no trial of role ``fit``.
    """
    experiment = loaded.experiment
    model = experiment.model
    own = [e for path in options.own_effects for e in effect_catalogue.from_file(path)]
    # The noise is estimated with the whole catalogue, even if only some effects are asked for. An effect of
    # the parameter file is part of the model, and no hypothesis.
    effects = [e for e in [*effect_catalogue.list_effects(), *own] if e.joins(model.effects)]
    begun = nominal.prepare_diagnosis(loaded)
    asked = None
    if options.effects:
        names = [*(e.name for e in (*effects, *begun.changes)), *readings.list_names(experiment)]
        _check_requested(options.effects, names, model)
        asked = {*options.effects, *(e.name for e in own)}
    trials = [t for t in begun.trials if t.role == "fit"]
    if not trials:
        raise NoTrustworthyResult("no trial has the role 'fit'")
    jobs = options.jobs or os.cpu_count() or 1
    study = GapStudy(model, model.parameters, trials, begun.prior, correlation=begun.correlation, jobs=jobs)
    given = experiment.values_from
    if options.params is not None:
        given = str(parameters_format.source_path(options.params))
    about = {
        "model": model.name,
        "robot": experiment.robot.name,
        "experiment": experiment.name,
        "params": given,
        "trials": [t.id for t in experiment.trials],
        "provenance": provenance.collect(inputs, settings=options.settings()),
    }
    applicable = effect_catalogue.applicable(effects, model, trials)
    return _Task(options, loaded, begun, study, effects, applicable, asked, about)


def _find_power(task: _Task, notices: Sequence[Notice]) -> DetectionPower:
    """Return the detection power of the trials."""
    with threadpool_limits(limits=1, user_api="blas"):
        rows, left_out = power.compute_power(task.study, task.applicable, task.asked, seed=task.options.seed)
    file = power.PowerFile(**task.about, effects=rows, left_out=left_out)
    return DetectionPower.of(file, power.build_power_evidence(file, list(notices)))


def _check_command(path: Path, file: GapFile) -> None:
    """Warn if there is no proposed trial, so that its command file is not written."""
    if all(a.command is None for a in file.advice):
        why = [a.text for a in file.advice if a.noise is not None] or [NO_RIVALS]
        warn("SWM075", f"{path.name} is not written: {why[0]}")


def _find_causes(
    task: _Task, folder: Path, checkpoint: Checkpoint, progress: Progress
) -> tuple[GapFile, list[HeldOutSeries], ParameterFile | None]:
    """Return the gap file, the worst held-out trial, and the parameters of the model with the causes.

    Parameters
    ----------
    folder : Path
        Folder of the parameter file with the causes.
    """
    options, begun, study = task.options, task.begun, task.study
    experiment = task.loaded.experiment
    as_given = _compute_errors(task.loaded)
    others, left_out = readings.list_readings(experiment, study.trials)
    result = search.search_causes(
        study, [*task.applicable, *others, *begun.changes], asked=task.asked, seed=options.seed,
        most=options.max_causes, checkpoint=checkpoint, progress=progress,
    )  # fmt: skip
    hz, deg = (most or math.inf for most in (options.max_frequency_hz, options.max_amplitude_deg))
    limits = TrialLimits(experiment, options.tank_length_m, hz, math.radians(deg))
    validation = [t for t in begun.trials if t.role == "validate"]
    with threadpool_limits(limits=1, user_api="blas"):
        file, worst = answer.answer(result, validation, begun, study.trials, limits=limits, progress=progress)
    origin = {"readings": dict(options.readings), "provenance": task.about["provenance"]}
    repaired_file = repaired.build_repaired(result, file, task.loaded, folder, **origin)
    if options.next is not None:
        _check_command(options.next, file)
    if experiment.values_from == TRIALS_FILE:
        forms = {e.name for e in task.applicable}
        left_out |= {e.name: CANNOT_ACT for e in task.effects if e.stage != "rig" and e.name not in forms}
    about = {
        "reasons": [*file.reasons, *task.reasons],
        "left_out": {name: why for name, why in left_out.items() if task.is_asked(name)} | file.left_out,
        "as_given": as_given,
    }
    return file.model_copy(update=task.about | about), worst, repaired_file


@takes(DiagnoseOptions)
def diagnose(
    trials: str | Path | TrialSet,
    *,
    options: DiagnoseOptions,
    output: Path | None = None,
    allow: Callable[[Path], object] = atomic.check_writable,
    progress: Progress = silent,
) -> Diagnosis | DetectionPower:
    """Find the effect behind the gap between a model and its trials.

    Without a parameter file the refit starts at the values of the robot file, which are not used as a prior.
    The result does not depend on the number of jobs. An effect that refitted coefficients can imitate is not
    detected. An explained gap does not rule out an effect outside the catalogue that acts in the same way.

    Parameters
    ----------
    trials : path or TrialSet
        Trials of any experiment: a file, or the result of :func:`swimid.load`.
    output : path, optional
        Gap file to write. The evidence file, and the parameter file of the model with the causes, are written
        next to it.
    allow : callable
        Function that is called with every file before it is written. It raises an error if the file must not
        be written.
    progress : Progress
        Progress display of the fitted effects.

    Returns
    -------
    Diagnosis or DetectionPower
        With ``power=True`` the detection power of the trials, otherwise the diagnosis.
        ``.answer`` is ``"none"``, ``"explained"``, ``"partial"``, ``"ambiguous"`` or ``"unexplained"``
        (:mod:`swimid.diagnosis.verdict`). ``.causes`` has the parameters of each cause with their units.
        ``.shrinkage`` has the errors on held-out data without and with the causes, divided by the measured
        range. ``.where`` has the gap and the noise floor of each channel. ``.repaired`` has the parameters of
        the model with the causes, or is None. ``.next`` is the command file of the trial that separates rival
        causes best, or None.

    Raises
    ------
    InputError, UsageError
        If a file or an option is invalid.
    NoTrustworthyResult
        If there is no trial of role ``fit``, or the model cannot be simulated.

    References
    ----------
    .. [1] M. C. Kennedy, A. O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63(3),
       2001: model discrepancy as part of the model.
    .. [2] V. Klein, E. A. Morelli, *Aircraft System Identification: Theory and Practice*, AIAA, 2006.
       Output error, coloured residuals.
    .. [3] Y. Yao et al., "Using stacking to average Bayesian predictive distributions", Bayesian Analysis
       13(3), 2018: weights of hypotheses by the Bayesian bootstrap.
    .. [4] K. R. Rad, A. Maleki, "A scalable estimate of the out-of-sample prediction error via approximate
       leave-one-out cross-validation", J. R. Stat. Soc. B 82(4), 2020: refit by one step.
    .. [5] G. E. P. Box, W. J. Hill, "Discrimination among mechanistic models", Technometrics 9(1), 1967:
       choice of the next experiment.

    Examples
    --------
    Four drops, with a model without pulley friction:

    >>> import swimid
    >>> drops = [
    ...     {"id": f"w{g}", "log": swimid.read_log(f"sample_logs/rig/w{g}.csv"), "pulling_mass_kg": g / 1000}
    ...     for g in (10, 20, 30, 40)
    ... ]
    >>> trials = swimid.load(drops, experiment="falling-weight", robot="boxfish")
    >>> ideal = swimid.fit_drag(trials, fixed={"pulley_friction": 0.0})
    >>> gap = diagnose(trials, params=ideal, effects=["pulley-friction"])
    >>> cause = gap.causes.iloc[0]
    >>> gap.answer, cause["effect"], round(float(cause["value"]), 3), cause["unit"]
    ('explained', 'pulley-friction', 0.031, 'N')

    The model with the cause follows the drops:

    >>> bool((swimid.compare(trials, params=gap.repaired).scores["nrmse"] < 0.002).all())
    True
    """
    with record_warnings(repeat=True) as notices:
        loaded = experiment_catalogue.load(trials, options)
        model = loaded.experiment.model
        inputs = [*loaded.experiment.inputs, *options.own_effects]
        repaired_path = _check_outputs(options, output, inputs, allow, model.file_ending)
        task = _prepare(loaded, options, inputs)
        origin = task.about["provenance"]
        checkpoint = Checkpoint.of_output(output, [origin["inputs"], origin["settings"]])
        model.prepare(progress, effects=True)
        if options.power:
            could = _find_power(task, notices)
            checkpoint.finish()
            return could.write_output(output)
        folder = (repaired_path or trials_format.place(trials)).parent
        file, worst, repaired_file = _find_causes(task, folder, checkpoint, progress)
        simulator = None
        if repaired_file is not None and repaired_path is not None:
            edited = repaired.build_simulator_file(loaded, repaired_file, repaired_path, options.own_effects)
            simulator = edited and (model.file_ending, edited)
        if repaired_file is None and repaired_path is not None and repaired_path.exists():
            text = f"{repaired_path.name} is the file of an earlier diagnosis: this diagnosis found no cause"
            warn("SWM061", text)
    sources = loaded.experiment.robot.sources
    shown = evidence.build_gap_evidence(file, worst, sources=sources, notices=list(notices))
    made = replace(Diagnosis.of(file, shown), repaired=repaired_file, simulator=simulator)
    made = _write_outputs(made, output, repaired_path, options.next)
    checkpoint.finish()
    return made
