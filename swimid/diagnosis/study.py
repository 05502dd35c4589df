"""Unknowns and priors of hypotheses, and their fits to trials with the noise of a noise model."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import norm

from swimid.diagnosis import crossval
from swimid.diagnosis.noise import NoiseModel, join_channels
from swimid.diagnosis.nominal import OWN_PRIOR, PREFIX
from swimid.diagnosis.settings import Folds, divide_folds
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem, Watch, map_in_processes

if TYPE_CHECKING:
    from swimid.diagnosis.screening import Screening

#: Prior standard deviation of the parameters of an effect, in units of their typical scales.
EFFECT_PRIOR = 5.0
#: Factor by which the prior of a changed parameter is wider. Its typical scale is that of a small change.
CHANGE_WIDTH = 10.0
#: Prior standard deviation of the initial state of a trial, in units of the typical scales of its parameters.
#: The prior mean comes from the first samples of the trial.
START_PRIOR = 30.0
#: Weight of the mean of a random effect that is held at 0, in units of its standard error by chance.
ZERO_MEAN_WEIGHT = 100.0
#: Distance of a coefficient from its prior mean, in prior standard deviations, above which a missing effect
#: may have distorted the coefficient.
MAX_PRIOR_DISTANCE_SD = 2.0
#: Maximum standard deviation of an informative prior, as a fraction of the coefficient. In place of a wider
#: prior, a prior of this width about the published value is used.
MAX_INFORMATIVE_SHARE = 0.3
#: Type of a prior correlation: names of coefficients, and the correlation matrix of their priors.
Correlation = tuple[Sequence[str], Array]
NO_CORRELATION: Correlation = ((), np.empty((0, 0)))
#: Number added to the diagonal of a correlation matrix to make it positive definite. This is necessary
#: because files round correlations to a few digits.
PRIOR_CORRELATION_RIDGE = 1e-6
#: Relative tolerance of the cost (sum of squared residuals and prior terms).
TOLERANCE = 1e-5
#: Search from several starting points: number of iterations from the best one (HEAT), maximum number of
#: iterations with new derivatives (STEPS), and relative tolerance of the cost before these last iterations
#: (ROUGH) and in them (FINE).
HEAT, STEPS, ROUGH, FINE = 4, 80, 1e-3, 1e-4
#: Ratio of the costs of two brief searches, after the same number of iterations, at which the worse one ends.
MAX_COST_RATIO = 3.0
#: Maximum number of iterations of a refit without one fold, which begins at the fit to all folds, and of the
#: first steps from distorted coefficients.
MAX_FOLD_ITERATIONS = 3
#: Maximum change of the parameters, in standard errors, up to which a fit uses earlier derivatives again.
MAX_REUSE_STDERR = 0.3


@dataclass(eq=False)
class Hypothesis:
    """Hypothesis: the model with a set of effects, at a fit to the trials.

    Residuals, derivatives and deviances are computed when they are first needed.

    Attributes
    ----------
    study : GapStudy
        Study with the noise model of the fit.
    effects : tuple of Effect
        Effects of the hypothesis.
    theta : ndarray, shape (p,)
        Estimates of the parameters.
    cost : float
        Sum of squared whitened residuals and squared prior terms.
    problem : Problem
        The residual problem that was solved.
    tried : Screening or None
        Screening result of the effect that was added last; None for the model without effects.
    rough : bool
        Whether the fit has not reached its optimum.
    gains : ndarray, shape (folds,)
        Decrease of the deviance of each fold, compared with the hypothesis without the effect that was added
        last; empty if the two were not compared.
    """

    study: GapStudy
    effects: tuple[Effect, ...]
    theta: Array
    cost: float
    problem: Problem
    tried: Screening | None = None
    rough: bool = False
    gains: Array = field(default_factory=lambda: np.empty(0))

    @property
    def key(self) -> frozenset[int]:
        """Return the identities of the effects, which identify the hypothesis in a search."""
        return frozenset(id(e) for e in self.effects)

    @property
    def names(self) -> frozenset[str]:
        """Return the names of the effects of the hypothesis."""
        return frozenset(e.name for e in self.effects)

    @property
    def last_screening(self) -> Screening:
        """Return the screening result of the effect that was added last."""
        assert self.tried is not None
        return self.tried

    @property
    def labels(self) -> list[str]:
        """Return the labels of the parameters."""
        return self.problem.labels

    @cached_property
    def deviance_parts(self) -> tuple[Array, Array, float]:
        """Return the deviances, their log-determinants, and the strain of the hypothesis.

        Returns
        -------
        deviances : ndarray, shape (folds,)
            Minus twice the log predictive density of each fold, up to a constant.
        log_determinant : ndarray, shape (folds,)
            Part of the deviances that is the log-determinant of the covariance of the prediction.
        strain : float
            Squared distance of the parameters from their prior means.
        """
        equations = crossval.form_normal_equations(self.study, self)
        distance, log_determinant = crossval.compute_deviances(equations)
        return distance + log_determinant, log_determinant, crossval.compute_strain(equations)

    @property
    def deviances(self) -> Array:
        """Return the deviance of each fold, shape (folds,)."""
        return self.deviance_parts[0]

    @property
    def log_determinant(self) -> Array:
        """Return the log-determinants that are part of the deviances, shape (folds,)."""
        return self.deviance_parts[1]

    @property
    def strain(self) -> float:
        """Return the squared distance of the parameters from their prior means."""
        return self.deviance_parts[2]

    @property
    def deviance(self) -> float:
        """Return the sum of the deviances of all folds and of the prior."""
        return float(self.deviances.sum()) + self.strain

    @property
    def gain(self) -> float:
        """Return the decrease of the deviance by the effect that was added last, summed over folds."""
        return float(self.gains.sum())

    @property
    def gain_stderr(self) -> float:
        """Return the standard error of the summed gain, estimated from its variation over folds."""
        n = len(self.gains)
        if n < 2:
            return math.nan
        return float(np.sqrt(n * np.var(self.gains, ddof=1)))

    @cached_property
    def residuals(self) -> list[Array]:
        """Return the residuals of each trial, each shape (n_k,).

        They are divided by the noise standard deviation, and not yet whitened.
        """
        return [self.problem.trial_residuals(self.theta, k) for k in range(len(self.problem.trials))]

    @cached_property
    def derivatives(self) -> list[Array]:
        """Return the derivatives of each trial's simulated samples, each shape (n_k, m_k).

        The m_k unknowns are those that affect the trial (:attr:`Problem.taken`). The derivatives are divided
        by the noise standard deviation. The derivatives of the residuals have the opposite sign.
        """
        return [-rows for rows in self.problem.own_jacobians(self.theta)]

    def typical(self, k: int) -> Array:
        """Return the residuals of trial ``k`` if random effects had their means, shape (n_k,).

        The residuals are linearised about the trial's own values of the random effects.
        """
        random = self.study.random(self.problem, k)
        if not len(random):
            return self.residuals[k]
        return np.asarray(self.residuals[k] + self.columns(k, random) @ self.theta[random])

    def columns(self, k: int, unknowns: Sequence[int] | NDArray[np.intp]) -> Array:
        """Return the derivatives of trial ``k`` with respect to some unknowns, shape (n_k, unknowns).

        They are zero for an unknown that does not affect the trial.
        """
        numbers, derivatives = self.problem.taken[k], self.derivatives[k]
        wanted = np.asarray(unknowns, dtype=int)
        place = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
        if not len(numbers):
            return np.zeros((len(derivatives), len(wanted)))
        found = np.asarray(derivatives[:, place])
        found[:, numbers[place] != wanted] = 0.0
        return found

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Return a mask of the parameters that are not at a bound, shape (p,)."""
        return np.asarray((self.theta > self.problem.lower) & (self.theta < self.problem.upper))

    @property
    def changes(self) -> dict[str, str]:
        """Return the label of the change of each changed parameter, by the name of the parameter."""
        return {e.adds_to: f"{e.name}/change" for e in self.effects if e.adds_to is not None}

    @property
    def is_imitating(self) -> bool:
        """Return whether a parameter is near a bound at which its effect could imitate others.

        The attribute :attr:`Effect.inside` of an effect lists such bounds.
        """
        ends = {"lower": self.problem.lower, "upper": self.problem.upper}
        bounds = {f"{e.name}/{name}": ends[end] for e in self.effects for name, end in e.inside.items()}
        return any(
            label in bounds and abs(self.theta[j] - bounds[label][j]) < self.problem.scale[j]
            for j, label in enumerate(self.labels)
        )

    def split(self, k: int) -> dict[str, Array]:
        """Return the residuals of a trial as one series for each channel, in its unit.

        The series are NaN where the channel has no sample.
        """
        found = {}
        parts = zip(self.problem.by_channel(k, self.residuals[k]), self.problem.sd[k], strict=True)
        for (channel, mask, part), sd in parts:
            found[channel] = np.full(len(mask), np.nan)
            found[channel][mask] = part * sd[mask]
        return found

    def by_channel(self) -> dict[str, Array]:
        """Return the residuals of all trials by channel, in the channel's unit."""
        parts = (part for k in range(len(self.residuals)) for part in self.split(k).items())
        return join_channels((channel, series[np.isfinite(series)]) for channel, series in parts)

    def collect_measured(self) -> dict[str, Array]:
        """Return the measured samples of all trials by channel, in the channel's unit."""
        problem = self.problem
        parts = (
            (channel, problem.trials[k].measured[channel][mask])
            for k, channels in enumerate(problem.channels)
            for channel, mask in zip(channels, problem.masks[k], strict=True)
        )
        return join_channels(parts)

    def is_inside(self, label: str) -> bool:
        """Return whether a parameter is estimated and not at a bound."""
        return label in self.labels and bool(self.inside[self.labels.index(label)])

    def value(self, label: str) -> float:
        """Return the estimate of the parameter with a given label, or its value if it is fixed."""
        if label in self.labels:
            return float(self.theta[self.labels.index(label)])
        return next(p.start for p in self.problem.parameters if p.name == label)


def _brief_watch(tolerance: float) -> Watch:
    """Return a function that ends a search if an earlier search from another starting point is better.

    Parameters
    ----------
    tolerance : float
        Relative decrease of the cost by an iteration below which a search ends.
    """
    lowest: dict[int, float] = {}
    last = math.inf

    def watch(theta: Array, cost: float, iteration: int) -> str | None:
        nonlocal last
        lowered, last = last - cost, cost
        beaten = cost > MAX_COST_RATIO * lowest.get(iteration, cost)
        lowest[iteration] = min(cost, lowest.get(iteration, cost))
        if iteration and (beaten or lowered <= tolerance * cost):
            return "another starting point is better, or the cost falls slowly"
        return None

    return watch


class StudyPriors:
    """Unknowns and priors of all hypotheses of a study.

    Attributes
    ----------
    model : Model
        The model without effects.
    parameters : tuple of Parameter
            Parameters of this model.
    prior : dict of name to (mean, sd)
        Normal priors of shared coefficients.
    correlation : tuple of sequence of str and ndarray, shape (m, m)
            Names of m coefficients, and the correlation matrix of their priors. The priors of all other
            coefficients are independent.
    noise : NoiseModel
            Noise of the trials, and their random effects.
    folds : Folds
    """

    model: Model
    parameters: tuple[Parameter, ...]
    prior: dict[str, tuple[float, float]]
    correlation: Correlation
    noise: NoiseModel
    folds: Folds

    def random(self, problem: Problem, k: int) -> NDArray[np.intp]:
        """Return the indices of the random effects of trial ``k`` among the unknowns of a problem."""
        names = {one.parameter for one in self.noise.random_effects}
        own = [j for j in problem.own(k) if problem.parameters[problem.slots[j][0]].name in names]
        return np.array(own, dtype=np.intp)

    @property
    def zero_mean_names(self) -> list[str]:
        """Return the names of the random effects whose mean over the trials is held at 0."""
        return [one.parameter for one in self.noise.random_effects if one.is_centred]

    def select_nonrandom(self, problem: Problem, k: int, own: Iterable[int]) -> NDArray[np.intp]:
        """Return those of the unknowns ``own`` of trial ``k`` that are no random effects."""
        random = self.random(problem, k).tolist()
        return np.array([j for j in own if j not in random], dtype=np.intp)

    def single(self, problem: Problem) -> NDArray[np.bool_]:
        """Return a mask of the parameters that are refitted in each held-out fold, shape (p,).

        The initial states of trials are refitted. If whole trials are held out, per-trial values of effects
        are refitted as well.
        """
        return np.array(
            [
                owner is not None and (self.folds.whole or "/" not in problem.parameters[index].name)
                for index, owner in problem.slots
            ],
            dtype=bool,
        )

    def select_shared(self, fit: Hypothesis) -> NDArray[np.intp]:
        """Return the indices of the parameters that all folds share and that are not at a bound."""
        return np.flatnonzero(~self.single(fit.problem) & fit.inside)

    def select_own(self, fit: Hypothesis, k: int) -> NDArray[np.intp]:
        """Return the indices of the parameters of trial ``k`` that are refitted in a held-out fold.

        Parameters at a bound are left out.
        """
        free = self.single(fit.problem) & fit.inside
        return np.array([j for j in fit.problem.own(k) if free[j]], dtype=int)

    def widen_priors(self, problem: Problem) -> dict[str, tuple[float, float]]:
        """Return wider priors of coefficients for a model with another interpretation of the robot's source.

        The result is empty for the interpretation in the robot file. The usual priors come from other trials
        that were fitted with that interpretation, and are too narrow for another one.
        """
        added = problem.model.acting[len(self.model.acting) :]
        if all(acting.model is self.model for acting in added):
            return {}
        own = {p.name: OWN_PRIOR * max(abs(p.start), 0.1 * p.scale) for p in self.parameters}
        return {name: (mean, own[name]) for name, (mean, sd) in self.prior.items() if 0 < sd < own[name]}

    def compute_prior(self, problem: Problem) -> tuple[Array, Array]:
        """Return the prior mean and the inverse prior standard deviation of each parameter.

        The inverse standard deviation of a parameter without a prior is 0.
        """
        mean, weight = np.array(problem.start), np.zeros(len(problem.labels))
        random = {one.parameter: one.sd for one in self.noise.random_effects}
        known = {**self.prior, **self.widen_priors(problem)}
        for j, (index, owner) in enumerate(problem.slots):
            p = problem.parameters[index]
            if owner is None and p.name in known:
                mean[j], sd = known[p.name]
                if sd > 0:
                    weight[j] = 1.0 / sd
            elif p.name in random:
                weight[j] = 1.0 / (random[p.name] * p.scale)
            elif "/" in p.name:
                wide = EFFECT_PRIOR * (CHANGE_WIDTH if p.name.startswith(PREFIX) else 1.0)
                mean[j], weight[j] = p.start, 1.0 / (wide * p.scale)
            elif owner is not None:
                weight[j] = 1.0 / (START_PRIOR * p.scale)
        return mean, weight

    def root(self, problem: Problem, left_out: Collection[int] = ()) -> Array:
        """Return a square root of the prior precision matrix, shape (m, p).

        The prior precision matrix is ``root.T @ root``. The root has one row for each parameter with a prior,
        and one for each random effect whose mean over the trials is held at 0.

        Parameters
        ----------
        left_out : collection of int, optional
                Indices of trials that are not fitted. They do not count in these means.
        """
        _, weight = self.compute_prior(problem)
        root, loosened = np.diag(weight), self.widen_priors(problem)
        names, correlation = self.correlation
        at = {problem.parameters[i].name: j for j, (i, owner) in enumerate(problem.slots) if owner is None}
        known = [(at[n], i) for i, n in enumerate(names) if n in at and n not in loosened]
        if known:
            places, rows = (list(ends) for ends in zip(*known, strict=True))
            own = correlation[np.ix_(rows, rows)]
            inverse = np.linalg.inv(own + PRIOR_CORRELATION_RIDGE * np.eye(len(rows)))
            root[np.ix_(places, places)] = np.linalg.cholesky(inverse).T * weight[places]
        rows = [root[weight > 0]]
        for name in self.zero_mean_names if len(problem.trials) > 1 else ():
            mine = [
                problem.parameters[i].name == name and owner not in left_out for i, owner in problem.slots
            ]
            rows.append(np.atleast_2d(ZERO_MEAN_WEIGHT * weight * mine / math.sqrt(max(sum(mine), 1))))
        return np.concatenate(rows)

    def precision(self, problem: Problem) -> Array:
        """Return the prior precision matrix of all parameters, shape (p, p); see :meth:`root`."""
        root = self.root(problem)
        return np.asarray(root.T @ root)

    def begins(self, problem: Problem, theta: Array) -> list[Array]:
        """Return further starting points of a fit: the prior means, if ``theta`` is far from them.

        A missing effect may have distorted the coefficients in ``theta``. A fit with the effect that starts
        at ``theta`` may end in a poor local optimum. The initial states may be distorted as well. A second
        starting point therefore combines the prior means with the start values of the initial states.
        """
        plain, distorted = theta.copy(), False
        known = {**self.prior, **self.widen_priors(problem)}
        for j, (index, owner) in enumerate(problem.slots):
            p = problem.parameters[index]
            if owner is not None or p.name not in known:
                continue
            mean, sd = known[p.name]
            size = max(abs(mean), p.scale)
            if p.known is not None and sd > MAX_INFORMATIVE_SHARE * size:
                # The prior was estimated from these trials, so a missing effect biases the prior too. Use the
                # published value of the coefficient instead of this prior.
                mean, sd = p.known, MAX_INFORMATIVE_SHARE * max(abs(p.known), p.scale)
            plain[j] = mean
            distorted = distorted or abs(theta[j] - mean) > MAX_PRIOR_DISTANCE_SD * sd
        if not distorted:
            return []
        rest = plain.copy()
        for j, (index, owner) in enumerate(problem.slots):
            if owner is not None and "/" not in problem.parameters[index].name:
                rest[j] = problem.start[j]
        return [plain, rest]


class GapStudy(StudyPriors):
    """Model, trials, priors and noise that all fits of a diagnosis share.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Parameters of the model. Every fit estimates the free ones.
    trials : sequence of Trial
        Trials that are fitted.
    prior : mapping of name to (mean, sd)
        Normal priors of shared coefficients.
    correlation : tuple of sequence of str and ndarray, shape (m, m), optional
            Names of m coefficients, and the correlation matrix of their priors. The priors of all other
            coefficients are independent.
    jobs : int
        Number of fits or simulations that run in parallel.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        trials: Sequence[Trial],
        prior: Mapping[str, tuple[float, float]],
        *,
        correlation: Correlation = NO_CORRELATION,
        jobs: int = 1,
    ) -> None:
        self.model = model
        self.parameters = tuple(parameters)
        self.trials = list(trials)
        self.prior = dict(prior)
        self.correlation = correlation
        self.jobs = jobs
        self._known: dict[tuple[int, ...], Model] = {}
        self.noise = NoiseModel([])
        self.shape = self.problem(())
        self.noise = NoiseModel(self.shape.sd)
        stamps = [
            np.concatenate([np.empty(0), *(trial.time_s[mask] for mask in masks)])
            for trial, masks in zip(self.trials, self.shape.masks, strict=True)
        ]
        self.folds = divide_folds(self.trials, stamps)

    def copy_with(self, model: Model, trials: Sequence[Trial]) -> GapStudy:
        """Return a study with the same priors, but with another model and other trials."""
        more = {"correlation": self.correlation, "jobs": self.jobs}
        return GapStudy(model, self.parameters, trials, self.prior, **more)  # type: ignore[arg-type]

    def finer(self, halvings: int) -> GapStudy:
        """Return a study with the same trials and noise, whose model has a halved integration step."""
        model = self.model
        for _ in range(halvings):
            model = model.refine() or model
        return self.copy_with(model, self.trials).with_noise(self.noise)

    def with_noise(self, noise: NoiseModel) -> GapStudy:
        """Return a study with another noise model."""
        other = copy.copy(self)
        other.noise = noise
        return other

    def build_model(self, effects: Sequence[Effect]) -> Model:
        """Return the model with the random effects and the given effects added."""
        # Cache the model with effects, because the typical scales of effects are computed from the trials.
        acting = [*(one.effect for one in self.noise.random_effects), *effects]
        key = tuple(id(e) for e in acting)
        if key not in self._known:
            self._known[key] = self.model.with_effects(acting, self.trials)
        return self._known[key]

    def problem(
        self,
        effects: Sequence[Effect],
        *,
        jobs: int | None = None,
        trials: Sequence[Trial] | None = None,
        known: Mapping[str, float] | None = None,
    ) -> Problem:
        """Return the residual problem of the model with effects, with the weights of the noise model.

        Parameters
        ----------
        trials : sequence of Trial, optional
                Trials of the problem; by default those of the study. Other trials have no weights.
        known : mapping of label to float, optional
            Shared parameters that are held at these values.
        """
        model = self.build_model(effects)
        own = model.parameters[len(self.parameters) :]
        parameters = fix_parameters((*self.parameters, *own), known or {})
        problem = Problem(
            model, parameters, self.trials if trials is None else trials, jobs=jobs or self.jobs
        )
        problem.near = MAX_REUSE_STDERR
        if trials is None and self.noise.sd:
            problem.sd = [list(sds) for sds in self.noise.sd]
        return problem

    def fit(
        self,
        effects: Sequence[Effect],
        starts: Sequence[Array],
        *,
        others: Sequence[Array] = (),
        tolerance: float = TOLERANCE,
        iterations: int = 30,
        brief: bool = False,
        hold: Hypothesis | None = None,
        reuse: Hypothesis | None = None,
        known: Mapping[str, float] | None = None,
        kept: Sequence[NDArray[np.bool_]] | None = None,
    ) -> Hypothesis:
        """Fit the model with effects, and return the best optimum from several starting points.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
            Starting points.
        others : sequence of ndarray, shape (p,)
            Further starting points, of which only the one with the lowest cost is used.
        brief : bool
            Whether the fit only has to show which starting point is best. A search then ends as soon as its
            cost is :data:`MAX_COST_RATIO` times that of an earlier one after the same number of iterations,
            or when its cost falls by less than the tolerance.
        hold : Hypothesis, optional
            Nearby fit, whose derivatives replace those with respect to the parameters that both fits have.
        reuse : Hypothesis, optional
            Fit of the same effects, whose derivatives are used as long as they are accurate enough.
        known : mapping of label to float, optional
            Shared parameters that are held at these values.
        kept : sequence of ndarray of bool, shape (n_k,), optional
            Mask of the samples of each trial that are fitted. By default all samples are fitted.
        """
        problem = self.problem(effects, jobs=None if hold is None and reuse is None else 1, known=known)
        left_out = [] if kept is None else [k for k, fitted in enumerate(kept) if not fitted.any()]
        problem.prior = self.compute_prior(problem)[0], self.root(problem, left_out)
        if hold is not None:
            problem.hold_derivatives(hold.problem, hold.derivatives)
        if reuse is not None:
            problem.reuse_derivatives(reuse.problem, reuse.theta, reuse.derivatives)

        def whiten(k: int, rows: Array) -> Array:
            seen = self.noise.whiten(problem, k, rows)
            if kept is None:
                return seen
            return (seen.T * kept[k]).T

        problem.whiten = whiten
        points = list(starts)
        if others:
            # Compare norms, because the squares of diverging residuals may overflow.
            points.append(min(others, key=lambda theta: float(norm(problem.residuals(theta)))))
        watch = _brief_watch(tolerance) if brief else None
        found = [
            problem.solve(point, tolerance=tolerance, max_iterations=iterations, secant=True, watch=watch)
            for point in points
        ]
        best = min(found, key=lambda one: float(np.nan_to_num(one.cost, nan=math.inf)))
        return Hypothesis(self, tuple(effects), best.x, best.cost, problem)

    def refit(self, fit: Hypothesis, *, tolerance: float) -> Hypothesis:
        """Continue a fit to its optimum.

        If the fit has the same random effects, its derivatives are used as long as they are accurate enough.
        """
        is_same = fit.labels == self.problem(fit.effects).labels
        start = self.start(fit.effects, fit)
        return self.fit(
            fit.effects, [start], tolerance=tolerance, iterations=STEPS, reuse=fit if is_same else None
        )

    def refit_folds(self, fit: Hypothesis) -> list[Array]:
        """Return the estimates of refits that leave out one fold each, one array of shape (p,) for each fold.

        The noise model is not re-estimated. Per-trial parameters of the held-out fold are not estimated.
        """

        def one(f: int) -> Array:
            kept = [owner != f for owner in self.folds.owner]
            few: dict[str, Any] = {"tolerance": ROUGH, "iterations": MAX_FOLD_ITERATIONS}
            theta = self.fit(fit.effects, [fit.theta], reuse=fit, kept=kept, **few).theta.copy()
            # Nothing determines the initial state of a trial that is held out as a whole.
            for k in (k for k, fitted in enumerate(kept) if not fitted.any()):
                own = fit.problem.own(k)
                theta[own] = fit.theta[own]
            return theta

        return list(map_in_processes(one, range(self.folds.count), self.jobs))

    def at(
        self, effects: Sequence[Effect], theta: Array, cost: float = math.nan, hold: Sequence[Hypothesis] = ()
    ) -> Hypothesis:
        """Return a hypothesis at the given parameter values, without a search for the optimum.

        Parameters
        ----------
        hold : sequence of Hypothesis, optional
                Nearby fits, whose derivatives replace those with respect to the parameters that they share
                with the hypothesis. Those of the last fit are preferred.
        """
        problem = self.problem(effects)
        for near in hold:
            problem.hold_derivatives(near.problem, near.derivatives)
        return Hypothesis(self, tuple(effects), theta, cost, problem)

    def start(
        self, effects: Sequence[Effect], fit: Hypothesis, own: Mapping[str, float] | None = None
    ) -> Array:
        """Return the starting point of a fit with other effects or another noise model.

        A parameter starts at its value in ``own``, otherwise at its estimate in ``fit``, otherwise at its
        null value.
        """
        problem = self.problem(effects)
        known = dict(zip(problem.labels, problem.start, strict=True))
        known |= dict(zip(fit.labels, fit.theta, strict=True))
        own = own or {}
        labels = problem.labels
        return np.array([own.get(n, own.get(n.split("[")[0], known[n])) for n in labels])

    def changes(self, base: Hypothesis, effect: Effect, points: Sequence[Array]) -> list[list[Array]]:
        """Return the changes of the simulated samples by an effect for several parameter values.

        The result has one list for each item of ``points``, with one array for each trial, shape (n_k,). All
        changes are divided by the noise standard deviation.

        Parameters
        ----------
        base : Hypothesis
            Fit that gives the values of the other parameters. The model includes the effects of this fit.
        points : sequence of ndarray
            Values of all parameters of the effect.
        """
        model = self.build_model((*base.effects, effect))
        own = [base.problem.vector(base.theta, k) for k in range(len(self.trials))]
        runs = [
            (np.concatenate((values, point[: len(model.acting[-1].parameters)])), trial)
            for point in points
            for values, trial in zip(own, self.trials, strict=True)
        ]
        without = self.build_model(base.effects).run_many(list(zip(own, self.trials, strict=True)))
        simulated = iter(model.run_many(runs))
        unaffected = [base.problem.stack(k, seen) for k, seen in enumerate(without)]
        weights = [base.problem.sample_weights(k) for k in range(len(self.trials))]

        def change(k: int) -> Array:
            return (base.problem.stack(k, next(simulated)) - unaffected[k]) * weights[k]

        return [[change(k) for k in range(len(weights))] for _ in points]


def fix_parameters(parameters: Sequence[Parameter], known: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters, with those in ``known`` fixed at the values given there."""
    found = list(parameters)
    for i, p in enumerate(parameters):
        if p.name in known:
            found[i] = replace(p, free=False, start=known[p.name])
    return tuple(found)
