"""Fit hypotheses: the model with effects and random effects, to trials with coloured noise."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.nominal import OWN_PRIOR
from swimid.diagnosis.random_effects import RandomEffect
from swimid.diagnosis.settings import folds
from swimid.effects.base import Affected, Effect
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import Problem, Solution, map_in_processes

#: Prior standard deviation of the parameters of an effect, in units of their typical scales.
EFFECT_PRIOR = 5.0
#: Prior standard deviation of the initial state of a trial, in units of the typical scales of its parameters.
#: The prior mean comes from the first samples of the trial.
START_PRIOR = 30.0
#: Relative tolerance of the cost (sum of squared residuals and prior terms).
TOLERANCE = 1e-5
#: Constants of the multistart search: number of starting points (HEATED) up to which each halving is preceded
#: by HEAT iterations instead of one, maximum number of iterations of the last starting point (STEPS),
#: relative tolerance of the cost before these last iterations (ROUGH) and in them (FINE).
HEATED, HEAT, STEPS, ROUGH, FINE = 4, 4, 80, 1e-3, 1e-4
#: Tolerance at which two optima count as equal. It applies to the difference of effect parameters in units of
#: their typical scales, and to the relative difference of the costs.
ALIKE = 0.1
#: Distance of a coefficient from its prior mean, in prior standard deviations, above which a missing effect
#: may have distorted the coefficient.
DISTORTED = 2.0
#: Maximum standard deviation of an informative prior, as a fraction of the coefficient. In place of a wider
#: prior, a prior of this width about the published value is used.
LOOSE = 0.3
#: Maximum change of the parameters, in standard errors, up to which a fit uses earlier derivatives again.
NEAR = 0.3


#: Type of a prior correlation: names of coefficients, and the correlation matrix of their priors.
Correlation = tuple[Sequence[str], Array]
NO_CORRELATION: Correlation = ((), np.empty((0, 0)))
#: Number added to the diagonal of a correlation matrix to make it positive definite. This is necessary
#: because files round correlations to a few digits.
ROUNDING = 1e-6


class Mixed(Problem):
    """Least-squares problem of a model on trials with random effects.

    Parameters
    ----------
    random_effects : sequence of RandomEffect
        Random effects. Each of them has a separate value for each trial.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        trials: Sequence[Trial],
        *,
        random_effects: Sequence[RandomEffect] = (),
        jobs: int = 1,
    ) -> None:
        known = {kind.label: kind for kind in random_effects}
        own = {name: kind for name, kind in known.items() if kind.effect is None}
        parameters = list(parameters)
        for i, p in enumerate(parameters):
            if p.name in own:
                parameters[i] = own[p.name].number(p)
        super().__init__(model, parameters, trials, jobs=jobs)
        self.random_effects = tuple(random_effects)
        self._differ = {i for i, p in enumerate(self.parameters) if p.name in known}

    def differs(self, j: int) -> bool:
        """Return whether the parameter with index ``j`` is a random effect of a trial."""
        return self.slots[j][0] in self._differ

    def begun(self, trial: int) -> list[int]:
        """Return the indices of the parameters that describe the initial state of a trial."""
        return [j for j in self.own(trial) if not self.differs(j)]

    def differing(self, trial: int) -> list[int]:
        """Return the indices of the parameters that are random effects of a trial."""
        return [j for j in self.own(trial) if self.differs(j)]


