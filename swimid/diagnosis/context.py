"""A model on its trials, fitted through a noise_model: the workbench of every step of a diagnosis."""

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

#: Prior standard deviation of an effect's parameters, in their typical sizes.
EFFECT_PRIOR = 5.0
#: The same of the start state of a trial, about where its first samples put it.
START_PRIOR = 30.0
#: Relative tolerance of a fit.
TOLERANCE = 1e-5
#: Of many starts the better half goes on after each step with lent derivatives, the last for so many steps;
#: so many of them go as far with their own, and the best to the end, in so many at most. The tolerances
#: meanwhile and there.
HEAT, FINALISTS, STEPS, ROUGH, FINE = 4, 2, 80, 1e-3, 1e-4
#: Two starts this near, in typical sizes of an effect and relatively in cost, are one.
ALIKE = 0.1
#: A coefficient this many prior standard deviations from what was known of it is distorted.
DISTORTED = 2.0
#: A prior as wide as this share of a coefficient says little.
LOOSE = 0.3
#: Derivatives are taken anew once the numbers have moved by this many standard errors.
NEAR = 0.3


#: Names of coefficients and the correlation of what is known of them.
Correlation = tuple[Sequence[str], Array]
NO_CORRELATION: Correlation = ((), np.empty((0, 0)))
#: Added to the diagonal of a correlation, which files hold to a few digits.
ROUNDING = 1e-6


class Mixed(Problem):
    """Residuals of a model on trials with random effects.

    Parameters
    ----------
    random_effects : sequence of RandomEffect
        What differs: a number of each trial.
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
        """Whether an estimated number is a random effect of a trial."""
        return self.slots[j][0] in self._differ

    def begun(self, trial: int) -> list[int]:
        """Places of a trial's start state."""
        return [j for j in self.own(trial) if not self.differs(j)]

    def differing(self, trial: int) -> list[int]:
        """Places of a random effect of a trial."""
        return [j for j in self.own(trial) if self.differs(j)]


class Optimum(NamedTuple):
    """What a search for an optimum ends with: a :class:`Fit` without its problem.

    Attributes
    ----------
    theta : ndarray, shape (p,)
    cost : float
    residuals, rows : list of ndarray
        As of a :class:`Fit`.
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
        Chosen ones.
    acting : tuple of Effect
        Those before, after what differs from trial to trial.
    labels : list of str
    theta : ndarray, shape (p,)
    cost : float
        Squared whitened residuals, prior included.
    residuals : list of ndarray
        Of each trial, weighted (not yet whitened), shape (n_k,).
    rows : list of ndarray
        Derivatives of the simulated samples, weighted, shape (n_k, p): residuals fall by them.
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
        """Its numbers alone."""
        return Optimum(self.theta, self.cost, self.residuals, self.rows)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which numbers are not at a bound, shape (p,)."""
        return np.asarray((self.theta > self.problem.lower) & (self.theta < self.problem.upper))

    def free_of_trial(self, k: int) -> NDArray[np.intp]:
        """Places of what trial ``k`` has for itself and is not at the end of its range."""
        inside = self.inside
        return np.array([j for j in self.problem.own(k) if inside[j]], dtype=int)

    def own(self, k: int) -> Array:
        """Derivatives to the start state of trial ``k``, per typical size, shape (n_k, m)."""
        mine = self.problem.begun(k)
        return np.asarray(self.rows[k][:, mine] * self.scale[mine])

    def centre(self, without: Collection[str] = ()) -> dict[str, float]:
        """Random effects as they are on average, by the name of its number.

        Parameters
        ----------
        without : collection of str
            Effects with which it shares a number and that are none here: then it is none, too.
        """
        null = {p.name: p.start for p in self.problem.parameters}
        apart = {kind.label for kind in self.problem.random_effects if kind.name.replace("_", "-") in without}
        return {
            name: null[name] if name in apart else float(np.mean(values))
            for name, values in self._differing().items()
        }

    def scatter(self) -> dict[str, float]:
        """How far trials are from one another in what differs by chance, by the name of its number.

        Standard deviation over trials, in its unit. What all trials share is no chance but an effect.
        """
        return {
            name: float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            for name, values in self._differing().items()
        }

    def _differing(self) -> dict[str, list[float]]:
        """Random effects of each trial, by the name of its number."""
        values: dict[str, list[float]] = {}
        for j, (index, _) in enumerate(self.problem.slots):
            if self.problem.differs(j):
                values.setdefault(self.problem.parameters[index].name, []).append(float(self.theta[j]))
        return values

    def fixed_effects_residual(self, k: int, without: Collection[str] = ()) -> Array:
        """Residuals of trial ``k`` were it like the average trial, to first order, shape (n_k,).

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
        """Residuals of each trial with its random effects unknown, its start state refitted.

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
        """An estimate by its label."""
        return float(self.theta[self.labels.index(label)])


