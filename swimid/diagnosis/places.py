"""Where the gap lies: channels, phase of the stroke, regime, time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.floor import split
from swimid.diagnosis.gap_file import Cell
from swimid.diagnosis.generic import beat_hz
from swimid.fitting.model import Array, Trial

Mask = NDArray[np.bool_]
#: Bins of the stroke's phase, and of the time of a trial.
PHASES, TIMES = 8, 6
#: The start-up lasts this many beats, or this share of a trial without a beat.
START_BEATS, START_SHARE = 3.0, 0.2
#: A change point must lower the squared residual by this share of the excess.
CHANGED = 0.3


class Map:
    """Squared residuals over the squared floor, sample by sample.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Of each trial, weighted.
    floors : mapping of channel to float
        In the channels' units.
    """

    def __init__(
        self, context: FitContext, fit: Fit, residuals: Sequence[Array], floors: Mapping[str, float]
    ) -> None:
        self.trials = context.trials
        self.excess: list[dict[str, Array]] = []
        for k, residual in enumerate(residuals):
            series = split(fit, k, residual)
            self.excess.append({c: (r / max(floors.get(c, 1.0), 1e-300)) ** 2 for c, r in series.items()})
        self.channels = sorted({c for by in self.excess for c in by})
        values = [v[np.isfinite(v)] - 1.0 for by in self.excess for v in by.values()]
        self.total = max(float(np.concatenate(values).sum()) if values else 0.0, 1e-12)

    def values(self, pick: list[tuple[int, Mask]], channels: Collection[str]) -> Array:
        """Of some samples: trial and mask over its samples."""
        parts = [v[m & np.isfinite(v)] for k, m in pick for c, v in self.excess[k].items() if c in channels]
        return np.concatenate(parts) if parts else np.empty(0)

    def cell(self, kind: str, label: str, pick: list[tuple[int, Mask]]) -> Cell | None:
        """The gap in some samples, all channels together."""
        values = self.values(pick, self.channels)
        if not len(values):
            return None
        share = float(np.sum(values - 1.0)) / self.total
        return Cell(
            kind=kind,
            label=label,
            ratio=float(np.sqrt(np.mean(values))),
            share=float(np.clip(share, 0.0, 1.0)),
        )

    def every(self, k: int) -> Mask:
        """All samples of a trial."""
        return np.ones(len(self.trials[k].time_s), dtype=bool)


def _ranked(cells: Sequence[Cell | None]) -> list[Cell]:
    return sorted((c for c in cells if c is not None), key=lambda c: -(c.share or 0.0))


def _bins(share: Array, count: int) -> Array:
    """In which of so many equal parts of a whole each share of it lies."""
    return np.minimum((share * count).astype(int), count - 1)


def _eighth(trial: Trial) -> Array:
    """In which of the :data:`PHASES` of the stroke each sample is."""
    return _bins((trial.time_s * beat_hz(trial)) % 1.0, PHASES)


def knobs(trial: Trial) -> dict[str, str]:
    """What was set in a trial, in words."""
    found: dict[str, str] = {}
    beat = trial.swim.beat
    if beat is not None:
        found["frequency"] = f"{beat.frequency_hz:g} Hz"
        found["amplitude"] = f"{math.degrees(beat.amplitude_rad):g} deg"
        found["bias"] = f"{math.degrees(beat.bias_rad):g} deg"
    for key, kind, unit, factor, value in (
        ("frequency_hz", "frequency", "Hz", 1.0, trial.surge.frequency_hz),
        ("amplitude_rad", "amplitude", "deg", 180.0 / math.pi, trial.surge.amplitude_rad),
    ):
        if not math.isnan(value):
            found.setdefault(kind, f"{factor * value:.3g} {unit}")
        if len(trial.inputs.get(key, ())) == 1:
            found[kind] = f"{factor * float(trial.inputs[key][0]):.3g} {unit}"
    if trial.cruise.fin:
        found["fin"] = trial.cruise.fin
    if trial.rig.force is not None:
        found["force"] = f"{trial.rig.force:.3g} N"
    return found


def regimes(where: Map) -> list[Cell]:
    """The gap by what was set, and by trial."""
    groups: dict[tuple[str, str], list[int]] = {}
    for k, trial in enumerate(where.trials):
        for kind, label in knobs(trial).items():
            groups.setdefault((kind, label), []).append(k)
        groups[("trial", trial.id)] = [k]
    kinds = Counter(kind for kind, _ in groups)
    few = len(where.trials) <= 30
    return _ranked(
        [
            where.cell(kind, label, [(k, where.every(k)) for k in members])
            for (kind, label), members in groups.items()
            if kinds[kind] > 1 and (kind != "trial" or few)
        ]
    )


def phases(where: Map) -> list[Cell]:
    """The gap by phase of the stroke; empty without a beat."""
    if not any(t.swim.beat is not None for t in where.trials):
        return []
    cells = []
    for i in range(PHASES):
        pick = [(k, _eighth(t) == i) for k, t in enumerate(where.trials)]
        low, high = round(360 * i / PHASES), round(360 * (i + 1) / PHASES)
        cells.append(where.cell("phase", f"{low}-{high} deg", pick))
    return _ranked(cells)


def times(where: Map) -> list[Cell]:
    """Start-up against steady, and change points of single trials."""
    early, late = [], []
    for k, t in enumerate(where.trials):
        if len(t.time_s) < 10:
            return []
        span = float(t.time_s[-1] - t.time_s[0])
        beat = t.swim.beat is not None
        start = min(START_BEATS / beat_hz(t), 0.5 * span) if beat else START_SHARE * span
        first = t.time_s <= t.time_s[0] + start
        early.append((k, first))
        late.append((k, ~first))
    cells = [where.cell("time", "start-up", early), where.cell("time", "steady", late)]
    for k, t in enumerate(where.trials):
        at = _change(where, k)
        if at is not None:
            cells.append(where.cell("change", f"{t.id} from {at:.3g} s", [(k, t.time_s >= at)]))
    return _ranked(cells)


def _change(where: Map, k: int) -> float | None:
    """When a trial's residual grows at once, if it does."""
    series = [np.nan_to_num(v - 1.0) for v in where.excess[k].values()]
    lengths = {len(s) for s in series}
    if len(lengths) != 1 or not series:
        return None
    x = np.sum(series, axis=0)
    n = len(x)
    edge = max(n // 10, 5)
    if n < 40 or x.sum() <= 3.0 * n:
        return None
    total = np.cumsum(x)
    cut = np.arange(edge, n - edge)
    before, after = total[cut - 1] / cut, (total[-1] - total[cut - 1]) / (n - cut)
    between = cut * (n - cut) / n * (after - before) ** 2
    best = int(np.argmax(between))
    spread = float(np.sum((x - x.mean()) ** 2))
    # a step, not a ramp: what grows steadily has no moment at which it began
    line = np.polynomial.Polynomial.fit(np.arange(n), x, 1)
    ramp = float(np.sum((line(np.arange(n)) - x.mean()) ** 2))
    step = between[best] > CHANGED * spread and between[best] > 1.3 * ramp
    if step and after[best] > 4.0 * max(before[best], 1.0):
        return float(where.trials[k].time_s[cut[best]])
    return None


def maps(where: Map) -> dict[str, tuple[list[str], list[str], Array]]:
    """Heat maps of root-mean-square residual over floor."""
    found: dict[str, tuple[list[str], list[str], Array]] = {}

    def ratio(channel: str, pick: list[tuple[int, Mask]]) -> float:
        values = where.values(pick, [channel])
        return float(np.sqrt(np.mean(values))) if len(values) else math.nan

    ids = [t.id for t in where.trials]
    if len(ids) <= 30 and any(len(t.time_s) > 5 for t in where.trials):
        grid = np.array([[ratio(c, [(k, where.every(k))]) for c in where.channels] for k in range(len(ids))])
        found["trial by channel"] = (ids, where.channels, grid)
        overall = []
        for k, t in enumerate(where.trials):
            part = _bins((t.time_s - t.time_s[0]) / max(float(np.ptp(t.time_s)), 1e-9), TIMES)
            overall.append(
                [_overall([ratio(c, [(k, part == i)]) for c in where.channels]) for i in range(TIMES)]
            )
        labels = [f"{round(100 * i / TIMES)}-{round(100 * (i + 1) / TIMES)} %" for i in range(TIMES)]
        found["trial by time"] = (ids, labels, np.array(overall))
    if any(t.swim.beat is not None for t in where.trials):
        eighths = [_eighth(t) for t in where.trials]
        rows = [
            [ratio(channel, [(k, own == i) for k, own in enumerate(eighths)]) for i in range(PHASES)]
            for channel in where.channels
        ]
        labels = [f"{round(360 * i / PHASES)}°" for i in range(PHASES)]
        found["channel by phase"] = (where.channels, labels, np.array(rows))
    return found


def _overall(ratios: Sequence[float]) -> float:
    """Of the channels that have samples there; NaN where none has."""
    known = np.array([ratio for ratio in ratios if math.isfinite(ratio)])
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan
