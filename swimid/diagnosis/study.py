"""Fit hypotheses, the model with sets of effects, to trials with the noise of a noise model."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import norm

from swimid.diagnosis import crossval
from swimid.diagnosis.noise import NoiseModel
from swimid.diagnosis.priors import NO_CORRELATION, Correlation, StudyPriors
from swimid.diagnosis.settings import divide_folds
from swimid.effects.base import Effect
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem, Watch, map_in_processes

if TYPE_CHECKING:
    from swimid.diagnosis.screening import Screening

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

        The unknowns are those that affect the trial (:attr:`Problem.taken`). The derivatives are divided by
        the noise standard deviation. The derivatives of the residuals have the opposite sign.
        """
        return [-rows for rows in self.problem.own_jacobians(self.theta)]

    def typical(self, k: int) -> Array:
        """Return the residuals of trial ``k`` if random effects had their means, shape (n_k,).

        They are linearised about the own values of the trial.
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
        parts: dict[str, list[Array]] = {}
        for k in range(len(self.residuals)):
            for channel, series in self.split(k).items():
                parts.setdefault(channel, []).append(series[np.isfinite(series)])
        return {c: np.concatenate(p) for c, p in parts.items()}

    def collect_measured(self) -> dict[str, Array]:
        """Return the measured samples of all trials by channel, in the channel's unit."""
        parts: dict[str, list[Array]] = {}
        for k, trial in enumerate(self.problem.trials):
            for channel, mask in zip(self.problem.channels[k], self.problem.masks[k], strict=True):
                parts.setdefault(channel, []).append(trial.measured[channel][mask])
        return {c: np.concatenate(p) for c, p in parts.items()}

    def value(self, label: str) -> float:
        """Return the estimate of the parameter with a given label, or its value if it is fixed."""
        if label in self.labels:
            return float(self.theta[self.labels.index(label)])
        return next(p.start for p in self.problem.parameters if p.name == label)


def _brief_watch(tolerance: float) -> Watch:
    """Return a function that ends a search which another one from another starting point has beaten.

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
        Names of coefficients, and the correlation matrix of their priors. The priors of all other
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

    def chance(self, fit: Hypothesis, k: int) -> Array:
        """Return the weighted change of trial ``k`` by one standard deviation of each random effect.

        The shape is (n_k, q).
        """
        random = self.random(fit.problem, k)
        return fit.columns(k, random) / self.compute_prior(fit.problem)[1][random]

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
            Default: the trials of the study. Others have no weights.
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
            # The norm of residuals that diverge stays finite where their squares overflow.
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

        Its derivatives are used as long as they are accurate enough, if it has the same random effects.
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
            theta = self.fit(
                fit.effects,
                [fit.theta],
                tolerance=ROUGH,
                iterations=MAX_FOLD_ITERATIONS,
                reuse=fit,
                kept=kept,
            ).theta.copy()
            # Nothing determines the initial state of a trial that is held out as a whole.
            for k in (k for k, fitted in enumerate(kept) if not fitted.any()):
                own = fit.problem.own(k)
                theta[own] = fit.theta[own]
            return theta

        return list(map_in_processes(one, range(self.folds.count), self.jobs))

    def at(
        self,
        effects: Sequence[Effect],
        theta: Array,
        cost: float = math.nan,
        hold: Sequence[Hypothesis] = (),
    ) -> Hypothesis:
        """Return a hypothesis at the given parameter values, without a search for the optimum.

        Parameters
        ----------
        hold : sequence of Hypothesis, optional
            Nearby fits, whose derivatives replace those with respect to the parameters that they have as
            well. Those of the last fit are preferred.
        """
        problem = self.problem(effects)
        for near in hold:
            problem.hold_derivatives(near.problem, near.derivatives)
        return Hypothesis(self, tuple(effects), theta, cost, problem)

    def start(
        self,
        effects: Sequence[Effect],
        fit: Hypothesis,
        own: Mapping[str, float] | None = None,
    ) -> Array:
        """Return the starting point of a fit with other effects or another noise model.

        A parameter starts at its value in ``own``, otherwise at its estimate in ``fit``, otherwise at its
        null value.
        """
        problem = self.problem(effects)
        known = dict(zip(fit.labels, fit.theta, strict=True))
        own = own or {}
        return np.array(
            [
                own.get(label, own.get(label.split("[")[0], known.get(label, start)))
                for label, start in zip(problem.labels, problem.start, strict=True)
            ]
        )

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
        return [
            [
                (base.problem.stack(k, next(simulated)) - unaffected[k]) * base.problem.sample_weights(k)
                for k in range(len(self.trials))
            ]
            for _ in points
        ]


def fix_parameters(parameters: Sequence[Parameter], known: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters, with those in ``known`` fixed at the values given there."""
    found = list(parameters)
    for i, p in enumerate(parameters):
        if p.name in known:
            found[i] = replace(p, free=False, start=known[p.name])
    return tuple(found)
