"""Compute how much of the gap the causes close on held-out data, and whether held-out data contradict them.

Held-out data are validation trials or cross-validation folds. The coefficients are uncertain after a fit.
This uncertainty can move the prediction of a held-out trial far off, with or without a cause. A model is
contradicted only by an error that no probable coefficients explain. The error is measured as the Mahalanobis
distance in the predictive distribution.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.diagnosis import crossval, remainder
from swimid.diagnosis.context import Fit, FitContext, Mixed, beyond, held_at
from swimid.diagnosis.gap_file import HeldOutTrial, Shrinkage, Step
from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.verdict import MOST, closed_gap
from swimid.fitting import output_error
from swimid.fitting.model import Array, Model, Trial

#: Relative tolerance of the cost when the initial state of a held-out trial is fitted.
TOLERANCE = 1e-4

#: Error of a held-out sample whose simulation diverged. Its unit is that of the errors with which it is
#: summed: the unit of the channel, or the noise standard deviation.
WORST = 1e6
#: Error of a simulation, divided by the measured range of the channel, above which the simulation counts as
#: diverged.
ASTRAY = 10.0


@dataclass(frozen=True)
class Piece:
    """Held-out samples of one channel of one trial, with their predictions.

    Attributes
    ----------
    measured, shipped, before, after : ndarray, shape (n,)
        Measured values, and the predictions with the parameters as given, without the causes, and with them.
    between : tuple of ndarray
        Predictions with the first cause, with the first two causes, and so on.
    """

    trial: Trial
    channel: str
    time_s: Array
    measured: Array
    shipped: Array
    before: Array
    after: Array
    between: tuple[Array, ...] = ()

    def seen(self, values: Array) -> Array:
        """Return the values at those samples at which the channel was measured."""
        return values[np.isfinite(self.measured)]

    def squares(self, simulated: Array, unit: float = 1.0) -> Array:
        """Return the squared errors of a simulation. A sample that diverged gets the error ``WORST``."""
        errors = self.seen(self.measured - simulated) / unit
        return np.minimum(np.nan_to_num(errors**2, nan=WORST**2), WORST**2)


def by_channel(found: Sequence[Piece]) -> dict[str, list[Piece]]:
    """Return the held-out samples, grouped by channel."""
    parts: dict[str, list[Piece]] = {}
    for p in found:
        parts.setdefault(p.channel, []).append(p)
    return parts


def _own_start(model: Model, shared: Mapping[str, float], trial: Trial, sd: Mapping[str, float]) -> Array:
    """Return all parameter values of a trial.

    The shared parameters are those in ``shared``. The initial state is fitted to the trial.
    """
    parameters = tuple(
        replace(p, start=shared.get(p.name, p.start), free=p.free and p.name not in trial.held)
        for p in model.parameters
    )
    found = output_error.estimate_start(model, parameters, trial, sd, tolerance=TOLERANCE)
    return np.array([found.get(f"{p.name}[{trial.id}]", p.start) for p in parameters])


def _numbers(fit: Fit, theta: Array, of: int | None = None) -> dict[str, float]:
    """Return the shared parameters of a fit, or the parameters of trial ``of``, by name."""
    return {
        label.split("[")[0]: float(v)
        for label, (_, owner), v in zip(fit.labels, fit.problem.slots, theta, strict=True)
        if owner == of
    }


def pieces(
    context: FitContext,
    fits: Sequence[Fit],
    noise_model: NoiseModel,
    sd: Mapping[str, float],
    shipped: Mapping[str, float],
    validation: Sequence[Trial],
    *,
    step: Callable[[], None] = lambda: None,
) -> list[Piece]:
    """Return the predictions of held-out data by the models without and with the causes.

    The held-out data are the validation trials. Without validation trials, each cross-validation fold is held
    out once.

    Parameters
    ----------
    fits : sequence of Fit
        Refitted model without causes, with the first cause and so on, and with all causes, on all trials of
        the context.
    sd : mapping of channel to float
        Standard deviation of the noise, for the fit of the initial states of held-out trials.
    shipped : mapping of name to float
        Coefficients as given.
    """
    found: list[Piece] = []
    folds = context.folds
    causes = {e.name for e in fits[-1].effects}
    models = [_average(context, fit, causes - {e.name for e in fit.effects}) for fit in fits]
    whole = [context.affected(()), *models]
    for trial in validation:
        numbers = [shipped, *(_numbers(fit, fit.theta) for fit in fits)]
        found += _whole(trial, whole, numbers, sd, [trial] * len(whole))
        step()
    if validation:
        return found
    thetas = list(zip(*(context.without_each(fit, noise_model) for fit in fits), strict=True))
    for f, held_out in enumerate(thetas):
        cut = list(zip(fits, held_out, strict=True))
        for k, trial in enumerate(context.trials):
            if f not in folds.owner[k]:
                continue
            if folds.whole:
                near = [
                    replace(trial, starts={**trial.starts, **_numbers(fit, fit.theta, k)}) for fit in fits
                ]
                numbers = [shipped, *(_numbers(*one) for one in cut)]
                found += _whole(trial, whole, numbers, sd, [near[0], *near])
            else:
                vectors = [fit.problem.vector(theta, k) for fit, theta in cut]
                found += _stretch(context, k, f, models, vectors, shipped)
            step()
    return found


def _average(context: FitContext, fit: Fit, without: Collection[str]) -> Model:
    """Return the model of a fit for a new trial, with random effects at their mean over the fitted trials."""
    model = copy.copy(context.affected(fit.acting))
    centre = fit.centre(without)
    own = model.parameters[len(context.parameters) :]
    model.parameters = held_at((*context.parameters, *own), centre)
    return model


def _whole(
    trial: Trial,
    models: Sequence[Model],
    shared: Sequence[Mapping[str, float]],
    sd: Mapping[str, float],
    near: Sequence[Trial],
) -> list[Piece]:
    """Return the predictions of a whole held-out trial: as given, without the causes, and with them.

    Each prediction begins at the initial state that fits the trial best.

    Parameters
    ----------
    near : sequence of Trial
        The trial with the initial state from which the search for the best one begins, for each model.
    """
    runs = [
        m.simulate(_own_start(m, values, begun, sd), trial)
        for m, values, begun in zip(models, shared, near, strict=True)
    ]
    return [
        _piece(trial, c, runs, slice(None))
        for c, y in trial.measured.items()
        if c in runs[0] and np.isfinite(y).any()
    ]


def _piece(
    trial: Trial, channel: str, runs: Sequence[Mapping[str, Array]], rows: slice | NDArray[np.intp]
) -> Piece:
    """Return the held-out samples ``rows`` of a channel with their predictions."""
    shipped, before, *between, after = (run[channel][rows] for run in runs)
    time_s, measured = trial.time_s[rows], trial.measured[channel][rows]
    return Piece(trial, channel, time_s, measured, shipped, before, after, tuple(between))


def _stretch(
    context: FitContext,
    k: int,
    fold: int,
    models: Sequence[Model],
    vectors: Sequence[Array],
    shipped: Mapping[str, float],
) -> list[Piece]:
    """Return the predictions of those samples of a trial that belong to a cross-validation fold.

    The predictions use the parameters as given, the refitted model, and the refitted model with the causes.
    """
    trial, inside = context.trials[k], context.folds.owner[k] == fold
    as_given = vectors[0].copy()
    for i, p in enumerate(models[0].parameters):
        if not p.per_trial and p.name in shipped:
            as_given[i] = shipped[p.name]
    own = zip((models[0], *models), (as_given, *vectors), strict=True)
    runs = [model.simulate(values, trial) for model, values in own]
    parts = context.shape.by_channel(k, inside)
    chosen = ((channel, np.flatnonzero(mask)[part]) for channel, mask, part in parts)
    return [_piece(trial, channel, runs, rows) for channel, rows in chosen if len(rows)]


def shrinkages(
    found: Sequence[Piece],
    floors: Mapping[str, float],
    noise: Callable[[Collection[str]], Mapping[str, float]],
    ranges: Mapping[str, float],
) -> list[Shrinkage]:
    """Return the held-out errors, the noise floor and the closed share of the squared gap of each channel.

    Parameters
    ----------
    floors : mapping of channel to float
        Noise floor in the unit of the channel; unknown for a channel that no fitted trial has.
    noise : callable
        Relative squared noise of each fitted trial in given channels
        (:meth:`swimid.diagnosis.floor.Floor.of_trials`).
    ranges : mapping of channel to float
        Measured range of each channel in the fitted trials, in the unit of the channel, for relative errors.
    """
    result = []
    for channel, mine in by_channel(found).items():
        own_range = float(np.ptp(np.concatenate([p.seen(p.measured) for p in mine])))
        size = ranges.get(channel) or own_range or 1.0
        errors = {}
        for which in ("shipped", "before", "after"):
            squares = np.concatenate([p.squares(getattr(p, which)) for p in mine])
            errors[which] = float(np.sqrt(np.mean(squares))) / size
        closed = closed_gap(by_trial(mine, floors), noise([channel]))
        floor = floors.get(channel, math.nan) / size
        result.append(
            Shrinkage(channel=channel, **errors, floor=floor, closed=closed.share, ci95=closed.ci95)
        )
    return result


def waterfall(found: Sequence[Piece], floors: Mapping[str, float], labels: Sequence[str]) -> list[Step]:
    """Return the held-out errors of each prediction, and of the noise alone.

    Parameters
    ----------
    labels : sequence of str
        Labels of the predictions, in their order: as given, without causes, with the first cause and so on.
        Predictions without a label are left out.
    """
    steps = []
    for n, label in enumerate(labels):
        squared, count = 0.0, 0
        channels: dict[str, float | None] = {}
        for channel, mine in by_channel(found).items():
            runs = [(p, (p.shipped, p.before, *p.between, p.after)[n]) for p in mine]
            squares = np.concatenate([p.squares(y) for p, y in runs])
            channels[channel] = float(np.sqrt(np.mean(squares)))
            if channel in floors:
                squared += float(np.sum(squares)) / max(floors[channel], 1e-300) ** 2
                count += len(squares)
        steps.append(Step(label=label, squared=squared / max(count, 1), rmse=channels))
    noise = {channel: floors.get(channel) for channel in by_channel(found)}
    return [*steps, Step(label="noise alone", squared=1.0, rmse=noise)]


def sound(found: Sequence[Piece]) -> bool:
    """Return whether no simulation of a held-out trial diverges because of the causes."""
    for mine in by_channel(found).values():
        values = np.concatenate([p.seen(p.measured) for p in mine])
        for p in mine:
            errors = [np.abs(p.seen(p.measured - y)) for y in (p.before, p.after)]
            before, after = (float(np.max(np.nan_to_num(e, nan=np.inf), initial=0.0)) for e in errors)
            if after > ASTRAY * max(float(np.ptp(values)), before):
                return False
    return True


def better(found: Sequence[Sequence[Piece]], floors: Mapping[str, float]) -> list[Piece]:
    """Choose among several predictions of the same held-out samples those with the smallest errors.

    The result has the prediction with the smallest error without causes, with each number of causes, and with
    all causes.

    Parameters
    ----------
    floors : mapping of channel to float
        Noise floor, by which the errors of a channel are divided.
    """

    def least(of: Callable[[Piece], Array]) -> list[Array]:
        best = min(found, key=lambda one: sum(float(_errors(p, of(p), floors).sum()) for p in one))
        return [of(p) for p in best]

    count = len(found[0][0].between) if found[0] else 0
    between = [least(lambda p, n=n: p.between[n]) for n in range(count)]  # type: ignore[misc]
    before, after = least(lambda p: p.before), least(lambda p: p.after)
    return [
        replace(p, before=before[i], after=after[i], between=tuple(runs[i] for runs in between))
        for i, p in enumerate(found[0])
    ]


def capped(floors: Mapping[str, float], found: Sequence[Piece]) -> dict[str, float]:
    """Return the noise floor of each channel, limited by the held-out errors.

    The noise floor cannot be larger than the errors without or with the causes, because they contain the
    noise.
    """
    result = dict(floors)
    for channel, mine in by_channel(found).items():
        for which in ("before", "after"):
            squares = np.concatenate([p.squares(getattr(p, which)) for p in mine])
            if channel in result and len(squares):
                result[channel] = min(result[channel], float(np.sqrt(np.mean(squares))))
    return result


def by_trial(found: Sequence[Piece], floors: Mapping[str, float]) -> dict[str, HeldOutTrial]:
    """Return the squared errors of each held-out trial, in units of the noise variance.

    Channels without a known noise are left out.
    """
    trials: dict[str, HeldOutTrial] = {}
    for p in (p for p in found if p.channel in floors):
        trial = trials.setdefault(p.trial.id, HeldOutTrial(samples=0, as_given=0.0, before=0.0, after=0.0))
        trial.samples += len(p.seen(p.time_s))
        trial.as_given += float(np.sum(_errors(p, p.shipped, floors)))
        trial.before += float(np.sum(_errors(p, p.before, floors)))
        trial.after += float(np.sum(_errors(p, p.after, floors)))
    return trials


def _errors(piece: Piece, simulated: Array, floors: Mapping[str, float]) -> Array:
    """Return the squared errors of a prediction, in units of the noise variance; zero if the noise is
    unknown.
    """
    return piece.squares(simulated, max(floors.get(piece.channel, math.inf), 1e-300))


def worst(found: Sequence[Piece], floors: Mapping[str, float], *, with_causes: bool) -> list[Piece]:
    """Return the samples of the held-out trial with the largest errors in units of the noise.

    Parameters
    ----------
    with_causes : bool
        Whether the errors with the causes are compared, or those without them.

    Returns
    -------
    list of Piece
        One item for each channel, with its samples in the order of time.
    """
    which = "before"
    if with_causes:
        which = "after"
    squares: dict[str, list[Array]] = {}
    for p in found:
        squares.setdefault(p.trial.id, []).append(_errors(p, getattr(p, which), floors))
    means = {trial: float(np.mean(np.concatenate(parts))) for trial, parts in squares.items()}
    trial = max(means, key=lambda trial: means[trial], default="")
    whole = []
    for parts in by_channel([p for p in found if p.trial.id == trial]).values():
        order = np.argsort(np.concatenate([p.time_s for p in parts]), kind="stable")
        names = ("time_s", "measured", "shipped", "before", "after")
        series = {name: np.concatenate([getattr(p, name) for p in parts])[order] for name in names}
        whole.append(replace(parts[0], between=(), **series))  # type: ignore[arg-type]
    return whole


#: Fit of a model with its predictive prior to validation trials: relative tolerance of the cost
#: (PREDICTED_RTOL), and maximum number of iterations (STEPS).
PREDICTED_RTOL, STEPS = 1e-3, 12
#: Probability that a correct model has at least one validation trial reported as unpredicted.
CHANCE = 0.025


@dataclass(frozen=True)
class Misfit:
    """Distance of held-out data from the prediction of a model.

    Attributes
    ----------
    distance : float
        Squared Mahalanobis distance. For a correct model it is about ``samples``.
    samples : int
        Number of held-out samples.
    slow : bool
        Whether the residuals vary more slowly than noise, or are too short to decide.
    changes : dict of channel to (float, int)
        Expected sum of squares of the changes of validation trials by random effects, given the samples of
        the trials, in the unit of the channel squared. The integer is the number of samples.
    """

    distance: float
    samples: int
    slow: bool = True
    changes: Mapping[str, tuple[float, int]] = field(default_factory=dict)

    @property
    def chance(self) -> dict[str, float]:
        """Return for each channel the mean square of the changes by random effects."""
        return {channel: total / count for channel, (total, count) in self.changes.items()}

    @property
    def shown(self) -> bool:
        """Return whether the data contradict the prediction.

        They do if noise makes up less than half of the squared distance.
        """
        return self.distance > self.samples / (1.0 - MOST)

    @property
    def times(self) -> float:
        """Return the ratio of the prediction's root-mean-square error to that expected of a correct model."""
        return math.sqrt(max(self.distance, 0.0) / max(self.samples, 1))


