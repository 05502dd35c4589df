"""JSON Schema of the answers that commands print with ``--json``.

The result of a command that writes a YAML file has the schema of this file. The other results are described
here. They may have further keys.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NotRequired

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import TypedDict

from swimid.cli.main import found
from swimid.results.result import FORMATS


class _Open(TypedDict):
    """Base class of results, which may have further keys."""

    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]


class Film(_Open):
    """Result of ``track video``."""

    frames: int
    found: int
    found_share: float
    duration_s: float
    interpolated: int
    gaps: int
    longest_gap_s: float
    unit: str
    swimming: dict[str, Any]


class Setup(_Open):
    """Result of ``track setup``."""

    video: str
    markers: list[dict[str, Any]]
    head: str
    tail: str | None
    found_share: dict[str, float]


class Inertial(_Open):
    """Result of ``track imu``."""

    method: str
    attitude_from: str
    still_periods: list[dict[str, Any]]
    faults: list[dict[str, Any]]
    stroke: dict[str, Any] | None


class Imported(_Open):
    """Result of ``import``; with ``--guess`` the drafted mapping."""

    file: str
    samples: NotRequired[int]
    duration_s: NotRequired[float]
    median_rate_hz: NotRequired[float]
    columns: NotRequired[list[str]]
    missing: NotRequired[dict[str, int]]
    stroke: NotRequired[dict[str, Any]]
    speed: NotRequired[dict[str, Any] | None]
    checks: NotRequired[list[dict[str, Any]]]
    mapping: NotRequired[str]
    open: NotRequired[int]


class Simulated(_Open):
    """Result of ``simulate``."""

    model: str
    robot: str
    runs: list[dict[str, Any]]


class Exported(_Open):
    """Result of ``export``."""

    target: NotRequired[str]
    limits: NotRequired[list[str]]


class Plotted(_Open):
    """Result of ``plot``."""

    logs: list[str]
    figures: list[str]


class Reported(_Open):
    """Result of ``report``."""

    title: str
    verdict: dict[str, Any]
    results: list[dict[str, Any]]


class BatchRun(_Open):
    """Result of ``batch``. In a dry run ``items`` is the list of items."""

    items: NotRequired[int | list[dict[str, Any]]]
    states: NotRequired[dict[str, int]]
    entries: NotRequired[list[dict[str, Any]]]
    jobs: NotRequired[int]


class Project(_Open):
    """Result of ``init``."""

    recordings: list[dict[str, str]]
    others: list[str]
    files: list[str]
    questions: list[dict[str, Any]]
    missing: list[str]
    commands: list[str]
    next: str


class Sample(_Open):
    """Result of ``sample``: one copied sample, or the list of all samples."""

    samples: NotRequired[dict[str, dict[str, str]]]
    sample: NotRequired[str]
    folder: NotRequired[str]
    about: NotRequired[str]
    command: NotRequired[str]


#: Type of the result of a command: a type of this module, or the format of a result file. The result of a
#: command that is not listed is any object.
RESULTS: dict[str, Any] = {
    **dict.fromkeys(("fit-drag", "fit-propulsion", "fit-graybox", "rwls"), "swimid-parameters/1"),
    "compare": "swimid-comparison/1",
    "diagnose": "swimid-gap/1",
    "sensitivity": "swimid-sensitivity/2",
    "map": "swimid-map/1",
    "optimise stiffness": "swimid-rule/2",
    "optimise gait": "swimid-gait/2",
    "compare-runs": "swimid-run-comparison/1",
    "track camera": "swimid-camera/1",
    "track video": Film,
    "track setup": Setup,
    "track imu": Inertial,
    "import": Imported,
    "simulate": Simulated,
    "export": Exported,
    "plot": Plotted,
    "report": Reported,
    "batch": BatchRun,
    "init": Project,
    "sample": Sample,
}


def answer_schema() -> dict[str, Any]:
    """Return the JSON Schema of the answer of any command to ``--json``."""
    definitions: dict[str, Any] = {}
    rules = []
    for command in found():
        kind = RESULTS.get(command, dict[str, Any])
        name = kind if isinstance(kind, str) else command
        if isinstance(kind, str):
            module, _, attribute = FORMATS[kind].partition(":")
            kind = getattr(import_module(module), attribute).file_type
        place = name.replace("/", "-").replace(" ", "-")
        if place not in definitions:
            schema = TypeAdapter(kind).json_schema(ref_template=f"#/$defs/{place}/$defs/{{model}}")
            # An answer may have more keys than the file.
            schema.pop("additionalProperties", None)
            definitions[place] = schema
        rules.append({
            "if": {"properties": {"command": {"const": command}}, "required": ["result"]},
            "then": {"properties": {"result": {"$ref": f"#/$defs/{place}"}}},
        })  # fmt: skip
    text = {"type": "string"}
    return {
        "title": "Answer of a command to --json",
        "type": "object",
        "required": ["schema", "ok", "command", "verdict", "warnings", "outputs", "next"],
        "properties": {
            "schema": {"const": 1},
            "ok": {"type": "boolean"},
            "command": {"enum": list(found())},
            "result": {"type": "object"},
            "error": {
                "type": "object",
                "required": ["type", "message", "exit_status"],
                "properties": {"type": text, "message": text, "exit_status": {"type": "integer"}},
            },
            "verdict": {
                "description": "null if nothing was checked",
                "anyOf": [{"type": "null"}, {
                    "type": "object",
                    "required": ["level", "text", "reasons"],
                    "properties": {
                        "level": {"enum": ["good", "caution", "bad"]},
                        "text": text,
                        "reasons": {"type": "array", "items": text},
                    },
                }],
            },
            "warnings": {
                "type": "array",
                "items": {
                    "type": "object",
                    "required": ["code", "text"],
                    "properties": {"code": text, "text": text},
                },
            },
            "outputs": {"type": "array", "items": text},
            "next": {"description": "commands that can be typed", "type": "array", "items": text},
        },
        "allOf": rules,
        "$defs": definitions,
    }  # fmt: skip
