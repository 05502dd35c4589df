"""The model with the causes of a gap, as a parameter file that other commands accept (``repaired.yaml``)."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.diagnosis.answer import compute_stderr
from swimid.diagnosis.crossval import compute_covariance
from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.readings import OtherReading
from swimid.diagnosis.search import SearchResult
from swimid.diagnosis.study import Hypothesis
from swimid.effects.base import Effect
from swimid.effects.catalogue import constants
from swimid.fitting import fit_common
from swimid.fitting.model import Array, Parameter
from swimid.results import parameters as parameters_format
from swimid.results.evidence import compute_rms
from swimid.results.numbers import join_names
from swimid.results.parameters import Correlation, Estimate, ParameterFile, Status
from swimid.simulation.catalogue import Applied, Loaded
from swimid.simulators.mjcf import MjcfModel
from swimid.simulators.repaired import SimulatorFile, make_repaired_file


def build_repaired(
    search: SearchResult,
    file: GapFile,
    loaded: Loaded,
    folder: Path,
    *,
    readings: dict[str, str],
    provenance: Mapping[str, Any],
) -> ParameterFile | None:
    """Return the model with the causes as the content of a parameter file; None if no cause is named.

    The parameters of single trials are left out, and with them effects that differ from trial to trial.

    Parameters
    ----------
    file : GapFile
        Answer of the diagnosis.
    loaded : Loaded
        The experiment, and the parameters with which the diagnosis began.
    folder : Path
        Folder of the parameter file, to which the path of a robot file is relative.
    readings : mapping of str to str
        Interpretations of the robot's source that the user chose.
    """
    causes = {c.effect: c for c in file.causes}
    named = search.base.effects
    if not named or any(e.name not in causes for e in named):
        return None
    fit = search.base
    acting, apart = _divide_effects(fit)
    status: dict[str, Status] = {}
    for e in named:
        values = causes[e.name].parameters.items()
        status |= {e.adds_to or f"{e.name}/{name}": value.status for name, value in values}
    errors = compute_stderr(search.study, fit)
    shared = [p for p in search.study.parameters if not p.per_trial]
    written = [*shared, *(p for e in acting for p in _parameters_of(fit, e))]
    found = {p.name: _estimate(fit, p, fit.changes.get(p.name), errors, status) for p in written}
    model, experiment = loaded.experiment.model, loaded.experiment
    made = ParameterFile(
        model=model.name,
        robot=fit_common.robot_reference(experiment, folder),
        effects=[e.name for e in (*model.effects, *acting)],
        parameters=found,
        identifiability=_list_limits(file, apart),
        correlation=_correlation(search, fit, found),
        settings=_settings(loaded, [*model.effects, *acting], readings | _list_answers(named)),
        fit=_fit_block(search, fit, loaded),
        provenance=dict(provenance),
    )
    if loaded.applied.file is not None:
        known = loaded.applied.file
        made.delay, made.sample_time_s = known.delay, known.sample_time_s
    made._drag = experiment.facts.get("drag")
    return made


def _divide_effects(fit: Hypothesis) -> tuple[list[Effect], list[Effect]]:
    """Return the effects of the model with the causes, and those that differ from trial to trial."""
    effects = [e for e in fit.effects if e.adds_to is None and not isinstance(e, OtherReading)]
    apart = [e for e in effects if any(p.per_trial for p in _parameters_of(fit, e))]
    return [e for e in effects if e not in apart], apart


def _list_answers(effects: Sequence[Effect]) -> dict[str, str]:
    """Return the answers to questions about the robot's source that are causes."""
    return {e.question: e.option for e in effects if isinstance(e, OtherReading)}


def _list_limits(file: GapFile, left_out: Sequence[Effect]) -> list[str]:
    """Return texts on causes that the trials cannot distinguish, and on effects that are left out."""
    alike = [c for c in file.causes if c.equivalent]
    texts = [f"the trials cannot distinguish {c.effect} from {join_names(c.equivalent, 'or')}" for c in alike]
    return texts + [f"{e.name} differs from trial to trial and is not in this model" for e in left_out]


def build_simulator_file(
    loaded: Loaded, made: ParameterFile, place: Path, own_effects: Sequence[Path]
) -> SimulatorFile | None:
    """Return the simulator file of the user with the causes added; None if the model has no such file."""
    model = copy.copy(loaded.experiment.model)
    if not isinstance(model, MjcfModel):
        return None
    if model.acting:
        model.parameters, model.acting = model.parameters[: model.acting[0].first], ()
    trials = loaded.experiment.trials
    applied = Applied(model, made, place, trials=trials, own_effects=own_effects)
    assert isinstance(applied.model, MjcfModel)
    return make_repaired_file(applied.model, applied.values(), trials[0], place)


