"""What a tool says of the cases: one JSON object a line, one line a case."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Share = Annotated[float, Field(allow_inf_nan=False)]
#: An effect, or another reading of the robot's source: ``reading:drag_point=strips``.
Name = Annotated[str, Field(pattern=r"^(reading:\w+=\w+|[a-z0-9]+(-[a-z0-9]+)*)$")]
Positive = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class BadAnswer(ValueError):
    """A line that is no answer, with its file and number."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Cause(_Strict):
    """One cause, as a set of effects that the trials cannot tell apart."""

    set: list[Name] = Field(min_length=1, description="effects, likeliest first; one of them acts")
    probability: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="that the cause is in the set"
    )
    closed: dict[str, tuple[Share, tuple[Share, Share] | None]] = Field(
        default_factory=dict,
        description="by channel, share of the gap that all causes together close, and its 95 % interval",
    )
    errors: dict[str, tuple[Positive, Positive]] = Field(
        default_factory=dict,
        description="by channel, root-mean-square error as given and with the causes, in the channel's unit: "
        "what the share is of. Without it the share is not scored",
    )

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if len(set(self.set)) < len(self.set):
            raise ValueError("an effect stands in the set twice")
        for channel, (share, interval) in self.closed.items():
            if interval is not None and not interval[0] <= interval[1]:
                raise ValueError(f"closed.{channel}: the interval of {share:g} ends before it begins")
        return self


class Answer(_Strict):
    """What a tool says of one case."""

    case: str = Field(pattern=r"^\d{4,}$", description="the name of its folder")
    verdict: Literal["none", "explained", "ambiguous", "partial", "unexplained", "failed"] = Field(
        description="none: nothing but noise. explained, ambiguous: the causes named act, with one effect or "
        "several in the first set. partial: the causes named act beside something unknown. unexplained: "
        "there is a gap, and no known effect makes it. failed: no answer, since the tool ended or does not "
        "take such trials"
    )
    causes: list[Cause] = Field(default_factory=list, description="that act together, the largest first")
    wall_s: Positive | None = Field(None, description="wall time, s")

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.named and not self.causes:
            raise ValueError(f"the verdict '{self.verdict}' names no cause")
        if self.verdict in ("none", "failed") and self.causes:
            raise ValueError(f"the verdict '{self.verdict}' has no causes")
        return self

    @property
    def named(self) -> bool:
        """Whether it says that its causes act."""
        return self.verdict in ("explained", "ambiguous", "partial")

    @property
    def doubts(self) -> bool:
        """Whether it says that something unknown acts."""
        return self.verdict in ("partial", "unexplained")

    def line(self) -> str:
        """As a line of an answers file."""
        return self.model_dump_json() + "\n"


def read(path: Path, cases: Collection[str] | None = None) -> dict[str, Answer]:
    """The answers of a file, by case.

    Parameters
    ----------
    cases : collection of str, optional
        Those that there are.

    Raises
    ------
    BadAnswer
        For a line that is no answer, one of no case, or a second one of the same case.
    """
    found: dict[str, Answer] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip():
            continue
        try:
            answer = Answer.model_validate_json(line)
        except ValidationError as error:
            raise BadAnswer(f"{path}:{number}: {_said(error)}") from error
        if answer.case in found:
            raise BadAnswer(f"{path}:{number}: case {answer.case} is answered twice")
        if cases is not None and answer.case not in cases:
            raise BadAnswer(f"{path}:{number}: the benchmark has no case {answer.case}")
        found[answer.case] = answer
    return found


def _said(error: ValidationError) -> str:
    first = error.errors()[0]
    place = ".".join(map(str, first["loc"]))
    return f"{place}: {first['msg']}" if place else first["msg"]


def schema() -> str:
    """The JSON schema of an answer."""
    return json.dumps(Answer.model_json_schema(), indent=1)


def of_gap(case: str, gap: Mapping[str, Any] | None, wall_s: float) -> Answer:
    """The answer that a gap file gives; None where the program wrote none."""
    if gap is None:
        return Answer(case=case, verdict="failed", wall_s=wall_s)
    causes = [_cause(c, gap) for c in gap.get("causes") or []]
    return Answer(case=case, verdict=gap["verdict"], causes=causes, wall_s=wall_s)


def _cause(cause: Mapping[str, Any], gap: Mapping[str, Any]) -> Cause:
    channels = {c["channel"]: c for c in gap["where"]["channels"]}
    closed, errors = {}, {}
    for row in cause.get("shrinkage") or []:
        name, of = row["channel"], channels.get(row["channel"], {})
        if row.get("closed") is None or not row.get("shipped"):
            continue
        interval = row.get("ci95")
        known = interval is not None and None not in interval
        closed[name] = (row["closed"], tuple(interval) if known else None)
        if of.get("rmse") and of.get("nrmse"):
            # the file has errors over the range of the channel
            width = of["rmse"] / of["nrmse"]
            errors[name] = (row["shipped"] * width, row["after"] * width)
    effects = list(dict.fromkeys([cause["effect"], *(cause.get("equivalent") or [])]))
    return Cause(set=effects, probability=cause.get("probability"), closed=closed, errors=errors)
