"""Divide the data into folds: repeats of one setting, runs of a table, or segments of trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swimid.diagnosis import settings
from swimid.fitting.model import Array, Trial

#: Minimum number of settings or trials for folds of whole trials. With fewer, segments of trials are held
#: out.
FEWEST = 4
#: Minimum total number of segments into which a few trials are divided.
STRETCHES = 8
#: Number of folds of a table of runs. A table with at most this number of settings has one fold for each
#: setting.
TABLE_FOLDS = 10


@dataclass(frozen=True)
class Folds:
    """Parts of the data that are held out in turn.

    Attributes
    ----------
    whole : bool
        True if whole trials are held out; the start state of a held-out trial is then fitted to this trial.
        False if segments of trials are held out.
    owner : list of ndarray of int
        Fold of each row of each trial, shape (n_k,).
    labels : list of str
        Name of each fold.
    """

    whole: bool
    owner: list[Array]
    labels: list[str]

    @property
    def count(self) -> int:
        """Return the number of folds."""
        return len(self.labels)


def folds(trials: Sequence[Trial], rows: Sequence[int]) -> Folds:
    """Divide trials into folds.

    Parameters
    ----------
    rows : sequence of int
        Number of rows (samples of all channels) of each trial.
    """
    names = [settings.repeated(t) for t in trials]
    groups = list(dict.fromkeys(names))
    if len(groups) < FEWEST <= len(trials):
        names = [t.id for t in trials]
        groups = list(dict.fromkeys(names))
    if len(groups) >= FEWEST:
        place = {g: i for i, g in enumerate(groups)}
        labels = [" ".join(t.id for t, n in zip(trials, names, strict=True) if n == g) for g in groups]
        if all(n == 1 for n in rows) and len(groups) > TABLE_FOLDS:
            # Runs are assigned to the folds in turn, so that neighbouring rows of the table are in different
            # folds.
            place = {g: i % TABLE_FOLDS for i, g in enumerate(groups)}
            labels = [f"part {i + 1}" for i in range(TABLE_FOLDS)]
        return Folds(True, [np.full(n, place[name]) for n, name in zip(rows, names, strict=True)], labels)
    per = -(-STRETCHES // len(trials))
    labels = [f"{t.id}, part {i + 1}" for t in trials for i in range(per)]
    owner = [np.zeros(n, dtype=int) + per * k for k, n in enumerate(rows)]
    return Folds(False, owner, labels)


def stretches(folds: Folds, k: int, times: Sequence[Array]) -> Array:
    """Return the fold of each row of trial ``k``, which is divided into segments of equal duration.

    Parameters
    ----------
    times : sequence of ndarray
        Times of the samples of each channel, in the order of the rows.
    """
    if folds.whole:
        return folds.owner[k]
    per = folds.count // len(folds.owner)
    stacked = np.concatenate(list(times)) if len(times) else np.empty(0)
    if not len(stacked):
        return folds.owner[k]
    low, high = float(stacked.min()), float(stacked.max())
    part = np.minimum(((stacked - low) / max(high - low, 1e-12) * per).astype(int), per - 1)
    return np.asarray(per * k + part)
