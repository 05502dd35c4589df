"""The power file (``swimid-power/1``): what trials could show of each effect, whatever they do show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd

FORMAT: Literal["swimid-power/1"] = "swimid-power/1"


class Row(yamlio.Document):
    """An effect."""

    effect: str
    stage: str
    #: What says how large it is, and its smallest value that is seen with 90 % power; null where none within
    #: its bounds is.
    parameter: str
    size: Number = None
    unit: str
    #: Share of its squared change that the model's numbers imitate.
    absorbed: Number = None
    #: Effects these trials do not tell from it, however large it is.
    alike: list[str] = []


class PowerFile(yamlio.ResultFile):
    """A power file."""

    kind: ClassVar[str] = "power file"
    format: Literal["swimid-power/1"] = FORMAT
    model: str
    robot: str
    experiment: str
    params: str
    trials: list[str]
    effects: list[Row]
    #: Effects of which nothing can be said, and why.
    left_out: dict[str, str] = {}
    provenance: dict[str, Any] = Field(default_factory=dict)


def answer(file: PowerFile) -> str:
    """How many effects could be seen, as a sentence."""
    seen = [r for r in file.effects if r.size is not None]
    twins = [r for r in seen if r.alike]
    said = f"Of {len(file.effects)} effects these trials would show {len(seen)}"
    return f"{said}, {len(twins)} of them never apart from another." if twins else f"{said}."


def evidence(file: PowerFile, notices: Sequence[ev.NoticeRecord]) -> ev.Evidence:
    """The table of a power file."""
    blind = [r.effect for r in file.effects if r.size is None]
    text = answer(file) + (f" Not seen at any size within its bounds: {', '.join(blind)}." if blind else "")
    return ev.Evidence(
        verb="diagnose",
        title=f"What trials could show: {file.robot}, {file.experiment}",
        verdict=ev.Verdict(level="caution" if blind else "good", text=text),
        checks=[],
        tables=[
            ev.Table(
                id="power",
                title="The smallest size of each effect that is seen with 90 % power",
                columns=["effect", "parameter", "smallest size", "unit", "imitated", "never told from"],
                rows=[
                    [r.effect, r.parameter, r.size, r.unit, r.absorbed, ", ".join(r.alike)]
                    for r in file.effects
                ],
            )
        ],
        figures=[],
        notices=list(notices),
        methods=[
            "The change that an effect makes in the trials, the model's numbers projected out, against their "
            "noise: seen is what leaves less than 10 % to there being no gap, nine times in ten (noncentral "
            "chi-square); never told apart are effects whose changes are so alike that a very large one "
            "leaves the other more than 10 %.",
        ],
        references=[],
        provenance=dict(file.provenance),
    )


@dataclass(frozen=True, eq=False)
class DetectionPower(FileResult[PowerFile]):
    """What trials could show of each effect, as ``diagnose`` gives it when it is asked for its power.

    Attributes
    ----------
    effects : DataFrame
        A row for each: ``effect``, ``stage``, ``parameter``, the smallest ``size`` seen with 90 % power (in
        ``unit``; NaN where none within its bounds is), the share ``absorbed`` by the model's numbers, and
        which effects it is never told from (``alike``).
    file : PowerFile
        What :meth:`save` writes.
    """

    format = FORMAT
    file_type = PowerFile

    @property
    def effects(self) -> pd.DataFrame:
        """A row for each effect."""
        import pandas as pd

        return pd.DataFrame([r.model_dump() for r in self.file.effects])


def summary(file: PowerFile) -> str:
    """Plain text for the terminal."""
    trials = f"{len(file.trials)} trial{'' if len(file.trials) == 1 else 's'}"
    lines = [f"{file.robot}, {file.experiment}: {trials} against {file.params}", "", answer(file), ""]
    width = max((len(r.effect) for r in file.effects), default=6)
    for r in file.effects:
        size = numbers.number(r.size, 2, r.unit)
        said = "not within its bounds" if r.size is None else f"{r.parameter} {size}"
        if r.absorbed is not None and r.absorbed > 0.9:
            said += f", {numbers.percent(r.absorbed)} imitated by the model's numbers"
        if r.alike:
            said += f"; never told from {', '.join(r.alike)}"
        lines.append(f"  {r.effect:<{width}}  {said}")
    lines += [f"  {name:<{width}}  {why}" for name, why in file.left_out.items()]
    return "\n".join(lines)
