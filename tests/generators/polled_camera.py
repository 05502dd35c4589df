"""A camera's track as a polling program logs it: jumps, repeated samples, a gap."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from tests.generators.marks import mark


@dataclass(frozen=True)
class Polled:
    """Samples as they were polled, and the truth behind them.

    Attributes
    ----------
    rows : list of (t s, x m, y m, yaw rad)
    path_m_s, line_m_s : float
        True mean speed along the path and along the straight line.
    jumps, repeats : int
        How many samples were moved, and how many say the same as the one before.
    """

    rows: list[tuple[float, float, float, float]]
    path_m_s: float
    line_m_s: float
    jumps: int
    repeats: int


def polled(
    seed: int,
    *,
    speed_m_s: float = 0.2,
    duration_s: float = 40.0,
    rate_hz: float = 30.0,
    beat_hz: float = 1.2,
    sway_m: float = 0.008,
    noise_m: float = 0.0008,
    jumps: int = 5,
    jump_samples: int = 1,
    repeat_share: float = 0.2,
    gap_s: float = 2.0,
    turn_rad_s: float = 0.0,
    stays: bool = False,
) -> Polled:
    """A swimmer that sways about a straight line or an arc."""
    dice = random.Random(seed)
    count = int(duration_s * rate_hz)

    def where(t: float) -> tuple[float, float, float]:
        heading = turn_rad_s * t
        if turn_rad_s:
            x, y = (
                speed_m_s / turn_rad_s * math.sin(heading),
                speed_m_s / turn_rad_s * (1 - math.cos(heading)),
            )
        else:
            x, y = speed_m_s * t, 0.0
        side = sway_m * math.sin(2 * math.pi * beat_hz * t)
        yaw = heading + 0.2 * math.cos(2 * math.pi * beat_hz * t)
        return x - side * math.sin(heading), y + side * math.cos(heading), yaw

    # the true path by many small chords
    fine, steps = 0.0, 200 * count // 10
    before = where(0.0)
    for k in range(1, steps + 1):
        here = where(k * duration_s / steps)
        fine += math.hypot(here[0] - before[0], here[1] - before[1])
        before = here
    start, end = where(0.0), where(duration_s)
    line = math.hypot(end[0] - start[0], end[1] - start[1]) / duration_s

    seen = []
    for k in range(count):
        x, y, yaw = where(k / rate_hz)
        seen.append(
            [k / rate_hz, x + dice.gauss(0, noise_m), y + dice.gauss(0, noise_m), yaw + dice.gauss(0, 0.002)]
        )
    gap_from = 0.4 * duration_s
    free = [k for k in range(20, count - 40) if not gap_from - 1 < k / rate_hz < gap_from + gap_s + 1]
    moved: set[int] = set()
    places: list[int] = []
    while len(places) < jumps:
        k = dice.choice(free)
        if any(abs(k - other) < 12 + jump_samples for other in places):
            continue
        places.append(k)
        way, turn = dice.uniform(0.3, 0.9), dice.uniform(0, 2 * math.pi)
        last = count if stays else k + jump_samples
        for j in range(k, last):
            seen[j][1] += way * math.cos(turn)
            seen[j][2] += way * math.sin(turn)
        moved.update(range(k - 1, k + jump_samples + 1))
    repeats = 0
    for k in sorted(dice.sample(range(1, count), int(repeat_share * count))):
        if k in moved or k - 1 in moved or gap_from <= seen[k][0] < gap_from + gap_s + 1 / rate_hz:
            continue
        seen[k][1:] = seen[k - 1][1:]
        repeats += 1
    rows = [tuple(row) for row in seen if not gap_from <= row[0] < gap_from + gap_s]
    repeats = sum(a[1:] == b[1:] for a, b in pairwise(rows))
    return Polled(rows, fine / duration_s, line, jumps, repeats)  # type: ignore[arg-type]


def write_sample(folder: Path) -> None:
    """A polled track as a foreign program writes it: semicolons, milliseconds, millimetres, degrees."""
    folder.mkdir(parents=True, exist_ok=True)
    made = polled(20261122)
    lines = ["Time (ms);X (mm);Y (mm);Heading (deg)"]
    lines += [
        f"{1000 * t:.1f};{1000 * x:.2f};{1000 * y:.2f};{math.degrees(a):.2f}" for t, x, y, a in made.rows
    ]
    (folder / "polled.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    mark(folder)
