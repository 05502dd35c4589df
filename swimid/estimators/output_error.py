"""Output-error identification: maximum likelihood over all samples of all trials.

The simulated channels are compared with the measured ones; what is left over is weighted by
a noise model estimated from the residuals themselves, and the uncertainty of the estimates
accounts for coloured residuals and for trials that scatter more than their noise.

Works for every :class:`swimid.models.base.Model`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from threadpoolctl import threadpool_limits

from swimid.errors import NoTrustworthyResult
from swimid.estimators import noise as noise_model
from swimid.estimators import sandwich
from swimid.estimators.fit_result import FitResult, Noise, Series
from swimid.estimators.problem import LITTLE, Problem
from swimid.models.base import Array, Model, Parameter, Trial
from swimid.notices import warn
from swimid.progress import Progress, show, silent

#: A standard error above this share of a parameter's size makes it unidentifiable.
UNIDENTIFIABLE = 0.5
#: Rounds of weighting by the noise model, at most, and the change of weights that ends them.
ROUNDS = 12
SETTLED = 0.01
#: Relative tolerance of the cost while the weights still change, and at the end.
COARSE, FINE = 1e-3, 1e-10
#: An estimate at its bound that would lie beyond it by at most this many standard errors may
#: be there by noise alone.
BY_NOISE = 2.0
#: Derivatives of more numbers than this (samples times unknowns) are taken forward only.
CENTRAL_NUMBERS = 50_000
#: The integration step is halved until halving it changes no sample by more than this many
#: standard deviations of its noise, at most so many times.
STEP_ERROR = 0.1
MAX_REFINEMENTS = 6

Loss = Literal["linear", "huber"]


def fit(
    model: Model,
    trials: Sequence[Trial],
    *,
    parameters: Sequence[Parameter] | None = None,
    progress: Progress = silent,
    jobs: int | None = None,
    loss: Loss = "linear",
    begin: Array | None = None,
) -> FitResult:
    """Estimate the free parameters of a model from all fit trials at once.

    Parameters
    ----------
    model : Model
    trials : sequence of Trial
        Those of role ``validate`` are simulated and scored, not fitted.
    parameters : sequence of Parameter, optional
        The model's with the user's choices applied
        (:func:`swimid.models.base.chosen`); default the model's own.
    jobs : int, optional
        Threads for simulations that take long, by default one per processor. The result does
        not depend on it. ``model.simulate`` must then be safe to call from several at once.
    loss : {"linear", "huber"}
        Huber's loss keeps outliers from pulling the estimate; the size of the noise is then
        the median absolute deviation.
    begin : ndarray, shape (p,), optional
        Where the search starts, one number per label of the result; default the parameters'
        start values.

    Returns
    -------
    FitResult
        Ctrl-C during the search stops it: the result is then the best point so far, not
        converged. A second Ctrl-C raises KeyboardInterrupt.

    Raises
    ------
    NoTrustworthyResult
        When the search does not converge, or there are fewer samples than unknowns.

    Notes
    -----
    Weighted nonlinear least squares by a bounded Levenberg-Marquardt method, reweighted by the
    estimated noise until the weights settle. Covariance ``H^-1 M H^-1`` with ``H = J'J``
    and ``M = sum_trials J_k' R J_k``, R the correlation of the weighted residuals under an
    autoregression chosen by BIC; multiplied by the trials' scatter where they disagree. A
    parameter that its bound may hold by noise alone counts as free in it.
    """
    parameters = tuple(parameters or model.parameters)
    for _ in range(MAX_REFINEMENTS):
        # the matrices here are small: BLAS threads would only take the cores from the simulations
        with threadpool_limits(limits=1, user_api="blas"):
            result = _fit_once(model, trials, parameters, progress, jobs or os.cpu_count() or 1, loss, begin)
        finer = model.refined()
        if finer is None or result.interrupted:
            return result
        result = replace(result, step_error=_step_error(result, finer))
        if result.step_error <= STEP_ERROR:
            return result
        model, begin = finer, result.estimate
    return result


def at(
    model: Model,
    trials: Sequence[Trial],
    point: Array,
    *,
    parameters: Sequence[Parameter] | None = None,
    jobs: int | None = None,
) -> FitResult:
    """What :func:`fit` would say of a point if its search ended there.

    The covariance is that of the model made linear at the point; the misfit there counts as noise.

    Parameters
    ----------
    point : ndarray, shape (p,)
        One number per label of the result.

    Raises
    ------
    NoTrustworthyResult
        When the model cannot be simulated there, or there are fewer samples than unknowns.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        result = _fit_once(
            model,
            trials,
            tuple(parameters or model.parameters),
            silent,
            jobs or os.cpu_count() or 1,
            "linear",
            point,
            search=False,
        )
    finer = model.refined()
    return result if finer is None else replace(result, step_error=_step_error(result, finer))


