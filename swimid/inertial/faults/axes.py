"""Axes that are swapped or flipped: gyroscope against accelerometer."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np

from swimid.errors import InputError
from swimid.inertial.faults.base import Finding, up_turning
from swimid.inertial.faults.rate_unit import VISIBLE
from swimid.inertial.record import Array, Record

NAME = "swapped or flipped axes"
#: Another arrangement must leave this much less of gravity's turning than the one in the log, and
#: less than the runner-up among those that do the same to the axes that turn. An arrangement that explains
#: more than half of the turning stays: what it leaves is acceleration (a yawing swimmer's ``u r`` looks like
#: roll).
BETTER, DECIDED, EXPLAINED = 0.5, 0.8, 0.5
_LETTERS = "xyz"


def check(record: Record) -> tuple[Record, list[Finding]]:
    """Try all 48 arrangements of the gyroscope's axes on how gravity turns in the accelerometer.

    A turn about the vertical, and one that is too small to see against accelerations, tells nothing;
    then this says that it cannot.
    """
    seen, up, turned = up_turning(record)
    if len(seen) < 16 or np.sqrt(np.mean(np.sum(seen**2, axis=1))) < VISIBLE:
        text = "the body hardly tilts: gyroscope axes cannot be held against the accelerometer's"
        return record, [Finding(NAME, "noted", text)]
    scores = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        left = seen + np.cross(turned[:, order] * signs, up)
        scores.append((_spread(left) / _spread(seen), order, signs))
    as_is = scores[0][0]
    (best, order, signs), (runner_up, _, _) = sorted(scores, key=lambda entry: entry[0])[:2]
    if best > BETTER * as_is or best > EXPLAINED or as_is < EXPLAINED:
        return record, []
    arrangement = ", ".join(
        f"w{_LETTERS[i]} from {'-' if s < 0 else ''}w{_LETTERS[o]}"
        for i, (o, s) in enumerate(zip(order, signs, strict=True))
        if o != i or s < 0
    )
    if best > DECIDED * runner_up:
        raise InputError(
            "the gyroscope's axes do not fit the accelerometer's (some are swapped or flipped), and the "
            f"tilting in this log does not tell which; {arrangement} fits best",
            file=record.name,
            column="wx_rad_s ... wz_rad_s",
            hint="put the axes right in a mapping (--map), with factor -1 for a flipped one",
        )
    text = (
        f"the gyroscope's axes do not fit the accelerometer's: {arrangement} leaves {100 * best:.0f} % of "
        f"gravity's turning unexplained, as logged {100 * as_is:.0f} %; rearranged so"
    )
    return replace(record, rate=record.rate[:, order] * np.asarray(signs)), [Finding(NAME, "handled", text)]


def _spread(values: Array) -> float:
    return float(np.sum((values - values.mean(axis=0)) ** 2))
