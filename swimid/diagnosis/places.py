"""Locate the gap between model and trials: noise floors, channels, stroke phases, settings and times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from swimid.diagnosis import settings
from swimid.diagnosis.gap_file import Cell, ChannelGap, Where
from swimid.diagnosis.noise import join_channels
from swimid.diagnosis.remainder import beat_hz
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.results.evidence import compute_rms

#: Number of bins of the stroke phase in which the gap is computed.
PHASES = 8
#: Maximum number of trials for which the gap is listed trial by trial.
MOST_TRIALS = 30
#: Duration of the start-up of a trial: number of beats (START_BEATS), or fraction of the duration of a trial
#: without a beat (START_SHARE).
START_BEATS, START_SHARE = 3.0, 0.2


def compute_floors(study: GapStudy, fit: Hypothesis) -> dict[str, float]:
    """Return the noise floor of each channel in the fitted trials, in its unit.

    It consists of the measurement noise and of the random effects.
    """
    problem = fit.problem
    every = (
        zip(*parts, strict=True) for parts in zip(problem.channels, problem.masks, problem.sd, strict=True)
    )
    squares = join_channels((channel, sd[mask] ** 2) for channel, mask, sd in chain(*every))
    return {c: study.noise.floor(c) * float(np.sqrt(np.mean(values))) for c, values in squares.items()}


def locate_gap(
    study: GapStudy, fit: Hypothesis, floors: Mapping[str, float], ranges: Mapping[str, float]
) -> Where:
    """Return the location of the gap that a fit leaves: by channel, phase, setting and time.

    The stage of the simulation in which the cause of the gap acts is not part of the result.

    Parameters
    ----------
    floors, ranges : mapping of channel to float
        Noise floor and measured range of each channel, in the unit of the channel.
    """
    units = {c.name: c.unit for c in study.model.channels}
    squares = {c: (v / max(floors[c], 1e-300)) ** 2 - 1.0 for c, v in fit.by_channel().items()}
    beyond = {c: max(float(np.sum(v)), 0.0) for c, v in squares.items()}
    total = sum(beyond.values()) or 1.0
    channels = []
    for channel, left in fit.by_channel().items():
        rmse, size = compute_rms(left), ranges[channel]
        errors = {"rmse": rmse, "nrmse": rmse / size, "floor": floors[channel] / size}
        share, unit = beyond[channel] / total, units.get(channel, "1")
        channels.append(ChannelGap(channel=channel, share=share, unit=unit, **errors))
    cells = Map(study, fit, floors)
    found = Where(channels=channels, stage={})
    found.regime, found.phase, found.time = regimes(cells), phases(cells), times(cells)
    return found


class Map:
    """Squared residual of each measured sample divided by the squared noise floor.

    Parameters
    ----------
    floors : mapping of channel to float
        Noise floor of each channel, in the unit of the channel.

    Attributes
    ----------
    trial : ndarray of int, shape (n,)
        Index of the trial of each sample.
    time_s, squares : ndarray, shape (n,)
    """

    def __init__(self, study: GapStudy, fit: Hypothesis, floors: Mapping[str, float]) -> None:
        self.trials = study.trials
        trial, time_s, squares = [], [], []
        for k in range(len(self.trials)):
            for channel, series in fit.split(k).items():
                there = np.isfinite(series)
                trial.append(np.full(int(there.sum()), k))
                time_s.append(self.trials[k].time_s[there])
                squares.append((series[there] / max(floors.get(channel, 1.0), 1e-300)) ** 2)
        self.trial, self.time_s, self.squares = (np.concatenate(part) for part in (trial, time_s, squares))
        self.total = max(float(np.sum(self.squares - 1.0)), 1e-12)

    def cells(self, kind: str, labels: Sequence[str], index: NDArray[np.intp]) -> list[Cell]:
        """Return the gap of the samples with each label, over all channels.

        Parameters
        ----------
        index : ndarray of int, shape (n,)
            Index of the label of each sample; a sample with the index -1 has no label.
        """
        found = []
        for i, label in enumerate(labels):
            squares = self.squares[index == i]
            if len(squares):
                share = float(np.clip(np.sum(squares - 1.0) / self.total, 0.0, 1.0))
                found.append(
                    Cell(kind=kind, label=label, ratio=float(np.sqrt(np.mean(squares))), share=share)
                )
        return found


def regimes(where: Map) -> list[Cell]:
    """Return the gap at each value of each setting, and in each trial."""
    known = [{**settings.describe_settings(t), "trial": t.id} for t in where.trials]
    found = []
    for kind in dict.fromkeys(name for of_trial in known for name in of_trial):
        values = [of_trial.get(kind) for of_trial in known]
        labels = list(dict.fromkeys(value for value in values if value is not None))
        if len(labels) > 1 and (kind != "trial" or len(values) <= MOST_TRIALS):
            index = np.array([-1 if value is None else labels.index(value) for value in values])
            found += where.cells(kind, labels, index[where.trial])
    return found


def phases(where: Map) -> list[Cell]:
    """Return the gap in each bin of the stroke phase; empty if no trial has a drive."""
    if not any(t.swim.drive is not None for t in where.trials):
        return []
    edges = [round(360 * i / PHASES) for i in range(PHASES + 1)]
    labels = [f"{begin}-{end} deg" for begin, end in pairwise(edges)]
    beats = where.time_s * np.array([beat_hz(t) for t in where.trials])[where.trial]
    return where.cells("phase", labels, np.minimum((beats % 1.0 * PHASES).astype(int), PHASES - 1))


def times(where: Map) -> list[Cell]:
    """Return the gap during the start-up of the trials, and during the steady motion after it."""
    ends = []
    for t in where.trials:
        if len(t.time_s) < 10:
            return []
        span = float(t.time_s[-1] - t.time_s[0])
        start = START_SHARE * span
        if t.swim.drive is not None:
            start = min(START_BEATS / beat_hz(t), 0.5 * span)
        ends.append(t.time_s[0] + start)
    late = where.time_s > np.array(ends)[where.trial]
    return where.cells("time", ["start-up", "steady"], late.astype(int))
