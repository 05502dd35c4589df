"""Propose the next experiment: the setting that best distinguishes rival causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.diagnosis import crossval, settings
from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.gap_file import Advice
from swimid.diagnosis.noise_model import NoiseModel
from swimid.fitting.model import Array, Trial
from swimid.fitting.problem import Problem

#: Maximum number of proposed experiments in a report.
MOST = 4


def proposals(trials: Sequence[Trial]) -> list[tuple[str, Trial]]:
    """Return experiments that could be done next, each with its description and a trial to simulate.

    A proposed trial differs from the given trials in its beat or its driving force.
    """
    template = max(trials, key=lambda t: len(t.time_s))
    found: list[tuple[str, Trial]] = []
    beat = template.swim.beat
    if beat is not None:
        beats = [t.swim.beat for t in trials if t.swim.beat is not None]
        f = sorted({b.frequency_hz for b in beats})
        a = sorted({b.amplitude_rad for b in beats})
        changes: list[dict[str, Any]] = [
            {"frequency_hz": 0.6 * f[0]}, {"frequency_hz": 1.4 * f[-1]}, {"amplitude_rad": 0.6 * a[0]},
            {"amplitude_rad": 1.4 * a[-1]}, {"bias_rad": math.radians(20.0)},
            {"frequency_hz": 1.4 * f[-1], "amplitude_rad": 1.4 * a[-1]},
            {"frequency_hz": 0.6 * f[0], "amplitude_rad": 1.4 * a[-1]},
        ]  # fmt: skip
        for change in changes:
            moved = replace(beat, **change)
            trial = replace(template, swim=replace(template.swim, beat=moved))
            says = settings.words(trial)
            found.append((", ".join(f"{k} {v}" for k, v in says.items()), trial))
    elif template.rig.force is not None and "force_N" not in template.inputs:
        forces = [t.rig.pull for t in trials]
        for force in (0.5 * min(forces), 2.0 * max(forces)):
            if force > 0:
                trial = replace(template, rig=replace(template.rig, force=force))
                found.append((f"a driving force of {force:.3g} N", trial))
    elif all(len(t.inputs.get("frequency_hz", ())) == 1 for t in trials):
        f = [float(t.inputs["frequency_hz"][0]) for t in trials]
        a = [float(t.inputs["amplitude_rad"][0]) for t in trials]
        for fx, ax in (
            (0.7 * min(f), max(a)),
            (1.3 * max(f), max(a)),
            (max(f), 0.6 * min(a)),
            (max(f), 1.4 * max(a)),
        ):
            inputs = {**template.inputs, "frequency_hz": np.array([fx]), "amplitude_rad": np.array([ax])}
            trial = replace(template, inputs=inputs)
            found.append((f"a run at {fx:.3g} Hz and {math.degrees(ax):.3g} deg", trial))
    # Give each proposed trial an id of its own, because simulations are cached by the id of the trial.
    return [(words, replace(trial, id=f"proposed {n}")) for n, (words, trial) in enumerate(found)]


def advise(
    context: FitContext,
    rivals: Sequence[Fit],
    noise_model: NoiseModel,
    floors: Mapping[str, float],
    now: float,
) -> list[Advice]:
    """Rank experiments by how well they would distinguish the first rival cause from the others.

    Parameters
    ----------
    rivals : sequence of Fit
        At least two fits, each with one of the rival causes.
    floors : mapping of channel to float
        Noise floor, in the channel's unit.
    now : float
        Difference between the first two rival fits on the present trials, in noise standard deviations. It is
        the square root of the difference of their held-out squared residuals.
    """
    known = information(context, rivals[0], noise_model)
    measured = sorted({c for t in context.trials for c in t.measured})
    found = []
    for words, trial in proposals(context.trials):
        sizes = [apart(context, rivals[0], other, trial, floors, known, measured) for other in rivals[1:]]
        found.append((min(sizes), f"run {words}"))
    found.sort(key=lambda pair: -pair[0])
    names = [f.effects[-1].name for f in rivals]
    return [Advice(text=words, separates=names, difference=size, now=now) for size, words in found[:MOST]]


def information(context: FitContext, fit: Fit, noise_model: NoiseModel) -> tuple[list[str], Array]:
    """Return the labels and the normal matrix (information) of the parameters that all trials share.

    The normal matrix is computed from the present trials. Parameters of single trials (initial states, random
    effects) are projected out.
    """
    shared = [j for j, (_, owner) in enumerate(fit.problem.slots) if owner is None]
    normal = np.zeros((len(shared), len(shared)))
    for k, residuals in enumerate(fit.residuals):
        # The function project_out() expects the residuals in the last column.
        block = np.column_stack((fit.columns(k, shared), residuals))
        seen = crossval.project_out(context, fit, noise_model, k, block)[:, :-1]
        normal += seen.T @ seen
    return [fit.labels[j] for j in shared], normal


def apart(
    context: FitContext,
    first: Fit,
    second: Fit,
    trial: Trial,
    floors: Mapping[str, float],
    known: tuple[Sequence[str], Array],
    channels: Sequence[str],
) -> float:
    """Return the difference between two rival models on a proposed trial, in noise standard deviations.

    It is the square root of the sum of squared differences that remain after the parameters of the first
    model have been refitted to the simulation of the second model.
    """
    proposed = replace(trial, measured={c: np.zeros(len(trial.time_s)) for c in channels})

    def posed(fit: Fit) -> Problem:
        model = context.affected(fit.effects)
        values = {label: v for label, v in zip(fit.labels, fit.theta, strict=True) if "[" not in label}
        parameters = (*context.parameters, *model.parameters[len(context.parameters) :])
        parameters = tuple(replace(p, start=values.get(p.name, p.start)) for p in parameters)
        problem = Problem(model, parameters, [proposed], jobs=1)
        for i, channel in enumerate(problem.channels[0]):
            problem.sd[0][i] = np.full(len(trial.time_s), max(floors.get(channel, 1.0), 1e-12))
        return problem

    problem, other = posed(first), posed(second)
    difference = problem.trial_residuals(problem.start, 0) - other.trial_residuals(other.start, 0)
    if not np.isfinite(difference).all() or np.max(np.abs(difference), initial=0.0) > 1e5:
        return 0.0
    rows, labels = -problem.trial_jacobians(problem.start)[0], problem.labels
    normal = rows.T @ rows
    names, prior = known
    where = [labels.index(name) for name in names if name in labels]
    take = [i for i, name in enumerate(names) if name in labels]
    normal[np.ix_(where, where)] += prior[np.ix_(take, take)]
    normal += 1e-9 * np.diag(np.diag(normal) + 1e-12)
    right = rows.T @ difference
    left = float(difference @ difference - right @ np.linalg.solve(normal, right))
    return math.sqrt(max(left, 0.0))
