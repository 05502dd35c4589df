"""Output-error identification: maximum likelihood over all samples of all trials.

The simulated channels are compared with the measured ones; what is left over is weighted by
a noise model estimated from the residuals themselves, and the uncertainty of the estimates
accounts for coloured residuals and for trials that scatter more than their noise.

Works for every :class:`swimid.fitting.model.Model`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special
from threadpoolctl import threadpool_limits

from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as noise_model
from swimid.fitting import restarts
from swimid.fitting.covariance import UNIDENTIFIABLE, Sandwich, sandwich
from swimid.fitting.metrics import FitResult, Loss, Noise, Series
from swimid.fitting.model import Array, Model, Parameter, Trial
from swimid.fitting.problem import KINKED, LITTLE, STRIDE, Problem, Unnoticed
from swimid.notices import warn
from swimid.progress import Progress, show, silent

#: Rounds of weighting by the noise model, at most, and the change of weights that ends them.
ROUNDS = 12
SETTLED = 0.01
#: Relative tolerance of the cost while the weights still change, and at the end.
COARSE, FINE = 1e-3, 1e-10
#: A move by this share of a standard error is no news: the root of :data:`problem.IMMATERIAL`.
SLIGHT = 0.03
#: Iterations of one search over all its rounds, and where what it came to is wanted unfinished: three times
#: what fits of right models take (6 to 25; 52 where simulations break down at the start).
MAX_ITERATIONS, BUDGET = 200, 75
#: The integration step is halved until halving it changes no sample by more than this many
#: standard deviations of its noise, at most so many times.
STEP_ERROR = 0.1
MAX_REFINEMENTS = 6
#: Relative tolerance of the search for the start state of a trial.
START_TOLERANCE = 1e-8
#: Restarts near an answer, at most, and how much they raise twice the log-likelihood to have been needed: as
#: much as one standard error.
RESTARTS, ANOTHER = 6, 1.0
#: Where the cost has no corners, restarts end with one that raised that by less than this, which a third of a
#: standard error does; and none is begun once they have taken this share of the first search.
TRIFLE, SHARE = 0.1, 1.0


@dataclass(frozen=True)
class _Task:
    """What is fitted, and how."""

    model: Model
    trials: tuple[Trial, ...]
    parameters: tuple[Parameter, ...]
    jobs: int
    loss: Loss = "linear"
    progress: Progress = silent


def fit(
    model: Model,
    trials: Sequence[Trial],
    *,
    parameters: Sequence[Parameter] | None = None,
    progress: Progress = silent,
    jobs: int | None = None,
    loss: Loss = "linear",
    begin: Array | None = None,
    tested: bool = True,
    unfinished: bool = False,
) -> FitResult:
    """Estimate the free parameters of a model from all fit trials at once.

    Parameters
    ----------
    model : Model
    trials : sequence of Trial
        Those of role ``validate`` are simulated and scored, not fitted.
    parameters : sequence of Parameter, optional
        The model's with the user's choices applied
        (:func:`swimid.fitting.model.chosen`); default the model's own.
    jobs : int, optional
        Threads for simulations that take long, by default one per processor. The result does
        not depend on it. ``model.simulate`` must then be safe to call from several at once.
    loss : {"linear", "huber"}
        Huber's loss keeps outliers from pulling the estimate; the size of the noise is then
        the median absolute deviation.
    begin : ndarray, shape (p,), optional
        Where the search starts, one number per label of the result; default the parameters'
        start values.
    tested : bool
        Whether the answer is held against points and short searches around it, and the search begun again
        where one of them lies lower (:mod:`swimid.fitting.restarts`).
    unfinished : bool
        Return what a search came to that does not converge within :data:`BUDGET` iterations, marked so; else
        that is an error.

    Returns
    -------
    FitResult
        Ctrl-C during the search stops it: the result is then the best point so far, not
        converged, and ``message`` says why. A second Ctrl-C raises KeyboardInterrupt.

    Raises
    ------
    NoTrustworthyResult
        When the search does not converge, the model cannot be simulated, or there are fewer samples than
        unknowns.

    Notes
    -----
    Weighted nonlinear least squares by a bounded Levenberg-Marquardt method, reweighted by the
    estimated noise until the weights settle. The search ends where five steps together neither lower
    the squared residuals by more than one parameter takes up of noise alone (:attr:`Sandwich.gain`; half
    a unit of log likelihood where noise is white) nor move a shared estimate by :data:`SLIGHT` of its
    standard error: what a model misses leaves a valley along which smaller steps would go on for ever.
    Covariance ``H^-1 M H^-1`` with ``H = J'J``
    and ``M = sum_trials J_k' R J_k``, R the correlation of the weighted residuals under an
    autoregression chosen by BIC; multiplied by the trials' scatter where they disagree. A
    parameter that its bound may hold by noise alone counts as free in it.
    """
    threads = jobs or os.cpu_count() or 1
    task = _Task(model, tuple(trials), tuple(parameters or model.parameters), threads, loss, progress)
    result = _refined(task, begin, unfinished)
    # what did not converge is no answer yet
    return held_to_restarts(result, jobs=threads) if tested and result.converged else result


def held_to_restarts(result: FitResult, *, jobs: int) -> FitResult:
    """The answer of a fit, or a better one that restarts around it lead to; warns of that.

    With :attr:`FitResult.restarts` and :attr:`FitResult.settled`.
    """
    first, count, settled = result, 0, True
    spent, taken, gain = result.evaluations, result.jacobians, 0.0
    if result.interrupted:
        return result
    try:
        while True:
            if spent > (1.0 + SHARE) * first.evaluations and not restarts.kinked(result):
                settled = gain <= ANOTHER
                break
            with threadpool_limits(limits=1, user_api="blas"):
                near = restarts.held(result, jobs=jobs, seed=count)
            spent, taken = spent + near.evaluations, taken + near.jacobians
            if near.point is None or count == RESTARTS:
                settled = near.point is None
                break
            task = _Task(result.model, result.trials, result.parameters, jobs, result.loss)
            again = _refined(task, near.point, True, near=result)
            spent, taken = spent + again.evaluations, taken + again.jacobians
            gain = _objective(result) - _objective(again)
            if not gain > 0.0:
                break
            result, count, settled = again, count + 1, again.converged
            if not settled or (gain < TRIFLE and not near.rough):
                break
    except KeyboardInterrupt:
        return replace(result, interrupted=True, converged=False, message="interrupted while it was tested")
    result = replace(result, restarts=count, settled=settled)
    if _objective(first) - _objective(result) > ANOTHER:
        warn(
            "SWM073",
            f"the search had stopped short of the best fit: {count} restart{'s' if count > 1 else ''} near "
            f"its answer lowered the mean squared residual by {100 * (1 - result.cost / first.cost):.3g} %"
            + ("" if result.settled else ", and the last still did: the answer may not be the best one"),
        )
    return replace(result, evaluations=spent, jacobians=taken)


def _objective(result: FitResult) -> float:
    """Twice the negative log-likelihood but for a constant, that of random effects included."""
    chance = 0.0
    for p in result.parameters:
        if math.isfinite(p.spread):
            mine = [j for j, label in enumerate(result.labels) if result.parameter(label) is p]
            chance += float(np.sum(((result.estimate[mine] - p.start) / p.spread) ** 2))
    return result.samples * math.log(max(result.cost, 1e-300)) + chance


def _refined(task: _Task, begin: Array | None, unfinished: bool, near: FitResult | None = None) -> FitResult:
    """The fit, with the integration step halved until that changes nothing.

    With a fit ``near`` the weights begin as that one's.
    """
    spent = taken = 0
    for _ in range(MAX_REFINEMENTS):
        result = _fit_once(task, begin, budget=BUDGET if unfinished else MAX_ITERATIONS, near=near)
        spent, taken = spent + result.evaluations, taken + result.jacobians
        result = replace(result, evaluations=spent, jacobians=taken)
        if not (result.converged or result.interrupted or unfinished):
            raise NoTrustworthyResult(
                f"the fit did not converge: {result.message}",
                hint="check units and trial settings, or hold a parameter with --fix",
            )
        finer = task.model.refined()
        if finer is None or result.interrupted:
            return result
        spent += len(result.trials)
        result = replace(result, step_error=_step_error(result, finer), evaluations=spent)
        if not result.converged or result.step_error <= STEP_ERROR:
            return result
        task, begin, near = replace(task, model=finer), result.estimate, result
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
    task = _Task(model, tuple(trials), tuple(parameters or model.parameters), jobs or os.cpu_count() or 1)
    result = _fit_once(task, point, search=False)
    finer = model.refined()
    return result if finer is None else replace(result, step_error=_step_error(result, finer))


def _step_error(result: FitResult, finer: Model) -> float:
    worst = 0.0
    for trial in result.trials:
        fine = finer.simulate(result.values(trial.id), trial)
        for s in result.series:
            if s.trial == trial.id:
                change = np.abs(fine[s.channel] - s.simulated) / s.sd
                worst = max(worst, float(np.max(change[np.isfinite(change)], initial=0.0)))
    return worst


# the matrices here are small: BLAS threads would only take the cores from the simulations
@threadpool_limits.wrap(limits=1, user_api="blas")
def _fit_once(
    task: _Task,
    begin: Array | None,
    *,
    search: bool = True,
    budget: int = 0,
    near: FitResult | None = None,
) -> FitResult:
    fitted = [t for t in task.trials if t.role == "fit"]
    if not fitted:
        raise NoTrustworthyResult("no trial has the role 'fit'")
    problem = Problem(task.model, task.parameters, fitted, jobs=task.jobs)
    start = problem.start if begin is None else np.clip(begin, problem.lower, problem.upper)
    samples = sum(int(mask.sum()) for masks in problem.masks for mask in masks)
    if samples <= len(start):
        raise NoTrustworthyResult(
            f"{samples} samples cannot determine {len(start)} unknowns",
            hint="give longer logs or more trials, or fix some parameters",
        )
    try:
        path = _Search(problem, start, task.loss, budget, near)
        if search:
            path.run(task.progress)
        else:
            path.stay()
        if not np.isfinite(path.theta).all():
            raise NoTrustworthyResult(
                f"the fit did not converge: {path.message}", hint="check units and trial settings"
            )
        _insist_unbroken(problem, path.theta)
        if path.stalled:
            warn(
                "SWM026",
                f"the search converged slowly along a flat valley and was ended after {path.iterations} "
                f"iterations: ten of them together lowered the squared residuals by less than {LITTLE:.0e} "
                "of their sum",
            )
        path.estimate_noise()
        result = _result(path, task)
        why = None if path.interrupted or not search else _unfinished(path, result)
        return result if why is None else replace(result, converged=False, message=why)
    finally:
        problem.close()


@dataclass
class _Search:
    """The search for the minimum, reweighted by the noise until the weights settle."""

    problem: Problem
    theta: Array
    loss: Loss
    budget: int
    near: FitResult | None = None
    converged: bool = False
    interrupted: bool = False
    stalled: bool = False
    message: str = ""
    iterations: int = 0
    lowered: float = math.inf
    moved: Array | None = None

    def __post_init__(self) -> None:
        self.noise: dict[str, tuple[float, float]] = {}

    def run(self, progress: Progress) -> None:
        """Search until done or interrupted once there is a point to keep."""
        even = self._even()
        rounds = 1 if even else ROUNDS
        known = self.near is not None and not even
        if known:
            assert self.near is not None
            restarts.weigh(self.problem, self.near)
        else:
            noise_model.weigh_first(self.problem, even)
        try:
            with progress("fitting", total=rounds) as step:
                for round_ in range(rounds):
                    again = round_ > 0 or known
                    settled = round_ == rounds - 1 or (again and self._reweigh() < SETTLED)
                    self._solve(settled, lambda text: show(step, text))
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
            and not self.problem.random.any()
            and len({c for names in self.problem.channels for c in names}) == 1
            and not any(t.stamps_uncertain or np.any(t.time_sd_s) or t.value_sd for t in fitted)
        )

    def _reweigh(self) -> float:
        """Estimate the noise anew; the largest relative change of a weight."""
        _insist_unbroken(self.problem, self.theta)
        before = noise_model.weights(self.problem)
        self.estimate_noise()
        return noise_model.largest_change(self.problem, before)

    def estimate_noise(self) -> None:
        """The size of the noise at the present point, and the weights that follow."""
        self.noise = noise_model.estimate(self.problem, self.theta, self.noise, robust=self.loss == "huber")

    def _unnoticed(self) -> Unnoticed:
        """What the last steps of a search may still do without being noticed."""
        problem, theta = self.problem, self.theta
        _insist_unbroken(problem, theta)
        _, residuals, rows = _influences(problem, theta)
        found = sandwich(problem, rows, residuals, noise_model.autoregressions(problem, residuals))
        errors = np.sqrt(np.maximum(np.diag(found.covariance), 0.0)) * problem.scale
        shared = np.array([owner is None for _, owner in problem.slots])
        # numbers of single trials (start states) are no answer: they may go on converging slowly
        known = shared & (errors <= UNIDENTIFIABLE * np.maximum(np.abs(theta), problem.scale))
        return Unnoticed(found.gain, np.where(known, SLIGHT * errors, math.inf))

    def _solve(self, last: bool, tell: Callable[[str], None]) -> None:
        done = self.iterations

        def watch(x: Array, cost: float, iteration: int) -> None:
            self.theta, self.iterations, self.message = x, done + iteration, "searching"
            tell(f"iteration {self.iterations}, cost {cost:.5g}")

        solution = self.problem.solve(
            self.theta,
            tolerance=FINE if last else COARSE,
            unnoticed=self._unnoticed() if last and (done or self.near is not None) else None,
            max_iterations=max(self.budget - done, 1),
            watch=watch,
        )
        self.theta, self.iterations = solution.x, done + solution.iterations
        self.converged, self.message, self.stalled = solution.success, solution.message, solution.stalled
        self.lowered, self.moved = solution.lowered, solution.moved


def _unfinished(search: _Search, result: FitResult) -> str | None:
    """Why the end of a search is no minimum, in words; None where it is one as far as noise tells."""
    moving = {}
    if search.moved is not None and not (search.converged and not search.stalled):
        for label, move in zip(result.labels, search.moved, strict=True):
            error = result.stderr(label)
            if "[" not in label and result.status[label] == "estimated" and error:
                moving[label] = abs(float(move)) / error
    worst = max(moving, key=lambda label: moving[label], default=None)
    still = worst is not None and moving[worst] > STRIDE * SLIGHT
    if search.converged and not still:
        return None
    if search.message == KINKED:
        said = f"kinks: after {search.iterations} iterations no step lowers the cost as its slope promises"
    elif search.lowered <= LITTLE * result.samples:
        said = f"a flat valley: after {search.iterations} iterations steps hardly lower the cost"
    else:
        said = f"after {search.iterations} iterations steps still lower the cost"
    if still and worst is not None and math.isfinite(moving[worst]):
        said += f", and the last {STRIDE} moved {worst} by {moving[worst]:.2g} standard errors"
    bound = [label for label in result.labels if "[" not in label and result.status[label] == "at-bound"]
    return said + (f"; {', '.join(bound)} at a bound" if bound else "")


def _insist_unbroken(problem: Problem, theta: Array) -> None:
    broken = problem.broken(theta)
    if broken:
        raise NoTrustworthyResult(
            f"the simulation breaks down at the best point found, in {', '.join(broken)}",
            hint="check units and trial settings, or start from other values",
        )


def _influences(
    problem: Problem, theta: Array, *, central: bool = False
) -> tuple[list[Array], list[Array], list[Array]]:
    """Each trial's weighted residuals, what they become for the covariance, and so the scaled derivatives."""
    raw = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    residuals, factors = noise_model.influence(problem, raw)
    jacobians = problem.trial_jacobians(theta, central=central)
    return raw, residuals, [f[:, None] * j * problem.scale for f, j in zip(factors, jacobians, strict=True)]


