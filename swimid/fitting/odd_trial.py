"""Which one trial does not agree with the others: each is predicted by a fit of all the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.fit_result import FitResult

#: Fewest trials among which one can be odd: of fewer the others do not show how far off is far.
MIN_TRIALS = 4
#: A trial is odd when chance would put one of them as far off less often than this.
ODD = 1e-2
#: ... and its error of prediction is at least so many times that of the others: less is no mistake in a
#: trial, however regular the others are.
TIMES = 2.0


@dataclass(frozen=True)
class Odd:
    """A trial that the others do not predict."""

    trial: str
    #: Its error of prediction over the others' typical one.
    times: float
    #: Of the most distant of so many trials by Student's t of the logarithms of their errors.
    p_value: float
    #: Of all other trials; this one has the role ``validate``.
    others: FitResult


def odd_trial(result: FitResult) -> Odd | None:
    """The trial that does not agree with the others; None where there is none, or a fit of the others fails.

    The suspect is the one whose absence lowers the misfit of the rest most. Its error, predicted from
    them, is then held against the errors with which each of them is predicted by the rest: what the model
    lacks for all trials is in those errors too, and makes none of them odd.
    """
    names = [t.id for t in result.trials if t.role == "fit"]
    if len(names) < MIN_TRIALS:
        return None
    here = result.at_estimates()

    def without(*left_out: str) -> FitResult:
        trials = [replace(t, role="validate") if t.id in left_out else t for t in result.trials]
        fit = output_error.fit(result.model, trials, parameters=here, tested=False)
        return output_error.with_held_out(fit)

    try:
        fits = {name: without(name) for name in names}
        suspect = min(names, key=lambda name: fits[name].cost)
        # so that channels of other units count alike
        scale = {name: max(noise.value_sd, 1e-300) for name, noise in fits[suspect].noise.items()}
        rest = [name for name in names if name != suspect]
        logs = np.log([_error(without(suspect, name), name, scale) for name in rest])
        far = float(np.log(_error(fits[suspect], suspect, scale)))
    except NoTrustworthyResult:
        return None
    n = len(rest)
    sd = float(np.std(logs, ddof=1))
    if not sd > 0 or not np.isfinite(sd):
        return None
    t = (far - float(np.mean(logs))) / (sd * np.sqrt(1.0 + 1.0 / n))
    # the most distant of n + 1 trials was picked (Bonferroni)
    p_value = min(1.0, (n + 1) * float(special.stdtr(n - 1, -t)))
    times = float(np.exp(far - np.median(logs)))
    return Odd(suspect, times, p_value, fits[suspect]) if p_value < ODD and times >= TIMES else None


def _error(result: FitResult, trial: str, scale: dict[str, float]) -> float:
    """Root-mean-square error of a trial over the noise."""
    own = [s for s in result.series if s.trial == trial and s.channel in scale]
    values = np.concatenate([s.residual / scale[s.channel] for s in own])
    return float(np.sqrt(np.nanmean(values**2)))