@dataclass(frozen=True)
class Fit:
    """Fit of a hypothesis: the model with its effects and random effects at the optimum.

    Residuals and derivatives are computed when they are first needed.

    Attributes
    ----------
    effects : tuple of Effect
        Effects of the hypothesis.
    acting : tuple of Effect
        All effects in the model: random effects, then effects of the hypothesis.
    labels : list of str
        Labels of the parameters.
    theta : ndarray, shape (p,)
        Estimates of the parameters.
    cost : float
        Sum of squared whitened residuals and squared prior terms.
    problem : Mixed
        The residual problem that was solved.
    """

    effects: tuple[Effect, ...]
    acting: tuple[Effect, ...]
    labels: list[str]
    theta: Array
    cost: float
    problem: Mixed

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

    @property
    def rows(self) -> list[Array]:
        """Return the derivatives of each trial's simulated samples, each shape (n_k, p)."""
        return [self.columns(k, np.arange(len(self.theta))) for k in range(len(self.problem.trials))]

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

    def free_of_trial(self, k: int) -> NDArray[np.intp]:
        """Return the indices of the parameters that only trial ``k`` has and that are not at a bound."""
        inside = self.inside
        return np.array([j for j in self.problem.own(k) if inside[j]], dtype=int)

    def own(self, k: int) -> Array:
        """Return the derivatives with respect to the initial state of trial ``k``, shape (n_k, m).

        The derivatives are multiplied by the typical scales of the m parameters.
        """
        mine = self.problem.begun(k)
        return self.columns(k, mine) * self.problem.scale[mine]

    def centre(self, without: Collection[str] = ()) -> dict[str, float]:
        """Return the mean of each random effect over trials, by parameter name.

        Parameters
        ----------
        without : collection of str
            Names of effects that do not act in this model. A random effect of the same name has its null
            value in place of the mean.
        """
        null = {p.name: p.start for p in self.problem.parameters}
        found = {name: float(np.mean(values)) for name, values in self._differing().items()}
        for kind in self.problem.random_effects:
            if kind.label in found and kind.name.replace("_", "-") in without:
                found[kind.label] = null[kind.label]
        return found

    def scatter(self) -> dict[str, float]:
        """Return the standard deviation of each random effect over trials, by parameter name, in its unit.

        The mean over trials does not count, because a value that all trials share is an effect and not
        random.
        """
        return {name: float(np.std(v, ddof=min(len(v) - 1, 1))) for name, v in self._differing().items()}

    def _differing(self) -> dict[str, list[float]]:
        """Return the values of each random effect in all trials, by parameter name."""
        values: dict[str, list[float]] = {}
        for j, (index, _) in enumerate(self.problem.slots):
            if self.problem.differs(j):
                values.setdefault(self.problem.parameters[index].name, []).append(float(self.theta[j]))
        return values

    def fixed_effects_residual(self, k: int, without: Collection[str] = ()) -> Array:
        """Return the residuals of trial ``k`` with its random effects at their mean, shape (n_k,).

        The simulation is linearised in the random effects.

        Parameters
        ----------
        without : collection of str
            As in :meth:`centre`.
        """
        mine = self.problem.differing(k)
        centre = self.centre(without)
        names = [self.problem.parameters[self.problem.slots[j][0]].name for j in mine]
        away = np.array([self.theta[j] - centre[name] for j, name in zip(mine, names, strict=True)])
        return np.asarray(self.residuals[k] + self.columns(k, mine) @ away)

    def marginal_residuals(self, without: Collection[str] = ()) -> list[Array]:
        """Return the residuals of each trial with random effects at their means.

        The initial state of each trial is refitted.

        Parameters
        ----------
        without : collection of str
            As in :meth:`centre`.
        """
        return [
            beyond(self.own(k), self.fixed_effects_residual(k, without)) if self.problem.differing(k) else r
            for k, r in enumerate(self.residuals)
        ]

    def value(self, label: str) -> float:
        """Return the estimate of the parameter with a given label, or its value if it is fixed."""
        if label in self.labels:
            return float(self.theta[self.labels.index(label)])
        return next(p.start for p in self.problem.parameters if p.name == label)


