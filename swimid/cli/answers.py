"""JSON Schema of the answers that commands print with ``--json``.

The result of a command that writes a YAML file has the schema of this file. Every other class of results
states the keys of its data (:attr:`swimid.results.result.Result.keys`). It may have further keys.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, get_args

from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from swimid.commands import find_commands
from swimid.notices import Notice


class AnswerVerdict(TypedDict):
    """Verdict on a result, with the reasons of the checks that do not pass."""

    level: Literal["good", "caution", "bad"]
    text: str
    reasons: list[str]


class Failure(TypedDict):
    """Error that ended a command. It may have further keys, such as ``file`` and ``line``."""

    type: str
    message: str
    exit_status: int


class CommandAnswer(TypedDict):
    """Answer of a command to --json."""

    schema: Literal[1]
    ok: bool
    command: str
    result: NotRequired[dict[str, Any]]
    error: NotRequired[Failure]
    verdict: Annotated[AnswerVerdict | None, Field(description="null if nothing was checked")]
    warnings: list[Notice]
    outputs: list[str]
    next: Annotated[list[str], Field(description="commands that can be typed")]


def answer_schema() -> dict[str, Any]:
    """Return the JSON Schema of the answer of any command to ``--json``."""
    document = TypeAdapter(CommandAnswer).json_schema()
    document["properties"]["command"] = {"enum": list(find_commands())}
    document["allOf"] = []
    for command, spec in find_commands().items():
        kinds = spec.result_type()
        shown = []
        for kind in get_args(kinds) or (kinds,):
            name = kind.__name__
            of_file = getattr(kind, "file_type", None)
            adapter = TypeAdapter(of_file or TypedDict(name, dict(kind.keys)))  # type: ignore[operator]
            schema = adapter.json_schema(ref_template=f"#/$defs/{name}/$defs/{{model}}")
            # An answer may have more keys than the file.
            schema.pop("additionalProperties", None)
            document["$defs"][name] = schema
            shown.append({"$ref": f"#/$defs/{name}"})
        document["allOf"].append({
            "if": {"properties": {"command": {"const": command}}, "required": ["result"]},
            "then": {"properties": {"result": {"anyOf": shown}}},
        })  # fmt: skip
    return document