class FitContext:
    """A nominal model, its trials and what is known of its coefficients beforehand.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Of the model; the free ones are refitted in every step.
    trials : sequence of Trial
        Those that take part in fits.
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
        """Return the same context of another model and other trials."""
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
        """The model with effects."""
        # their scales are read off the trials: once will do
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
        """Residuals of the model with effects, on trials that differ by random_effects, coefficients as here.

        Parameters
        ----------
        trials : sequence of Trial, optional
            Others than those of the context.
        known : mapping of label to float, optional
            Shared numbers that are not to be estimated.
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
        """Numbers that are a trial's own business in a comparison of folds, shape (p,).

        Start states always; what an effect has for each trial only where whole trials are held out.
        """
        return np.array(
            [
                owner is not None and (self.folds.whole or "/" not in problem.parameters[index].name)
                for index, owner in problem.slots
            ],
            dtype=bool,
        )

    def shared(self, fit: Fit) -> NDArray[np.intp]:
        """Places of the numbers that folds share, without those at their bounds: these stay there."""
        return np.flatnonzero(~self.single(fit.problem) & fit.inside)

    def apart(self, fit: Fit, k: int) -> NDArray[np.intp]:
        """Places of what is trial ``k``'s own business in a comparison of folds, without those at bounds."""
        single = self.single(fit.problem)
        return np.array([j for j in fit.free_of_trial(k) if single[j]], dtype=int)

    def loosened(self, problem: Problem) -> dict[str, tuple[float, float]]:
        """Coefficients of which less is known once the robot is read otherwise, as :attr:`prior`: what other
        trials told of them they told of the nominal robot.
        """
        if getattr(problem.model, "model", self.model) is self.model:
            return {}
        own = {p.name: OWN_PRIOR * max(abs(p.start), 0.1 * p.scale) for p in self.parameters}
        return {name: (mean, own[name]) for name, (mean, sd) in self.prior.items() if 0 < sd < own[name]}

    def expected(self, problem: Mixed) -> tuple[Array, Array]:
        """Prior mean and inverse standard deviation of each number; 0 where there is none."""
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
        """Numbers to fit from: given ones and, where their coefficients are far from what is known of them,
        the known ones with all else as it is.

        A model distorted by what it lacks may hold an effect in a poor local optimum.
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
                # the trials themselves told the prior: what lacks has distorted it, too
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
        """The best optimum from several starts.

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
        warm : Fit, optional
            Take the derivatives to the numbers of this fit from it: an optimum nearby costs a fifth.
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
        """The best optimum from many starts: all begin with the derivatives of a fit nearby, and after each
        step the better half goes on (successive halving [1]_).

        Parameters
        ----------
        starts : sequence of ndarray, shape (p,)
        warm : Fit
            Whose derivatives are lent.
        finalists : int
            How many go on with derivatives of their own.

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

        # of coefficients, which any step sets anew, nothing is asked
        own = np.where(["/" in label for label in problem.labels], problem.scale, np.inf)

        def ranked(starts: Sequence[Array], tolerance: float, steps: int) -> list[Solution]:
            found: list[Solution] = []
            for ended in sorted((one(s, tolerance, steps) for s in starts), key=cost):
                # what has come to the same point goes on once
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
        """The best optimum of a problem from several starts.

        Parameters
        ----------
        kept : sequence of ndarray of bool, shape (n_k,), optional
            Samples that take part; default all.
        prior : tuple of ndarray, shapes (p,) and (m, p), optional
            What is known of the numbers: their mean, and a root of their precision; default that of a fit.
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
        """Numbers of a fit refitted without each fold, from the fit to all on; shape (p,) each.

        The noise model stays that of all trials. Of what a fold has for itself nothing is asked.
        """

        def one(f: int) -> Array:
            problem = self.problem(fit.effects, fit.problem.random_effects, jobs=1)
            noise_model.install(problem)
            kept = [owner != f for owner in self.folds.owner]
            # first with the derivatives of the fit to all, as far as they lead
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
        """The state of a fit at given numbers, nothing searched."""
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
        """The fit that ended with some numbers."""
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
        """Numbers for a fit with other effects or noise: those of an earlier fit, and given or null ones."""
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
        """What an effect at some strengths changes in each trial, weighted, shape (n_k,), for each of them.

        Parameters
        ----------
        base : Fit
            Where its other numbers stand; its effects stay.
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
        """What a step of one of the model's own parameters changes in each trial, weighted, shape (n_k,)."""
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
    """Whether two searches are on their way to one point: in what effects have, and in cost."""
    near = np.all(np.abs(one.x - other.x) <= ALIKE * scale)
    return bool(near and abs(one.cost - other.cost) <= ALIKE * other.cost)


def _acting(effects: Sequence[Effect], random_effects: Sequence[RandomEffect]) -> tuple[Effect, ...]:
    """Everything that acts on the model: what differs by random_effects, then effects."""
    return (*(kind.acting for kind in random_effects if kind.acting is not None), *effects)


def beyond(columns: Array, values: Array) -> Array:
    """What least squares on some columns leaves of some values, shape (n,)."""
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
