"""The result of ``compare``: how far a simulation is from each trial."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.results.evidence import Evidence
from swimid.results.result import Result
from swimid.simulation import comparison_file
from swimid.simulation.comparison_file import ComparisonFile

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Comparison(Result):
    """Measured trials against their simulation."""

    format = comparison_file.FORMAT

    @property
    def file(self) -> ComparisonFile:
        """What :meth:`save` writes."""
        assert isinstance(self.document, ComparisonFile)
        return self.document

    @property
    def scores(self) -> pd.DataFrame:
        """Errors of each channel of each trial: RMSE in the channel's unit, NRMSE, variance accounted for."""
        import pandas as pd

        return pd.DataFrame(
            [
                {"trial": trial.id, "role": trial.role, "channel": channel, **score.model_dump()}
                for trial in self.file.trials
                for channel, score in trial.channels.items()
            ]
        )

    @classmethod
    def _read(cls, path: str | Path) -> ComparisonFile:
        return comparison_file.read(path)

    @classmethod
    def _told(cls, document: ComparisonFile, evidence: Evidence | None) -> str:
        from swimid.simulation.compare_evidence import summary

        return summary(document, evidence) if evidence else super()._told(document, evidence)

    def _write(self, path: Path) -> list[Path]:
        comparison_file.write(path, self.file)
        return [path]