def _step_error(result: FitResult, finer: Model) -> float:
    trials = {t.id: t for t in result.trials}
    worst = 0.0
    for name, trial in trials.items():
        fine = finer.simulate(result.values(name), trial)
        for s in result.series:
            if s.trial == name:
                change = np.abs(fine[s.channel] - s.simulated) / s.sd
                worst = max(worst, float(np.max(change[np.isfinite(change)], initial=0.0)))
    return worst


def _fit_once(
    model: Model,
    trials: Sequence[Trial],
    parameters: tuple[Parameter, ...],
    progress: Progress,
    jobs: int,
    loss: Loss,
    begin: Array | None,
    *,
    search: bool = True,
) -> FitResult:
    fitted = [t for t in trials if t.role == "fit"]
    if not fitted:
        raise NoTrustworthyResult("no trial has the role 'fit'")
    problem = Problem(model, parameters, fitted, jobs=jobs)
    start = problem.start if begin is None else np.clip(begin, problem.lower, problem.upper)
    samples = sum(int(mask.sum()) for masks in problem.masks for mask in masks)
    if samples <= len(start):
        raise NoTrustworthyResult(
            f"{samples} samples cannot determine {len(start)} unknowns",
            hint="give longer logs or more trials, or fix some parameters",
        )
    try:
        path = _Search(problem, start, loss)
        if search:
            path.run(progress)
        else:
            path.stay()
        _insist(problem, path)
        if path.crept:
            warn(
                "SWM026",
                f"the search crept along a flat valley and was ended after {path.iterations} iterations: "
                f"ten of them together lowered the squared residuals by less than {LITTLE:.0e} of their sum",
            )
        noise = noise_model.estimate(problem, path.theta, path.noise, robust=loss == "huber")
        return _result(problem, path, noise, parameters, tuple(trials), loss)
    finally:
        problem.close()


