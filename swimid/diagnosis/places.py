"""Locate the gap between model and trials: by channel, stroke phase, setting and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from swimid.diagnosis import settings
from swimid.diagnosis.gap_file import Cell
from swimid.diagnosis.remainder import beat_hz
from swimid.diagnosis.study import Fit, Study

#: Number of bins of the stroke phase in which the gap is computed.
PHASES = 8
#: Maximum number of trials for which the gap is listed trial by trial.
MOST_TRIALS = 30
#: Duration of the start-up of a trial: number of beats (START_BEATS), or fraction of the duration of a trial
#: without a beat (START_SHARE).
START_BEATS, START_SHARE = 3.0, 0.2


class Map:
    """Table of the squared residual of each sample divided by the squared noise floor.

    Parameters
    ----------
    floors : mapping of channel to float
        Noise floor of each channel, in the unit of the channel.
    """

    def __init__(self, study: Study, fit: Fit, floors: Mapping[str, float]) -> None:
        self.trials = study.trials
        parts = []
        for k, (trial, residual) in enumerate(zip(self.trials, fit.residuals, strict=True)):
            time = trial.time_s
            known = {
                "trial": k,
                "time_s": time,
                "phase": np.minimum((time * beat_hz(trial) % 1.0 * PHASES).astype(int), PHASES - 1),
            }
            for channel, series in fit.split(k, residual).items():
                square = (series / max(floors.get(channel, 1.0), 1e-300)) ** 2
                parts.append(pd.DataFrame({**known, "channel": channel, "square": square}))
        #: One row for each sample of each channel. ``square`` is missing if the sample was not measured.
        self.samples = pd.concat(parts, ignore_index=True)
        self.total = max(float(np.sum(self.samples["square"].dropna().to_numpy() - 1.0)), 1e-12)

    def cells(self, kind: str, labels: pd.Series) -> list[Cell]:
        """Return the gap for each label, over all channels, where each sample has one of the labels."""
        return [
            Cell(
                kind=kind,
                label=str(label),
                ratio=float(np.sqrt(np.mean(squares.to_numpy()))),
                share=float(np.clip(np.sum(squares.to_numpy() - 1.0) / self.total, 0.0, 1.0)),
            )
            for label, squares in self.samples["square"].dropna().groupby(labels, sort=False)
        ]

    def of_trials(self, values: Sequence[Any]) -> pd.Series:
        """Return, for each sample, the value of the trial to which the sample belongs."""
        return self.samples["trial"].map(dict(enumerate(values)))


def regimes(where: Map) -> list[Cell]:
    """Return the gap at each value of each setting, and in each trial."""
    known = pd.DataFrame([{**settings.words(t), "trial": t.id} for t in where.trials])
    found = []
    for kind in known:
        labels = known[kind]
        if labels.nunique() > 1 and (kind != "trial" or len(labels) <= MOST_TRIALS):
            found += where.cells(str(kind), where.of_trials(labels))
    return found


def phases(where: Map) -> list[Cell]:
    """Return the gap in each bin of the stroke phase; empty if no trial has a drive."""
    if not any(t.swim.drive is not None for t in where.trials):
        return []
    edges = [round(360 * i / PHASES) for i in range(PHASES + 1)]
    labels = {i: f"{edges[i]}-{edges[i + 1]} deg" for i in range(PHASES)}
    return where.cells("phase", where.samples["phase"].map(labels))


def times(where: Map) -> list[Cell]:
    """Return the gap during the start-up of the trials, and during the steady motion after it."""
    ends = []
    for t in where.trials:
        if len(t.time_s) < 10:
            return []
        span = float(t.time_s[-1] - t.time_s[0])
        driven = t.swim.drive is not None
        start = min(START_BEATS / beat_hz(t), 0.5 * span) if driven else START_SHARE * span
        ends.append(t.time_s[0] + start)
    time = where.samples["time_s"]
    early = time <= where.of_trials(ends)
    return where.cells("time", early.map({True: "start-up", False: "steady"}))
