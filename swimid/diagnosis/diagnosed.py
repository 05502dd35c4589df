"""The result of ``diagnose``: the gap by channel, the causes, and the errors without and with the causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swimid.diagnosis import evidence
from swimid.diagnosis.gap_file import GapFile, Value
from swimid.results.evidence import Evidence
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Diagnosis(FileResult[GapFile]):
    """Result of ``diagnose``: the gap between trials and a model, and the causes of the gap.

    Attributes
    ----------
    answer : str
        Verdict: ``"none"``, ``"explained"``, ``"ambiguous"`` or ``"unexplained"``.
    causes : DataFrame
        One row for each parameter of each cause, the most probable cause first. Columns: ``effect``,
        ``probability`` (that this effect or an equivalent one is among the causes), ``parameter``, ``value``
        and ``stderr`` (in ``unit``), ``status``.
    shrinkage : DataFrame
        One row for each cause and channel. Columns: error on held-out data ``before`` and ``after`` the
        causes are added, noise ``floor`` (all divided by the measured range), fraction ``closed`` of the
        error above the floor, and its 95 % interval ``ci95``.
    where : DataFrame
        One row for each channel. Columns: error ``nrmse`` of the refitted model, noise ``floor``, error
        ``within`` trials without between-trial variation (all divided by the measured range), ``share``
        (fraction of the squared gap), ``rmse`` (in ``unit``).
    file : GapFile
        Content of the file that :meth:`save` writes. It also has rival causes, remaining residuals, proposed
        experiments and the scores of all effects.
    """

    file_type = GapFile

    @property
    def answer(self) -> str:
        """Return the verdict: ``"none"``, ``"explained"``, ``"ambiguous"`` or ``"unexplained"``."""
        return self.file.verdict

    @property
    def causes(self) -> pd.DataFrame:
        """Return one row for each parameter of each cause.

        A cause without parameters, such as another interpretation of the robot's source, has one row.
        """
        import pandas as pd

        none = {"": Value(value=None, unit="")}

        rows = [
            (c.effect, c.probability, name, v.value, v.stderr, v.unit, v.status)
            for c in self.file.causes
            for name, v in (c.parameters or none).items()
        ]
        return pd.DataFrame(
            rows, columns=["effect", "probability", "parameter", "value", "stderr", "unit", "status"]
        )

    @property
    def shrinkage(self) -> pd.DataFrame:
        """Return the held-out errors of each channel without and with the causes."""
        import pandas as pd

        rows = [{"effect": c.effect, **s.model_dump()} for c in self.file.causes for s in c.shrinkage]
        return pd.DataFrame(rows)

    @property
    def where(self) -> pd.DataFrame:
        """Return the gap and the noise floor of each channel."""
        import pandas as pd

        return pd.DataFrame([c.model_dump() for c in self.file.where.channels])

    def bare(self) -> Evidence:
        """Return the evidence that can be shown if the evidence file is missing."""
        found = evidence.evidence(self.file)
        text = f"No evidence file, so its figures cannot be shown. {found.verdict.text}"
        level = "bad" if found.verdict.level == "bad" else "caution"
        return found.model_copy(
            update={"verdict": found.verdict.model_copy(update={"level": level, "text": text})}
        )
