"""Evidence of a result (``swimid-evidence/1``): its verdict, checks, tables and figures as data in a file.

A command writes the evidence file next to its result file: ``drag.evidence.json`` belongs to ``drag.yaml``.
Reports show the evidence of all commands with the same code. Numbers keep all digits. NaN is written as null.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from swimid.errors import InputError, UsageError, file_errors
from swimid.files import atomic, yamlio
from swimid.notices import Notice
from swimid.options import describe_problem
from swimid.results import numbers

FORMAT: Literal["swimid-evidence/1"] = "swimid-evidence/1"
#: Name of the check that fails if logged values are impossible for a swimmer, probably due to a wrong unit.
POSSIBLE = "Values a swimmer reaches"
#: Maximum number of points of a trace in a figure. A longer trace is drawn as its envelope.
MAX_TRACE_POINTS = 2000


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Trace(_Part):
    """Curve or set of points in a panel of a figure."""

    x: yamlio.Numbers
    y: yamlio.Numbers
    label: str = ""
    style: Literal["line", "dashed", "points", "step", "stems", "arrows"] = "line"
    #: Number of the group to which the trace belongs. Traces of a group, such as a measurement and its
    #: simulation, have the same colour.
    group: int | None = None
    #: Half-widths of vertical error bars, with one number for each point of the trace.
    y_error: yamlio.Numbers | None = None
    #: Lower and upper limits of a shaded band in the colour of the trace, each with one number for each point
    #: of the trace.
    lower: yamlio.Numbers | None = None
    upper: yamlio.Numbers | None = None

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        for name in ("y", "y_error", "lower", "upper"):
            values = getattr(self, name)
            if values is not None and len(values) != len(self.x):
                raise ValueError(f"a trace has {len(values)} numbers of '{name}' for {len(self.x)} of 'x'")
        return self


class Mark(_Part):
    """Horizontal or vertical reference line in a panel of a figure."""

    at: float
    axis: Literal["x", "y"] = "y"
    label: str = ""


class Span(_Part):
    """Interval of an axis that is shaded in a panel of a figure, for instance a gap in the data."""

    start: float
    end: float
    axis: Literal["x", "y"] = "x"
    label: str = ""


class Heat(_Part):
    """Heat map of a panel: a table of numbers in cells that are shaded by value.

    A panel shows either a heat map or traces. Every cell shows its number. With the scale ``log``, cells with
    a number above ``neutral`` are shaded by the logarithm of the number. With the scale ``linear``, the shade
    increases from the smallest to the largest number.
    """

    rows: list[str]
    columns: list[str]
    #: Numbers in the cells of the heat map, row by row; None for a cell without a number.
    values: list[yamlio.Numbers]
    #: Largest number whose cell has no shade if the scale is ``log``.
    neutral: float = Field(default=1.0, gt=0)
    scale: Literal["log", "linear"] = "log"

    @model_validator(mode="after")
    def _a_number_for_each_cell(self) -> Self:
        if [len(row) for row in self.values] != [len(self.columns)] * len(self.rows):
            raise ValueError("a heat map has other rows or columns than its labels")
        return self


class Panel(_Part):
    """Panel of a figure: a pair of axes with traces or a heat map, labels and reference lines."""

    x_label: str
    y_label: str
    traces: list[Trace] = []
    heat: Heat | None = None
    title: str = ""
    x_scale: Literal["linear", "log"] = "linear"
    y_scale: Literal["linear", "log"] = "linear"
    equal_aspect: bool = False
    invert_y: bool = False
    marks: list[Mark] = []
    spans: list[Span] = []
    #: Names that the x axis shows at the positions 0, 1, 2, ...; None for an axis with numbers.
    x_categories: list[str] | None = None
    #: Names that the y axis shows at the positions 0, 1, 2, ...; None for an axis with numbers.
    y_categories: list[str] | None = None


class Figure(_Part):
    """Figure of a report, with one or several panels and a caption."""

    id: str
    title: str
    caption: str
    panels: list[Panel]


class Image(_Part):
    """Picture whose content is stored in the evidence of a result, such as a video frame with a track."""

    id: str
    title: str
    caption: str
    media_type: Literal["image/jpeg", "image/png"]
    base64: str


class Table(_Part):
    """Table of a report with texts and numbers.

    A folded table shows only its title until the reader opens it, and is not printed.
    """

    id: str
    title: str
    columns: list[str]
    rows: list[list[str | float | int | bool | None]]
    caption: str = ""
    folded: bool = False

    @model_validator(mode="after")
    def _a_cell_for_each_column(self) -> Self:
        for number, row in enumerate(self.rows, 1):
            if len(row) != len(self.columns):
                text = f"the table '{self.id}' has {len(row)} cells in row {number}"
                raise ValueError(f"{text} for {len(self.columns)} columns")
        return self


class Check(_Part):
    """Check of one property of a result: its value, the limit, and whether the value is within the limit."""

    name: str
    value: str
    limit: str = ""
    verdict: Literal["pass", "warn", "fail", "info"]
    text: str = ""
    #: Clause that the verdict of the result states as a reason if the check does not pass.
    reason: str = ""


class Verdict(_Part):
    """Verdict on a result: how far it can be relied on, and a text with the finding and the reasons."""

    level: Literal["good", "caution", "bad"]
    text: str
    #: Word that reports show in place of the level of the verdict; empty to show the level itself.
    word: str = ""

    def lower_to(self, level: str, text: str) -> Verdict:
        """Return a copy of the verdict with a new text, and with the given level if it is the worse one."""
        worst = max(level, self.level, key=("good", "caution", "bad").index)
        return self.model_copy(update={"level": worst, "text": text})


#: Class of a warning that is stored in the evidence of a result.
NoticeRecord = Notice


class Evidence(_Part):
    """Evidence of a result: verdict, checks, tables, figures and other entries of a report.

    A report shows the evidence in addition to the content of the result file.
    """

    format: Literal["swimid-evidence/1"] = FORMAT
    #: Name of the result file to which the evidence belongs, and SHA-256 of the content of this result file.
    #: Both are empty for a result in memory.
    result: str = Field(default="", pattern=r"^[^/\\\x00]*$")
    sha256: str = ""
    command: str
    title: str
    verdict: Verdict
    #: Short facts about the result by name, such as robot, model and number of trials.
    facts: dict[str, str] = Field(default_factory=dict)
    #: Sentences that a report shows below the first table.
    notes: list[str] = []
    checks: list[Check] = []
    tables: list[Table] = []
    figures: list[Figure] = []
    images: list[Image] = []
    notices: list[Notice] = []
    #: Sentences for the methods section of a paper, generated from the settings of the computation.
    methods: list[str] = []
    #: Publications to cite together with the sentences in ``methods``.
    references: list[str] = []
    #: Copy of the block ``provenance`` of the result file: command, version and inputs.
    provenance: yamlio.Provenance = Field(default_factory=dict)

    @model_validator(mode="after")
    def _nothing_impossible(self) -> Evidence:
        """Lower the verdict if a warning says that values are unusual for a swimmer or have a wrong unit.

        A unit that contradicts other columns lowers the verdict to bad. Values that are only unusual lower it
        to caution, because the stated unit may be correct.
        """
        if any(check.name == POSSIBLE for check in self.checks):
            return self
        for code, grade, level in (("SWM034", "fail", "bad"), ("SWM002", "warn", "caution")):
            texts = "; ".join(notice.text for notice in self.notices if notice.code == code)
            if texts:
                self.checks.append(Check(name=POSSIBLE, value="beyond", verdict=grade, text=texts))
                text = f"{self.verdict.text} Values that no swimmer reaches: {texts}."
                self.verdict = self.verdict.lower_to(level, text)
                break
        return self


def make_check(
    name: str,
    value: str,
    passed: bool | None,
    limit: str = "",
    text: str = "",
    *,
    otherwise: Literal["warn", "fail"] = "warn",
    reason: str = "",
) -> Check:
    """Return a check of a value against a limit, for the evidence (checks, tables, figures) of a result.

    Parameters
    ----------
    name, value, limit, text : str
        Name of the quantity, its value, the allowed values, and an explanation.
    passed : bool or None
        None for a check that is for information only.
    otherwise : {"warn", "fail"}
        Verdict of a check that does not pass.
    reason : str
        Clause for the verdict of the result, such as ``"residuals are not white in yaw_rad"``.
    """
    verdicts: dict[bool | None, Any] = {None: "info", True: "pass", False: otherwise}
    return Check(name=name, value=value, limit=limit, verdict=verdicts[passed], text=text, reason=reason)


def make_verdict(answer: str, checks: Sequence[Check]) -> Verdict:
    """Return the verdict on a result. Its text is the answer, the number of failed checks and the reasons.

    The level is bad if a check has the verdict ``fail``, else caution if one has ``warn``, and else good.
    """
    failed = [check for check in checks if check.verdict == "fail"]
    warned = [check for check in checks if check.verdict == "warn"]
    if not failed and not warned:
        return Verdict(level="good", text=answer)
    count = sum(check.verdict != "info" for check in checks)
    noun = "check" if count == 1 else "checks"
    parts = [f"{len(failed)} of {count} {noun} failed"] if failed else []
    if warned:
        parts.append(f"{len(warned)} warn" if failed else f"{len(warned)} of {count} {noun} warn")
    reasons = "; ".join(dict.fromkeys(c.reason or f"{c.name} {c.value}".strip() for c in failed + warned))
    level: Literal["caution", "bad"] = "bad" if failed else "caution"
    return Verdict(level=level, text=f"{answer} {', '.join(parts)}: {reasons}.")


def count_checks(checks: Sequence[Check]) -> str:
    """Return a sentence with the number of checks if all pass; empty if one fails or if there are none.

    The text of the verdict states the number of checks that fail (:func:`make_verdict`).
    """
    tested = [check.verdict for check in checks if check.verdict != "info"]
    if set(tested) != {"pass"}:
        return ""
    return f"{len(tested)} {'check passes' if len(tested) == 1 else 'checks pass'}."


def leaf_table(id: str, title: str, entries: dict[str, Any], caption: str = "") -> Table:
    """Return a folded table with a row for the name and value of each innermost entry of a nested mapping."""
    rows: list[list[Any]] = [list(leaf) for leaf in leaves(entries)]
    return Table(id=id, title=title, columns=["quantity", "value"], rows=rows, caption=caption, folded=True)


def leaves(entries: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each innermost entry of a nested mapping.

    ``a.b`` names the value of the key ``b`` in the mapping ``a``. ``a[1].b`` names the value of ``b`` in the
    first mapping of the list ``a``.
    """
    for key, value in entries.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from leaves(value, f"{name}.")
        elif isinstance(value, list | tuple) and any(isinstance(one, dict) for one in value):
            yield from leaves({f"[{k}]": one for k, one in enumerate(value, 1)}, name)
        elif isinstance(value, list | tuple):
            yield name, ", ".join(str(one) for one in value)
        else:
            yield name, value if isinstance(value, str | int | float) or value is None else str(value)


