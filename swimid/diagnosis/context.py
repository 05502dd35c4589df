"""Fit hypotheses: a model with effects and random effects on its trials, through a noise model."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.diagnosis.folds import Folds, folds, stretches
from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.nominal import OWN_PRIOR
from swimid.diagnosis.random_effects import RandomEffect
from swimid.effects.base import Affected, Effect
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.parallel import map_in_processes
from swimid.fitting.problem import Problem, Solution

#: Prior standard deviation of an effect's parameters, in typical sizes.
EFFECT_PRIOR = 5.0
#: Prior standard deviation of the start state of a trial about its first samples, in typical sizes.
START_PRIOR = 30.0
#: Relative tolerance of the cost.
TOLERANCE = 1e-5
#: Multistart search: number of steps with borrowed derivatives between halvings, number of finalists that use
#: their own derivatives, maximum number of steps of the best one, and the relative tolerances meanwhile and
#: at the end.
HEAT, FINALISTS, STEPS, ROUGH, FINE = 4, 2, 80, 1e-3, 1e-4
#: Distance, in typical sizes and in relative cost, below which two starts are the same.
ALIKE = 0.1
#: Number of prior standard deviations from which a coefficient counts as distorted.
DISTORTED = 2.0
#: A prior as wide as this share of a coefficient says little.
LOOSE = 0.3
#: Number of standard errors by which parameters must move before derivatives are recomputed.
NEAR = 0.3


#: Names of coefficients and the correlation of their priors.
Correlation = tuple[Sequence[str], Array]
NO_CORRELATION: Correlation = ((), np.empty((0, 0)))
#: Added to the diagonal of a correlation, which files state to a few digits.
ROUNDING = 1e-6


class Mixed(Problem):
    """Residuals of a model on trials with random effects.

    Parameters
    ----------
    random_effects : sequence of RandomEffect
        Each has a value for each trial.
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
        parameters = [
            known[p.name].number(p) if p.name in known and known[p.name].effect is None else p
            for p in parameters
        ]
        super().__init__(model, parameters, trials, jobs=jobs)
        self.random_effects = tuple(random_effects)
        self._differ = {i for i, p in enumerate(self.parameters) if p.name in known}

    def differs(self, j: int) -> bool:
        """Return whether a parameter is a random effect of a trial."""
        return self.slots[j][0] in self._differ

    def begun(self, trial: int) -> list[int]:
        """Return the indices of a trial's start state."""
        return [j for j in self.own(trial) if not self.differs(j)]

    def differing(self, trial: int) -> list[int]:
        """Return the indices of a trial's random effects."""
        return [j for j in self.own(trial) if self.differs(j)]


class Optimum(NamedTuple):
    """End of a search: a :class:`Fit` without its problem.

    Attributes
    ----------
    theta : ndarray, shape (p,)
    cost : float
    residuals, rows : list of ndarray
        As in :class:`Fit`.
    """

    theta: Array
    cost: float
    residuals: list[Array]
    rows: list[Array]


