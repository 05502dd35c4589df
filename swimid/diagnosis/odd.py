"""Does one trial contradict the others, so that what is wrong is wrong in it alone?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.floor import split
from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.model import Array
from swimid.fitting.odd_trial import MIN_TRIALS, Odd, odd_trial

#: One trial is asked about where it has more of the squared gap than all the others together.
MAJORITY = 0.5


def contradicting(
    context: FitContext, nominal: Fit, residuals: Sequence[Array], floor: Mapping[str, float]
) -> Odd | None:
    """The trial that has most of the gap, if the others do not predict it as they predict one another.

    Parameters
    ----------
    nominal : Fit
        The model without effects.
    residuals : sequence of ndarray, shape (n_k,)
        What it leaves, weighted.
    floor : mapping of channel to float
        Noise of each channel, in its unit.
    """
    if len(context.trials) < MIN_TRIALS or not context.folds.whole:
        return None
    excess = np.array([_excess(nominal, k, r, floor) for k, r in enumerate(residuals)])
    if not excess.max() > MAJORITY * excess.sum():
        return None
    known = dict(zip(nominal.labels, nominal.theta, strict=True))
    here = [
        replace(p, start=float(known[p.name])) if p.name in known and not p.per_trial else p
        for p in context.parameters
    ]
    try:
        return odd_trial(output_error.fit(context.model, context.trials, parameters=here, tested=False))
    except NoTrustworthyResult:
        return None


def _excess(fit: Fit, k: int, residual: Array, floor: Mapping[str, float]) -> float:
    """Squared residuals of a trial beyond those of the noise, in units of it; none where there are fewer."""
    parts = split(fit, k, residual).items()
    return max(sum(float(np.nansum((v / max(floor[c], 1e-300)) ** 2 - 1.0)) for c, v in parts), 0.0)
