"""The tail beat a log shows, against the one its metadata state."""

from __future__ import annotations

from swimid.formats.trials import FreeSwimTrial
from swimid.notices import warn
from swimid.signals.beat import Beat

#: A beat frequency this far from the metadata's contradicts it.
TOLERANCE = 0.05


def facts(entry: FreeSwimTrial, beat: Beat | None, *, used: str) -> dict[str, float | str | None]:
    """Stated and found frequency of a trial, Hz; warns where they contradict each other.

    Parameters
    ----------
    beat : Beat or None
        As found in the heading.
    used : {"measured", "stated"}
        Which of the two the work goes on with, for the warning.
    """
    assert entry.drive is not None
    stated = entry.drive.frequency_hz
    found: dict[str, float | str | None] = {"stated_hz": stated, "found_hz": None, "stderr_hz": None}
    if beat is None:
        return found
    found.update(found_hz=beat.frequency_hz, stderr_hz=beat.stderr_hz)
    if abs(beat.frequency_hz - stated) > max(TOLERANCE * stated, 3 * beat.stderr_hz):
        ratio = beat.frequency_hz / stated
        whole = f", {ratio:.2f} times as fast" if abs(ratio - round(ratio)) < 0.05 and ratio > 1.5 else ""
        last = (
            "the measured frequency is used"
            if used == "measured"
            else "correct it if it is wrong: it is used"
        )
        warn(
            "SWM032",
            f"{entry.id}: the heading beats at {beat.frequency_hz:.3f} ± {beat.stderr_hz:.3f} Hz{whole}, "
            f"the trials file says {stated:g} Hz; {last}",
        )
    return found