def unpredicted(found: Mapping[str, Misfit]) -> dict[str, float]:
    """Return the validation trials that a model does not predict, the largest error first.

    The value is the ratio of the root-mean-square error to the one expected of a correct model. More than
    half of the squared distance of such a trial is not noise. A trial is left out if its residuals are larger
    than the noise of the other trials, but have no low-frequency component.
    """
    off = {}
    for name, seen in found.items():
        largest = float(special.chdtri(max(seen.samples, 1), CHANCE / len(found)))
        if seen.slow and seen.shown and seen.distance > largest:
            off[name] = seen.times
    return dict(sorted(off.items(), key=lambda item: -item[1]))


def predictions(
    context: FitContext, fit: Fit, noise_model: NoiseModel, validation: Sequence[Trial]
) -> tuple[dict[str, Misfit], dict[str, Misfit]]:
    """Return the distances of held-out data from their predictions by a fit.

    Returns
    -------
    folds, validation : dict of str to Misfit
        Distance of each cross-validation fold from its prediction by a fit to the other folds, and of each
        validation trial from its prediction by the fit.
    """
    inner = crossval.normal_equations(context, fit, noise_model)
    parts = zip(crossval.predictive(inner), inner.samples, strict=True)
    folds = {f"fold {f}": Misfit(float(distance), int(n)) for f, (distance, n) in enumerate(parts, 1)}
    return folds, {t.id: _of_trial(context, fit, noise_model, inner, t) for t in validation}


