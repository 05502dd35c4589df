"""Limits of the errors of a simulation against its trials, the same for every command that states them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Protocol

from swimid.results import blocks, numbers
from swimid.results import evidence as ev

#: Error over the measured range, up to which a channel is described well, and up to which at all.
GOOD, USABLE = 0.15, 0.30
#: The same for the mean speeds of the trials, over those measured.
GOOD_SPEED, USABLE_SPEED = 0.10, 0.25


class Errors(Protocol):
    """Errors of one channel, as :class:`swimid.fitting.metrics.Score` and the comparison file hold them."""

    @property
    def nrmse(self) -> float | None:
        """Root-mean-square error over the measured range."""

    @property
    def vaf(self) -> float | None:
        """Variance accounted for."""


def error_checks(
    scores: Mapping[str, Errors], *, fitted: Iterable[str], noise: Iterable[str] = (), held_out: bool = False
) -> list[ev.Check]:
    """Checks of the errors of channels against their limits.

    Parameters
    ----------
    scores : mapping of channel name to Errors
        Errors over all trials.
    fitted : iterable of str
        Channels that the parameters were fitted to: a negative variance accounted for fails there.
    noise : iterable of str
        Channels whose residuals are white: their errors are noise, however large it is over the range.
    held_out : bool
        The trials were held out.
    """
    text = "root-mean-square error over all trials, over the measured range; of a pose over each trial's own"
    where = "held-out error" if held_out else "error"
    found = []
    for name, score in scores.items():
        check = share_check(f"{where} of {name}", score.nrmse, GOOD, USABLE, "measured range", text)
        if name in set(noise) and check.verdict != "pass":
            check = ev.check(
                check.name, check.value, None, text="the residuals are white: noise alone is left"
            )
        found.append(check)
    for name in fitted:
        vaf = scores[name].vaf if name in scores else None
        if vaf is not None and vaf < 0.0:
            found.append(
                blocks.check(
                    f"{'held-out ' if held_out else ''}variance accounted for, {name}",
                    numbers.percent(vaf),
                    "≥ 0 %",
                    False,
                    otherwise="fail",
                    text="the simulation is farther from the measurement than a constant is",
                )
            )
    return found


def share_check(name: str, share: float | None, good: float, usable: float, of: str, text: str) -> ev.Check:
    """Check a share against two limits: above the first is a warning, above the second a failure."""
    value = math.inf if share is None or math.isnan(share) else share
    limit = f"≤ {100 * good:g} % of the {of} (fail above {100 * usable:g} %)"
    return blocks.check(
        name,
        numbers.percent(share),
        limit,
        value <= good,
        otherwise="warn" if value <= usable else "fail",
        text=text,
    )