def _result(search: _Search, task: _Task) -> FitResult:
    problem, theta = search.problem, search.theta
    samples = sum(int(mask.sum()) for masks in problem.masks for mask in masks)
    raw, residuals, rows = _influences(problem, theta, central=samples * len(theta) <= 50_000)
    autoregressions = noise_model.autoregressions(problem, residuals)
    priors = problem.priors(theta)
    rows = [np.vstack((a, b * problem.scale)) for a, (_, b) in zip(rows, priors, strict=True)]
    residuals = [np.concatenate((a, b)) for a, (b, _) in zip(residuals, priors, strict=True)]
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
        few = float(special.stdtrit(max(samples - int(free.sum()), 1), 0.975) / special.ndtri(0.975))
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
        parameters=task.parameters,
        trials=task.trials,
        labels=problem.labels,
        estimate=theta,
        covariance=covariance,
        status=status,
        series=[],
        noise={
            c: Noise(noise_model.value_sd(problem, c, v), t, autoregressions[c])
            for c, (v, t) in search.noise.items()
        },
        scatter=1.0 if found is None else found.scatter,
        scatter_p=1.0 if found is None else found.scatter_p,
        samples=samples,
        converged=search.converged,
        message=search.message,
        evaluations=problem.evaluations + sum(t.role != "fit" for t in task.trials),
        interrupted=search.interrupted,
        cost=_cost(problem, raw),
        information_root=root,
        loss=task.loss,
        jacobians=problem.jacobians,
    )
    return replace(result, series=_series(problem, result))


