"""Propose the next experiment: the trial that best distinguishes rival causes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import chdtri

import swimid
from swimid.diagnosis import proposals
from swimid.diagnosis.crossval import project_out, solve_normal
from swimid.diagnosis.gap_file import Advice
from swimid.diagnosis.proposals import Proposal, Segment, TrialLimits
from swimid.diagnosis.screening import is_sound
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.fitting.model import Array, Trial
from swimid.fitting.problem import Problem, map_in_processes
from swimid.logs.log import Log

#: Maximum number of proposed experiments in a report.
MAX_ADVICE = 4
#: Probability with which noise alone makes a smaller difference than :func:`compute_threshold`.
CONFIDENCE_LEVEL = 0.95
#: Name of the command file of a proposed trial if the user gives none.
COMMAND_FILE = "next.csv"


def compute_threshold(rivals: Sequence[Hypothesis]) -> float:
    """Return the difference between two rivals that noise alone may make, in noise standard deviations.

    A refit to pure noise lowers the squared residuals by a chi-square variable. Its degrees of freedom are
    the number of parameters that act on one trial.
    """
    most = max(len(fit.problem.taken[0]) for fit in rivals)
    return math.sqrt(float(chdtri(most, 1.0 - CONFIDENCE_LEVEL)))


def advise_trials(
    study: GapStudy, rivals: Sequence[Hypothesis], limits: TrialLimits, now: float
) -> list[Advice]:
    """Rank proposed trials by how well they would distinguish the first rival cause from the others.

    A trial distinguishes two rivals if their difference exceeds what noise alone may make. Trials that
    distinguish more rivals come first, then those with a larger difference. The last advice names the rivals
    that no trial distinguishes.

    Parameters
    ----------
    rivals : sequence of Hypothesis
        At least two fits, each with one of the rival causes.
    now : float
        Difference between the first two rival fits on the present trials, in noise standard deviations. It is
        the square root of the difference of their held-out squared residuals.
    """
    protocol = proposals.protocol_of(study.model, study.trials, limits)
    if protocol is None:
        return []
    models = [RivalModel(study, fit) for fit in rivals]
    length_m = proposals.tank_length(study.trials, limits)
    first, *others = [fit.effects[-1].name for fit in rivals]
    least = compute_threshold(rivals)

    def evaluate(segments: Sequence[Segment]) -> Advice | None:
        found = proposals.shorten(
            protocol, segments, length_m, lambda trial: [one.simulate(trial) for one in models]
        )
        if found is None:
            return None
        advice = Advice(text=found.text, noise=least, now=now)
        sizes = [compute_difference(models[0], other, found.trial) for other in models[1:]]
        apart = {name: size for name, size in zip(others, sizes, strict=True) if size > least}
        if apart:
            advice.separates, advice.difference = [first, *apart], min(apart.values())
            advice._command = _log(found, advice, limits)
        return advice

    made = map_in_processes(evaluate, proposals.PROPOSALS, study.jobs)
    possible = {a.text: a for a in made if a is not None}
    found = [a for a in possible.values() if a.separates]
    found.sort(key=lambda a: (-len(a.separates), -(a.difference or 0.0)))
    left = [name for name in others if not any(name in a.separates for a in found)]
    found = found[:MAX_ADVICE]
    if left:
        found.append(Advice(text=_nothing(first, left, len(possible), length_m, least), noise=least))
    return found


def _nothing(first: str, left: Sequence[str], count: int, length_m: float, least: float) -> str:
    """Return a clause about rivals that no proposed trial distinguishes."""
    rivals = f"{first} from {' or '.join(left)}"
    if not count:
        return (
            f"none: no trial of {proposals.MIN_SEGMENT_BEATS:g} beats and "
            f"{proposals.MIN_PROPOSAL_SAMPLES} samples keeps the limits (a path of at most {length_m:.3g} "
            f"m), so that none separates {rivals}"
        )
    return (
        f"none: of {count} possible trials none separates {rivals} by more than noise alone could "
        f"({least:.2g} standard deviations)"
    )


def _log(proposal: Proposal, advice: Advice, limits: TrialLimits) -> Log:
    """Return the command file of a proposed trial."""
    sizes = {"difference": advice.difference, "noise": advice.noise, "now": advice.now}
    metadata = {
        "made_by": "swimid diagnose",
        "version": swimid.__version__,
        "robot": limits.experiment.robot.name,
        "experiment": limits.experiment.name,
        "run": advice.text,
        "separates": advice.separates,
        **{name: float(f"{size:.3g}") for name, size in sizes.items()},
        "trial": {"id": Path(COMMAND_FILE).stem, "log": COMMAND_FILE, **proposal.entry},
    }
    return Log(Path(COMMAND_FILE), metadata, dict(proposal.columns), None)


# ---------------------------------------------------------------- difference between rivals


class RivalModel:
    """Fitted model with a rival cause, which predicts proposed trials.

    Attributes
    ----------
    values : mapping of str to float
        Estimate of each parameter by name. A parameter with a value for each trial has its mean.
    sd : mapping of channel to float
        Typical noise of each measured channel.
    shared : list of str
        Names of the parameters that all trials share.
    precision : ndarray, shape (shared, shared)
        Precision matrix of these parameters from the present trials and the priors. The parameters of single
        trials are projected out.
    """

    def __init__(self, study: GapStudy, fit: Hypothesis) -> None:
        self.study, self.fit = study, fit
        problem = fit.problem
        names = np.array([problem.parameters[index].name for index, _ in problem.slots])
        self.values = {str(name): float(np.mean(fit.theta[names == name])) for name in names}
        sd: dict[str, list[Array]] = {}
        for channels, series in zip(problem.channels, problem.sd, strict=True):
            for channel, own in zip(channels, series, strict=True):
                sd.setdefault(channel, []).append(own)
        self.sd = {channel: float(np.median(np.concatenate(own))) for channel, own in sd.items()}
        shared = [j for j, (_, owner) in enumerate(problem.slots) if owner is None]
        self.shared = [fit.labels[j] for j in shared]
        self.precision = study.precision(problem)[np.ix_(shared, shared)]
        for k, residuals in enumerate(fit.residuals):
            # The function project_out() expects the residuals in the last column.
            block = np.column_stack((fit.columns(k, shared), residuals))
            seen = project_out(study, fit, k, block)[:, :-1]
            self.precision = self.precision + seen.T @ seen

    def problem(self, trial: Trial) -> tuple[Problem, Array]:
        """Return the residual problem of a proposed trial, measured as zero, and its estimates."""
        measured = {channel: np.zeros(len(trial.time_s)) for channel in self.sd}
        trial = replace(trial, measured=measured)
        problem = self.study.problem(self.fit.effects, jobs=1, trials=[trial])
        problem.sd[0] = [np.full(len(trial.time_s), self.sd[c]) for c in problem.channels[0]]
        own = [self.values.get(problem.parameters[index].name, math.nan) for index, _ in problem.slots]
        return problem, np.where(np.isnan(own), problem.start, own)

    def simulate(self, trial: Trial) -> dict[str, Array]:
        """Return all channels of a proposed trial, measured or not."""
        problem, theta = self.problem(trial)
        return problem.model.run(problem.vector(theta, 0), problem.trials[0])

    def predict(self, trial: Trial) -> tuple[Array, Array, Array]:
        """Return the whitened samples of a proposed trial, their derivatives, and the prior precision.

        The derivatives have one column for each parameter that acts on the trial.
        """
        problem, theta = self.problem(trial)
        noise = self.study.noise
        samples = -noise.whiten(problem, 0, problem.trial_residuals(theta, 0))
        rows = -noise.whiten(problem, 0, problem.trial_jacobians(theta)[0])
        _, weight = self.study.compute_prior(problem)
        precision = np.diag(weight**2)
        at = [problem.labels.index(name) for name in self.shared]
        precision[np.ix_(at, at)] = self.precision
        return samples, rows, precision


def compute_difference(first: RivalModel, second: RivalModel, trial: Trial) -> float:
    """Return the difference between two rivals in a proposed trial, in noise standard deviations.

    It is the root of the squared residuals that one rival has if the other one is right, after its parameters
    have been refitted to the present trials and this one. The smaller value of both cases is returned.
    """
    one, other = first.predict(trial), second.predict(trial)
    apart = one[0] - other[0]
    if not is_sound(apart):
        return 0.0
    left = []
    for _, rows, precision in (one, other):
        right = (rows.T @ apart)[:, None]
        taken = right.T @ solve_normal(rows.T @ rows + precision, right)
        left.append(float(apart @ apart - taken[0, 0]))
    return math.sqrt(max(min(left), 0.0))
