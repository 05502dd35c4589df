"""Types of the JSON answers that commands print with ``--json``.

The key ``result`` has the content of the file that the command writes. Its schema is that of the file format.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from pydantic import Field
from typing_extensions import TypedDict

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
    """JSON answer that a command prints with ``--json``."""

    schema: Literal[1]
    ok: bool
    command: str
    result: NotRequired[dict[str, Any]]
    error: NotRequired[Failure]
    verdict: Annotated[AnswerVerdict | None, Field(description="null if nothing was checked")]
    warnings: list[Notice]
    outputs: list[str]
    next: Annotated[list[str], Field(description="commands that can be typed")]
