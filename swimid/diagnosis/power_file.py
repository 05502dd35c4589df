"""The power file (``swimid-power/1``): detection power of trials for each effect."""

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
    """Detection power of one effect."""

    effect: str
    stage: str
    #: Parameter that states the size of the effect. ``size`` is its smallest value that is detected with 90 %
    #: power; null if no value within its bounds is detected.
    parameter: str
    size: Number = None
    unit: str
    #: Fraction of the squared change by the effect that the model's parameters imitate.
    absorbed: Number = None
    #: Effects that these trials cannot distinguish from this one, however large it is.
    alike: list[str] = []


class PowerFile(yamlio.ResultFile):
    """Content of a power file."""

    kind: ClassVar[str] = "power file"
    format: Literal["swimid-power/1"] = FORMAT
    model: str
    robot: str
    experiment: str
    params: str
    trials: list[str]
    effects: list[Row]
    #: Effects that could not be evaluated, with the reason.
    left_out: dict[str, str] = {}
    provenance: dict[str, Any] = Field(default_factory=dict)


def evidence(file: PowerFile, notices: Sequence[ev.NoticeRecord] = ()) -> ev.Evidence:
    """Return the evidence of a power file: its table, and the number of detectable effects."""
    blind = [r.effect for r in file.effects if r.size is None]
    twins = sum(r.size is not None and bool(r.alike) for r in file.effects)
    seen = len(file.effects) - len(blind)
    answer = (
        f"Of {len(file.effects)} effects these trials would show {seen}, {twins} of them never distinguished."
    )
    unseen = f"not seen at any size within their bounds: {', '.join(blind)}"
    check = ev.check("effects seen", str(seen), not blind, str(len(file.effects)), reason=unseen)
    rows: list[list[Any]] = [
        [
            r.effect,
            r.parameter,
            numbers.number(r.size, 2, r.unit),
            None if r.absorbed is None else 100.0 * r.absorbed,
            ", ".join(r.alike),
        ]
        for r in file.effects
    ]
    return ev.Evidence(
        command="diagnose",
        title=f"What trials could show: {file.robot}, {file.experiment}",
        verdict=ev.judged(answer, [check]),
        facts={"Trials": f"{len(file.trials)} against {file.params}"},
        notes=[f"{name}: {why}." for name, why in file.left_out.items()],
        checks=[check],
        tables=[
            ev.Table(
                id="power",
                title="The smallest size of each effect that is seen with 90 % power",
                columns=["effect", "parameter", "smallest size", "imitated (%)", "never distinguished from"],
                rows=rows,
                caption="Imitated: share of its squared change that the coefficients take up.",
            )
        ],
        notices=list(notices),
        methods=[
            "The change that an effect makes in the trials, the coefficients of the model projected out, was "
            "held against their noise: seen is what leaves less than 10 % to there being no gap, nine times "
            "in ten (noncentral chi-square); never distinguished: effects whose changes are so alike that a "
            "very large one leaves the other more than 10 %.",
        ],
        provenance=dict(file.provenance),
    )


@dataclass(frozen=True, eq=False)
class DetectionPower(FileResult[PowerFile]):
    """Detection power of trials: the result of ``diagnose`` with ``power=True``.

    Attributes
    ----------
    effects : DataFrame
        One row for each effect, with the columns ``effect``, ``stage``, ``parameter``, ``size``, ``unit``,
        ``absorbed`` and ``alike``. ``size`` is the smallest value of the parameter that is detected with 90 %
        power; NaN if no value within its bounds is detected. ``absorbed`` is the fraction of the squared
        change by the effect that the model's parameters imitate. ``alike`` lists the effects from which the
        effect is never distinguished.
    file : PowerFile
        The file that :meth:`save` writes.
    """

    file_type = PowerFile

    @property
    def effects(self) -> pd.DataFrame:
        """Return a table with one row for each effect."""
        import pandas as pd

        return pd.DataFrame([r.model_dump() for r in self.file.effects])

    def bare(self) -> ev.Evidence:
        """Return the evidence for the report of a power file that contains none."""
        return evidence(self.file)
