"""Checks that maps, rules and gaits share: what their coefficients are worth, and where these were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from swimid.notices import Notice
from swimid.results import blocks
from swimid.results import evidence as ev

#: Warnings that coefficients are not vouched for: outside their bounds, or by a fit that did not converge or
#: could not identify them.
DOUBTFUL = ("SWM053", "SWM062")
#: What a drive has where it does not say.
NEUTRAL = {"bias_deg": 0.0, "asymmetry": 0.0, "lag_deg": 0.0, "scale": 1.0}
#: The range of the identification trials, by the name of what was varied in them.
Region = Mapping[str, tuple[float, float]]


def coefficients_check(notices: Sequence[Notice]) -> list[ev.Check]:
    """A check that stands only where the coefficients are in doubt."""
    doubts = [n.text for n in notices if n.code in DOUBTFUL]
    if not doubts:
        return []
    name = "coefficients are those of a sound fit"
    return [ev.check(name, "no", False, "converged, identified, within bounds", "; ".join(doubts))]


def draws_check(draws: int, inside: int | None, refused: int) -> ev.Check:
    """Whether most draws of the coefficients lie within their bounds.

    Parameters
    ----------
    draws, inside, refused : int
        That were used, and of those made, inside and outside; an older file does not tell ``inside``.
    """
    within = draws if inside is None else inside
    known = refused <= within
    return ev.check(
        "draws within the coefficients' bounds",
        f"{within} of {within + refused}",
        known,
        "half or more",
        "" if known else "the coefficients are hardly known: fit them better",
    )


def beyond(region: Region, at: Mapping[str, float]) -> list[str]:
    """What of a gait lies outside the range of the identification trials; what it does not name is neutral.

    >>> beyond({"frequency_hz": (1.0, 1.8), "bias_deg": (0.0, 15.0)}, {"frequency_hz": 2.0})
    ['frequency_hz']
    """
    found = []
    for name, (low, high) in region.items():
        slack = 1e-9 * (1.0 + max(abs(low), abs(high)))
        value = at.get(name, NEUTRAL.get(name))  # a stroke has a frequency of its own
        if value is not None and not low - slack <= value <= high + slack:
            found.append(name)
    return found


def region_check(region: Region, points: Sequence[Mapping[str, float]]) -> ev.Check:
    """Whether gaits lie inside the range of the identification trials."""
    name = "inside the range of the identification trials"
    if not region:
        return ev.check(name, "not known", None, text="give the parameter file of a fit: --params")
    out = [beyond(region, at) for at in points]
    inside = sum(not names for names in out)
    text = ""
    if inside < len(points):
        names = ", ".join(name for name in region if any(name in one for one in out))
        text = f"elsewhere it is extrapolation in {names}: the coefficients were not identified there"
    return ev.check(name, f"{inside} of {len(points)}", inside == len(points), "all", text)


def forwards_check(surge_m_s: Sequence[float | None]) -> list[ev.Check]:
    """Whether gaits swim nose first: speed is that along the path, whichever way the robot faces.

    Parameters
    ----------
    surge_m_s : sequence of float or None
        Mean forward speed of each; None where there is none.
    """
    known = [surge for surge in surge_m_s if surge is not None]
    back = sum(surge <= 0 for surge in known)
    if not known:
        return []
    text = "elsewhere the robot is driven tail first: its speed there is none of swimming" if back else ""
    return [
        blocks.check(
            "swims nose first",
            f"{len(known) - back} of {len(known)}",
            "all",
            not back,
            otherwise="fail" if back == len(known) else "warn",
            text=text,
        )
    ]