@dataclass(frozen=True)
class Fit:
    """An optimum.

    Attributes
    ----------
    effects : tuple of Effect
        Effects of the hypothesis.
    acting : tuple of Effect
        Random effects, then effects of the hypothesis.
    labels : list of str
    theta : ndarray, shape (p,)
    cost : float
        Squared whitened residuals, prior included.
    residuals : list of ndarray
        Of each trial, weighted (not yet whitened), shape (n_k,).
    rows : list of ndarray
        Derivatives of the simulated samples, weighted, shape (n_k, p); the derivatives of the residuals are
        their negative.
    lower, upper, scale : ndarray, shape (p,)
    """

    effects: tuple[Effect, ...]
    acting: tuple[Effect, ...]
    labels: list[str]
    theta: Array
    cost: float
    residuals: list[Array]
    rows: list[Array]
    scale: Array
    problem: Mixed

    @property
    def optimum(self) -> Optimum:
        """Return its values without its problem."""
        return Optimum(self.theta, self.cost, self.residuals, self.rows)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Return which parameters are not at a bound, shape (p,)."""
        return np.asarray((self.theta > self.problem.lower) & (self.theta < self.problem.upper))

    def free_of_trial(self, k: int) -> NDArray[np.intp]:
        """Return the indices of the parameters of trial ``k`` that are not at a bound."""
        inside = self.inside
        return np.array([j for j in self.problem.own(k) if inside[j]], dtype=int)

    def own(self, k: int) -> Array:
        """Return the derivatives with respect to the start state of trial ``k``, per typical size, shape
        (n_k, m).
        """
        mine = self.problem.begun(k)
        return np.asarray(self.rows[k][:, mine] * self.scale[mine])

    def centre(self, without: Collection[str] = ()) -> dict[str, float]:
        """Return the mean of each random effect over trials, by parameter name.

        Parameters
        ----------
        without : collection of str
            Effects whose parameter a random effect shares and that do not act here: the random effect is left
            out as well.
        """
        null = {p.name: p.start for p in self.problem.parameters}
        apart = {kind.label for kind in self.problem.random_effects if kind.name.replace("_", "-") in without}
        return {
            name: null[name] if name in apart else float(np.mean(values))
            for name, values in self._differing().items()
        }

    def scatter(self) -> dict[str, float]:
        """Return the standard deviation over trials of each random effect, by parameter name, in its unit.

        A value that all trials share is an effect, not chance.
        """
        return {
            name: float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            for name, values in self._differing().items()
        }

    def _differing(self) -> dict[str, list[float]]:
        """Return the random effects of each trial, by parameter name."""
        values: dict[str, list[float]] = {}
        for j, (index, _) in enumerate(self.problem.slots):
            if self.problem.differs(j):
                values.setdefault(self.problem.parameters[index].name, []).append(float(self.theta[j]))
        return values

    def fixed_effects_residual(self, k: int, without: Collection[str] = ()) -> Array:
        """Return the residuals of trial ``k`` with its random effects at their mean, to first order, shape
        (n_k,).

        Parameters
        ----------
        without : collection of str
            As in :meth:`centre`.
        """
        mine = self.problem.differing(k)
        centre = self.centre(without)
        names = [self.problem.parameters[self.problem.slots[j][0]].name for j in mine]
        away = np.array([self.theta[j] - centre[name] for j, name in zip(mine, names, strict=True)])
        return np.asarray(self.residuals[k] + self.rows[k][:, mine] @ away)

    def marginal_residuals(self, without: Collection[str] = ()) -> list[Array]:
        """Return the residuals of each trial with its random effects unknown and its start state refitted.

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
        """Return an estimate by its label."""
        return float(self.theta[self.labels.index(label)])


