"""Warnings of swimid, each with a stable code, and the interface of progress bars for long loops.

Functions of swimid issue a warning with :func:`warn`. In Python, the user sees a :class:`SwimidWarning`. A
command collects its warnings with :func:`record_warnings`, prints them at its end, and stores them in its
results.
The caller of a long loop decides whether and how the progress of the loop is shown.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from html import escape
from typing import Any

from swimid.errors import in_words_of_the_caller

#: Subject of each warning code. ``docs/warnings.md`` explains the codes.
WARNING_CODES: dict[str, str] = {
    "SWM001": "missing samples masked",
    "SWM002": "values are unusual in the stated unit",
    "SWM003": "uneven time steps",
    "SWM004": "columns not used",
    "SWM010": "parameter not identifiable from these trials",
    "SWM011": "parameters strongly correlated",
    "SWM012": "estimate at its bound",
    "SWM013": "residuals are not white",
    "SWM014": "trials differ by more than their noise",
    "SWM015": "validation error much larger than fit error",
    "SWM016": "the integration step is too coarse for its accuracy target",
    "SWM017": "the trials do not start at rest at their first sample",
    "SWM018": "part of a log left out",
    "SWM019": "only ratios of the parameters are known",
    "SWM020": "identified model is unstable or integrating",
    "SWM021": "working point removed from the data",
    "SWM022": "input does not excite the model order",
    "SWM023": "the model order lies at the edge of its range",
    "SWM024": "an effect that is not fitted would explain the residuals",
    "SWM025": "outliers",
    "SWM026": "the search converged too slowly along an ill-conditioned valley",
    "SWM027": "points of a Pareto front left out",
    "SWM028": "differences between trials would not show",
    "SWM030": "measurement departs from the propulsion law",
    "SWM031": "free exponent disagrees with the law",
    "SWM032": "beat frequency contradicts the metadata",
    "SWM033": "two frequencies that are no multiples of each other",
    "SWM034": "a unit contradicts other columns",
    "SWM035": "a channel holds one value amid its motion",
    "SWM040": "frames without a marker",
    "SWM041": "no calibration: output in pixels",
    "SWM042": "marker separation is not constant",
    "SWM043": "video timing is irregular",
    "SWM044": "video ends early or has damaged frames",
    "SWM045": "marker touches the edge of the picture",
    "SWM047": "track split at a long gap",
    "SWM048": "calibration points are mirrored",
    "SWM049": "a motionless object of the marker's colour left out",
    "SWM050": "evidence of a result is missing",
    "SWM051": "figure reduced to fewer points",
    "SWM052": "a result was changed after its evidence was made",
    "SWM053": "a value lies outside its bounds",
    "SWM054": "the drive is impossible for a swimmer, or is not resolved",
    "SWM055": "uncertainty of a parameter left out",
    "SWM056": "start state of a trial not found",
    "SWM057": "rows or cells left out, or rows put in order",
    "SWM058": "track cleaned",
    "SWM059": "the track goes on elsewhere after a jump",
    "SWM060": "the target of an export cannot express a part of the robot",
    "SWM061": "a file of an earlier run stays beside the result",
    "SWM062": "parameters in use that their fit does not support",
    "SWM063": "course and heading of a track contradict each other",
    "SWM064": "another object was first taken for the marker",
    "SWM065": "no marker at the beginning or the end of a video",
    "SWM066": "marker hidden in part",
    "SWM067": "the followed object does not move",
    "SWM068": "the camera moves",
    "SWM069": "random samples of parameters lay outside the bounds",
    "SWM070": "the pulley friction follows the pulling mass",
    "SWM071": "a trial contradicts the others",
    "SWM072": "an estimate is physically impossible",
    "SWM073": "the search had stopped short of the best fit",
    "SWM074": "rows of a log fitted twice",
    "SWM075": "no next trial to write",
    "SWM076": "effects of a parameter file left out",
    "SWM077": "an actuator leaves the table of a transmission",
    "SWM080": "a fault of recording was repaired",
    "SWM081": "an integrated path is accurate for a short time only",
    "SWM082": "no still period in an inertial log",
    "SWM083": "the clocks of two logs differ",
    "SWM084": "the motion between rests does not close",
    "SWM086": "an impossible motion is left empty",
    "SWM087": "two logs of one trial contradict each other",
    "SWM090": "two columns of a log contradict each other",
    "SWM091": "the time step of a simulator changes its simulation",
    "SWM100": "the robot swims tail first",
    "SWM101": "a body larger than a marker is followed",
    "SWM110": "a measured force has the wrong sign",
    "SWM120": "tracked points left out or exchanged",
    "SWM121": "places of tracked points are wrong or not determined",
    "SWM150": "lines of a checkpoint ignored",
    "SWM151": "a checkpoint cannot be written",
    "SWM152": "compiled kernels are not stored",
    "SWM172": "several objects of the colour of a marker move",
    "SWM173": "pixels may not be square",
    "SWM174": "a picture of a calibration is not used",
    "SWM176": "an input has changed since it was read",
    "SWM178": "files of a download are missing",
    "SWM179": "the mean of a joint angle may not be that of its swing",
}


class SwimidWarning(UserWarning):
    """Warning of swimid with a stable code, one of :data:`WARNING_CODES`.

    Attributes
    ----------
    code : str
        Code of the warning, such as ``"SWM013"``. ``docs/warnings.md`` explains the codes.
    text : str
        Text of the warning, with the values that were found.

    Examples
    --------
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", SwimidWarning)
    ...     try:
    ...         warn("SWM003", "the time steps differ by 12 %")
    ...     except SwimidWarning as doubt:
    ...         print(doubt.code)
    SWM003
    """

    def __init__(self, code: str, text: str) -> None:
        if code not in WARNING_CODES:
            raise KeyError(f"unknown warning code {code}")
        self.code = code
        self.text = in_words_of_the_caller(text)
        super().__init__(f"{code} {self.text}")


@dataclass(frozen=True)
class Notice:
    """Code and text of one recorded warning."""

    code: str
    text: str


def warn(code: str, text: str) -> None:
    """Issue a warning to the user with the given code, one of :data:`WARNING_CODES`."""
    warnings.warn(SwimidWarning(code, text), stacklevel=2)


@contextmanager
def record_warnings(*, repeat: bool = False) -> Iterator[list[Notice]]:
    """Collect the warnings of swimid that a ``with`` block issues, and yield the list, without duplicates.

    The collected warnings are not shown to the user. With ``repeat`` they are issued again at the end of the
    block, even after an error, so that an outer block collects them too.
    """
    notices: list[Notice] = []
    show_others = warnings.showwarning

    def keep(message: Warning | str, *rest: Any, **more: Any) -> None:
        if isinstance(message, SwimidWarning):
            notice = Notice(message.code, message.text)
            if notice not in notices:
                notices.append(notice)
        else:
            show_others(message, *rest, **more)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", SwimidWarning)
            warnings.showwarning = keep
            yield notices
    finally:
        for notice in notices if repeat else []:
            warn(notice.code, notice.text)


# ---------------------------------------------------------------- progress

#: Minimum time between two updates of a progress bar in a notebook, s.
REFRESH_S = 0.2
#: Type of a function that advances one progress bar by one step, or by a number of steps: ``step(3)``.
Step = Callable[..., None]
#: Type of a function that opens a progress bar: ``with progress("tracking", total=600) as step: step()``.
#: Without ``total`` the number of steps is unknown.
Progress = Callable[..., AbstractContextManager[Step]]


def show(step: Step, text: str) -> None:
    """Show a remark next to a progress bar, if the function ``step`` of the bar has an attribute ``note``."""
    note = getattr(step, "note", None)
    if note is not None:
        note(text)


def silent(description: str, total: int | None = None) -> AbstractContextManager[Step]:
    """Return a progress bar that shows nothing."""

    def step(amount: int = 1) -> None:
        return None

    return nullcontext(step)


class Automatic:
    """Default of the argument ``progress`` of public functions: a bar in a notebook, nothing elsewhere."""

    def __call__(self, description: str, total: int | None = None) -> AbstractContextManager[Step]:
        """Return the progress bar."""
        shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
        if hasattr(shell, "kernel"):
            return _in_notebook(description, total)
        return silent(description, total)

    def __repr__(self) -> str:
        return "automatic"


automatic = Automatic()


@contextmanager
def _in_notebook(description: str, total: int | None) -> Iterator[Step]:
    """Show a progress bar below the cell of a notebook during the ``with`` block."""
    from IPython.display import HTML, display

    place = display(HTML(""), display_id=True)
    done, shown_s, note = 0, 0.0, ""

    def step(amount: int = 1) -> None:
        nonlocal done, shown_s
        done += amount
        if time.monotonic() - shown_s > REFRESH_S:
            shown_s = time.monotonic()
            most = "" if total is None else f" max={total}"
            count = f"{done}" if total is None else f"{done} of {total}"
            text = escape(f"{description}{note}: ")
            place.update(HTML(f"{text}<progress value={done}{most}></progress> {count}"))

    def remark(text: str) -> None:
        nonlocal note
        note = f", {text}"

    step.note = remark  # type: ignore[attr-defined]
    try:
        yield step
    finally:
        place.update(HTML(""))
