"""Report failed samples (frozen, jumped or displaced markers) as a cause of the gap."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from swimid.diagnosis import shrinkage
from swimid.diagnosis.floor import by_channel, rms
from swimid.diagnosis.gap_file import Cause, Shrinkage, Value
from swimid.diagnosis.search import State
from swimid.effects.sensing import MarkerDropout
from swimid.fitting.model import Trial

#: Minimum number of failed samples, and minimum sum of their squared residuals in units of the noise
#: variance. Failed samples below either minimum are not reported as a cause.
FAILED, FAILED_MISFIT = 4, 50.0
#: Probability that a marker really failed if there are failed samples and a cause outside the catalogue. In
#: blind tests this was true in one of two such cases, because a body that slips or sticks also jumps.
REAL = 0.5


def misfit(state: State, raw: Sequence[Trial], floor: Mapping[str, float]) -> float:
    """Return the sum of squared residuals of the failed samples, in units of the noise variance.

    The result is 0 if there are too few failed samples, or if the sum is too small.

    Parameters
    ----------
    raw : sequence of Trial
        The fitted trials, failed samples included.
    """
    if state.dropouts.count < FAILED:
        return 0.0
    squares = _squares(state, raw)
    total = sum(squares[c][0] / max(floor[c], 1e-300) ** 2 for c in floor if c in squares)
    return total if total > FAILED_MISFIT else 0.0


def _squares(state: State, raw: Sequence[Trial]) -> dict[str, tuple[float, int]]:
    """Return, by channel, the sum of squared model errors at failed samples and the number of samples."""
    found: dict[str, tuple[float, int]] = {}
    simulated = state.nominal.problem.simulations(state.nominal.theta)
    for trial, run in zip(raw, simulated, strict=True):
        for channel, mask in state.dropouts.masks.get(trial.id, {}).items():
            error = (trial.measured[channel] - run[channel])[mask]
            total, count = found.get(channel, (0.0, 0))
            found[channel] = total + float(np.nansum(error**2)), count + int(np.isfinite(error).sum())
    return found


def among(
    state: State,
    causes: list[Cause],
    raw: Sequence[Trial],
    floor: Mapping[str, float],
    size: float,
    ranges: Mapping[str, float],
) -> list[Cause]:
    """Return the causes in the order of their gain, with the failed samples inserted as one of them.

    Parameters
    ----------
    size : float
        Sum of squared residuals of the failed samples, in units of the noise variance.
    ranges : mapping of channel to float
        Measured range, in the channel's unit.
    """
    closing = {s.channel: s for s in causes[0].shrinkage} if causes else {}
    sound = by_channel(state.nominal, state.nominal.residuals)
    for channel, (squares, count) in _squares(state, raw).items():
        if channel not in floor or not count:
            continue
        own, span = sound[channel], ranges[channel]
        before = math.sqrt((float(np.sum(own**2)) + squares) / (len(own) + count)) / span
        after = closing[channel].after if channel in closing else None
        after = rms(own) / span if after is None else after
        level = min(floor[channel] / span, before, after)
        closed = shrinkage.closed(before, after, level)
        closing[channel] = Shrinkage(
            channel=channel, before=before, after=after, shipped=before, floor=level, closed=closed
        )
    stretches = state.dropouts.stretches
    kinds = ", ".join(sorted({s.kind for s in stretches}))
    samples = sum(int(np.isfinite(y).sum()) for t in raw for y in t.measured.values())
    effect = Cause(
        effect=MarkerDropout.name,
        probability=1.0 - (1.0 - REAL) * state.posterior.outside,
        parameters={
            "failed_share": Value(value=state.dropouts.count / max(samples, 1), unit="1"),
            "first_failure_s": Value(value=min(s.begin for s in stretches), unit="s"),
        },
        stage=MarkerDropout.stage,
        meaning=f"{MarkerDropout.meaning} ({kinds}; in {len({s.trial for s in stretches})} trials)",
        sources=list(MarkerDropout.sources),
        gain=size,
    )
    of_all = {
        "shrinkage": list(closing.values()),
        "absorbed": causes[0].absorbed if causes else [],
        "extrapolation": causes[0].extrapolation if causes else {},
    }
    first, *rest = sorted([*causes, effect], key=lambda c: -(c.gain or 0.0))
    bare: dict[str, Any] = {"shrinkage": [], "absorbed": [], "extrapolation": {}}
    return [first.model_copy(update=of_all), *(c.model_copy(update=bare) for c in rest)]