class FitContext:
    """A model, its trials, and the prior of its coefficients.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Of the model; the free ones are refitted in every fit.
    trials : sequence of Trial
        Trials that take part in fits.
    prior : mapping of name to (mean, sd)
        Of shared coefficients.
    correlation : tuple of sequence of str and ndarray, shape (m, m), optional
        Names of coefficients, and the correlation of their priors; others are independent.
    jobs : int
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
        plain = self.problem(())
        self.shape = plain
        self.folds = self._folds(plain)

    def replaced(self, model: Model, trials: Sequence[Trial]) -> FitContext:
        """Return the same context with another model and other trials."""
        more = {"correlation": self.correlation, "jobs": self.jobs}
        return FitContext(model, self.parameters, trials, self.prior, **more)  # type: ignore[arg-type]

    def _folds(self, problem: Problem) -> Folds:
        rows = [sum(int(m.sum()) for m in masks) for masks in problem.masks]
        found = folds(self.trials, rows)
        if found.whole:
            return found
        owner = [
            stretches(found, k, [t.time_s[m] for m in masks])
            for k, (t, masks) in enumerate(zip(self.trials, problem.masks, strict=True))
        ]
        return replace(found, owner=owner)

    def affected(self, effects: Sequence[Effect]) -> Affected:
        """Return the model with effects."""
        # The scales of effects depend on the trials: cache them.
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
            Default: those of the context.
        known : mapping of label to float, optional
            Shared parameters that are held.
        """
        acting = _acting(effects, random_effects)
        model = self.affected(acting)
        own = model.parameters[len(self.parameters) :]
        known = known or {}
        problem = Mixed(
            model,
            [
                replace(p, free=False, start=known[p.name]) if p.name in known else p
                for p in (*self.parameters, *own)
            ],
            self.trials if trials is None else trials,
            random_effects=random_effects,
            jobs=self.jobs if jobs is None else jobs,
        )
        problem.near = NEAR
        return problem

    def single(self, problem: Problem) -> NDArray[np.bool_]:
        """Return the parameters that are refitted in each held-out fold, shape (p,).

        These are the start states, and if whole trials are held out the per-trial values of effects.
        """
        return np.array(
            [
                owner is not None and (self.folds.whole or "/" not in problem.parameters[index].name)
                for index, owner in problem.slots
            ],
            dtype=bool,
        )

    def shared(self, fit: Fit) -> NDArray[np.intp]:
        """Return the indices of the parameters that folds share, without those at bounds."""
        return np.flatnonzero(~self.single(fit.problem) & fit.inside)

    def apart(self, fit: Fit, k: int) -> NDArray[np.intp]:
        """Return the indices of the parameters of trial ``k`` that are refitted in its fold, without those
        at bounds.
        """
        single = self.single(fit.problem)
        return np.array([j for j in fit.free_of_trial(k) if single[j]], dtype=int)

    def loosened(self, problem: Problem) -> dict[str, tuple[float, float]]:
        """Return the priors of coefficients that are less well known under another reading of the robot.

        Other trials determined them for the robot as read in the robot file.
        """
        if getattr(problem.model, "model", self.model) is self.model:
            return {}
        own = {p.name: OWN_PRIOR * max(abs(p.start), 0.1 * p.scale) for p in self.parameters}
        return {name: (mean, own[name]) for name, (mean, sd) in self.prior.items() if 0 < sd < own[name]}

    def expected(self, problem: Mixed) -> tuple[Array, Array]:
        """Return the prior mean and inverse standard deviation of each parameter; 0 without a prior."""
        mean, weight = np.array(problem.start), np.zeros(len(problem.labels))
        known = {**self.prior, **self.loosened(problem)}
        for j, (index, owner) in enumerate(problem.slots):
            p = problem.parameters[index]
            if problem.differs(j):
                mean[j], weight[j] = p.start, 1.0 / p.scale
            elif "/" in p.name:
                mean[j], weight[j] = p.start, 1.0 / (EFFECT_PRIOR * p.scale)
            elif owner is not None:
                weight[j] = 1.0 / (START_PRIOR * p.scale)
            elif owner is None and p.name in known:
                m, sd = known[p.name]
                mean[j], weight[j] = m, 1.0 / sd if sd > 0 else 0.0
        return mean, weight

    def root(self, problem: Mixed) -> Array:
        """Return a root of the prior precision, shape (m, p): m of the p parameters have a prior."""
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
        """Return the prior precision of the parameters, shape (p, p); see :meth:`root`."""
        root = self.root(problem)
        return np.asarray(root.T @ root)

    def begins(self, problem: Mixed, theta: Array) -> list[Array]:
        """Return starting points: the given ones and, if their coefficients are far from the prior, the prior
        means.

        A model that is distorted by a missing effect may hold an effect in a poor local optimum.
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
                # The prior was estimated from these trials, so the missing effect biases it too.
                mean, sd = p.known, LOOSE * max(abs(p.known), p.scale)
            plain[j] = mean
            distorted = distorted or abs(theta[j] - mean) > DISTORTED * sd
        return [theta, plain] if distorted else [theta]

    def fit(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        starts: Sequence[Array],
        *,
        tolerance: float = TOLERANCE,
        iterations: int = 30,
        jobs: int | None = None,
        warm: Fit | None = None,
    ) -> Fit:
        """Return the best optimum from several starts.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
        warm : Fit, optional
            Fit from which derivatives are borrowed; a nearby optimum then costs a fifth.
        """
        problem = self.problem(effects, noise_model.random_effects, jobs=jobs)
        noise_model.install(problem)
        if warm is not None:
            problem.hold_derivatives(warm.labels, warm.rows)
        best = self.search(problem, noise_model, starts, tolerance, iterations)
        return self._at(problem, effects, best.x, best.cost)

    def multistart(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        starts: Sequence[Array],
        *,
        warm: Fit,
        finalists: int = FINALISTS,
        jobs: int = 1,
    ) -> Fit:
        """Return the best optimum from many starts by successive halving [1]_.

        All starts begin with the derivatives of a nearby fit. After each step the better half continues.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
        warm : Fit
            Fit whose derivatives are borrowed.
        finalists : int
            Number of starts that continue with their own derivatives.

        References
        ----------
        .. [1] K. Jamieson, A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
           optimization", AISTATS 2016.
        """
        problem = self.problem(effects, noise_model.random_effects, jobs=jobs)
        noise_model.install(problem)

        def one(start: Array, tolerance: float, steps: int) -> Solution:
            return self.search(problem, noise_model, [start], tolerance, steps)

        def cost(found: Solution) -> float:
            return found.cost if math.isfinite(found.cost) else math.inf

        # Coefficients do not distinguish two starts, because any step changes them.
        own = np.where(["/" in label for label in problem.labels], problem.scale, np.inf)

        def ranked(starts: Sequence[Array], tolerance: float, steps: int) -> list[Solution]:
            found: list[Solution] = []
            for ended in sorted((one(s, tolerance, steps) for s in starts), key=cost):
                # Starts that reached the same point continue once.
                if not any(_same(ended, other, own) for other in found):
                    found.append(ended)
            return found

        if len(starts) > finalists:
            problem.hold_derivatives(warm.labels, warm.rows)
            while len(starts) > finalists:
                steps = 1 if len(starts) > 2 * finalists else HEAT
                left = ranked(starts, ROUGH, steps)[: max(len(starts) // 2, finalists)]
                starts = [found.x for found in left]
            problem.hold_derivatives((), ())
        found = ranked(starts, ROUGH, HEAT)[:1] if len(starts) > 1 else []
        found.append(one(found[0].x if found else starts[0], FINE, STEPS))
        best = min(found, key=cost)
        return self._at(problem, effects, best.x, best.cost)

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
        """Return the best optimum of a problem from several starts.

        Parameters
        ----------
        kept : sequence of ndarray of bool, shape (n_k,), optional
            Samples that take part; default all.
        prior : tuple of ndarray, shapes (p,) and (m, p), optional
            Mean of the parameters, and a root of their precision; default that of a fit.
        """
        problem.prior = prior or (self.expected(problem)[0], self.root(problem))

        def whiten(k: int, rows: Array) -> Array:
            seen = noise_model.whiten(problem, k, rows)
            return seen if kept is None else (seen.T * kept[k]).T

        problem.whiten = whiten
        found = [
            problem.solve(start, tolerance=tolerance, max_iterations=iterations, secant=True)
            for start in starts
        ]
        return min(found, key=lambda one: one.cost)

    def without_each(self, fit: Fit, noise_model: NoiseModel) -> list[Array]:
        """Return the parameters of a fit refitted without each fold, shape (p,) each.

        The noise model stays that of all trials. Per-trial parameters of the held-out fold are not estimated.
        """

        def one(f: int) -> Array:
            problem = self.problem(fit.effects, fit.problem.random_effects, jobs=1)
            noise_model.install(problem)
            kept = [owner != f for owner in self.folds.owner]
            # The derivatives of the fit to all trials are used first, as far as they lead.
            problem.hold_derivatives(fit.labels, fit.rows)
            begun = self.search(problem, noise_model, [fit.theta], ROUGH, STEPS, kept=kept)
            problem.hold_derivatives((), ())
            return self.search(problem, noise_model, [begun.x], FINE, STEPS, kept=kept).x

        for known, through, found in self._without:
            if known is fit and through is noise_model:
                return found
        found = list(map_in_processes(one, range(self.folds.count), self.jobs))
        self._without.append((fit, noise_model, found))
        return found

    def at(self, effects: Sequence[Effect], noise_model: NoiseModel, theta: Array) -> Fit:
        """Return the state of a fit at given parameters, without a search."""
        problem = self.problem(effects, noise_model.random_effects)
        noise_model.install(problem)
        return self._at(problem, effects, theta, math.nan)

    def _at(self, problem: Mixed, effects: Sequence[Effect], theta: Array, cost: float) -> Fit:
        rows = [-r for r in problem.trial_jacobians(theta)]
        residuals = [problem.trial_residuals(theta, k) for k in range(len(self.trials))]
        return self._fit(problem, effects, Optimum(theta, cost, residuals, rows))

    def _fit(self, problem: Mixed, effects: Sequence[Effect], found: Optimum) -> Fit:
        acting = _acting(effects, problem.random_effects)
        theta, cost, residuals, rows = found
        return Fit(
            tuple(effects), acting, problem.labels, theta, cost, residuals, rows, problem.scale, problem
        )

    def fitted(self, effects: Sequence[Effect], noise_model: NoiseModel, found: Optimum) -> Fit:
        """Return the fit that ended with some parameters."""
        problem = self.problem(effects, noise_model.random_effects)
        noise_model.install(problem)
        return self._fit(problem, effects, found)

    def start(
        self,
        effects: Sequence[Effect],
        noise_model: NoiseModel,
        fit: Fit,
        own: Mapping[str, float] | None = None,
    ) -> Array:
        """Return starting parameters for a fit with other effects or noise: those of an earlier fit, given
        or null values.
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
        """Return the changes by an effect at some sizes in each trial, weighted, shape (n_k,), one list for
        each size.

        Parameters
        ----------
        base : Fit
            Fit with the values of the other parameters; its effects stay.
        points : sequence of ndarray
            Values of all the effect's parameters.
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

    def moved(self, base: Fit, index: int, step: float) -> list[Array]:
        """Return the change of each trial by a step of one of the model's own parameters, weighted, shape
        (n_k,).
        """
        runs = []
        for k, trial in enumerate(self.trials):
            own = base.problem.vector(base.theta, k)
            own[index] += step
            runs.append((own, trial))
        plain = base.problem.simulations(base.theta)
        return [
            (base.problem.stacked(k, seen) - base.problem.stacked(k, plain[k]))
            * base.problem.sample_weights(k)
            for k, seen in enumerate(self.affected(base.acting).simulate_many(runs))
        ]


def _same(one: Solution, other: Solution, scale: Array) -> bool:
    """Return whether two searches lead to the same point: equal effect parameters and equal cost."""
    near = np.all(np.abs(one.x - other.x) <= ALIKE * scale)
    return bool(near and abs(one.cost - other.cost) <= ALIKE * other.cost)


def _acting(effects: Sequence[Effect], random_effects: Sequence[RandomEffect]) -> tuple[Effect, ...]:
    """Return everything that acts on the model: random effects, then effects."""
    return (*(kind.acting for kind in random_effects if kind.acting is not None), *effects)


def beyond(columns: Array, values: Array) -> Array:
    """Return the residuals of least squares of some values on some columns, shape (n,)."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    return np.asarray(values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-10)[0])


def covariance(fit: Fit, noise_model: NoiseModel, precision: Array) -> Array:
    """Return the covariance of a fit's parameters, shape (p, p), prior included.

    Parameters
    ----------
    precision : ndarray, shape (p, p)
        Of the prior.
    """
    normal = precision.copy()
    for k, rows in enumerate(fit.rows):
        seen = noise_model.whiten(fit.problem, k, rows)
        normal += seen.T @ seen
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = scale[:, None] * normal * scale
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale)