def sidecar(result: str | Path) -> Path:
    """Return the path of the evidence file of a result: ``drag.evidence.json`` for ``drag.yaml``."""
    result = Path(result)
    return result.with_name(f"{result.stem}.evidence.json")


def write(path: str | Path, evidence: Evidence) -> None:
    """Write the evidence (verdict, checks, figures) of a result to a JSON file, completely or not at all.

    Numbers that are not finite are written as null.
    """
    atomic.write_text(path, evidence.model_dump_json() + "\n")


def check_beside(result: Path) -> None:
    """Check that writing a result does not replace the evidence file of another result.

    The evidence files of two results have the same name if the names of the two result files differ only in
    the extension.

    Raises
    ------
    UsageError
        If the evidence file exists and belongs to another file that also exists.
    """
    other = _owner(sidecar(result))
    if other not in ("", result.name) and result.with_name(other).exists():
        raise UsageError(
            f"{result.name} and {other} would both have the evidence file {sidecar(result)}",
            hint="give the output a name that differs before the dot",
        )


def remove_outdated(result: Path) -> None:
    """Remove the evidence file of a result file that is replaced by a result without evidence."""
    if result.exists() and _owner(sidecar(result)) == result.name:
        atomic.remove(sidecar(result))


def _owner(path: Path) -> str:
    """Return the name of the result file to which an evidence file states that it belongs; empty if none."""
    try:
        data = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return ""
    return str(data.get("result", "")) if isinstance(data, dict) else ""


