"""Noise of the trials of a diagnosis: autocorrelated measurement noise, and random effects of the trials.

The measurement noise of a channel has one of the autocorrelation models of :mod:`swimid.fitting.noise`, which
every fit uses. The noise is estimated from the residuals of a fit in which each trial has its own values of
all parameters and of generic smooth terms. Neither a gap nor differences between trials then count as noise.

A random effect is a quantity that differs by chance between trials, for example the trim, the clock or the
pulley friction. Each trial has a value of its own, which is fitted with a normal prior. The standard
deviation of this prior maximises the restricted likelihood, in which the trials are linearised about the
fitted values (Lindstrom and Bates 1990).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.diagnosis import crossval
from swimid.diagnosis.nominal import MIN_RANDOM_TRIALS, RANDOM_IN_REPEATS, RANDOM_PARAMETERS, ParameterChange
from swimid.diagnosis.settings import describe_setting
from swimid.effects.base import Effect, parameter
from swimid.fitting import uncertainty
from swimid.fitting.model import Array, Hooks, Model, Parameter, Trial
from swimid.fitting.noise import NoiseForm, NoiseRows, compute_posterior
from swimid.fitting.problem import Problem

if TYPE_CHECKING:
    from swimid.diagnosis.study import GapStudy, Hypothesis

#: Candidates for the standard deviation of a random effect, in typical scales of the effect.
DEVIATIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5)
#: Maximum standard deviation of a random effect, in typical scales. LARGEST_SD applies if the trials have no
#: structure in common. BESIDE_GAP applies if a gap may remain, which larger random effects would absorb.
LARGEST_SD, BESIDE_GAP = 0.5, 0.2
#: Minimum increase of the log-likelihood by a random effect.
MIN_LOG_LIKELIHOOD_GAIN = 4.0
#: Noise model that replaces slow noise, which may be part of a gap: autocorrelated fraction of the variance
#: (COLOURED), and its correlation between successive samples (POLE), as for a tracker. The model replaces
#: noise whose standard deviation is more than SLOW times its own.
COLOURED, POLE, SLOW = 0.4, 0.8, 2.2
#: Minimum number of degrees of freedom of a channel after the fit of the own parameters and generic terms of
#: each trial, as a fraction of its samples. With fewer, all trials share the generic terms.
MIN_FREE_SHARE = 0.4
#: Minimum number of samples of the contrasts between repeats, as a fraction of all samples, with which the
#: noise is estimated from them alone. Pairs of repeats have one half.
MIN_CONTRAST_SHARE = 0.4
#: Significance level below which the mean of a random effect counts as not due to chance.
COMMON_P_VALUE = 0.01
#: Minimum noise floor, as a fraction of the variance of the measurement noise.
MIN_FLOOR = 1e-4
#: Number of iterations that reweight the residuals before any effect is fitted.
MAX_REWEIGHTINGS = 2


#: Prefix of the names of effects that are random effects.
BETWEEN = "between:"


def join_channels(parts: Iterable[tuple[str, Array]]) -> dict[str, Array]:
    """Return the series of all trials in one array for each channel."""
    found: dict[str, list[Array]] = {}
    for channel, series in parts:
        found.setdefault(channel, []).append(series)
    return {channel: np.concatenate(each) for channel, each in found.items()}


class Scatter(Effect):
    """Effect that gives each trial its own value of a quantity that differs by chance between trials.

    The value is added to one parameter of another effect, which may act on its own as well.

    Parameters
    ----------
    of : Effect
        The other effect.
    null : ndarray
        Values of the parameters of ``of`` at which this effect has no influence.
    index : int
        Index, among these parameters, of the one that differs.
    label : str
        Name of the random effect.
    scale : float
        Typical size of the difference, in the unit of the parameter.
    """

    name: ClassVar[str]
    stage: ClassVar[None] = None  # type: ignore[assignment]
    meaning: ClassVar[str] = "differs by chance between trials"

    def __init__(self, of: Effect, null: Array, index: int, label: str, scale: float) -> None:
        vars(self).update(name=f"{BETWEEN}{label}", adds_to=of.adds_to)
        self.of, self.null, self.index, self.label, self.scale = of, null, index, label, scale

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the deviation of each trial as a parameter, in the unit of the effect's parameter."""
        p = self.of.parameters(model, trials)[self.index]
        return (parameter("deviation", p.unit, self.scale, self.meaning, per_trial=True),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks of the effect with the deviation of this trial."""
        point = self.null.copy()
        point[self.index] += values[0]
        return self.of.hooks(point, trial, model)

    def in_place_of(self, model: Model) -> Model:
        """Return the model on which the effect acts."""
        return self.of.in_place_of(model)


@dataclass(frozen=True)
class RandomEffect:
    """Random effect: a quantity that differs by chance between trials.

    Attributes
    ----------
    name : str
        Name of the effect or of the parameter that differs.
    sd : float
        Between-trial standard deviation, in typical scales.
    effect : Scatter
        Effect that gives each trial its own value.
    is_centred : bool
            Whether the mean over the trials is held at 0, because the mean is too large to be due to chance.
    """

    name: str
    sd: float
    effect: Scatter = field(repr=False)
    is_centred: bool = False

    @property
    def parameter(self) -> str:
        """Return the name of the parameter of each trial."""
        return f"{self.effect.name}/deviation"


@dataclass(frozen=True)
class NoiseModel:
    """Linear map from the weighted residuals of each trial to independent residuals of unit variance.

    Attributes
    ----------
    sd : list of list of ndarray
        Weights: standard deviation of each sample, by trial and channel (:attr:`Problem.sd`).
    forms : mapping of channel to NoiseForm
            Autocorrelation of the noise.
    variance : mapping of channel to float
            Variance of the noise in the weighted residuals of a channel. Its default is 1.
    random_effects : tuple of RandomEffect
            Quantities of which each trial has its own value. These values are unknowns of each trial in all
            fits. Their priors have the standard deviations of the random effects.
    """

    sd: list[list[Array]]
    forms: Mapping[str, NoiseForm] = field(default_factory=dict)
    variance: Mapping[str, float] = field(default_factory=dict)
    random_effects: tuple[RandomEffect, ...] = ()
    #: Restricted log-likelihood of the residuals with the random effects, up to a constant.
    log_likelihood: float = math.nan
    #: Noise floor of each channel in the fitted trials, in units of its weights (:func:`with_floors`).
    floors: Mapping[str, float] = field(default_factory=dict)
    #: Channels of each trial, in the order of ``sd``.
    channels: list[list[str]] = field(default_factory=list, repr=False)

    def whiten(self, problem: Problem, k: int, rows: Array) -> Array:
        """Return the whitened residuals, or columns of derivatives, of trial ``k``.

        Parameters
        ----------
        rows : ndarray, shape (n_k,) or (n_k, m)
            Weighted residuals or derivatives.
        """
        whole = rows.reshape(len(rows), -1)
        time_s, first = problem.trials[k].time_s, 0
        out = np.empty_like(whole)
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            key = channel, time_s.tobytes(), mask.tobytes()
            if key not in self._filters:
                form = self.forms.get(channel, NoiseForm())
                self._filters[key] = form.filter(time_s[mask], np.flatnonzero(mask))
            last = first + int(np.count_nonzero(mask))
            white, _ = self._filters[key](whole[first:last])
            out[first:last] = white
            out[first:last] /= math.sqrt(self.variance.get(channel, 1.0))
            first = last
        return out.reshape(rows.shape)

    @cached_property
    def _filters(self) -> dict[tuple[str, bytes, bytes], Callable[[Array], tuple[Array, float]]]:
        """Filter of each series that was whitened, by channel, sample times and mask."""
        return {}

    def floor(self, channel: str) -> float:
        """Return the standard deviation of the noise of a channel, in units of its weights."""
        return self.floors.get(channel, 1.0)

    def covariance(self, channel: str, time_s: Array, columns: Array) -> Array:
        """Return the covariance matrix of the weighted noise of a series, multiplied by columns."""
        form = self.forms.get(channel, NoiseForm())
        return self.variance.get(channel, 1.0) * form.correlate(time_s, columns)

    def standardise(self, problem: Problem, k: int, rows: Array) -> Array:
        """Return residuals or derivatives of trial ``k`` in units of the noise floor, not whitened."""
        parts = [part / self.floor(channel) for channel, _, part in problem.by_channel(k, rows)]
        return np.concatenate([rows[:0], *parts])

    def of_new_trials(self, problem: Problem) -> None:
        """Weight the trials of another problem by the median weight of each channel."""
        weights = join_channels(zip(chain(*self.channels), chain(*self.sd), strict=True))
        typical = {channel: float(np.median(sd)) for channel, sd in weights.items()}
        problem.sd = [
            [np.full(len(m), typical.get(c, np.inf)) for c, m in zip(channels, masks, strict=True)]
            for channels, masks in zip(problem.channels, problem.masks, strict=True)
        ]


def estimate_weights(study: GapStudy) -> tuple[NoiseModel, Hypothesis]:
    """Refit the model without effects, and weight the residuals by their own size.

    Returns
    -------
    NoiseModel
        Independent noise with these weights.
    Hypothesis
    """
    problem = study.problem(())
    uncertainty.weigh_first(problem)
    previous: dict[str, tuple[float, float]] = {}
    start = np.clip(problem.start, problem.lower, problem.upper)
    fit = None
    for _ in range(1 + MAX_REWEIGHTINGS):
        if fit is not None:
            previous = uncertainty.estimate_noise(problem, fit.theta, previous)
        known = NoiseModel([list(sds) for sds in problem.sd], channels=problem.channels)
        others = study.begins(problem, start) if fit is None else []
        fit = study.with_noise(known).fit((), [start], others=others, tolerance=1e-3, hold=fit)
        start = fit.theta
    assert fit is not None
    return known, fit


def has_repeats(trials: Sequence[Trial]) -> bool:
    """Return whether a setting was repeated."""
    return len({describe_setting(t) for t in trials}) < len(trials)


def update_weights(study: GapStudy, fit: Hypothesis) -> NoiseModel:
    """Return the noise model of a study with weights from the residuals of a fit.

    Only a fit that leaves no gap shows which part of the error is due to the time stamps.
    """
    problem = study.problem(fit.effects)
    known: dict[str, tuple[float, float]] = {}
    for _ in range(1 + MAX_REWEIGHTINGS):
        known = uncertainty.estimate_noise(problem, fit.theta, known)
    return replace(study.noise, sd=[list(sds) for sds in problem.sd])


class RandomCandidate(NamedTuple):
    """Possible random effect, with the weighted change of each trial by one typical scale."""

    effect: Scatter
    changes: list[Array]


#: Parameter of an effect that may differ by chance between trials: label, effect, index of the parameter,
#: typical difference, and the sign of a change within the bounds.
ScatterQuantity = tuple[str, Effect, int, float, float]


def list_random_candidates(
    study: GapStudy, fit: Hypothesis, effects: Sequence[Effect]
) -> list[RandomCandidate]:
    """Return the quantities that may differ by chance between trials.

    They are the shared parameters of effects that scatter (:attr:`Effect.scatters`), and per-trial parameters
    of the model (:data:`RANDOM_PARAMETERS`). Their changes are linearised about the fit.
    """
    quantities = [*_list_scattering(study, effects), *_list_per_trial(study, fit)]
    forms = Counter(effect.name for _, effect, *_ in quantities)
    acting = {one.name: one for one in study.noise.random_effects}
    candidates = []
    for label, effect, number, scale, sign in quantities:
        # The name of the effect is enough unless it has several forms or parameters.
        name = label if forms[effect.name] > 1 else label.partition("/")[0]
        if name in acting:
            one = acting[name]
            columns = [
                fit.columns(k, [fit.labels.index(f"{one.parameter}[{trial.id}]")])[:, 0]
                for k, trial in enumerate(study.trials)
            ]
            candidates.append(RandomCandidate(one.effect, [one.effect.scale * c for c in columns]))
            continue
        null = np.array([p.start for p in effect.parameters(study.model, study.trials)])
        scatter = Scatter(effect, null, number, name, scale)
        changes = study.changes(fit, scatter, [np.array([0.5 * sign * scale])])[0]
        if all(np.isfinite(c).all() for c in changes) and any(c.any() for c in changes):
            candidates.append(RandomCandidate(scatter, [2.0 * sign * c for c in changes]))
    return candidates


def _list_scattering(study: GapStudy, effects: Sequence[Effect]) -> list[ScatterQuantity]:
    """Return the shared parameters of effects that scatter."""
    quantities: list[ScatterQuantity] = []
    for effect in (e for e in effects if e.scatters):
        for j, p in enumerate(effect.parameters(study.model, study.trials)):
            if not p.per_trial:
                sign = 1.0 if p.start + 0.5 * p.scale <= p.upper else -1.0
                quantities.append((f"{effect.name}/{p.name}", effect, j, p.scale, sign))
    return quantities


def _list_per_trial(study: GapStudy, fit: Hypothesis) -> list[ScatterQuantity]:
    """Return the per-trial parameters of the model that may be random effects."""
    values = {p.name: p.start for p in study.parameters} | dict(zip(fit.labels, fit.theta, strict=True))
    is_repeated = has_repeats(study.trials)
    quantities: list[ScatterQuantity] = []
    for p in study.parameters:
        is_random = p.per_trial and not p.free and p.name in RANDOM_PARAMETERS
        if not is_random or (p.name in RANDOM_IN_REPEATS and not is_repeated):
            continue
        share, size = RANDOM_PARAMETERS[p.name], 0.0
        if share is not None:
            size = share[1] * abs(float(values.get(share[0], 0.0)))
        quantities.append((p.name, ParameterChange(p), 0, size or p.scale, 1.0))
    return quantities


def estimate_measurement_noise(
    study: GapStudy,
    fit: Hypothesis,
    generic: Sequence[Sequence[Array]],
    differing: Sequence[RandomCandidate],
    *,
    brief: bool = True,
) -> NoiseModel:
    """Estimate the measurement noise from the residuals of a fit.

    Each trial has own values of all parameters and generic terms. The part of the residuals that these
    explain does not count as noise. If most settings were repeated, the noise is estimated from the
    differences between repeats, in which everything that depends on the setting cancels (pure error).

    Parameters
    ----------
    generic : sequence of lists of ndarray
        Weighted changes of each trial by generic smooth terms, each with its typical size.
    differing : sequence of RandomCandidate
        Quantities that may differ between trials.
    brief : bool
            Whether an autocorrelation that is long compared with a trial does not count as noise, because it
            may be a gap.
    """
    problem = fit.problem
    series: dict[str, dict[int, _Series]] = {}
    for k, trial in enumerate(study.trials):
        changes = [*(c.changes[k] for c in differing), *(g[k] for g in generic)]
        columns = np.column_stack([fit.derivatives[k] * problem.scale[problem.taken[k]], *changes])
        parts = zip(problem.by_channel(k, fit.residuals[k]), problem.by_channel(k, columns), strict=True)
        for ((channel, mask, residual), (_, _, own)), sd in zip(parts, problem.sd[k], strict=True):
            one = _Series(trial.time_s[mask], np.flatnonzero(mask), own, residual, sd[mask])
            series.setdefault(channel, {})[k] = one
    forms, variance = {}, {}
    shared: Mapping[str, float] | None = None
    for channel, of_channel in series.items():
        pure = _contrasts(study.trials, of_channel)
        of_trials = pure or {k: one.rows() for k, one in of_channel.items()}
        samples = sum(len(r.residual) for r in of_trials.values())
        free = sum(len(r.residual) - r.basis.shape[1] for r in of_trials.values())
        if free < MIN_FREE_SHARE * samples:
            shared = shared or _estimate_shared_level(study, fit, generic)
            forms[channel], variance[channel] = NoiseForm(), shared[channel]
            continue
        known = compute_posterior(of_trials)
        likeliest = int(np.argmax(known.probability))
        forms[channel], variance[channel] = known.forms[likeliest], float(known.variance[likeliest])
        if brief and not pure:
            forms[channel], variance[channel] = _replace_slow(of_trials, forms[channel], variance[channel])
    return NoiseModel(problem.sd, forms, variance, channels=problem.channels)


def _replace_slow(rows: Mapping[int, NoiseRows], form: NoiseForm, variance: float) -> tuple[NoiseForm, float]:
    """Return quickly decorrelating noise in place of much slower noise, which may be a part of the gap.

    The level of the new noise follows from the second differences of the residuals, to which low frequencies
    contribute little.
    """
    bends = [np.diff(part.own_residual, 2)[np.diff(part.place, 2) == 0] for part in rows.values()]
    steps = [np.diff(part.time_s) for part in rows.values()]
    bend, step = np.concatenate(bends), np.concatenate(steps)
    if not len(bend):
        return form, variance
    first, second = COLOURED * POLE, COLOURED * POLE**2
    level = float(np.mean(bend**2)) / (6.0 - 8.0 * first + 2.0 * second)
    if variance * (1.0 + form.ratio) <= SLOW**2 * level:
        return form, variance
    time_s = -float(np.median(step)) / math.log(POLE)
    return NoiseForm(COLOURED / (1.0 - COLOURED), time_s), (1.0 - COLOURED) * level


class _Series(NamedTuple):
    """Weighted residual of one channel of one trial, columns of the terms of this trial, and weights."""

    time_s: Array
    place: NDArray[np.intp]
    own: Array
    residual: Array
    sd: Array

    def rows(self) -> NoiseRows:
        """Return the residual and the columns as rows of a noise estimate.

        Combinations of columns that change the residual by less than noise are left out.
        """
        u, size, vt = np.linalg.svd(self.own, full_matrices=False)
        kept = size > 1.0
        return NoiseRows(self.time_s, self.place, u[:, kept], size[kept, None] * vt[kept], self.residual)

    def at(self, index: NDArray[np.intp]) -> _Series:
        """Return the samples with the given indices."""
        time_s, place, own, residual, sd = self
        return _Series(time_s[index], place[index], own[index], residual[index], sd[index])


def _contrasts(trials: Sequence[Trial], series: Mapping[int, _Series]) -> dict[int, NoiseRows]:
    """Return orthogonal contrasts of the repeats of each setting, as rows of independent series of noise.

    A sample is compared with the sample of the other repeat that is nearest in time. The contrasts are those
    of Helmert: a repeat against the mean of those before it. The result is empty if the contrasts have less
    than :data:`MIN_CONTRAST_SHARE` of the samples.
    """
    found: dict[int, NoiseRows] = {}
    for group in _repeats(trials, series):
        times = [series[k].time_s for k in group]
        paired = [series[k].at(at) for k, at in zip(group, _common(times), strict=True)]
        if max(map(len, times)) == 1:
            # Rows of a table (timed runs) have no terms of their own.
            paired = [one._replace(own=one.own[:, :0]) for one in paired]
        for j in range(1, len(paired)):
            weights = [1.0 / j] * j + [-1.0]
            sd = np.sqrt(sum((w * one.sd) ** 2 for w, one in zip(weights, paired, strict=False)))
            shares = [w * one.sd / sd for w, one in zip(weights, paired, strict=False)]
            own = [share[:, None] * one.own for share, one in zip(shares, paired, strict=False)]
            residual = np.sum([s * one.residual for s, one in zip(shares, paired, strict=False)], axis=0)
            first = paired[0]
            found[len(found)] = _Series(first.time_s, first.place, np.hstack(own), residual, sd).rows()
    count = sum(len(one.residual) for one in series.values())
    return found if sum(len(rows.residual) for rows in found.values()) >= MIN_CONTRAST_SHARE * count else {}


def _differences(problem: Problem, series: Sequence[Array], random: int) -> list[Array]:
    """Return Helmert contrasts of the whitened rows of repeats; empty if there are too few repeats.

    Parameters
    ----------
    series : sequence of ndarray, shape (n_k + m, c)
            Rows of each trial: n_k samples, then m priors. The first ``random`` of the c columns are changes
            due to random effects, which are alike in repeats and independent in each.
    """
    trials, found = problem.trials, []
    for group in _repeats(trials, range(len(trials))):
        parts = [problem.by_channel(k, series[k][: problem.counts[k]]) for k in group]
        if len({tuple(channel for channel, _, _ in part) for part in parts}) > 1:
            continue
        aligned = []
        for each in zip(*parts, strict=True):
            times = [trials[k].time_s[mask] for k, (_, mask, _) in zip(group, each, strict=True)]
            chosen = [part[at] for (_, _, part), at in zip(each, _common(times), strict=True)]
            aligned.append(np.array(chosen))
        rows = np.concatenate(aligned, axis=1)
        for j in range(1, len(group)):
            contrast = (rows[:j].mean(axis=0) - rows[j]) / math.sqrt(1.0 + 1.0 / j)
            contrast[:, :random] = rows[: j + 1, :, :random].mean(axis=0)
            found.append(contrast)
    enough = sum(map(len, found)) >= MIN_CONTRAST_SHARE * sum(problem.counts)
    return found if enough else []


def _repeats(trials: Sequence[Trial], indices: Iterable[int]) -> list[list[int]]:
    """Return the indices of the trials of each setting that was repeated.

    A copy of a recording is no repeat, because it has the same noise.
    """
    groups: dict[str, dict[tuple[bytes, ...], int]] = {}
    for k in indices:
        measured = tuple(values.tobytes() for values in trials[k].measured.values())
        groups.setdefault(describe_setting(trials[k]), {}).setdefault(measured, k)
    return [list(group.values()) for group in groups.values() if len(group) > 1]


def _common(times: Sequence[Array]) -> list[NDArray[np.intp]]:
    """Return, for each series, the indices of the samples at the times that all series have.

    Times are equal if they differ by at most half a sampling step. Series of one sample are rows of a table,
    which have no times.
    """
    first = times[0]
    if {len(time_s) for time_s in times} == {1}:
        return [np.zeros(1, dtype=np.intp)] * len(times)
    if min(map(len, times)) < 2:
        return [np.zeros(0, dtype=np.intp)] * len(times)
    half = 0.5 * float(np.median(np.diff(first)))
    nearest = []
    for time_s in times:
        after = np.clip(np.searchsorted(time_s, first), 1, len(time_s) - 1)
        nearest.append(after - (first - time_s[after - 1] < time_s[after] - first))
    apart = [np.abs(time_s[at] - first) for time_s, at in zip(times, nearest, strict=True)]
    common = np.max(apart, axis=0) <= half * (1.0 + 1e-6)
    return [at[common] for at in nearest]


def _estimate_shared_level(
    study: GapStudy, fit: Hypothesis, generic: Sequence[Sequence[Array]]
) -> dict[str, float]:
    """Return the mean squared residual of each channel after a fit of generic terms that all trials share.

    The result is corrected for the effective number of fitted parameters.
    """
    every = np.arange(len(fit.theta))
    whole = np.concatenate([fit.columns(k, every) for k in range(len(study.trials))])
    terms = [np.concatenate(list(g)) for g in generic]
    rows = np.column_stack([whole * fit.problem.scale, *terms])
    residual = np.concatenate(fit.residuals)
    ridge = np.concatenate((np.full(whole.shape[1], 1e-12), np.ones(len(terms))))
    normal = rows.T @ rows
    ridge *= max(float(np.trace(normal)) * 1e-12, 1.0)
    inverse = np.linalg.pinv(normal + np.diag(ridge), hermitian=True)
    used = float(np.trace(inverse @ normal))
    left = residual - rows @ (inverse @ (rows.T @ residual))
    factor = len(residual) / max(len(residual) - used, 0.2 * len(residual), 1.0)
    each = np.split(left, np.cumsum([len(r) for r in fit.residuals])[:-1])
    parts = (part for k, own in enumerate(each) for part in fit.problem.by_channel(k, own))
    squares = join_channels((channel, part**2) for channel, _, part in parts)
    return {c: max(factor * float(np.mean(values)), 1e-300) for c, values in squares.items()}


def with_random_effects(
    study: GapStudy,
    fit: Hypothesis,
    noise: NoiseModel,
    differing: Sequence[RandomCandidate],
    *,
    largest: float,
) -> NoiseModel:
    """Return the noise model with the random effects of the largest restricted likelihood.

    Random effects are added one by one, as long as each increases the log-likelihood by
    :data:`MIN_LOG_LIKELIHOOD_GAIN`. If most settings were repeated, the likelihood is that of the differences
    between repeats.

    Parameters
    ----------
    differing : sequence of RandomCandidate
        Possible random effects.
    largest : float
            Maximum standard deviation of a random effect, in typical scales. If most settings were repeated,
            :data:`LARGEST_SD` is the maximum instead.
    """
    if not differing or not study.folds.whole or len(study.trials) < MIN_RANDOM_TRIALS:
        return noise
    noise = replace(noise, random_effects=())
    series = []
    for k in range(len(study.trials)):
        random = [d.changes[k] for d in differing]
        own = study.select_nonrandom(fit.problem, k, study.select_own(fit, k))
        # Estimate the mean of each quantity over the trials as a fixed effect, because it is not random.
        block = np.column_stack([*random, *random, fit.columns(k, study.select_shared(fit)), fit.typical(k)])
        series.append(crossval.project_out(study, fit, k, block, to=own, noise=noise))
    pure = _differences(fit.problem, series, len(differing))
    if pure:
        series, largest = pure, LARGEST_SD
    stacked = np.array([rows.T @ rows for rows in series])
    sd = _maximise_likelihood(stacked, np.zeros(len(differing)), largest)
    kept = np.flatnonzero(sd).tolist()
    # Compare hypotheses without free means, because a difference that all trials share needs a cause.
    count = len(differing)
    rest = np.delete(stacked, np.s_[count : 2 * count], axis=1)
    noise = replace(noise, log_likelihood=_likelihood(np.delete(rest, np.s_[count : 2 * count], axis=2), sd))
    if not kept:
        return noise
    chosen = [(differing[i].effect, float(sd[i])) for i in kept]
    return replace(noise, random_effects=tuple(RandomEffect(e.label, size, e) for e, size in chosen))


def _maximise_likelihood(products: Array, sd: Array, largest: float) -> Array:
    """Return standard deviations of random effects, added one by one while the likelihood clearly increases.

    Parameters
    ----------
    products : ndarray
        Inner products (:func:`_likelihood`).
    sd : ndarray, shape (q,)
            Initial standard deviations.
    largest : float
        Maximum standard deviation.
    """
    likelihood = _likelihood(products, sd)
    while True:
        tried = []
        for i in np.flatnonzero(sd == 0.0):
            for size in (size for size in DEVIATIONS if size <= largest):
                one = sd.copy()
                one[i] = size
                tried.append((_likelihood(products, one), one))
        best, candidate = max(tried, key=lambda t: t[0], default=(-math.inf, sd))
        if best < likelihood + MIN_LOG_LIKELIHOOD_GAIN:
            return sd
        likelihood, sd = best, candidate


def with_held_means(fit: Hypothesis) -> NoiseModel | None:
    """Return the noise model in which a mean of a random effect that chance does not explain is held at 0.

    A value that all trials share is then a gap, which no random effect absorbs. The mean is compared with 0
    by Student's t test. The result is None if chance explains all means.
    """
    study = fit.study
    found = []
    for one in study.noise.random_effects:
        values = fit.theta[[name.startswith(f"{one.parameter}[") for name in fit.labels]]
        stderr = float(values.std(ddof=1)) / math.sqrt(len(values))
        largest = stderr * float(special.stdtrit(len(values) - 1, 1.0 - 0.5 * COMMON_P_VALUE))
        is_common = bool(abs(values.mean()) > largest)
        found.append(replace(one, is_centred=one.is_centred or is_common))
    if found == list(study.noise.random_effects):
        return None
    return replace(study.noise, random_effects=tuple(found))


def with_floors(study: GapStudy, fit: Hypothesis) -> NoiseModel:
    """Return the noise model of a study with the noise floor of each channel.

    The noise floor is the root-mean-square residual that noise alone leaves in the fitted trials, after a fit
    of the initial state and the random effects of each trial.
    """
    noise, problem = study.noise, fit.problem
    squares: dict[str, list[tuple[float, int]]] = {}
    for k, trial in enumerate(study.trials):
        own = np.linalg.qr(find_basis(fit.columns(k, problem.own(k))))[0]
        for channel, mask, basis in problem.by_channel(k, own):
            time_s = trial.time_s[mask]
            total = float(noise.covariance(channel, time_s[:1], np.ones((1, 1)))[0, 0]) * len(time_s)
            total -= float(np.sum(basis * noise.covariance(channel, time_s, basis)))
            squares.setdefault(channel, []).append((total, len(time_s)))
    floors = {}
    for channel, each in squares.items():
        total, count = (sum(part) for part in zip(*each, strict=True))
        least = MIN_FLOOR * float(noise.covariance(channel, np.zeros(1), np.ones((1, 1)))[0, 0])
        floors[channel] = math.sqrt(max(total / max(count, 1), least, 1e-300))
    return replace(noise, floors=floors)


def find_basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns, without undetermined directions."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    u, singular, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(u[:, singular > 1e-7 * singular.max(initial=0.0)])


def _likelihood(products: Array, sd: Array) -> float:
    """Return the restricted log-likelihood of the residuals with random effects of given standard deviations.

    Parameters
    ----------
    products : ndarray, shape (trials, q + p + 1, q + p + 1)
        Inner products of the whitened changes by q random effects, of the derivatives with respect to p
        shared parameters, and of the residual.
    sd : ndarray, shape (q,)
    """
    used = np.flatnonzero(sd)
    rest = products[:, len(sd) :, len(sd) :]
    value = 0.0
    if len(used):
        size = sd[used]
        inner = np.eye(len(used)) + size[:, None] * products[:, used[:, None], used] * size
        mixed = size[:, None] * products[:, used, len(sd) :]
        rest = rest - np.swapaxes(mixed, 1, 2) @ crossval.solve_normal(inner, mixed)
        value -= 0.5 * float(np.linalg.slogdet(inner)[1].sum())
    total = rest.sum(axis=0)
    normal, right = total[:-1, :-1], total[:-1, -1]
    # Keep a column of zeros at zero, although rounding errors may have changed its products.
    length = np.sqrt(np.maximum(np.diag(normal), 0.0))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 1e-100)
    size, vectors = np.linalg.eigh(scale[:, None] * normal * scale)
    kept = size > 1e-9
    along = vectors.T @ (scale * right)
    value -= 0.5 * float(np.log(size[kept]).sum())
    return value - 0.5 * (float(total[-1, -1]) - float(np.sum(along[kept] ** 2 / size[kept])))