@dataclass
class _Search:
    """The search for the minimum, reweighted by the noise until the weights settle."""

    problem: Problem
    theta: Array
    loss: Loss
    converged: bool = False
    interrupted: bool = False
    crept: bool = False
    message: str = ""
    iterations: int = 0

    def __post_init__(self) -> None:
        self.noise: dict[str, tuple[float, float]] = {}

    def run(self, progress: Progress) -> None:
        """Search until done or interrupted once there is a point to keep."""
        even = self._even()
        rounds = 1 if even else ROUNDS
        noise_model.weigh_first(self.problem, even)
        try:
            with progress("fitting", total=rounds) as step:
                for round_ in range(rounds):
                    settled = round_ == rounds - 1 or (round_ > 0 and self._reweigh() < SETTLED)
                    self._solve(FINE if settled else COARSE, lambda text: show(step, text))
                    step()
                    if settled:
                        break
        except KeyboardInterrupt:
            if not self.message:
                raise
            self.interrupted, self.converged = True, False
            self.message = f"interrupted after {self.iterations} iterations"

    def stay(self) -> None:
        """Take the point as the end, and settle the weights there."""
        even = self._even()
        noise_model.weigh_first(self.problem, even)
        for _ in range(0 if even else ROUNDS):
            if self._reweigh() < SETTLED:
                break
        self.converged, self.message = True, "no search: the point was given"

    def _even(self) -> bool:
        """Whether all samples weigh the same and go on doing so: one round is then enough."""
        fitted = self.problem.trials
        return (
            self.loss == "linear"
            and len({c for names in self.problem.channels for c in names}) == 1
            and not any(t.stamps_uncertain or t.time_sd_s or t.value_sd for t in fitted)
        )

    def _reweigh(self) -> float:
        """Estimate the noise anew; the largest relative change of a weight."""
        _insist_unbroken(self.problem, self.theta)
        before = noise_model.weights(self.problem)
        self.noise = noise_model.estimate(self.problem, self.theta, self.noise, robust=self.loss == "huber")
        return noise_model.far_apart(self.problem, before)

    def _solve(self, tolerance: float, tell: Callable[[str], None]) -> None:
        done = self.iterations

        def watch(x: Array, cost: float, iteration: int) -> None:
            self.theta, self.iterations, self.message = x, done + iteration, "searching"
            tell(f"iteration {self.iterations}, cost {cost:.5g}")

        solution = self.problem.solve(self.theta, tolerance=tolerance, watch=watch)
        self.theta, self.iterations = solution.x, done + solution.iterations
        self.converged, self.message, self.crept = solution.success, solution.message, solution.crept


def _insist(problem: Problem, search: _Search) -> None:
    """Raise where there is nothing to go on from."""
    if not (search.converged or search.interrupted) or not np.isfinite(search.theta).all():
        raise NoTrustworthyResult(
            f"the fit did not converge: {search.message}",
            hint="check units and trial settings, or hold a parameter with --fix",
        )
    _insist_unbroken(problem, search.theta)


def _insist_unbroken(problem: Problem, theta: Array) -> None:
    broken = problem.broken(theta)
    if broken:
        raise NoTrustworthyResult(
            f"the simulation breaks down at the best point found, in {', '.join(broken)}",
            hint="check units and trial settings, or start from other values",
        )


def _result(
    problem: Problem,
    search: _Search,
    noise: dict[str, tuple[float, float]],
    parameters: tuple[Parameter, ...],
    trials: tuple[Trial, ...],
    loss: Loss,
) -> FitResult:
    theta = search.theta
    raw = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    samples = sum(len(r) for r in raw)
    jacobians = problem.trial_jacobians(theta, central=samples * len(theta) <= CENTRAL_NUMBERS)
    residuals, factors = noise_model.influence(problem, raw)
    rows = [f[:, None] * j * problem.scale for f, j in zip(factors, jacobians, strict=True)]
    autoregressions = noise_model.autoregressions(problem, residuals)
    margin = 1e-6 * np.maximum(problem.scale, np.abs(theta))
    outward = np.where(theta - problem.lower < margin, -1.0, 0.0)
    outward[problem.upper - theta < margin] = 1.0
    free, found = _by_noise(problem, rows, residuals, autoregressions, outward)
    covariance = np.full((len(theta), len(theta)), np.nan)
    root = np.full((int(free.sum()), len(theta)), np.nan)
    null = np.zeros(len(theta), dtype=bool)
    if found is not None:
        scale = problem.scale[free]
        # Student's t for few samples: the standard error is that whose 1.96-fold covers 95 %
        few = float(stats.t.ppf(0.975, max(samples - int(free.sum()), 1)) / stats.norm.ppf(0.975))
        covariance[np.ix_(free, free)] = few**2 * found.covariance * np.outer(scale, scale)
        root[:, free] = found.root / few / scale
        null[free] = found.null
    status = {}
    for j, label in enumerate(problem.labels):
        variance = covariance[j, j]
        limit = UNIDENTIFIABLE * max(abs(theta[j]), problem.scale[j])
        known = not null[j] and math.isfinite(variance) and math.sqrt(max(variance, 0.0)) <= limit
        if outward[j] and (known or not free[j]):
            status[label] = "at-bound"
        else:
            status[label] = "estimated" if known else "unidentifiable"
    held = np.array([status[label] == "at-bound" for label in problem.labels], dtype=bool)
    covariance[held] = covariance[:, held] = np.nan
    result = FitResult(
        model=problem.model,
        parameters=parameters,
        trials=trials,
        labels=problem.labels,
        estimate=theta,
        covariance=covariance,
        status=status,
        series=[],
        noise={
            c: Noise(noise_model.value_sd(problem, c, v), t, autoregressions[c])
            for c, (v, t) in noise.items()
        },
        scatter=1.0 if found is None else found.scatter,
        scatter_p=1.0 if found is None else found.scatter_p,
        samples=samples,
        converged=search.converged,
        message=search.message,
        evaluations=problem.evaluations,
        interrupted=search.interrupted,
        cost=_cost(problem, raw),
        information_root=root,
        loss=loss,
        jacobians=problem.jacobians,
    )
    return replace(result, series=_series(problem, result, trials))


