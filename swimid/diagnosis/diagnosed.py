"""The result of ``diagnose``: where the gap is, which effect causes it, and how far it shrinks."""

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
    """The gap between trials and a model, and its causes, as ``diagnose`` returns it.

    Attributes
    ----------
    answer : str
        ``"none"``, ``"explained"``, ``"ambiguous"`` or ``"unexplained"``.
    causes : DataFrame
        One row for each parameter of each cause, the most probable cause first: ``effect``, ``probability``
        (that this effect or an equivalent one is among the causes), ``parameter``, ``value`` and ``stderr``
        (in ``unit``), ``status``.
    shrinkage : DataFrame
        By cause and channel: the error on held-out data ``before`` and ``after``, the noise ``floor`` (all
        over the measured range), and the share ``closed`` with its ``ci95``.
    where : DataFrame
        By channel: ``nrmse`` of the refitted model, its ``floor``, the error ``within`` trials without
        between-trial variation (all over the measured range), ``share`` of the whole gap, ``rmse`` (in
        ``unit``).
    file : GapFile
        The file that :meth:`save` writes. It also has rivals, remaining residuals, advice and the scores of
        all effects.
    """

    file_type = GapFile

    @property
    def answer(self) -> str:
        """Return ``"none"``, ``"explained"``, ``"ambiguous"`` or ``"unexplained"``."""
        return self.file.verdict

    @property
    def causes(self) -> pd.DataFrame:
        """Return one row for each parameter of each cause; a reading has one row without a parameter."""
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
        """Return how far each cause shrinks the gap of each channel on held-out trials."""
        import pandas as pd

        rows = [{"effect": c.effect, **s.model_dump()} for c in self.file.causes for s in c.shrinkage]
        return pd.DataFrame(rows)

    @property
    def where(self) -> pd.DataFrame:
        """Return the gap of each channel and its noise floor."""
        import pandas as pd

        return pd.DataFrame([c.model_dump() for c in self.file.where.channels])

    def bare(self) -> Evidence:
        """Return what a report shows of a gap file whose evidence is missing."""
        found = evidence.evidence(self.file)
        text = f"No evidence file, so its figures cannot be shown. {found.verdict.text}"
        level = "bad" if found.verdict.level == "bad" else "caution"
        return found.model_copy(
            update={"verdict": found.verdict.model_copy(update={"level": level, "text": text})}
        )
