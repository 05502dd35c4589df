"""The result of ``compare``: how far a simulation is from each trial."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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

    def _write(self, path: Path) -> list[Path]:
        comparison_file.write(path, self.file)
        return [path]