def total(found: Mapping[str, Misfit]) -> Misfit:
    """Return the distance of all held-out data together."""
    changes: dict[str, tuple[float, int]] = {}
    for one in found.values():
        for channel, (square, count) in one.changes.items():
            known, samples = changes.get(channel, (0.0, 0))
            changes[channel] = known + square, samples + count
    distance = sum(one.distance for one in found.values())
    return Misfit(distance, sum(one.samples for one in found.values()), changes=changes)


def _of_trial(
    context: FitContext, fit: Fit, noise_model: NoiseModel, inner: crossval.NormalEquations, trial: Trial
) -> Misfit:
    shared = [fit.labels[j] for j in context.shared(fit)]
    known = dict(zip(fit.labels, fit.theta, strict=True))
    ended = {
        label: known[label]
        for label, (_, owner) in zip(fit.labels, fit.problem.slots, strict=True)
        if owner is None and label not in shared
    }
    problem = context.problem(fit.effects, noise_model.random_effects, trials=[trial], known=ended)
    _weigh(problem, fit, noise_model)
    begin = np.array([known.get(n, start) for n, start in zip(problem.labels, problem.start, strict=True)])
    # Per-trial values of the fitted trials carry no information about a held-out trial.
    common = np.array([label in problem.labels for label in shared], dtype=bool)
    normal = inner.products.sum(axis=0)[:-1, :-1] + inner.prior
    mixed = normal[np.ix_(~common, common)]
    told = normal[np.ix_(common, common)] - mixed.T @ crossval.solved(normal[np.ix_(~common, ~common)], mixed)
    sizes, vectors = np.linalg.eigh(told)
    places = [problem.labels.index(label) for label in shared if label in problem.labels]
    mean, weight = context.expected(problem)
    mean[places], weight[places] = begin[places], 0.0
    root = np.zeros((len(places) + len(begin), len(begin)))
    root[: len(places), places] = np.sqrt(np.maximum(sizes, 0.0))[:, None] * vectors.T
    root[len(places) :] = np.diag(weight)
    found = context.search(problem, noise_model, [begin], PREDICTED_RTOL, STEPS, (mean, root))
    left = [problem.trial_residuals(found.x, 0)]
    chance = _changes(problem, found.x, fit, noise_model)
    moving = remainder.low_frequency(problem, left)
    slow = not moving or any(channel.ratio > remainder.SLOW for channel in moving.values())
    return Misfit(float(found.cost), sum(len(r) for r in left), slow, chance)


