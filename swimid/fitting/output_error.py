"""Output-error identification: maximum likelihood over all samples of all trials.

The simulated channels are compared with the measured channels. The residuals are weighted by a noise model,
which is estimated from the residuals. The covariance of the estimates allows for coloured residuals, and for
trials that differ by more than their noise. The estimator works for every
:class:`swimid.fitting.model.Model`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special
from threadpoolctl import threadpool_limits

from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise, uncertainty
from swimid.fitting.intervals import Differences, compute_errors
from swimid.fitting.model import Array, Model, Parameter, Trial, values_of
from swimid.fitting.problem import (
    KINKED,
    MAX_REFINEMENTS,
    MIN_DECREASE,
    STALLED,
    STEP_ERROR,
    STRIDE,
    Blocks,
    Patience,
    Problem,
    choose_step,
    minimise,
)
from swimid.fitting.uncertainty import UNIDENTIFIABLE, Sandwich, sandwich
from swimid.notices import Progress, show, silent, warn

#: Maximum number of times that a fit estimates the noise (MAX_NOISE_ITERATIONS), and relative change of the
#: sample weights at which the weights have converged (WEIGHT_RTOL).
MAX_NOISE_ITERATIONS = 12
WEIGHT_RTOL = 0.01
#: Relative tolerances of the cost of a search: while the sample weights still change (COARSE_RTOL), and in
#: the last search (FINE_RTOL).
COARSE_RTOL, FINE_RTOL = 1e-3, 1e-10
#: Maximum change of an estimate, in standard errors, that is negligible at the end of a search.
NEGLIGIBLE_MOVE = 0.03
#: Maximum number of iterations of a fit that must converge (MAX_ITERATIONS), and of a fit that may be
#: returned unfinished (UNFINISHED_ITERATIONS). Fits of correct models need 6 to 25 iterations, or 52 if
#: simulations diverge at the start. UNFINISHED_ITERATIONS is three times the usual number.
MAX_ITERATIONS, UNFINISHED_ITERATIONS = 200, 75
#: Maximum number of times that the integration step is halved because simulations diverge at the start of
#: a fit. Simulations with wrong parameters may diverge with every step.
MAX_START_HALVINGS = 3
#: Relative tolerance of the cost when the initial state of a held-out trial is estimated.
START_RTOL = 1e-8
#: Maximum number of restarts of a search near the estimates.
MAX_RESTARTS = 6
#: Minimum increases of twice the log-likelihood by restarts of a search. Above NEEDED_GAIN (an estimate moves
#: by one standard error) the restart is reported. Above SMALL_GAIN (a third of a standard error) a further
#: restart follows.
NEEDED_GAIN, SMALL_GAIN = 1.0, 0.1


# ---------------------------------------------------------------- result of a fit


@dataclass(frozen=True)
class ChannelNoise:
    """Measurement noise of one channel, as estimated by a fit."""

    #: Standard deviation of the measured values, in the unit of the channel. If it differs between samples,
    #: the root mean square over the samples.
    value_sd: float
    #: Standard deviation of the time stamps, s; 0 if the time stamps are exact.
    time_sd_s: float
    #: Coefficients of the autoregression of the weighted residuals, shape (p,). Empty if the residuals are
    #: white.
    autoregression: Array


@dataclass(frozen=True)
class Series:
    """Measured and simulated series of one channel of one trial."""

    trial: str
    role: str
    channel: str
    #: Time and values of the samples, shape (n,) each. ``sd`` is the standard deviation of each sample in the
    #: noise model.
    time_s: Array
    measured: Array
    simulated: Array
    sd: Array

    @property
    def residual(self) -> Array:
        """Measured minus simulated values, shape (n,); NaN for missing samples."""
        return self.measured - self.simulated

    @property
    def z_scores(self) -> Array:
        """Residuals divided by the standard deviations of their samples, shape (n,)."""
        return self.residual / self.sd


@dataclass(frozen=True)
class FitResult:
    """Result of a fit: estimates and their covariance, simulated series, noise, and convergence."""

    model: Model
    #: Parameters of the fit, with the choices of the user.
    parameters: tuple[Parameter, ...]
    trials: tuple[Trial, ...]
    #: One label for each unknown: the name of its parameter, or ``name[trial]`` if each trial has its own
    #: value.
    labels: list[str]
    #: Estimates, shape (p,).
    estimate: Array
    #: Covariance of the estimates, shape (p, p). NaN for parameters at a bound, and for parameters that do
    #: not affect the residuals.
    covariance: Array
    #: Status of each label: ``estimated``, ``at-bound`` or ``unidentifiable``.
    status: dict[str, str]
    #: Measured and simulated series of the fitted and of the validation trials.
    series: list[Series]
    #: Estimated measurement noise of each channel.
    noise: dict[str, ChannelNoise]
    samples: int
    converged: bool
    message: str
    #: Number of simulations of single trials in all searches and tests of the fit. Simulations for
    #: derivatives by time (uncertain time stamps) are not counted.
    evaluations: int
    #: Largest change of a simulated sample if the integration step is halved, in standard deviations of the
    #: noise.
    step_error: float = 0.0
    #: Whether the user stopped the search. The estimates are then the best ones found so far.
    interrupted: bool = False
    #: Cost of the fit: mean squared residual, as a geometric mean over channels of different units. It is the
    #: exponential of (twice the negative log-likelihood per sample, minus one). Costs can be compared between
    #: fits of the same samples, even if the sample weights of these fits differ.
    cost: float = math.nan
    #: Square root of the information matrix, shape (q, p): ``information_root' information_root`` is the
    #: inverse of the covariance. It is accurate even if the covariance is infinite. Columns of parameters
    #: held at a bound are NaN.
    information_root: Array = field(default_factory=lambda: np.empty((0, 0)))
    #: Estimates of the per-trial parameters of validation trials, by label. The shared parameters are held at
    #: the estimates of the fit.
    start_states: Mapping[str, float] = field(default_factory=dict)
    #: Differences between the trials; None before :func:`with_intervals`.
    differences: Differences | None = None
    #: Number of restarts near the estimates that led to a better fit; None if no restart was tested.
    restarts: int | None = None
    #: Whether the estimates are final: the last restart led to no better fit.
    settled: bool = True

    @property
    def common_labels(self) -> list[str]:
        """Labels of the unknowns that all trials share."""
        return [label for label in self.labels if "[" not in label]

    def parameter(self, label: str) -> Parameter:
        """Return the parameter to which a label of the fit belongs (``name`` or ``name[trial]``)."""
        return next(p for p in self.parameters if p.name == label.split("[")[0])

    def series_of(self, channel: str, role: str | None = None) -> list[Series]:
        """Return the series of a channel in all trials, or in the trials with the given role."""
        return [s for s in self.series if s.channel == channel and role in (None, s.role)]

    def at_estimates(self) -> tuple[Parameter, ...]:
        """Return the model parameters with the estimates of shared parameters as their start values."""
        return tuple(replace(p, start=self.value(p.name)) for p in self.parameters)

    def stderr(self, label: str) -> float | None:
        """Return the standard error of an estimate; None if it has no standard error."""
        if label not in self.labels:
            return None
        index = self.labels.index(label)
        variance = float(self.covariance[index, index])
        return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None

    def value(self, name: str, trial: str | None = None) -> float:
        """Return the estimated or fixed value of a parameter, in the given trial if it is per-trial."""
        for label in (f"{name}[{trial}]", name):
            if label in self.labels:
                return float(self.estimate[self.labels.index(label)])
            if label in self.start_states:
                return self.start_states[label]
        return next(p.start for p in self.parameters if p.name == name)

    def values(self, trial: str) -> Array:
        """Return the values of all parameters in one trial, in the order of the model."""
        known = {p.name: self.value(p.name, trial) for p in self.parameters}
        return values_of(self.model, self.parameters, known)


# ---------------------------------------------------------------- fit


def fit_output_error(
    model: Model,
    trials: Sequence[Trial],
    *,
    parameters: Sequence[Parameter] | None = None,
    progress: Progress = silent,
    jobs: int | None = None,
    begin: Array | None = None,
    tested: bool = True,
    max_iterations: int | None = None,
) -> FitResult:
    """Estimate the free parameters of a model from all fit trials at once.

    Parameters
    ----------
    model : Model
    trials : sequence of Trial
        Trials of the role ``validate`` are simulated and scored, but not fitted.
    parameters : sequence of Parameter, optional
        Parameters of the model with the choices of the user (:func:`swimid.fitting.model.choose_parameters`).
        The default is the parameters of the model.
    jobs : int, optional
        Number of threads for long simulations, on which the result does not depend. The default is the number
        of processors. ``model.simulate`` must be safe to call from several threads at once.
    begin : ndarray, shape (p,), optional
        Starting point of the search, one value for each label of the result. The default is the start values
        of the parameters.
    tested : bool
        Whether to compare the estimates with points and short searches around them, and to search again from
        a better point (:func:`search_around`).
    max_iterations : int, optional
        Number of iterations after which a result is returned that is marked as not converged. By default a
        search that does not converge within :data:`MAX_ITERATIONS` raises an error.

    Returns
    -------
    FitResult
        Result of the fit. Ctrl-C stops the search. The result is then the best point so far, marked as not
        converged, and ``message`` says why. A second Ctrl-C raises KeyboardInterrupt.

    Raises
    ------
    NoTrustworthyResult
        If the search does not converge, the model cannot be simulated, or there are fewer samples than
        unknowns.

    Notes
    -----
    The method is weighted nonlinear least squares by a bounded Levenberg-Marquardt search. The weights follow
    from the estimated noise, and the search is repeated until they converge. :meth:`NoiseSearch.run` ends at
    changes below the noise, and :func:`_make_result` has the covariance.
    """
    threads, budget = jobs or os.cpu_count() or 1, max_iterations or MAX_ITERATIONS
    chosen = tuple(parameters or model.parameters)
    search = NoiseSearch(model, tuple(trials), chosen, threads, begin=begin, budget=budget, progress=progress)
    search.must_converge = max_iterations is None
    result = _fit_with_step(search)
    if tested and result.converged:
        return check_by_restarts(result, jobs=threads)
    return result


def check_by_restarts(result: FitResult, *, jobs: int) -> FitResult:
    """Restart the search of a fit near its estimates, and return the best fit.

    The user is warned if a restart finds a better fit. The result has :attr:`FitResult.restarts` and
    :attr:`FitResult.settled`.
    """
    first, count, settled = result, 0, True
    spent, gain = result.evaluations, 0.0
    try:
        while True:
            # Limit all restarts together to twice the simulations of the first fit, unless the cost is not
            # smooth.
            if spent > 2 * first.evaluations and not is_kinked(result):
                settled = gain <= NEEDED_GAIN
                break
            with threadpool_limits(limits=1, user_api="blas"):
                near = search_around(result, jobs=jobs, seed=count)
            spent += near.evaluations
            if near.point is None or count == MAX_RESTARTS:
                settled = near.point is None
                break
            again = _fit_with_step(
                NoiseSearch(
                    result.model, result.trials, result.parameters, jobs, begin=near.point, near=result
                )
            )
            spent += again.evaluations
            gain = _objective(result) - _objective(again)
            if not gain > 0.0:
                break
            result, count, settled = again, count + 1, again.converged
            if not settled or (gain < SMALL_GAIN and not near.rough):
                break
    except KeyboardInterrupt:
        text = "interrupted during the restarts that test the minimum"
        return replace(result, interrupted=True, converged=False, message=text)
    result = replace(result, restarts=count, settled=settled, evaluations=spent)
    if _objective(first) - _objective(result) > NEEDED_GAIN:
        doubt = "" if settled else "; the last restart still did, so that a better fit may exist"
        warn(
            "SWM073",
            f"the first search stopped before the best fit: {count} restarts near its end lowered the mean "
            f"squared residual by {100 * (1 - result.cost / first.cost):.3g} %{doubt}",
        )
    return result


def _objective(result: FitResult) -> float:
    """Return twice the negative log-likelihood of a fit, without its constant."""
    return result.samples * math.log(max(result.cost, 1e-300))


# Use one thread of BLAS. The matrices are small, so that more threads would only slow down the simulations.
@threadpool_limits.wrap(limits=1, user_api="blas")
def _fit_with_step(search: NoiseSearch) -> FitResult:
    """Fit a model, and repeat the fit with a smaller integration step until the samples hardly change."""
    spent, halvings = 0, MAX_REFINEMENTS
    while True:
        result = search.run()
        if search.must_converge and not (result.converged or result.interrupted):
            raise NoTrustworthyResult(
                f"the fit did not converge: {result.message}",
                hint="check units and trial settings, or hold a parameter with --fix",
            )
        spent += result.evaluations
        if result.interrupted:
            return replace(result, evaluations=spent)
        if not result.converged or search.budget is None:
            halvings = 0
        runs = [(result.values(t.id), t) for t in result.trials]
        noise: dict[str, dict[str, Array]] = {t.id: {} for t in result.trials}
        for s in result.series:
            noise[s.trial][s.channel] = s.sd
        chosen = choose_step(result.model, runs, list(noise.values()), halvings=halvings)
        spent += sum(bool(changes) for changes in chosen.changes)
        result = replace(result, step_error=STEP_ERROR * chosen.change, evaluations=spent)
        if not chosen.halvings:
            return result
        halvings -= chosen.halvings
        search = replace(search, model=chosen.model, begin=result.estimate, near=result)


def evaluate_fit(
    model: Model,
    trials: Sequence[Trial],
    point: Array,
    *,
    parameters: Sequence[Parameter] | None = None,
    jobs: int | None = None,
) -> FitResult:
    """Return the result that :func:`fit_output_error` would have if its search ended at a given point.

    The covariance is that of the model linearised at the point. The residuals at the point are treated as
    noise.

    Parameters
    ----------
    point : ndarray, shape (p,)
        Unknowns at which the fit is evaluated, one value for each label of the result.

    Raises
    ------
    NoTrustworthyResult
        If the model cannot be simulated at the point, or if there are fewer samples than unknowns.
    """
    threads, parameters = jobs or os.cpu_count() or 1, tuple(parameters or model.parameters)
    return _fit_with_step(NoiseSearch(model, tuple(trials), parameters, threads, begin=point, budget=None))


@dataclass
class NoiseSearch:
    """Search for the minimum cost, repeated with re-estimated noise weights until the weights converge.

    Attributes
    ----------
    model, trials, parameters, jobs, progress
        As in :func:`fit_output_error`.
    begin : ndarray, shape (p,), optional
        Point at which the search begins.
    near : FitResult, optional
        Fit whose final sample weights are those of the first search.
    budget : int or None
        Maximum number of iterations. With None the fit is evaluated at its starting point, without a search.
    must_converge : bool
        Whether a search that does not converge is an error.
    problem : Problem
    theta : ndarray, shape (p,)
        Current point of the search.
    noise : dict of str to (float, float)
        Standard deviations of values and of time stamps of each channel.
    levels : dict of (int, str) to ndarray
        Local levels of the noise (:func:`swimid.fitting.noise.compute_levels`).
    """

    model: Model
    trials: tuple[Trial, ...]
    parameters: tuple[Parameter, ...]
    jobs: int
    progress: Progress = silent
    begin: Array | None = None
    near: FitResult | None = None
    budget: int | None = UNFINISHED_ITERATIONS
    must_converge: bool = False
    problem: Problem = field(init=False)
    theta: Array = field(init=False)
    noise: dict[str, tuple[float, float]] = field(init=False, default_factory=dict)
    levels: dict[tuple[int, str], Array] = field(init=False, default_factory=dict)
    patience: Patience = field(init=False, default_factory=Patience)
    converged: bool = field(init=False, default=False)
    interrupted: bool = field(init=False, default=False)
    message: str = field(init=False, default="")
    iterations: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        fitted = [t for t in self.trials if t.role == "fit"]
        if not fitted:
            raise NoTrustworthyResult("no trial has the role 'fit'")
        self.problem = problem = Problem(self.model, self.parameters, fitted, jobs=self.jobs)
        self.theta = problem.start
        if self.begin is not None:
            self.theta = np.clip(self.begin, problem.lower, problem.upper)
        if problem.find_broken(self.theta):
            runs = [(problem.vector(self.theta, k), trial) for k, trial in enumerate(fitted)]
            unknown = [dict.fromkeys(trial.measured, math.inf) for trial in fitted]
            chosen = choose_step(self.model, runs, unknown, halvings=MAX_START_HALVINGS)
            self.problem = Problem(chosen.model, self.parameters, fitted, jobs=self.jobs)
        if self.samples <= len(self.theta):
            raise NoTrustworthyResult(
                f"{self.samples} samples cannot determine {len(self.theta)} unknowns",
                hint="give longer logs or more trials, or fix some parameters",
            )

    @property
    def samples(self) -> int:
        """Number of samples of the fitted trials."""
        return sum(self.problem.counts)

    @property
    def has_equal_weights(self) -> bool:
        """Whether all samples have one weight, so that one search without reweighting is enough.

        There is then one channel only, and all its samples have the same noise.
        """
        problem = self.problem
        return len({c for names in problem.channels for c in names}) == 1 and not any(
            t.stamps_uncertain or np.any(t.time_sd_s) or t.value_sd for t in problem.trials
        )

    def run(self) -> FitResult:
        """Search until the noise weights converge, and return the result."""
        self._repeat()
        self._insist_unbroken()
        if self.message == STALLED:
            warn(
                "SWM026",
                f"the search was ended after {self.iterations} iterations, because {STRIDE} iterations "
                f"lowered the sum of squared residuals by less than a fraction of {MIN_DECREASE:.0e}: fix a "
                "parameter with --fix, or search a missing effect with swimid diagnose",
            )
        self._estimate_noise()
        result = _make_result(self)
        reason = None
        if not self.interrupted:
            reason = _explain_unfinished(self, result)
        if reason is None:
            return result
        return replace(result, converged=False, message=reason)

    def _repeat(self) -> None:
        """Search until the noise weights converge, or until the user interrupts the search.

        If the local levels of the noise differ, a last search uses weights with these levels.
        """
        rounds, first = MAX_NOISE_ITERATIONS, 1
        if self.has_equal_weights:
            rounds = 1
        elif self.near is None:
            uncertainty.weigh_first(self.problem)
        else:
            first = 0
            set_weights(self.problem, self.near)
            self._find_levels()
        try:
            with self.progress("fitting", total=rounds) as step:
                for k in range(rounds):
                    last = k == rounds - 1 or (k >= first and self._reweigh() < WEIGHT_RTOL)
                    self._solve(last, lambda text: show(step, text))
                    step()
                    if last:
                        break
                if self.near is None and self._find_levels():
                    self._estimate_noise()
                    self._solve(True, lambda text: show(step, text))
        except KeyboardInterrupt:
            if not self.message:
                raise
            self.interrupted, self.converged = True, False
            self.message = f"interrupted after {self.iterations} iterations"

    def _insist_unbroken(self) -> None:
        """Raise an error if a trial cannot be simulated at the current point of the search."""
        broken = self.problem.find_broken(self.theta)
        if broken:
            raise NoTrustworthyResult(
                f"the simulation diverges at the best point found, in {', '.join(broken)}",
                hint="check units and trial settings, or start from other values",
            )

    def _reweigh(self) -> float:
        """Estimate the noise at the current point, and return the largest relative change of a weight.

        A factor that is common to all weights does not count as a change.
        """
        self._insist_unbroken()
        trials = range(len(self.problem.trials))
        before = np.concatenate([self.problem.sample_weights(k) for k in trials])
        self._estimate_noise()
        change = np.concatenate([self.problem.sample_weights(k) for k in trials]) / before
        return float(np.max(np.abs(change / np.median(change) - 1.0), initial=0.0))

    def _estimate_noise(self) -> None:
        """Estimate the noise at the current point of the search, and set the weights of the samples."""
        self.noise = uncertainty.estimate_noise(self.problem, self.theta, self.noise, self.levels)

    def _find_levels(self) -> bool:
        """Estimate the local levels of the noise at the current point, and return whether they differ."""
        if not self.problem.find_broken(self.theta):
            self.levels = noise.compute_levels(self.problem, self.theta)
        return bool(self.levels)

    def _noise_limits(self) -> Patience:
        """Return the rule that ends a search when its steps have a smaller effect than the noise.

        The search ends if five successive steps together lower the squared residuals by less than one
        parameter that is fitted to noise alone (:attr:`Sandwich.gain`), and move each shared estimate by less
        than :data:`NEGLIGIBLE_MOVE` standard errors.
        """
        problem, theta = self.problem, self.theta
        self._insist_unbroken()
        residuals, rows = _linearise(problem, theta)
        found = sandwich(problem, rows, residuals, uncertainty.autoregressions(problem, residuals))
        errors = np.sqrt(np.maximum(np.diag(found.covariance), 0.0)) * problem.scale
        shared = np.array([owner is None for _, owner in problem.slots])
        # Unknowns of single trials (initial states) are no result of the fit, so they may still change.
        known = shared & (errors <= UNIDENTIFIABLE * np.maximum(np.abs(theta), problem.scale))
        return Patience(found.gain, np.where(known, NEGLIGIBLE_MOVE * errors, math.inf))

    def _solve(self, last: bool, tell: Callable[[str], None]) -> None:
        """Search for the minimum cost with the current noise weights."""
        if self.budget is None:
            self.converged, self.message = True, "no search: the point was given"
            return
        done, tolerance = self.iterations, COARSE_RTOL
        self.patience = patience = Patience()
        if last:
            tolerance = FINE_RTOL
            if done or self.near is not None:
                self.patience = patience = self._noise_limits()

        def watch(x: Array, cost: float, iteration: int) -> str | None:
            self.theta, self.iterations, self.message = x, done + iteration, "searching"
            tell(f"iteration {self.iterations}, cost {cost:.5g}")
            return patience(x, cost, iteration)

        budget = max(self.budget - done, 1)
        found = self.problem.solve(self.theta, tolerance=tolerance, max_iterations=budget, watch=watch)
        self.theta, self.iterations = found.x, done + found.iterations
        self.converged, self.message = found.success, found.message


def _explain_unfinished(search: NoiseSearch, result: FitResult) -> str | None:
    """Return the reason why a search did not end at a minimum, to within noise.

    Return None if the search ended at a minimum.
    """
    if search.converged and search.message != STALLED:
        return None
    lowered, moved = search.patience.last(STRIDE)
    moves = {"": 0.0} | _scale_moves(result, moved)
    worst = max(moves, key=lambda label: moves[label])
    still = moves[worst] > STRIDE * NEGLIGIBLE_MOVE
    if search.converged and not still:
        return None
    if search.message == KINKED:
        said = f"after {search.iterations} iterations no step lowers the cost as its slope predicts (kinks)"
    elif lowered <= MIN_DECREASE * result.samples:
        said = f"after {search.iterations} iterations steps hardly lower the cost (a flat valley)"
    else:
        said = f"after {search.iterations} iterations steps still lower the cost"
    if still and math.isfinite(moves[worst]):
        said += f", and the last {STRIDE} steps moved {worst} by {moves[worst]:.2g} standard errors"
    bound = [label for label in result.common_labels if result.status[label] == "at-bound"]
    if bound:
        said += f"; {', '.join(bound)} at a bound"
    return said


def _scale_moves(result: FitResult, moved: Array) -> dict[str, float]:
    """Return the moves of the estimated shared parameters, in standard errors."""
    moves = {}
    for label, move in zip(result.labels, moved, strict=False):
        error = result.stderr(label)
        if "[" not in label and result.status[label] == "estimated" and error:
            moves[label] = abs(float(move)) / error
    return moves


def _linearise(problem: Problem, theta: Array, *, central: bool = False) -> tuple[list[Array], Blocks]:
    """Return the weighted residuals of each trial, and their derivatives with respect to scaled unknowns."""
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    return residuals, problem.blocks(theta, central=central).scale_columns(problem.scale)


def with_intervals(result: FitResult) -> FitResult:
    """Return a fit with standard errors that allow for slow noise and for trials that differ.

    See :mod:`swimid.fitting.intervals`. The search, and the comparison with alternative fits, use the errors
    under an autoregression, because they need less computing time.
    """
    free: NDArray[np.bool_] = np.asarray(np.isfinite(result.information_root).all(axis=0))
    problem, theta = rebuild_problem(result), np.asarray(result.estimate)
    shared = [free[j] for j, (_, owner) in enumerate(problem.slots) if owner is None]
    if not len(result.information_root) or not any(shared):
        return result
    scale, central = problem.scale, result.samples * len(theta) <= 50_000
    derivatives = problem.own_jacobians(theta, central=central)
    rows = [-part * scale[columns] for part, columns in zip(derivatives, problem.taken, strict=True)]
    residuals = [problem.trial_residuals(theta, k) for k in range(len(problem.trials))]
    covariance, root, differences = compute_errors(problem, theta, free, rows, residuals)
    root = np.where(free, root / scale, np.nan)
    covariance, status = _judge(problem, theta, covariance * np.outer(scale, scale), free)
    differences = differences.in_units(dict(zip(problem.labels, scale.tolist(), strict=True)))
    known = replace(result, covariance=covariance, status=status)
    return replace(known, information_root=root, differences=differences)


def complete_fit(result: FitResult) -> FitResult:
    """Return the result of a fit with its final intervals, and with its validation trials predicted.

    See :func:`with_intervals` and :func:`with_held_out`.
    """
    return with_held_out(with_intervals(result))


def _outward(problem: Problem, theta: Array) -> Array:
    """Return for each unknown -1 at its lower bound, 1 at its upper bound, and 0 inside, shape (p,)."""
    margin = 1e-6 * np.maximum(problem.scale, np.abs(theta))
    outward = np.where(theta - problem.lower < margin, -1.0, 0.0)
    outward[problem.upper - theta < margin] = 1.0
    return outward


def _judge(
    problem: Problem, theta: Array, covariance: Array, free: NDArray[np.bool_]
) -> tuple[Array, dict[str, str]]:
    """Return the covariance without unknowns at a bound, and the status of each unknown.

    Parameters
    ----------
    covariance : ndarray, shape (p, p)
        Covariance of the unknowns; NaN for unknowns that the trials do not determine.
    free : ndarray of bool, shape (p,)
        Mask of the unknowns that no bound holds.
    """
    # A standard error of NaN makes the comparison false.
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = errors <= UNIDENTIFIABLE * np.maximum(np.abs(theta), problem.scale)
    held = (_outward(problem, theta) != 0) & (known | ~free)
    status = np.where(held, "at-bound", np.where(known, "estimated", "unidentifiable"))
    covariance = covariance.copy()
    covariance[held] = covariance[:, held] = np.nan
    return covariance, dict(zip(problem.labels, status.tolist(), strict=True))


def _make_result(search: NoiseSearch) -> FitResult:
    """Return the result of a fit from the end of a search: estimates, covariance and status.

    The covariance is ``H^-1 M H^-1`` with ``H = J'J`` and ``M = sum_trials J_k' R J_k``. R is the correlation
    matrix of the weighted residuals under an autoregression whose order the BIC selects. A parameter counts
    as free in the covariance if noise alone can explain that it is at its bound.
    """
    problem, theta, samples = search.problem, search.theta, search.samples
    residuals, rows = _linearise(problem, theta, central=samples * len(theta) <= 50_000)
    autoregressions = uncertainty.autoregressions(problem, residuals)
    free, found = _free_in_noise(problem, rows, residuals, autoregressions, _outward(problem, theta))
    covariance = np.full((len(theta), len(theta)), np.nan)
    root = np.zeros((int(free.sum()), len(theta)))
    root[:, ~free] = np.nan
    if found is not None:
        scale = problem.scale[free]
        # For few samples use Student's t, so that 1.96 of these standard errors cover 95 %.
        few = float(special.stdtrit(max(samples - int(free.sum()), 1), 0.975) / special.ndtri(0.975))
        part = few**2 * found.covariance * np.outer(scale, scale)
        part[found.null] = part[:, found.null] = np.nan
        covariance[np.ix_(free, free)] = part
        root[: len(found.root), free] = found.root / few / scale
    covariance, status = _judge(problem, theta, covariance, free)
    result = FitResult(
        model=problem.model,
        parameters=search.parameters,
        trials=search.trials,
        labels=problem.labels,
        estimate=theta,
        covariance=covariance,
        status=status,
        series=[],
        noise={
            c: ChannelNoise(uncertainty.value_sd(problem, c, v), t, autoregressions[c])
            for c, (v, t) in search.noise.items()
        },
        samples=samples,
        converged=search.converged,
        message=search.message,
        evaluations=problem.evaluations + sum(t.role != "fit" for t in search.trials),
        interrupted=search.interrupted,
        cost=_cost(problem, residuals),
        information_root=root,
    )
    return replace(result, series=_series(problem, result))


def _free_in_noise(
    problem: Problem,
    rows: Blocks,
    residuals: list[Array],
    autoregressions: dict[str, Array],
    outward: Array,
) -> tuple[NDArray[np.bool_], Sandwich | None]:
    """Return a mask of the unknowns that are not at a bound, and the covariance of these unknowns.

    An unknown is held by its bound if the minimum without bounds is more than two standard errors beyond the
    bound. Noise alone can explain why the other unknowns are at a bound, so that these count as free. If they
    were held, unknowns that are confounded with them would have too small standard errors.
    """
    free = np.ones(len(outward), dtype=bool)
    while free.any():
        found = sandwich(problem, rows.columns(free), residuals, autoregressions)
        sd = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
        beyond = np.where(np.isfinite(sd) & (outward[free] != 0), outward[free] * found.step / sd, 0.0)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 2.0:
            return free, found
        free[np.flatnonzero(free)[worst]] = False
    return free, None


def _cost(problem: Problem, residuals: list[Array]) -> float:
    """Return the cost (:attr:`FitResult.cost`) of residuals weighted by the final noise model."""
    logs = [2 * np.log(problem.at_samples(k, problem.sd[k])) for k in range(len(residuals))]
    mean = float(np.mean(np.concatenate(logs) + np.concatenate(residuals) ** 2))
    return float(np.exp(min(mean - 1.0, 700.0)))


def _series(problem: Problem, result: FitResult) -> list[Series]:
    """Return the measured and simulated series of every trial and channel of a fit."""
    series = []
    fitted = dict(zip((t.id for t in problem.trials), problem.simulations(result.estimate), strict=True))
    sds = {
        (trial.id, channel): sd
        for trial, channels, of_trial in zip(problem.trials, problem.channels, problem.sd, strict=True)
        for channel, sd in zip(channels, of_trial, strict=True)
    }
    for trial in result.trials:
        simulated = fitted.get(trial.id) or problem.model.run(result.values(trial.id), trial)
        for channel in (c.name for c in problem.model.channels if c.name in trial.measured):
            known = np.full(len(trial.time_s), getattr(result.noise.get(channel), "value_sd", math.nan))
            sd = sds.get((trial.id, channel), known)
            measured = trial.measured[channel]
            series.append(
                Series(trial.id, trial.role, channel, trial.time_s, measured, simulated[channel], sd)
            )
    return series


# ---------------------------------------------------------------- searches around the estimates


# A search ends where its local model of the cost predicts no decrease. Such a point need not be a minimum if
# the cost is not smooth, as with dry friction, or if a bound holds a parameter. Therefore test whether a
# point near the estimates, or a short search from such a point, reaches a lower cost than the estimates.

#: Pairs of opposite points around the estimates at which the cost is tested: number of pairs, and distance
#: from the estimates in standard errors under white noise.
N_PAIRS, PAIR_DISTANCE = 3, 2.0
#: Minimum deviation of the mean cost of two opposite points from its quadratic prediction, as a fraction of
#: the prediction, that shows a non-smooth cost.
KINK_SHARE = 0.5
#: Distances from the estimates at which short searches start, in standard errors under white noise. The key
#: is whether the cost is non-smooth.
DISTANCES = {False: (10.0,), True: (3.0, 10.0, 30.0, 100.0, 3.0, 10.0, 30.0, 100.0)}
#: Number of iterations of a short search around the estimates (SHORT_ITERATIONS). If the cost is non-smooth,
#: a second search with LONG_ITERATIONS starts from the two best end points.
SHORT_ITERATIONS, LONG_ITERATIONS = 3, 10
#: Values at which a parameter with a non-smooth effect is tested: multiples of its typical scale
#: (SCALE_FACTORS), and multiples of its estimate (ESTIMATE_FACTORS). Multiples of the scale help if the
#: estimate is far from the best value. A free decay with dry friction has a local minimum for every number of
#: half swings before the body sticks.
SCALE_FACTORS, ESTIMATE_FACTORS = (0.25, 1.0, 3.0), (0.6, 0.8, 0.9, 1.1, 1.25, 1.6)
#: Distance from the bound at which a parameter at a bound is tested, in typical scales of the parameter.
INSIDE = 1.0
#: Maximum step along a direction that the data hardly determine, as a fraction of the parameter values.
MAX_STEP_SHARE = 0.5
#: Minimum decrease of the sum of squared residuals that counts as a lower cost, in units of the residual
#: variance. Such a decrease moves an estimate by about a thirtieth of its standard error.
IMMATERIAL = 1e-3


@dataclass(frozen=True)
class Surroundings:
    """Result of a search around the estimates of a fit."""

    #: Point with a lower cost than the estimates, shape (p,); None if there is none.
    point: Array | None
    #: Number of simulations of single trials that the search needed.
    evaluations: int
    #: Whether the cost is not smooth: :attr:`Parameter.kinked` of a parameter is set, or the cost deviates
    #: from its quadratic prediction.
    rough: bool


def search_around(result: FitResult, *, jobs: int = 1, seed: int = 0) -> Surroundings:
    """Search for a lower cost around the estimates of a fit.

    If the cost is smooth, all starting points use the derivatives at the estimates for one step. If this step
    leads at least half of the way back to the estimates, measured in residuals, the starting point is not
    searched further. Otherwise the search continues with new derivatives.
    """
    if not len(result.labels):
        return Surroundings(None, 0, False)
    problem = rebuild_problem(result, jobs=jobs)
    rng = np.random.default_rng(seed)
    theta = np.asarray(result.estimate, dtype=float)
    here = _squares(problem, theta)
    rows = problem.blocks(theta)
    variance = here / max(result.samples - len(theta), 1)
    steps = _standard_steps(problem, theta, rows, variance)
    material = max(IMMATERIAL * here / max(result.samples, 1), 1e-9 * here)
    ends: list[tuple[float, Array]] = []
    rough = is_kinked(result)
    for _ in range(N_PAIRS):
        step = PAIR_DISTANCE * steps @ _unit(rng, len(theta))
        pair = [np.clip(theta + sign * step, problem.lower, problem.upper) for sign in (1.0, -1.0)]
        costs = [_squares(problem, point) for point in pair]
        ends += list(zip(costs, pair, strict=True))
        if not rough and np.allclose(pair, (theta + step, theta - step)):
            rough = not _smooth(problem, theta, rows, step, KINK_SHARE * variance)
        starts = [
            np.clip(theta + far * steps @ _unit(rng, len(theta)), problem.lower, problem.upper)
            for far in DISTANCES[rough]
        ]
    starts += _inside(problem, result, theta, rough)
    tolerance = 0.1 * material / max(here, 1e-300)
    if rough:
        found = _search_briefly(problem, starts, SHORT_ITERATIONS, tolerance)
        lowest = [point for _, point in sorted(found, key=lambda end: end[0])[:2]]
        ends += found + _search_briefly(problem, lowest, LONG_ITERATIONS, tolerance)
    else:
        for start in starts:
            ends += _search_smooth(problem, theta, rows, start, here - material, tolerance)
    lower = [end for end in ends if end[0] < here - material]
    _, point = min(lower, key=lambda end: end[0], default=(here, None))
    return Surroundings(point, problem.evaluations, rough)


def _search_smooth(
    problem: Problem, theta: Array, rows: Blocks, start: Array, limit: float, tolerance: float
) -> list[tuple[float, Array]]:
    """Return the cost and the end point of one step, and of a short search if the step is not sufficient.

    The step begins at ``start`` and uses the derivatives ``rows``, which belong to ``theta``. The short
    search follows if the cost after the step is not below ``limit``, and if more than half of the distance to
    ``theta`` remains.
    """
    solution = minimise(problem.residuals, lambda _: rows, start, problem.box, max_iterations=1)
    cost = solution.cost if np.isfinite(solution.cost) else np.inf
    before, after = (float(np.linalg.norm(rows.along(p - theta))) for p in (start, solution.x))
    # If the residuals do not depend on the parameter that was moved, both distances are 0.
    if cost < limit or after < 0.5 * before:
        return [(cost, solution.x)]
    return [(cost, solution.x), *_search_briefly(problem, [solution.x], SHORT_ITERATIONS, tolerance)]


def rebuild_problem(result: FitResult, *, jobs: int = 1) -> Problem:
    """Return the least-squares problem of a fit with its final weights."""
    fitted = [t for t in result.trials if t.role == "fit"]
    problem = Problem(result.model, result.parameters, fitted, jobs=jobs)
    set_weights(problem, result)
    return problem


def set_weights(problem: Problem, result: FitResult) -> None:
    """Set the weights of a problem to the final weights of a fit of the same trials."""
    known = {(s.trial, s.channel): s for s in result.series}
    for k, trial in enumerate(problem.trials):
        problem.sd[k] = [known[trial.id, channel].sd for channel in problem.channels[k]]


def _smooth(problem: Problem, theta: Array, rows: Blocks, step: Array, allowed: float) -> bool:
    """Return whether the cost is smooth along a step.

    The mean cost of two opposite points is compared with its quadratic prediction. If the deviation exceeds
    both ``allowed`` and the fraction :data:`KINK_SHARE` of the prediction, nearer points are compared. The
    deviation falls with the fourth power of the step if the cost is smooth. With a kink it falls with the
    step, and with a piecewise constant cost it falls with the square of the step.
    """
    before = math.nan
    for nearer in (1.0, 4.0, 16.0):
        ends = [_squares(problem, theta + sign * step / nearer) for sign in (1.0, -1.0)]
        predicted = float(np.sum(rows.along(step / nearer) ** 2))
        off = abs(0.5 * sum(ends) - _squares(problem, theta) - predicted)
        # At a quarter of the distance, 1/256 of the deviation remains if the cost is smooth, and 1/16 if it
        # is piecewise constant.
        if off < before / 32.0 or (nearer == 1.0 and off <= max(KINK_SHARE * predicted, allowed)):
            return True
        before = off
    return False


def is_kinked(result: FitResult) -> bool:
    """Return whether an estimated parameter makes the cost non-smooth (:attr:`Parameter.kinked`)."""
    return any(p.kinked and p.free for p in result.parameters)


def _search_briefly(
    problem: Problem, starts: list[Array], iterations: int, tolerance: float
) -> list[tuple[float, Array]]:
    """Return the cost and the end point of a short search from each starting point."""
    found = [problem.solve(start, tolerance=tolerance, max_iterations=iterations) for start in starts]
    return [(solution.cost, solution.x) for solution in found if np.isfinite(solution.cost)]


def _squares(problem: Problem, theta: Array) -> float:
    r = problem.residuals(theta)
    return float(r @ r)


def _unit(rng: np.random.Generator, size: int) -> Array:
    """Return a random unit vector with ``size`` components."""
    direction = rng.normal(size=size)
    return np.asarray(direction / np.linalg.norm(direction))


def _standard_steps(problem: Problem, theta: Array, rows: Blocks, variance: float) -> Array:
    """Return steps of one standard error in independent directions, as columns, shape (p, p).

    The standard errors are those under white noise.
    """
    at_bound = (theta <= problem.lower) | (theta >= problem.upper)
    values, vectors = np.linalg.eigh(rows.scale_columns(np.where(at_bound, 0.0, problem.scale)).normal())
    sizes = np.sqrt(variance / np.maximum(values, 1e-300))
    largest = MAX_STEP_SHARE * np.max(np.maximum(np.abs(theta), problem.scale) / problem.scale)
    steps = vectors * np.minimum(sizes, largest)
    steps[at_bound] = 0.0
    return np.asarray(problem.scale[:, None] * steps)


def _inside(problem: Problem, result: FitResult, theta: Array, rough: bool) -> list[Array]:
    """Return starting points that differ from the estimates in one parameter.

    A parameter at a bound is moved away from the bound. A parameter with a non-smooth effect is set to
    several values. Parameters of single trials are included only if the cost is not smooth.
    """
    found = []
    for j, label in enumerate(problem.labels):
        per_trial = "[" in label
        if per_trial and not rough:
            continue
        lower, upper, scale, values = problem.lower[j], problem.upper[j], problem.scale[j], []
        if result.parameter(label).kinked and not per_trial:
            values = [size * scale for size in SCALE_FACTORS] + [
                f * theta[j] for f in ESTIMATE_FACTORS if theta[j]
            ]
        elif theta[j] - lower < 1e-3 * scale:
            values = [lower + INSIDE * scale]
        elif upper - theta[j] < 1e-3 * scale:
            values = [upper - INSIDE * scale]
        for value in values:
            point = theta.copy()
            point[j] = np.clip(value, lower, upper)
            found.append(point)
    return found


# ---------------------------------------------------------------- initial states of held-out trials


def estimate_start(
    model: Model,
    parameters: tuple[Parameter, ...],
    trial: Trial,
    sd: Mapping[str, float],
    *,
    tolerance: float = START_RTOL,
) -> dict[str, float]:
    """Estimate the per-trial parameters of one trial, with the shared parameters held.

    A held-out trial has its own initial pose, initial speed and clock offset. These values are estimated,
    because they are not part of the test.

    Parameters
    ----------
    parameters : tuple of Parameter
        Parameters of the model. Shared parameters are held at ``start``; free per-trial parameters are
        estimated.
    sd : mapping of channel name to float
        Standard deviation of the noise of each channel, for the sample weights. Other channels are not used.

    Returns
    -------
    dict of str to float
        Estimates by label ``name[trial]``.
    """
    held = [replace(p, free=p.free and p.per_trial) for p in parameters]
    used = {c: v for c, v in trial.measured.items() if c in sd}
    problem = Problem(model, held, [replace(trial, role="fit", measured=used)])
    if not problem.labels:
        return {}
    problem.sd[0] = [np.full(len(trial.time_s), sd[channel]) for channel in problem.channels[0]]
    begin = problem.start
    if problem.find_broken(begin):
        # The simulation may diverge because the initial state was estimated with other coefficients. Start
        # from the default values then.
        begin = np.clip([held[i].start for i, _ in problem.slots], problem.lower, problem.upper)
    solution = problem.solve(begin, tolerance=tolerance, watch=Patience())
    return {label: float(v) for label, v in zip(problem.labels, solution.x, strict=True)}


def with_held_out(result: FitResult) -> FitResult:
    """Return the result of a fit with each validation trial simulated from its own initial state.

    The initial state is estimated from the validation trial, with the shared parameters held.
    """
    waiting = [t for t in result.trials if t.role == "validate"]
    sd = {name: noise.value_sd for name, noise in result.noise.items()}
    found: dict[str, float] = {}
    for trial in waiting:
        found |= estimate_start(result.model, result.at_estimates(), trial, sd)
    if not found:
        return result
    result = replace(result, start_states=found)
    shown = {t.id: result.model.run(result.values(t.id), t) for t in waiting}
    series = [replace(s, simulated=shown.get(s.trial, {}).get(s.channel, s.simulated)) for s in result.series]
    return replace(result, series=series)