def _by_noise(
    problem: Problem,
    rows: list[Array],
    residuals: list[Array],
    autoregressions: dict[str, Array],
    outward: Array,
) -> tuple[NDArray[np.bool_], sandwich.Sandwich | None]:
    """The parameters to take as free, and their covariance.

    Those whose minimum without bounds lies well beyond the bound they are at are held by it.
    The others at a bound may be there by noise alone: leaving them out would make what they
    are confounded with look well known.
    """
    free = np.ones(len(outward), dtype=bool)
    while free.any():
        found = sandwich.sandwich(problem, [r[:, free] for r in rows], residuals, autoregressions)
        sd = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
        beyond = np.where(np.isfinite(sd) & (outward[free] != 0), outward[free] * found.step / sd, 0.0)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= BY_NOISE:
            return free, found
        free[np.flatnonzero(free)[worst]] = False
    return free, None


def _cost(problem: Problem, residuals: list[Array]) -> float:
    """See :attr:`FitResult.cost`; ``residuals`` as weighted by the final noise model."""
    total, count = 0.0, 0
    for k, values in enumerate(residuals):
        sds, dampings = (
            np.concatenate([v[mask] for v, mask in zip(parts[k], problem.masks[k], strict=True)])
            if parts[k]
            else np.empty(0)
            for parts in (problem.sd, problem.damping)
        )
        # under Huber's loss a far residual costs 2 c |r| - c^2; linear losses have no damping
        far = dampings < 1
        squares = np.where(far, 2 * values**2 - noise_model.CORNER**2, values**2)
        total += float(np.sum(2 * np.log(sds) + squares))
        count += len(values)
    return float(np.exp(min(total / max(count, 1) - 1.0, 700.0)))


def _series(problem: Problem, result: FitResult, trials: tuple[Trial, ...]) -> list[Series]:
    by_id = {t.id: k for k, t in enumerate(problem.trials)}
    known = problem.simulations(result.estimate)
    series = []
    for trial in trials:
        simulated = (
            known[by_id[trial.id]]
            if trial.id in by_id
            else problem.model.simulate(result.values(trial.id), trial)
        )
        for channel in (c.name for c in problem.model.channels if c.name in trial.measured):
            if trial.id in by_id and channel in problem.channels[by_id[trial.id]]:
                k = by_id[trial.id]
                sd = problem.sd[k][problem.channels[k].index(channel)]
            else:
                sd = np.full(
                    len(trial.time_s), result.noise[channel].value_sd if channel in result.noise else np.nan
                )
            series.append(
                Series(
                    trial.id,
                    trial.role,
                    channel,
                    trial.time_s,
                    trial.measured[channel],
                    simulated[channel],
                    sd,
                )
            )
    return series
