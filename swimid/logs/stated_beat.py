"""The tail beat a log shows, against the one its metadata state."""

from __future__ import annotations

from swimid.logs.beat import Beat, contradiction
from swimid.logs.trials import Drive, FreeSwimTrial
from swimid.notices import warn


def facts(entry: FreeSwimTrial, beat: Beat | None, *, used: str) -> dict[str, float | str | None]:
    """Stated and found frequency of a trial, Hz; warns where they contradict each other.

    Parameters
    ----------
    beat : Beat or None
        As found in the heading.
    used : {"measured", "stated"}
        Which of the two the work goes on with, for the warning.
    """
    assert isinstance(entry.drive, Drive)
    stated = entry.drive.frequency_hz
    found: dict[str, float | str | None] = {"stated_hz": stated, "found_hz": None, "stderr_hz": None}
    if beat is None:
        return found
    found.update(found_hz=beat.frequency_hz, stderr_hz=beat.stderr_hz)
    against = contradiction(beat, stated)
    if against is not None:
        last = (
            "the measured frequency is used"
            if used == "measured"
            else "correct it if it is wrong: it is used"
        )
        warn("SWM032", f"{entry.id}: the heading {against}, the trials file says {stated:g} Hz; {last}")
    return found
