"""Detect failed samples (frozen, jumped or displaced markers), and report them as a cause of the gap."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, median_filter

from swimid.diagnosis.gap_file import Cause, Shrinkage, Value
from swimid.diagnosis.held_out import compute_closed_share
from swimid.effects.sensing import MarkerDropout
from swimid.fitting.model import Array, Trial
from swimid.logs.sampling import step_of
from swimid.results.evidence import compute_rms

if TYPE_CHECKING:
    from swimid.diagnosis.search import SearchResult

#: Minimum change of the residual that counts as a jump, in robust standard deviations of the differences
#: between successive residuals.
JUMP = 9.0
#: Frozen segment: minimum number of equal consecutive values (FROZEN), and minimum motion of the simulation
#: over the segment (MOVED), in robust standard deviations of the differences between successive residuals.
FROZEN, MOVED = 4, 6.0
#: Channels that a camera measures by tracking markers.
CAMERA = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
#: Minimum number of samples of a channel in which failed samples are detected.
MIN_CHANNEL_SAMPLES = 60
#: Maximum fraction of jumped and displaced samples of a channel in a trial. Their detection rests on
#: medians, which break down with more than half of outliers. A larger fraction is an error of the model.
MAX_JUMPED_SHARE = 0.5
#: Minimum offset of the residuals of a displaced segment, in robust standard deviations of the differences
#: between successive residuals.
MIN_OFFSET_SD = 6.0
#: Maximum number of samples on one side of a jump whose median is the level of the residual on that side.
MAX_LEVEL_SAMPLES = 8


class Stretch(NamedTuple):
    """Segment of consecutive failed samples in one channel of one trial.

    The fields ``begin`` and ``end`` are times in s. The field ``kind`` is the failure of the first sample.
    """

    trial: str
    channel: str
    begin: float
    end: float
    kind: str


@dataclass(frozen=True)
class Dropouts:
    """Failed samples of all trials.

    Attributes
    ----------
    masks : dict of trial id to dict of channel to ndarray of bool
        Whether each sample failed.
    stretches : list of Stretch
        Segments of failed samples.
    """

    masks: Mapping[str, Mapping[str, NDArray[np.bool_]]]
    stretches: list[Stretch]

    @property
    def count(self) -> int:
        """Return the number of failed samples."""
        return sum(int(m.sum()) for by in self.masks.values() for m in by.values())

    def confirm(self, other: Dropouts) -> Dropouts:
        """Return the failed samples that a second detection, with a better model, finds as well."""
        kept = [
            s
            for s in self.stretches
            if any(o[:2] == s[:2] and o.begin <= s.end and o.end >= s.begin for o in other.stretches)
        ]
        masks = {}
        for trial, by in self.masks.items():
            again = other.masks.get(trial, {})
            masks[trial] = {c: m & again[c] for c, m in by.items() if c in again}
        return Dropouts(masks, kept)

    def remove_from(self, trials: Sequence[Trial]) -> list[Trial]:
        """Return the trials with all camera channels set to NaN in the frames in which a marker failed."""
        found = []
        for trial in trials:
            masks = self.masks.get(trial.id, {})
            if masks:
                failed = np.logical_or.reduce(list(masks.values()))
                seen = trial.measured.items()
                measured = {c: np.where(failed, np.nan, v) if c in CAMERA else v for c, v in seen}
                trial = replace(trial, measured=measured)
            found.append(trial)
        return found


def detect_failures(trials: Sequence[Trial], simulated: Sequence[Mapping[str, Array]]) -> Dropouts:
    """Detect failed samples by jumps of the residuals and by values that do not change.

    Parameters
    ----------
    simulated : sequence of mappings
        Simulated channels of each trial. The simulation need not be accurate, but it must be smooth.
    """
    masks: dict[str, dict[str, NDArray[np.bool_]]] = {}
    stretches = []
    for trial, model in zip(trials, simulated, strict=True):
        for channel, values in trial.measured.items():
            if channel not in CAMERA or channel not in model or trial.stamps_uncertain:
                continue
            if np.isfinite(values).sum() < MIN_CHANNEL_SAMPLES:
                continue
            kinds = _find_failures(values, model[channel])
            mask = kinds != ""
            if (mask & (kinds != "frozen")).sum() > MAX_JUMPED_SHARE * np.isfinite(values).sum():
                continue
            if mask.any():
                masks.setdefault(trial.id, {})[channel] = mask
            for rows in _runs(mask):
                begin, end = trial.time_s[rows[[0, -1]]].tolist()
                stretches.append(Stretch(trial.id, channel, begin, end, str(kinds[rows[0]])))
    return Dropouts(masks, stretches)


def _runs(mask: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the indices of each group of consecutive true values."""
    parts, count = label(mask)
    return [np.flatnonzero(parts == i) for i in range(1, count + 1)]


def _robust(x: Array) -> float:
    if not len(x):
        return 0.0
    return 1.4826 * float(np.median(np.abs(x - np.median(x))))


