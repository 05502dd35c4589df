"""Files on the state of an item in its folder: ``status.json``, and ``stamps.json`` about its inputs.

The status file is written last. It has the state, the SHA-256 of every input and output, and the verdicts and
estimates that the summary of the run shows. An item is outdated if its steps, inputs or version of swimid
differ from those in its status file.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ValidationError, model_validator

from swimid import reading
from swimid.files import atomic, yamlio
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.runs.plan import Item, is_linked

State = Literal["done", "no result", "refused", "failed"]
#: States of an item in the order in which they need attention. An item is ``missing`` before it is processed,
#: and ``busy`` while another process processes it. Results of ``outdated`` and ``missing`` items are not
#: used.
STATES = ("failed", "refused", "no result", "busy", "missing", "outdated", "done")
#: Levels of a verdict from the worst to the best; empty for a result without a verdict.
VERDICT_LEVELS = ("bad", "caution", "good", "")
STATUS_FILE, STAMPS, LOG = "status.json", "stamps.json", "log.txt"
#: Maximum number of traces, and maximum number of points of a trace, in the sketch of a figure.
MAX_TRACES, MAX_SKETCHED = 3, 48


class Metric(BaseModel):
    """Estimate or score of an item, with its 95 % interval if it has one."""

    value: float
    low: yamlio.Number = None
    high: yamlio.Number = None
    unit: str = "1"

    @property
    def stderr(self) -> float:
        """Standard error that corresponds to the interval; NaN without an interval."""
        if self.low is None or self.high is None:
            return math.nan
        return (self.high - self.low) / (2 * numbers.Z95)


class Sketch(BaseModel):
    """Small copy of the first panel of a figure: its axes, and points of its first traces."""

    title: str
    x_label: str
    y_label: str
    equal_aspect: bool
    traces: list[tuple[list[float | None], list[float | None]]]
    styles: list[str]

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        if len(self.traces) != len(self.styles) or any(len(x) != len(y) for x, y in self.traces):
            raise ValueError("traces of a sketch have different numbers of samples: they must be equal")
        return self


class StepStatus(BaseModel):
    """Verdict, warnings and estimates of one step of an item."""

    name: str
    level: str = ""
    text: str = ""
    warnings: list[str] = []
    metrics: dict[str, Metric] = {}


class Status(BaseModel):
    """Content of ``status.json``."""

    format: Literal["swimid-item/1"] = "swimid-item/1"
    id: str
    state: State
    version: str
    #: SHA-256 of steps and version of swimid, and SHA-256 of steps, version and inputs.
    steps_sha256: str
    key: str = ""
    inputs: dict[str, str] = {}
    outputs: dict[str, str] = {}
    steps: list[StepStatus] = []
    #: Error of the step that was refused or failed: step, type, message, hint.
    error: dict[str, Any] = {}
    sketch: Sketch | None = None

    @property
    def level(self) -> str:
        """Worst verdict of the steps; empty if no step has a verdict."""
        return min((step.level for step in self.steps), key=VERDICT_LEVELS.index, default="")

    @property
    def reason(self) -> str:
        """Error of the item, or the text of its worst verdict."""
        if self.error:
            return ": ".join(filter(None, [self.error.get("step"), self.error.get("message")]))
        return next((step.text for step in self.steps if step.level == self.level), "")

    @property
    def metrics(self) -> dict[str, Metric]:
        """Estimates of all steps. The key is the name of the step, followed by the name of the estimate."""
        return {f"{s.name}: {name}": one for s in self.steps for name, one in s.metrics.items()}

    def write(self, folder: Path) -> None:
        """Write the status into the folder of the item."""
        text = json.dumps([self.steps_sha256, self.inputs], sort_keys=True)
        keyed = self.model_copy(update={"key": hashlib.sha256(text.encode()).hexdigest()})
        atomic.write_text(folder / STATUS_FILE, keyed.model_dump_json() + "\n")


def read(folder: Path) -> Status | None:
    """Read the status of an item; None if the status file is missing or damaged."""
    try:
        return Status.model_validate_json((folder / STATUS_FILE).read_bytes())
    except (OSError, ValidationError):
        return None


def read_stamps(folder: Path) -> dict[str, Any]:
    """Return size and time of modification of each input of an item; empty if the file is missing."""
    try:
        return dict(json.loads((folder / STAMPS).read_bytes()))
    except (OSError, ValueError, TypeError):
        return {}


def state_of(item: Item, folder: Path) -> tuple[str, Status | None]:
    """Return the state of an item and its status.

    The status of an outdated item is also returned, so that its version can be shown.
    """
    if is_linked(folder):
        # Read and remove nothing through a link, which may lead to files that do not belong to the run.
        text = f"its folder items/{item.id} is a symbolic link, or below one: remove the link"
        return "failed", Status(
            id=item.id, state="failed", version="", steps_sha256="", error={"message": text}
        )
    status = read(folder)
    if status is None:
        return "missing", None
    if status.steps_sha256 != item.digest():
        return "outdated", status
    stated = read_stamps(folder)
    for name, digest in status.inputs.items():
        # Assume unchanged content if size and time of modification are unchanged, as other tools do.
        files = reading.files_of(folder / name)
        now = reading.Opened(files, reading.stamp_of(files))
        if now.stamp != stated.get(name) and now.digest()[0] != digest:
            return "outdated", status
    if not all((folder / name).exists() for name in status.outputs):
        return "missing", status
    return status.state, status


# ---------------------------------------------------------------- estimates and sketch of a result


def metrics_of(answer: Mapping[str, Any], patterns: list[str]) -> dict[str, Metric]:
    """Return the estimates in the ``--json`` output of a command, and the numbers that match patterns.

    An estimate is a mapping with ``value`` and ``unit``, and ``stderr`` or ``low`` and ``high``. Estimates of
    one trial and parameters that the data do not determine are left out. A pattern has dotted names, ``*``
    for any name, and after ``|`` the dotted name of the 95 % interval of the number.
    """
    found = dict(_estimates(answer))
    for pattern in patterns:
        place, _, interval = pattern.partition("|")
        ends: list[float | None] = [value for _, value in _find_numbers(answer, interval.split("."))]
        if len(ends) != 2:
            ends = [None, None]
        for name, value in _find_numbers(answer, place.split(".")):
            unit = numbers.split_unit(name)[1] or "1"
            found[name] = Metric(value=value, low=ends[0], high=ends[1], unit=unit)
    return found


def _estimates(data: Mapping[str, Any]) -> Iterator[tuple[str, Metric]]:
    for name, entry in data.items():
        if not isinstance(entry, Mapping) or "[" in name:
            continue
        if not {"value", "unit"} <= entry.keys():
            yield from _estimates(entry)
        elif entry.get("status", "estimated") == "estimated" and _is_known(entry["value"]):
            low, high, error = entry.get("low"), entry.get("high"), entry.get("stderr")
            if error is not None:
                low, high = (entry["value"] + sign * numbers.Z95 * error for sign in (-1, 1))
            yield name, Metric(value=entry["value"], low=low, high=high, unit=entry["unit"])


def _is_known(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _find_numbers(data: Any, keys: list[str]) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of each number, single or in a list, that a pattern of keys matches."""
    if not keys:
        values = data if isinstance(data, list) else [data]
        yield from (("", float(value)) for value in values if _is_known(value))
        return
    if not isinstance(data, Mapping):
        return
    for key in data:
        if keys[0] in ("*", key):
            for rest, value in _find_numbers(data[key], keys[1:]):
                yield f"{key}.{rest}".rstrip("."), value


def sketch_of(evidence: ev.Evidence) -> Sketch | None:
    """Return a sketch of the first figure in the evidence of a result; None if there is no figure."""
    for figure in evidence.figures:
        for panel in figure.panels:
            if panel.traces:
                traces = [_points(trace) for trace in panel.traces[:MAX_TRACES]]
                return Sketch(
                    title=panel.title or figure.title,
                    x_label=panel.x_label,
                    y_label=panel.y_label,
                    equal_aspect=panel.equal_aspect,
                    traces=traces,
                    styles=[trace.style for trace in panel.traces[:MAX_TRACES]],
                )
    return None


def _points(trace: ev.Trace) -> tuple[list[float | None], list[float | None]]:
    x, y = ev.thin_curve(
        [math.nan if v is None else v for v in trace.x],
        [math.nan if v is None else v for v in trace.y],
        MAX_SKETCHED,
    )
    return _short(x), _short(y)


def _short(values: Any) -> list[float | None]:
    return [float(f"{v:.4g}") if math.isfinite(v) else None for v in values]