def read(path: str | Path) -> Evidence:
    """Read an evidence file that :func:`write` has written.

    Raises
    ------
    InputError
        If the file is missing, is not JSON, or has another format.
    """
    path = Path(path)
    try:
        with file_errors(path):
            return Evidence.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        text = f"is no {FORMAT} file: {describe_problem(first)}"
        raise InputError(text, file=path, column=place or None) from error


def thin_curve(x: Any, y: Any, points: int = MAX_TRACE_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a curve to a maximum number of samples that preserve its envelope.

    The curve is divided into segments with equal numbers of samples. The samples with the smallest and the
    largest y of each segment are retained in their order, so that no peak is lost.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        A segment whose samples of y are all NaN remains a gap in the line.

    Returns
    -------
    x, y : ndarray, shape (m,), m <= max(points, 4)
    """
    x = np.asarray(x, dtype=float)
    y = np.asarray(y, dtype=float)
    if len(x) <= points:
        return x, y
    keep = {0, len(x) - 1}
    for part in np.array_split(np.arange(len(x)), max(points // 2 - 1, 1)):
        known = part[~np.isnan(y[part])]
        if len(known):
            keep |= {known[y[known].argmin()], known[y[known].argmax()]}
        else:
            keep.add(part[0])
    index = np.array(sorted(keep))
    return x[index], y[index]


# ---------------------------------------------------------------- parts that several packages use

#: Maximum number of points that one trial has in a figure of several trials.
MAX_TRIAL_POINTS = 400
#: Number of measured points drawn along a curve, per length of one panel width.
MAX_MARKS = 50
#: Maximum number of trials in a figure of residuals, and largest residual that it shows, in standard
#: deviations of the noise. Each trial has a horizontal strip (row) of the figure. Larger residuals are drawn
#: at the edge of the row.
MAX_RESIDUAL_ROWS, ROW_SD = 12, 4.0
#: Distance between the middle of a row (:data:`MAX_RESIDUAL_ROWS`) and a drawn residual of ROW_SD standard
#: deviations, as a fraction of the distance between two rows.
HALF_ROW = 0.45

Cell = str | float | int | bool | None


#: Type of the measured and simulated values of one channel in one trial. It is an object with ``trial``,
#: ``role`` ("fit" or "validate"), and the arrays ``time_s``, ``measured``, ``simulated`` and ``weighted``
#: (measured minus simulated, divided by the standard deviation of the noise).
Series = Any
#: Type of a correlation function: an object with ``lags``, ``values`` and ``bound``. The bound is the
#: half-width of the 95 % band of white noise.
Correlogram = Any


def p_text(p: float) -> str:
    """Return a p-value as text with two significant digits.

    >>> p_text(0.0321), p_text(1e-20)
    ('p = 0.032', 'p < 10⁻¹⁶')
    """
    if p < 1e-16:
        return "p < 10⁻¹⁶"
    return f"p = {numbers.format_number(p, 2)}"


# ---------------------------------------------------------------- tables


def make_table(
    id: str, title: str, rows: Sequence[Mapping[str, Cell]], caption: str = "", columns: Sequence[str] = ()
) -> Table:
    """Return a table of a report from its rows. Each row is a mapping of column names to cells.

    Parameters
    ----------
    columns : sequence of str
        Names of the columns, required if there may be no rows. The default is the columns of the first row.
    """
    names = list(columns or rows[0])
    return Table(
        id=id, title=title, columns=names, rows=[[row[n] for n in names] for row in rows], caption=caption
    )


# ---------------------------------------------------------------- figures


def make_figure(
    id: str,
    title: str,
    caption: str,
    x_label: str,
    y_label: str,
    traces: Sequence[Trace],
    **more: Any,
) -> Figure:
    """Return a figure of a report with a single panel.

    Further keyword arguments are fields of :class:`Panel`.
    """
    return panels(id, title, caption, [panel(x_label, y_label, traces, **more)])


def panels(id: str, title: str, caption: str, panels: Sequence[Panel]) -> Figure:
    """Return a figure of a report with several panels."""
    return Figure(id=id, title=title, caption=caption, panels=list(panels))


def panel(x_label: str, y_label: str, traces: Sequence[Trace], **more: Any) -> Panel:
    """Return a panel of a figure. Further keyword arguments are fields of :class:`Panel`."""
    return Panel(x_label=x_label, y_label=y_label, traces=list(traces), **more)


def band(x: Any, y: Any, half: Any, **trace: Any) -> Trace:
    """Return a trace with a curve and a shaded band of half-width ``half`` around the curve."""
    return Trace(x=x, y=y, lower=y - half, upper=y + half, **trace)


def pair(x: Sequence[Any], y: Sequence[Any], **measured: Any) -> list[Trace]:
    """Return two traces: measured values as points, and simulated values as a line.

    Parameters
    ----------
    x, y : sequence
        Two arrays of coordinates: measured, then simulated.
    **measured
        Further fields of the trace of the measured values.
    """
    points = Trace(x=x[0], y=y[0], style="points", label="measured", group=0, **measured)
    return [points, Trace(x=x[1], y=y[1], label="simulated", group=0)]


def path(title: str, names: Sequence[str], x: Sequence[Any], y: Sequence[Any]) -> Panel:
    """Return a panel with a measured and a simulated path, from the columns ``names`` of two coordinates."""
    x_label, y_label = map(numbers.column_title, names)
    return panel(x_label, y_label, pair(x, y), title=title, equal_aspect=True)


def make_point_trace(
    runs: Sequence[Any], x: Callable[[Any], Any], y: Callable[[Any], Any], **trace: Any
) -> Trace:
    """Return a trace of points, one for each object in ``runs``.

    The functions ``x`` and ``y`` compute the coordinates of a point from its object.
    """
    return Trace(x=[x(run) for run in runs], y=[y(run) for run in runs], style="points", **trace)


def make_fit_figure(
    id: str,
    title: str,
    caption: str,
    y_label: str,
    shown: Sequence[Series],
    factor: float = 1.0,
) -> Figure:
    """Return a figure of one channel with measured points and simulated lines for selected trials.

    There is a panel for the fitted trial with the largest root-mean-square weighted residual, for the fitted
    trial with the smallest, and for the held-out trial with the largest. ``factor`` converts values to the
    unit of the figure.
    """
    drawn: list[Panel] = []
    for name, s in extremes(shown, lambda s: compute_rms(s.z_scores)).items():
        known = select_marks(s.time_s, s.measured)
        x, y = thin_curve(s.time_s, factor * s.simulated, MAX_TRIAL_POINTS)
        traces = pair((s.time_s[known], x), (factor * s.measured[known], y))
        drawn.append(panel("time (s)", y_label, traces, title=name))
    return panels(id, title, caption, drawn)


def select_marks(x: Any, y: Any) -> Any:
    """Return the indices of samples that are evenly spaced along a curve in a panel of a figure.

    The distance along the curve is 1 / MAX_MARKS of the width of the panel, which is twice as wide as high. A
    curve that rises and falls gets more samples than a straight line, up to :data:`MAX_TRIAL_POINTS`.
    """
    known = np.flatnonzero(np.isfinite(y))
    if not len(known):
        return known
    steps = np.hypot(
        np.diff(x[known]) / max(float(np.ptp(x[known])), 1e-300),
        np.diff(y[known]) / max(2.0 * float(np.ptp(y[known])), 1e-300),
    )
    number = np.floor(np.concatenate(([0.0], np.cumsum(steps))) * MAX_MARKS)
    marks = known[np.unique(number, return_index=True)[1]]
    return marks[:: -(-len(marks) // MAX_TRIAL_POINTS)]


def extremes(shown: Sequence[Series], error: Callable[[Series], float]) -> dict[str, Series]:
    """Return the fitted trials with the largest and the smallest error, and the worst held-out trial.

    The key of each trial is the title of its panel.
    """
    ranked = sorted(shown, key=error)
    fitted = [s for s in ranked if s.role == "fit"]
    held_out = [s for s in ranked if s.role != "fit"]
    if len(fitted) == 1:
        found = {fitted[0].trial: fitted[0]}
    else:
        found = {
            f"{s.trial} ({word})": s
            for word, s in zip(("largest error", "smallest error"), fitted[-1:] + fitted[:1], strict=False)
        }
    return found | {f"{s.trial} (held out)": s for s in held_out[-1:]}


def compute_rms(*series: Any) -> float:
    """Return the root mean square of all finite samples of several series; 0 without samples."""
    values = np.concatenate(series)
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.sum(known**2) / max(len(known), 1)))


def make_residual_figure(
    id: str, title: str, caption: str, shown: Sequence[Series], correlation: Correlogram | None
) -> Figure:
    """Return a figure of the residuals over time, divided by the standard deviation of the noise.

    It shows the trials with the largest errors. If ``correlation`` is given, a second panel shows the
    autocorrelation of the residuals.
    """
    worst = sorted(range(len(shown)), key=lambda k: -compute_rms(shown[k].z_scores))[:MAX_RESIDUAL_ROWS]
    rows = [shown[k] for k in sorted(worst)]
    mixed = len({s.role for s in rows}) > 1
    traces: list[Trace] = []
    for k, s in enumerate(rows):
        x, y = thin_curve(s.time_s, np.clip(s.z_scores, -ROW_SD, ROW_SD), MAX_TRIAL_POINTS)
        group, label = 0, "fitted" if mixed else "residuals"
        if s.role != "fit":
            group, label = 1, "held out"
        traces.append(Trace(x=x, y=k - y * HALF_ROW / ROW_SD, style="points", label=label, group=group))
    middles, half = range(len(rows)), HALF_ROW / 2
    spans = [Span(start=k - half, end=k + half, axis="y", label=f"±{ROW_SD / 2:g} sd") for k in middles]
    names = [s.trial for s in rows]
    over_time = panel("time (s)", "trial", traces, y_categories=names, invert_y=True, spans=spans)
    caption += f" Each row is a trial; the band is ±{ROW_SD / 2:g} standard deviations."
    if correlation is None:
        return panels(id, title, caption, [over_time])
    lagged = correlogram(correlation, "autocorrelation", "residuals", skip_zero=True)
    caption += " The autocorrelation is of all fitted trials, with the 95 % band of white noise."
    return panels(id, title, caption, [over_time, lagged])


def correlogram(correlation: Correlogram, y_label: str, label: str, *, skip_zero: bool) -> Panel:
    """Return a panel that shows a correlation function as stems, and the 95 % band of white noise.

    With ``skip_zero`` the stem at lag 0 is left out.
    """
    keep = np.ones(len(correlation.lags), dtype=bool)
    if skip_zero:
        keep = correlation.lags != 0
    lags = correlation.lags[keep]
    stems = Trace(x=lags, y=correlation.values[keep], style="stems", label=label, group=0)
    null = band(lags, np.zeros(len(lags)), correlation.bound[keep], label="95 % band", group=1)
    return panel("lag (samples)", y_label, [stems, null], marks=[Mark(at=0.0)])
