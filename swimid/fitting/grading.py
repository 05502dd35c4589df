"""Limits of the errors of a simulation against its trials, the same for every command that states them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from swimid.results import evidence as ev
from swimid.results import numbers

#: Largest error over the measured range of a channel that is described well, and of a usable one.
GOOD, USABLE = 0.15, 0.30
#: The same for the mean speeds of the trials, over those measured.
GOOD_SPEED, USABLE_SPEED = 0.10, 0.25


def error_checks(
    scores: Mapping[str, Any], *, fitted: Iterable[str], noise: Iterable[str] = (), held_out: bool = False
) -> list[ev.Check]:
    """Check the errors of channels against their limits.

    Parameters
    ----------
    scores : mapping of channel name to Score, or to what has ``nrmse`` and ``vaf``
        Errors over all trials.
    fitted : iterable of str
        Channels that the parameters were fitted to: a negative variance accounted for fails there.
    noise : iterable of str
        Channels whose residuals are white: their errors are noise, however large it is over the range.
    held_out : bool
        The trials were held out.
    """
    where = "held-out error" if held_out else "error"
    found = []
    for name, score in scores.items():
        check = share_check(f"{where} of {name}", score.nrmse, GOOD, USABLE, "measured range")
        if name in set(noise) and check.verdict != "pass":
            text = "the residuals are white: noise alone is left"
            check = ev.check(check.name, check.value, None, text=text)
        found.append(check)
    for name in fitted:
        vaf = scores[name].vaf if name in scores else None
        if vaf is not None and vaf < 0.0:
            found.append(
                ev.check(
                    f"{'held-out ' if held_out else ''}variance accounted for, {name}",
                    numbers.percent(vaf),
                    False,
                    "≥ 0 %",
                    otherwise="fail",
                    reason=f"the simulated {name} is farther from the measurement than a constant is",
                )
            )
    return found


def share_check(
    name: str, share: float | None, good: float, usable: float, of: str, text: str = ""
) -> ev.Check:
    """Check a share against two limits: above the first is a warning, above the second a failure."""
    value = math.inf if share is None or math.isnan(share) else share
    shown = numbers.percent(share)
    return ev.check(
        name,
        shown,
        value <= good,
        f"≤ {100 * good:g} % of the {of} (fail above {100 * usable:g} %)",
        text,
        otherwise="warn" if value <= usable else "fail",
        reason=f"the {name} is {shown} of the {of}",
    )