def _parameters_of(fit: Hypothesis, effect: Effect) -> list[Parameter]:
    """Return the parameters of an effect among those of a fit, with the name ``effect/parameter``."""
    return [p for p in fit.problem.parameters if p.name.rpartition("/")[0] == effect.name]


def _estimate(
    fit: Hypothesis,
    p: Parameter,
    change: str | None,
    errors: Mapping[str, float],
    status: Mapping[str, Status],
) -> Estimate:
    """Return the entry of a parameter in the parameter file.

    Parameters
    ----------
    change : str or None
        Label of the change that is added to the parameter; None if it has not changed.
    status : mapping of name to status
        Status of the parameters of the causes.
    """
    entry = Estimate(value=p.start, unit=p.unit, bounds=p.bounds, status="fixed", meaning=p.meaning)
    label = change or p.name
    if label not in fit.labels:
        return entry
    entry.value, stderr = fit.value(p.name), errors[label.removesuffix("/change") if change else label]
    if change is not None:
        entry.value += fit.value(change)
    entry.status = "at-bound"
    if status.get(p.name, "estimated") == "estimated" and (fit.is_inside(label) or p.name in status):
        entry.status, entry.stderr = "estimated", float(stderr)
    return entry


def _correlation(search: SearchResult, fit: Hypothesis, found: Mapping[str, Estimate]) -> Correlation | None:
    """Return the correlation matrix of the estimates that have a standard error; None for fewer than two."""
    names = [name for name, one in found.items() if one.stderr]
    if len(names) < 2:
        return None
    # Each row of the matrix selects one parameter, or sums a parameter and its change.
    rows = np.array([np.isin(fit.labels, [n, fit.changes.get(n, n)]) for n in names], dtype=float)
    whole = compute_covariance(search.study, fit)
    part: Array = rows @ whole @ rows.T
    sd = np.sqrt(np.diag(part))
    return Correlation(names=names, matrix=(part / np.outer(sd, sd)).tolist())


def _settings(loaded: Loaded, effects: Sequence[Effect], readings: Mapping[str, str]) -> dict[str, Any]:
    """Return the settings of the model: those of the file with which the diagnosis began, and the causes."""
    experiment, file = loaded.experiment, loaded.applied.file
    model, facts = experiment.model, experiment.facts
    found = {} if file is None else dict(file.settings)
    # The diagnosis estimates each parameter of a group separately, so that groups do not apply any more.
    found.pop("shared", None)
    names = ("reference_amplitude_rad", "reference_frequency_hz")
    found |= {name: value for name in names if (value := getattr(model, name, None)) is not None}
    found |= {name: facts[name] for name in ("waveform", "asymmetry") if name in facts}
    if "drag_path" in facts:
        found["drag_file"] = str(facts["drag_path"])
    chosen = {**found.get("readings", {}), **readings}
    own = {e.name: constants(e) for e in effects if constants(e)}
    return found | {name: of for name, of in (("readings", chosen), ("effects", own)) if of}


def _fit_block(search: SearchResult, fit: Hypothesis, loaded: Loaded) -> parameters_format.Fit:
    """Return the trials, the errors of each channel and the noise of a fit."""
    study, file = search.study, loaded.applied.file
    units = {c.name: c.unit for c in study.model.channels}
    samples = fit.collect_measured()
    channels, noise = {}, {}
    for channel, left in fit.by_channel().items():
        if file is not None and file.fit is not None and channel not in file.fit.channels:
            continue
        error, size = compute_rms(left), float(np.ptp(samples[channel])) or 1.0
        known = {"rmse": error, "nrmse": error / size, "samples": len(left), "unit": units.get(channel, "1")}
        channels[channel], noise[channel] = known, {"value_sd": error}
    about: dict[str, Any] = {"method": "diagnosis"}
    about["samples_sha256"] = {t.id: t.digest for t in loaded.experiment.trials}
    if study.model.swimmer is not None:
        from swimid.swimmer.trials import find_drive_range

        drives = find_drive_range(study.trials)
        if drives:
            about["drives"] = {name: list(ends) for name, ends in drives.items()}
    trials = [t.id for t in loaded.experiment.trials if t.role == "fit"]
    return parameters_format.Fit(trials=trials, channels=channels, converged=True, noise=noise, **about)