class FitContext:
    """Model, trials and priors that all fits of a diagnosis share.

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
        self._known: dict[tuple[int, ...], Affected] = {}
        self._without: list[tuple[Fit, NoiseModel, list[Array]]] = []
        self.shape = self.problem(())
        stamps = [
            np.concatenate([np.empty(0), *(trial.time_s[mask] for mask in masks)])
            for trial, masks in zip(self.trials, self.shape.masks, strict=True)
        ]
        self.folds = folds(self.trials, stamps)

    def replaced(self, model: Model, trials: Sequence[Trial]) -> FitContext:
        """Return a context with the same priors, but with another model and other trials."""
        more = {"correlation": self.correlation, "jobs": self.jobs}
        return FitContext(model, self.parameters, trials, self.prior, **more)  # type: ignore[arg-type]

    def finer(self, halvings: int) -> FitContext:
        """Return a context with the same trials, whose model has a halved integration step."""
        model = self.model
        for _ in range(halvings):
            model = model.refined() or model
        return self.replaced(model, self.trials)

    def affected(self, effects: Sequence[Effect]) -> Affected:
        """Return the model with the given effects added."""
        # Cache the model with effects, because the typical scales of effects are computed from the trials.
        key = tuple(id(e) for e in effects)
        if key not in self._known:
            self._known[key] = Affected(self.model, effects, self.trials)
        return self._known[key]

    def problem(
        self,
        effects: Sequence[Effect],
        random_effects: Sequence[RandomEffect] = (),
        *,
        jobs: int | None = None,
        trials: Sequence[Trial] | None = None,
        known: Mapping[str, float] | None = None,
    ) -> Mixed:
        """Return the residual problem of the model with effects and random effects.

        Parameters
        ----------
        trials : sequence of Trial, optional
            Default: the trials of the context.
        known : mapping of label to float, optional
            Shared parameters that are held at these values.
        """
        acting = _acting(effects, random_effects)
        model = self.affected(acting)
        own = model.parameters[len(self.parameters) :]
        parameters = held_at((*self.parameters, *own), known or {})
        if trials is None:
            trials = self.trials
        problem = Mixed(model, parameters, trials, random_effects=random_effects, jobs=jobs or self.jobs)
        problem.near = NEAR
        return problem

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

    def shared(self, fit: Fit) -> NDArray[np.intp]:
        """Return the indices of the parameters that all folds share and that are not at a bound."""
        return np.flatnonzero(~self.single(fit.problem) & fit.inside)

    def apart(self, fit: Fit, k: int) -> NDArray[np.intp]:
        """Return the indices of the parameters of trial ``k`` that are refitted in a held-out fold.

        Parameters at a bound are left out.
        """
        single = self.single(fit.problem)
        return np.array([j for j in fit.free_of_trial(k) if single[j]], dtype=int)

    def loosened(self, problem: Problem) -> dict[str, tuple[float, float]]:
        """Return wider priors of coefficients for a model with another interpretation of the robot's source.

        The result is empty for the interpretation in the robot file. The usual priors come from other trials
        that were fitted with that interpretation, and are too narrow for another one.
        """
        if getattr(problem.model, "model", self.model) is self.model:
            return {}
        own = {p.name: OWN_PRIOR * max(abs(p.start), 0.1 * p.scale) for p in self.parameters}
        return {name: (mean, own[name]) for name, (mean, sd) in self.prior.items() if 0 < sd < own[name]}

    def expected(self, problem: Mixed) -> tuple[Array, Array]:
        """Return the prior mean and the inverse prior standard deviation of each parameter.

        The inverse standard deviation of a parameter without a prior is 0.
        """
        mean, weight = np.array(problem.start), np.zeros(len(problem.labels))
        known = {**self.prior, **self.loosened(problem)}
        for j, (index, owner) in enumerate(problem.slots):
            p = problem.parameters[index]
            if problem.differs(j):
                mean[j], weight[j] = p.start, 1.0 / p.scale
            elif owner is None and p.name in known:
                mean[j], sd = known[p.name]
                if sd > 0:
                    weight[j] = 1.0 / sd
            elif "/" in p.name:
                mean[j], weight[j] = p.start, 1.0 / (EFFECT_PRIOR * p.scale)
            elif owner is not None:
                weight[j] = 1.0 / (START_PRIOR * p.scale)
        return mean, weight

    def root(self, problem: Mixed) -> Array:
        """Return a square root of the prior precision matrix, shape (m, p).

        The prior precision matrix is ``root.T @ root``. The number m counts the parameters with a prior.
        """
        _, weight = self.expected(problem)
        root, loosened = np.diag(weight), self.loosened(problem)
        names, correlation = self.correlation
        at = {problem.parameters[i].name: j for j, (i, owner) in enumerate(problem.slots) if owner is None}
        known = [(at[n], i) for i, n in enumerate(names) if n in at and n not in loosened]
        if known:
            places, rows = (list(ends) for ends in zip(*known, strict=True))
            own = correlation[np.ix_(rows, rows)]
            inverse = np.linalg.inv(own + ROUNDING * np.eye(len(rows)))
            root[np.ix_(places, places)] = np.linalg.cholesky(inverse).T * weight[places]
        return np.asarray(root[weight > 0])

    def precision(self, problem: Mixed) -> Array:
        """Return the prior precision matrix of all parameters, shape (p, p); see :meth:`root`."""
        root = self.root(problem)
        return np.asarray(root.T @ root)

    def begins(self, problem: Mixed, theta: Array) -> list[Array]:
        """Return starting points of a fit: ``theta``, and the prior means if ``theta`` is far from them.

        A missing effect may have distorted the coefficients in ``theta``. A fit with the effect that starts
        there may end in a poor local optimum. A third starting point has the start values of the initial
        states beside the prior means, because the initial states may be distorted as well.
        """
        plain, distorted = theta.copy(), False
        known = {**self.prior, **self.loosened(problem)}
        for j, (index, owner) in enumerate(problem.slots):
            p = problem.parameters[index]
            if owner is not None or p.name not in known:
                continue
            mean, sd = known[p.name]
            size = max(abs(mean), p.scale)
            if p.known is not None and sd > LOOSE * size:
                # The prior was estimated from these trials, so a missing effect biases the prior too. Use the
                # published value of the coefficient instead of this prior.
                mean, sd = p.known, LOOSE * max(abs(p.known), p.scale)
            plain[j] = mean
            distorted = distorted or abs(theta[j] - mean) > DISTORTED * sd
        if not distorted:
            return [theta]
        rest = plain.copy()
        for j, (index, owner) in enumerate(problem.slots):
            if owner is not None and "/" not in problem.parameters[index].name:
                rest[j] = problem.start[j]
        return [theta, plain, rest]

    def fit(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        starts: Sequence[Array],
        *,
        tolerance: float = TOLERANCE,
        iterations: int = 30,
        warm: Fit | None = None,
    ) -> Fit:
        """Return the best optimum from several starting points.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
            Starting points.
        warm : Fit, optional
            Fit whose derivatives are used first. If the optimum is near this fit, the search is five times as
            fast.
        """
        problem = self.posed(effects, noise_model)
        if warm is not None:
            problem.hold_derivatives(warm.problem, warm.derivatives)
        best = self.search(problem, noise_model, starts, tolerance, iterations)
        return self.at(effects, noise_model, best.x, best.cost, problem)

    def multistart(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        starts: Sequence[Array],
        *,
        warm: Fit,
        rough: bool = False,
        jobs: int = 1,
    ) -> Fit:
        """Return the best optimum from many starting points by successive halving [1]_.

        All starting points use the derivatives of a nearby fit, and own derivatives only with respect to the
        other parameters. After each round the better half continues. The last one continues with derivatives
        of its own.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
            Starting points.
        warm : Fit
            Nearby fit whose derivatives are used first.
        rough : bool
            Whether the search ends with the last round, and without new derivatives.

        References
        ----------
        .. [1] K. Jamieson, A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
           optimization", AISTATS 2016.
        """
        problem = self.posed(effects, noise_model, jobs)

        def one(start: Array, tolerance: float, steps: int) -> Solution:
            return self.search(problem, noise_model, [start], tolerance, steps)

        def cost(found: Solution) -> float:
            return float(np.nan_to_num(found.cost, nan=math.inf))

        # Compare starting points by the parameters of effects only, because every iteration changes the
        # coefficients.
        own = np.where(["/" in label for label in problem.labels], problem.scale, np.inf)

        def ranked(starts: Sequence[Array], tolerance: float, steps: int) -> list[Solution]:
            found: list[Solution] = []
            for ended in sorted((one(s, tolerance, steps) for s in starts), key=cost):
                # Continue only one of several starting points that lead to the same optimum.
                if not any(_same(ended, other, own) for other in found):
                    found.append(ended)
            return found

        best: Solution | None = None
        problem.hold_derivatives(warm.problem, warm.derivatives)
        while len(starts) > 1 or (rough and best is None):
            steps = 1
            if len(starts) <= HEATED:
                steps = HEAT
            found = ranked(starts, ROUGH, steps)[: max(len(starts) // 2, 1)]
            best, starts = found[0], [one.x for one in found]
        if best is None or not rough:
            problem.release_derivatives()
            best = one(starts[0], FINE, STEPS)
        return self.at(effects, noise_model, best.x, best.cost, problem)

    def search(
        self,
        problem: Mixed,
        noise_model: NoiseModel,
        starts: Sequence[Array],
        tolerance: float,
        iterations: int,
        prior: tuple[Array, Array] | None = None,
        kept: Sequence[NDArray[np.bool_]] | None = None,
    ) -> Solution:
        """Return the optimum with the lowest cost from several starting points.

        Parameters
        ----------
        kept : sequence of ndarray of bool, shape (n_k,), optional
            Mask of the samples of each trial that are fitted. By default all samples are fitted.
        prior : tuple of ndarray, shapes (p,) and (m, p), optional
            Prior mean of the parameters, and a root of their prior precision. By default it is the prior of
            :meth:`fit`.
        """
        problem.prior = prior or (self.expected(problem)[0], self.root(problem))

        def whiten(k: int, rows: Array) -> Array:
            seen = noise_model.whiten(problem, k, rows)
            if kept is None:
                return seen
            return (seen.T * kept[k]).T

        problem.whiten = whiten
        found = [
            problem.solve(start, tolerance=tolerance, max_iterations=iterations, secant=True)
            for start in starts
        ]
        return min(found, key=lambda one: one.cost)

    def without_each(self, fit: Fit, noise_model: NoiseModel) -> list[Array]:
        """Return the estimates of refits that leave out one fold each, one array of shape (p,) for each fold.

        The noise model is not re-estimated. Per-trial parameters of the held-out fold are not estimated.
        """

        def one(f: int) -> Array:
            problem = self.problem(fit.effects, fit.problem.random_effects, jobs=1)
            noise_model.install(problem)
            kept = [owner != f for owner in self.folds.owner]
            problem.reuse_derivatives(fit.theta, fit.derivatives)
            return self.search(problem, noise_model, [fit.theta], FINE, STEPS, kept=kept).x

        for known, through, found in self._without:
            if known is fit and through is noise_model:
                return found
        found = list(map_in_processes(one, range(self.folds.count), self.jobs))
        self._without.append((fit, noise_model, found))
        return found

    def at(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        theta: Array,
        cost: float = math.nan,
        problem: Mixed | None = None,
    ) -> Fit:
        """Return a fit at the given parameter values, without a search for the optimum."""
        problem = problem or self.posed(effects, noise_model)
        acting = _acting(effects, problem.random_effects)
        return Fit(tuple(effects), acting, problem.labels, theta, cost, problem)

    def posed(self, effects: Sequence[Effect], noise_model: NoiseModel, jobs: int | None = None) -> Mixed:
        """Return the residual problem with the random effects and the weights of a noise model."""
        problem = self.problem(effects, noise_model.random_effects, jobs=jobs)
        noise_model.install(problem)
        return problem

    def start(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        fit: Fit,
        own: Mapping[str, float] | None = None,
    ) -> Array:
        """Return the starting point of a fit with other effects or another noise model.

        A parameter starts at its value in ``own``, otherwise at its estimate in ``fit``, otherwise at its
        null value.
        """
        problem = self.problem(effects, noise_model.random_effects)
        known = dict(zip(fit.labels, fit.theta, strict=True))
        own = own or {}
        return np.array(
            [
                own.get(label, own.get(label.split("[")[0], known.get(label, start)))
                for label, start in zip(problem.labels, problem.start, strict=True)
            ]
        )

    def changes(self, base: Fit, effect: Effect, points: Sequence[Array]) -> list[list[Array]]:
        """Return the changes of the simulated samples by an effect for several parameter values.

        The result has one list for each item of ``points``, with one array for each trial, shape (n_k,). All
        changes are divided by the noise standard deviation.

        Parameters
        ----------
        base : Fit
            Fit that gives the values of the other parameters. The model includes the effects of this fit.
        points : sequence of ndarray
            Values of all parameters of the effect.
        """
        model = self.affected((*base.acting, effect))
        own = [base.problem.vector(base.theta, k) for k in range(len(self.trials))]
        runs = [
            (np.concatenate((values, point[: len(model.own[-1])])), trial)
            for point in points
            for values, trial in zip(own, self.trials, strict=True)
        ]
        without = self.affected(base.acting).simulate_many(list(zip(own, self.trials, strict=True)))
        simulated = iter(model.simulate_many(runs))
        unaffected = [base.problem.stacked(k, seen) for k, seen in enumerate(without)]
        return [
            [
                (base.problem.stacked(k, next(simulated)) - unaffected[k]) * base.problem.sample_weights(k)
                for k in range(len(self.trials))
            ]
            for _ in points
        ]


def _same(one: Solution, other: Solution, scale: Array) -> bool:
    """Return whether two searches ended with equal effect parameters and equal cost."""
    near = np.all(np.abs(one.x - other.x) <= ALIKE * scale)
    return bool(near and abs(one.cost - other.cost) <= ALIKE * other.cost)


def held_at(parameters: Sequence[Parameter], known: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters, with those in ``known`` fixed at the values given there."""
    found = list(parameters)
    for i, p in enumerate(parameters):
        if p.name in known:
            found[i] = replace(p, free=False, start=known[p.name])
    return tuple(found)


def _acting(effects: Sequence[Effect], random_effects: Sequence[RandomEffect]) -> tuple[Effect, ...]:
    """Return all effects that act on the model: random effects, then the effects of the hypothesis."""
    return (*(kind.acting for kind in random_effects if kind.acting is not None), *effects)


def beyond(columns: Array, values: Array) -> Array:
    """Return the residuals of a linear least-squares fit of ``values`` by ``columns``, shape (n,)."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-10)[0])


def covariance(fit: Fit, noise_model: NoiseModel, precision: Array) -> Array:
    """Return the posterior covariance matrix of the parameters of a fit, shape (p, p).

    Parameters
    ----------
    precision : ndarray, shape (p, p)
        Prior precision matrix of the parameters.
    """
    normal = precision.copy()
    for k, rows in enumerate(fit.derivatives):
        seen, own = noise_model.whiten(fit.problem, k, rows), fit.problem.taken[k]
        normal[np.ix_(own, own)] += seen.T @ seen
    return inverted(normal)


def inverted(normal: Array) -> Array:
    """Return the inverse of a normal matrix, without the directions that nothing determines."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = scale[:, None] * normal * scale
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale)