def _find_failures(values: Array, simulated: Array) -> NDArray[np.str_]:
    """Return the kind of failure of each sample of one channel; the kind of a valid sample is empty."""
    kinds = np.full(len(values), "", dtype="U9")
    there = np.flatnonzero(np.isfinite(values) & np.isfinite(simulated))
    x, r = values[there], (values - simulated)[there]
    # The variance of the error of values that are rounded to a step q is q² / 12.
    rounded = step_of(x)
    size = max(_robust(np.diff(r)), (rounded or 0.0) / math.sqrt(6.0))
    if size <= 0:
        return kinds
    for rows in _runs(np.concatenate(([False], np.diff(x) == 0.0))):
        moved = np.ptp(simulated[there][rows[0] - 1 : rows[-1] + 1])
        if len(rows) + 1 < FROZEN or moved <= MOVED * size:
            continue
        # Rounded values also repeat while a robot rests and its model drifts. They count as frozen only if
        # the marker jumps when it is tracked again. At the end of a trial, the simulation must instead move
        # by far more than the model error.
        after = x[rows[-1] + 1 : rows[-1] + 2]
        failed = np.abs(after - x[rows[-1]]) > JUMP * size if len(after) else moved > MOVED * _robust(r)
        if rounded is None or np.any(failed):
            kinds[there[rows]] = "frozen"
    smooth = median_filter(r, size=5, mode="nearest")
    spikes = there[np.abs(r - smooth) > JUMP * max(_robust(r - smooth), size / np.sqrt(2.0))]
    kinds[spikes[kinds[spikes] == ""]] = "spike"
    # Detect a displacement: an offset of the median-filtered residual between two jumps, or from a jump to
    # the end of the trial.
    well = kinds[there] == ""
    there, r = there[well], r[well]
    smooth = median_filter(r, size=5, mode="nearest")
    local = np.maximum(size, 1.4826 * median_filter(np.abs(np.diff(r)), size=25, mode="nearest"))
    jumps = np.flatnonzero(np.abs(smooth[4:] - smooth[:-4]) > JUMP * local[2:-1])
    if len(jumps):
        edges = [int(g[len(g) // 2]) + 2 for g in np.split(jumps, np.flatnonzero(np.diff(jumps) > 3) + 1)]
        # Compute the residual level of the last valid samples. A segment that returns to this level is valid.
        sound = float(np.median(r[max(edges[0] - MAX_LEVEL_SAMPLES, 0) : edges[0]]))
        for begin, end in zip(edges, [*edges[1:], len(r)], strict=True):
            level = float(np.median(r[begin : min(begin + MAX_LEVEL_SAMPLES, end)])) if end > begin else sound
            if abs(level - sound) > MIN_OFFSET_SD * size:
                kinds[there[begin:end]] = "displaced"
            elif end > begin:
                sound = float(np.median(r[max(end - MAX_LEVEL_SAMPLES, begin) : end]))
    return kinds


#: Failed samples that are reported as a cause: their minimum number (FAILED), and the minimum sum of their
#: squared residuals in units of the noise variance (FAILED_MISFIT).
FAILED, FAILED_MISFIT = 4, 50.0
#: Probability that detected failures of a marker are real if the gap also has a cause outside the catalogue.
#: In blind tests they were real in one of two such cases, because a body that slips or sticks also jumps.
REAL = 0.5


def compute_misfit(search: SearchResult, raw: Sequence[Trial], floor: Mapping[str, float]) -> float:
    """Return the sum of squared residuals of the failed samples, in units of the noise variance.

    The result is 0 if there are fewer failed samples than FAILED, or if the sum is below FAILED_MISFIT.

    Parameters
    ----------
    raw : sequence of Trial
        The fitted trials, failed samples included.
    """
    if search.dropouts.count < FAILED:
        return 0.0
    squares = _sum_squares(search, raw)
    total = sum(squares[c][0] / max(floor[c], 1e-300) ** 2 for c in floor if c in squares)
    if total <= FAILED_MISFIT:
        return 0.0
    return total


def _sum_squares(search: SearchResult, raw: Sequence[Trial]) -> dict[str, tuple[float, int]]:
    """Return the sum of squared model errors at the failed samples of each channel, and their number."""
    found: dict[str, tuple[float, int]] = {}
    simulated = search.null.problem.simulations(search.null.theta)
    for trial, run in zip(raw, simulated, strict=True):
        for channel, mask in search.dropouts.masks.get(trial.id, {}).items():
            error = (trial.measured[channel] - run[channel])[mask]
            total, count = found.get(channel, (0.0, 0))
            found[channel] = total + float(np.nansum(error**2)), count + int(np.isfinite(error).sum())
    return found


def add_failed_samples(
    search: SearchResult,
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
    sound = search.null.by_channel()
    for channel, (squares, count) in _sum_squares(search, raw).items():
        if channel not in floor or not count:
            continue
        own, span = sound[channel], ranges[channel]
        before = math.sqrt((float(np.sum(own**2)) + squares) / (len(own) + count)) / span
        after = compute_rms(own) / span
        known = closing.get(channel)
        if known is not None and known.after is not None:
            after = known.after
        level = min(floor[channel] / span, before, after)
        closed = compute_closed_share(before**2, after**2, level**2)
        closing[channel] = Shrinkage(
            channel=channel, before=before, after=after, shipped=before, floor=level, closed=closed
        )
    stretches = search.dropouts.stretches
    kinds = ", ".join(sorted({s.kind for s in stretches}))
    samples = sum(int(np.isfinite(y).sum()) for t in raw for y in t.measured.values())
    effect = Cause(
        effect=MarkerDropout.name,
        probability=1.0 - (1.0 - REAL) * search.posterior.outside,
        parameters={
            "failed_share": Value(value=search.dropouts.count / max(samples, 1), unit="1"),
            "first_failure_s": Value(value=min(s.begin for s in stretches), unit="s"),
        },
        stage=MarkerDropout.stage,
        meaning=f"{MarkerDropout.meaning} ({kinds}; in {len({s.trial for s in stretches})} trials)",
        sources=list(MarkerDropout.sources),
        gain=size,
    )
    found = sorted([*causes, effect], key=lambda c: -(c.gain or 0.0))
    # The first entry has the errors and the coefficients with all causes in the model.
    for c in causes[:1]:
        c.shrinkage = []
        c.absorbed, found[0].absorbed = [], c.absorbed
    found[0].shrinkage = list(closing.values())
    return found