def _changes(problem: Mixed, theta: Array, fit: Fit, noise_model: NoiseModel) -> dict[str, tuple[float, int]]:
    """Return for each channel the sum of squares by which random effects change the validation trials.

    It is the expectation given the samples of these trials. Initial states are refitted, and random effects
    are limited to probable values.
    """
    if not problem.random_effects:
        return {}
    centre, scale = fit.centre(), problem.scale
    squares: dict[str, list[Array]] = {}
    for k, jacobian in enumerate(problem.trial_jacobians(theta)):
        mine = problem.differing(k)
        names = [problem.parameters[problem.slots[j][0]].name for j in mine]
        away = (theta[mine] - [centre[name] for name in names]) / scale[mine]
        likely = special.chdtri(len(mine), CHANCE)
        away *= math.sqrt(min(1.0, likely / max(float(away @ away), likely)))
        rows = jacobian[:, mine] * scale[mine]
        own = problem.begun(k)
        seen = noise_model.whiten(problem, k, np.column_stack((rows, jacobian[:, own] * scale[own])))
        seen = beyond(seen[:, len(mine) :], seen[:, : len(mine)])
        # Compute a square root of the covariance matrix of the random effects.
        root = np.linalg.inv(np.linalg.qr(np.vstack((seen, np.eye(len(mine)))), mode="r"))
        moved = beyond(jacobian[:, own] * scale[own], rows @ np.column_stack((away, root)))
        changes = np.column_stack((np.sum(moved**2, axis=1), problem.sample_weights(k) ** 2))
        for channel, _, part in problem.by_channel(k, changes):
            squared, weights = part.T
            # The noise of a channel that no fitted trial has is unknown.
            if weights.all():
                squares.setdefault(channel, []).append(squared / weights)
    return {c: (float(np.sum(v)), len(v)) for c, v in ((c, np.concatenate(v)) for c, v in squares.items())}


def _weigh(problem: Mixed, fit: Fit, noise_model: NoiseModel) -> None:
    """Weight the samples of new trials by the median noise standard deviation of each channel in a fit."""
    weights: dict[str, list[Array]] = {}
    for channels, sds in zip(fit.problem.channels, noise_model.sd, strict=True):
        for channel, sd in zip(channels, sds, strict=True):
            weights.setdefault(channel, []).append(sd)
    typical = {channel: float(np.median(np.concatenate(sds))) for channel, sds in weights.items()}
    problem.sd = [
        [np.full(len(m), typical.get(c, np.inf)) for c, m in zip(channels, masks, strict=True)]
        for channels, masks in zip(problem.channels, problem.masks, strict=True)
    ]