def _by_noise(
    problem: Problem,
    rows: list[Array],
    residuals: list[Array],
    autoregressions: dict[str, Array],
    outward: Array,
) -> tuple[NDArray[np.bool_], Sandwich | None]:
    """The parameters to take as free, and their covariance.

    Those whose minimum without bounds lies well beyond the bound they are at are held by it.
    The others at a bound may be there by noise alone: leaving them out would make what they
    are confounded with look well known.
    """
    free = np.ones(len(outward), dtype=bool)
    while free.any():
        found = sandwich(problem, [r[:, free] for r in rows], residuals, autoregressions)
        sd = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
        beyond = np.where(np.isfinite(sd) & (outward[free] != 0), outward[free] * found.step / sd, 0.0)
        worst = int(np.argmax(beyond))
        # within two standard errors a bound may hold it by noise alone
        if beyond[worst] <= 2.0:
            return free, found
        free[np.flatnonzero(free)[worst]] = False
    return free, None


def _cost(problem: Problem, residuals: list[Array]) -> float:
    """See :attr:`FitResult.cost`; ``residuals`` as weighted by the final noise model."""
    total, count = 0.0, 0
    for k, values in enumerate(residuals):
        sds, dampings = problem.at_samples(k, problem.sd[k]), problem.at_samples(k, problem.damping[k])
        # under Huber's loss a far residual costs 2 c |r| - c^2; linear losses have no damping
        squares = np.where(dampings < 1, 2 * values**2 - noise_model.CORNER**2, values**2)
        total += float(np.sum(2 * np.log(sds) + squares))
        count += len(values)
    return float(np.exp(min(total / max(count, 1) - 1.0, 700.0)))


