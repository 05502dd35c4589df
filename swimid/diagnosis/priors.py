"""Unknowns of a hypothesis and their priors: coefficients, effects, initial states and random effects."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swimid.diagnosis.noise import NoiseModel
from swimid.diagnosis.nominal import OWN_PRIOR, PREFIX
from swimid.diagnosis.settings import Folds
from swimid.fitting.model import Array, Model, Parameter
from swimid.fitting.problem import Problem

if TYPE_CHECKING:
    from swimid.diagnosis.study import Hypothesis

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


class StudyPriors:
    """Unknowns and priors of all hypotheses of a study.

    Attributes
    ----------
    model : Model
        The model without effects.
    parameters : tuple of Parameter
        Its parameters.
    prior : dict of name to (mean, sd)
        Normal priors of shared coefficients.
    correlation : tuple of sequence of str and ndarray, shape (m, m)
        Names of coefficients, and the correlation matrix of their priors. The priors of all other
        coefficients are independent.
    noise : NoiseModel
        It has the random effects.
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

        The prior precision matrix is ``root.T @ root``. It has a row for each parameter with a prior, and for
        each random effect whose mean over the trials is held at 0.

        Parameters
        ----------
        left_out : collection of int, optional
            Indices of trials that are not fitted. They do not belong to the mean.
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
        there may end in a poor local optimum. A second starting point has the start values of the initial
        states beside the prior means, because the initial states may be distorted as well.
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
