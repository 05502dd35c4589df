"""Evidence of a result as data: verdict, checks, tables and figures (``swimid-evidence/1``).

A command writes it beside its result (``drag.yaml``: ``drag.evidence.json``). Reports draw the evidence of
all commands with the same code. Numbers keep every digit; NaN is written as null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from swimid.errors import InputError, UsageError, file_errors
from swimid.files import atomic

FORMAT: Literal["swimid-evidence/1"] = "swimid-evidence/1"
#: Name of the check that fails where a unit cannot be right.
POSSIBLE = "Values a swimmer reaches"
#: A trace longer than this is reduced to its envelope before it is stored.
MAX_POINTS = 2000
#: Maximum number of reasons in the text of a verdict.
MAX_REASONS = 3


def _numbers(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return value
    return [None if isinstance(x, float) and not math.isfinite(x) else x for x in value]


#: A list of numbers; a numpy array is taken as it is and NaN becomes None.
Numbers = Annotated[list[float | None], BeforeValidator(_numbers)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Trace(_Part):
    """One curve or cloud of points of a panel."""

    x: Numbers
    y: Numbers
    label: str = ""
    style: Literal["line", "dashed", "points", "step", "bars", "stems", "arrows"] = "line"
    #: Traces with the same group number share a colour (a measurement and its model).
    group: int | None = None
    #: Half-width of the error bars of ``points``, same length as y.
    y_error: Numbers | None = None
    #: A shaded band, same length as x; drawn with the trace's colour.
    lower: Numbers | None = None
    upper: Numbers | None = None


class Mark(_Part):
    """A horizontal or vertical reference line."""

    at: float
    axis: Literal["x", "y"] = "y"
    label: str = ""


class Span(_Part):
    """A shaded stretch of the horizontal axis, a gap in the data for instance."""

    start: float
    end: float
    label: str = ""


class Heat(_Part):
    """A table of numbers shaded by their size, in place of the traces of a panel.

    The number stands in every cell; the shade grows with its logarithm where it exceeds ``neutral``, or
    evenly from the smallest to the largest number.
    """

    rows: list[str]
    columns: list[str]
    #: One list a row; None where there is no number.
    values: list[Numbers]
    #: Up to here a cell is not shaded, with a scale of logarithms.
    neutral: float = Field(default=1.0, gt=0)
    scale: Literal["log", "linear"] = "log"


class Panel(_Part):
    """One pair of axes."""

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
    #: Category names in place of numbers on the x axis (``bars``), at 0, 1, 2, ...
    x_categories: list[str] | None = None
    #: The same on the y axis.
    y_categories: list[str] | None = None


class Figure(_Part):
    """One figure: panels side by side (``columns`` a row), and what a good one looks like."""

    id: str
    title: str
    caption: str
    panels: list[Panel]
    columns: int = 1


class Image(_Part):
    """A picture (an overlay frame), embedded."""

    id: str
    title: str
    caption: str
    media_type: Literal["image/jpeg", "image/png"]
    base64: str


class Table(_Part):
    """A table of texts and numbers; a folded table opens on demand and is not printed."""

    id: str
    title: str
    columns: list[str]
    rows: list[list[str | float | int | bool | None]]
    caption: str = ""
    folded: bool = False


class Check(_Part):
    """One test of the result against a limit."""

    name: str
    value: str
    limit: str = ""
    verdict: Literal["pass", "warn", "fail", "info"]
    text: str = ""
    #: Clause that the verdict of the result gives as its reason where the check does not pass.
    reason: str = ""


class Verdict(_Part):
    """Level of a result, and the sentence that says what it found and why it has this level."""

    level: Literal["good", "caution", "bad"]
    text: str
    #: What a badge says; by default the level.
    word: str = ""

    def lowered(self, level: str, text: str) -> Verdict:
        """Return this verdict with another text, at the level given or at its own if that is lower."""
        worst = max(level, self.level, key=("good", "caution", "bad").index)
        return self.model_copy(update={"level": worst, "text": text})


class NoticeRecord(_Part):
    """A warning kept with the result."""

    code: str
    text: str


class Evidence(_Part):
    """Everything that a report shows of a result beside the content of its file."""

    format: Literal["swimid-evidence/1"] = FORMAT
    #: Name and SHA-256 of the content of the file that it was written for; empty in memory.
    result: str = ""
    sha256: str = ""
    command: str
    title: str
    verdict: Verdict
    #: Short particulars: robot, model, number of trials.
    facts: dict[str, str] = Field(default_factory=dict)
    #: Sentences that stand below the first table.
    notes: list[str] = []
    checks: list[Check] = []
    tables: list[Table] = []
    figures: list[Figure] = []
    images: list[Image] = []
    notices: list[NoticeRecord] = []
    #: Sentences for a paper's methods section, generated from what was run.
    methods: list[str] = []
    #: Sources to cite with them.
    references: list[str] = []
    #: The same block as the ``provenance`` of the result.
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _nothing_impossible(self) -> Evidence:
        """Lower the verdict of a result that rests on unusual values or on a unit that others contradict.

        A stated unit is believed: unusual values alone are a reason for caution, and no more.
        """
        if any(check.name == POSSIBLE for check in self.checks):
            return self
        for code, grade, level in (("SWM034", "fail", "bad"), ("SWM002", "warn", "caution")):
            texts = "; ".join(notice.text for notice in self.notices if notice.code == code)
            if texts:
                self.checks.append(Check(name=POSSIBLE, value="beyond", verdict=grade, text=texts))
                text = f"{self.verdict.text} Values that no swimmer reaches: {texts}."
                self.verdict = self.verdict.lowered(level, text)
                break
        return self


def check(
    name: str,
    value: str,
    passed: bool | None,
    limit: str = "",
    text: str = "",
    *,
    otherwise: Literal["warn", "fail"] = "warn",
    reason: str = "",
) -> Check:
    """Return the test of a value against a limit; it is for information where ``passed`` is None.

    Parameters
    ----------
    name, value, limit, text : str
        Quantity, its value, the values allowed, and what the value means.
    passed : bool or None
    otherwise : {"warn", "fail"}
        Verdict of a check that does not pass.
    reason : str
        Clause for the verdict of the result, ``"residuals are not white in yaw_rad"``.
    """
    verdict: Literal["info", "pass", "warn", "fail"] = otherwise
    if passed is None:
        verdict = "info"
    elif passed:
        verdict = "pass"
    return Check(name=name, value=value, limit=limit, verdict=verdict, text=text, reason=reason)


def judged(answer: str, checks: Sequence[Check]) -> Verdict:
    """Return the verdict of a result: its answer, and the reasons of the checks that do not pass.

    It is bad where a check fails, caution where one warns, and else good.
    """
    for grade, level, words in (("fail", "bad", "Do not rely on it"), ("warn", "caution", "Caution")):
        failed = [c.reason or f"{c.name} {c.value}".strip() for c in checks if c.verdict == grade]
        reasons = list(dict.fromkeys(failed))
        if reasons:
            shown = reasons[:MAX_REASONS]
            if len(reasons) > MAX_REASONS:
                shown.append(f"and {len(reasons) - MAX_REASONS} more")
            return Verdict(level=level, text=f"{answer} {words}: {'; '.join(shown)}.")  # type: ignore[arg-type]
    return Verdict(level="good", text=answer)


def leaf_table(id: str, title: str, entries: dict[str, Any], caption: str = "") -> Table:
    """Return a folded table of the names and values of a nested mapping, one leaf a row."""
    rows: list[list[Any]] = [list(leaf) for leaf in leaves(entries)]
    return Table(id=id, title=title, columns=["quantity", "value"], rows=rows, caption=caption, folded=True)


def leaves(entries: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values of the leaves of a nested mapping.

    ``a.b`` is a value inside ``a``, ``a[1].b`` one inside the first of several mappings in ``a``.
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
    """Return the path of the evidence of a result file: ``drag.yaml`` has ``drag.evidence.json``."""
    result = Path(result)
    return result.with_name(f"{result.stem}.evidence.json")


def write(path: str | Path, evidence: Evidence) -> None:
    """Write evidence as JSON, complete or not at all."""
    text = json.dumps(evidence.model_dump(mode="json"), ensure_ascii=False, allow_nan=False)
    atomic.write_text(path, text + "\n")


def check_beside(result: Path) -> None:
    """Check that the evidence of a result will not replace that of another file with the same stem.

    Raises
    ------
    UsageError
        When the evidence file is there and belongs to another file that exists.
    """
    other = _owner(sidecar(result))
    if other not in ("", result.name) and result.with_name(other).exists():
        raise UsageError(
            f"{sidecar(result)} is the evidence of {other}, and would be replaced by that of {result.name}",
            hint="give the output another name before its ending",
        )


def remove_outdated(result: Path) -> None:
    """Remove the evidence of an older file that is replaced by one without evidence."""
    if result.exists() and _owner(sidecar(result)) == result.name:
        atomic.remove(sidecar(result))


def _owner(path: Path) -> str:
    """Return the name of the file that evidence belongs to; empty if it is unknown."""
    try:
        data = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return ""
    return str(data.get("result", "")) if isinstance(data, dict) else ""


def read(path: str | Path) -> Evidence:
    """Read evidence written by :func:`write`.

    Raises
    ------
    InputError
        When the file is missing, no JSON, or not of this format.
    """
    path = Path(path)
    try:
        with file_errors(path):
            return Evidence.model_validate_json(path.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"no {FORMAT} file: {first['msg']}", file=path, column=place or None) from error


def thinned(x: Any, y: Any, points: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return at most ``points`` samples of x and y that keep the envelope of y.

    The record is cut into equal stretches; of each the smallest and the largest sample are
    kept in their order, so that no peak is lost.

    Parameters
    ----------
    x, y : array_like, shape (n,)
        NaN in y is kept as a break of the line where it fills a whole stretch.

    Returns
    -------
    x, y : ndarray, shape (m,), m <= max(points, 4)
    """
    x = np.asarray(x, dtype=float)
    y = np.asarray(y, dtype=float)
    if len(x) <= points:
        return x, y
    keep: set[int] = {0, len(x) - 1}
    first, whole = 0, not np.isnan(y).any()
    for values in np.array_split(y, max(points // 2 - 1, 1)):
        if whole:
            keep.update((first + int(np.argmin(values)), first + int(np.argmax(values))))
        elif np.all(np.isnan(values)):
            keep.add(first)
        else:
            keep.update((first + int(np.nanargmin(values)), first + int(np.nanargmax(values))))
        first += len(values)
    index = np.array(sorted(keep))
    return x[index], y[index]