def _series(problem: Problem, result: FitResult) -> list[Series]:
    places = {t.id: k for k, t in enumerate(problem.trials)}
    known = problem.simulations(result.estimate)
    series = []
    for trial in result.trials:
        k = places.get(trial.id)
        simulated = problem.model.simulate(result.values(trial.id), trial) if k is None else known[k]
        for channel in (c.name for c in problem.model.channels if c.name in trial.measured):
            if k is not None and channel in problem.channels[k]:
                sd = problem.sd[k][problem.channels[k].index(channel)]
            else:
                size = result.noise[channel].value_sd if channel in result.noise else np.nan
                sd = np.full(len(trial.time_s), size)
            measured = trial.measured[channel]
            series.append(
                Series(trial.id, trial.role, channel, trial.time_s, measured, simulated[channel], sd)
            )
    return series


# ---------------------------------------------------------------- start states of held-out trials


def estimate_start(
    model: Model,
    parameters: tuple[Parameter, ...],
    trial: Trial,
    sd: Mapping[str, float],
    *,
    tolerance: float = START_TOLERANCE,
) -> dict[str, float]:
    """Estimate per-trial parameters of one trial by label, ``name[trial]``, with the shared ones held.

    A held-out trial has its own start pose, speed and clock. They are no part of what it tests.

    Parameters
    ----------
    parameters : tuple of Parameter
        Shared ones with their values as ``start``; of the others those that are free are estimated.
    sd : mapping of channel name to float
        Noise of each channel, for the weights; channels that are not in it are not used.
    """
    held = [replace(p, free=p.free and p.per_trial) for p in parameters]
    used = {c: v for c, v in trial.measured.items() if c in sd}
    problem = Problem(model, held, [replace(trial, role="fit", measured=used)])
    try:
        if not problem.labels:
            return {}
        for i, channel in enumerate(problem.channels[0]):
            problem.sd[0][i] = np.full(len(trial.time_s), sd[channel])
        begin = problem.start
        if problem.broken(begin):
            # known from other coefficients, with which it did not diverge
            begin = np.clip([held[i].start for i, _ in problem.slots], problem.lower, problem.upper)
        solution = problem.solve(begin, tolerance=tolerance)
        return {label: float(v) for label, v in zip(problem.labels, solution.x, strict=True)}
    finally:
        problem.close()


def with_held_out(result: FitResult) -> FitResult:
    """The result with each validation trial simulated from its own start state."""
    waiting = [t for t in result.trials if t.role == "validate"]
    if not any(p.free and p.per_trial for p in result.parameters):
        return result
    sd = {name: noise.value_sd for name, noise in result.noise.items()}
    found: dict[str, float] = {}
    for trial in waiting:
        found.update(estimate_start(result.model, result.at_estimates(), trial, sd))
    result = replace(result, start_states=found)
    simulated = {t.id: result.model.simulate(result.values(t.id), t) for t in waiting}
    series = [
        replace(s, simulated=simulated[s.trial][s.channel]) if s.trial in simulated else s
        for s in result.series
    ]
    return replace(result, series=series)
