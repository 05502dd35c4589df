"""The result of ``sensitivity``: what each output of a robot is most sensitive to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.results.evidence import Evidence
from swimid.results.result import Result
from swimid.sensitivity_analysis import file as sensitivity_file
from swimid.sensitivity_analysis.file import SensitivityFile

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Sensitivity(Result):
    """Sensitivity indices of coefficients, and outputs over a grid of drives."""

    format = sensitivity_file.FORMAT

    @property
    def file(self) -> SensitivityFile:
        """What :meth:`save` writes."""
        assert isinstance(self.document, SensitivityFile)
        return self.document

    @property
    def indices(self) -> pd.DataFrame:
        """A row for each coefficient of each output: Sobol shares, or elementary effects (Morris)."""
        import pandas as pd

        rows = []
        for o in self.file.outputs:
            found = {**o.shares, **o.effects}
            rows += [
                {"output": o.quantity, "trial": o.trial, "coefficient": name, **index.model_dump()}
                for name, index in found.items()
            ]
        return pd.DataFrame(rows)

    @classmethod
    def _read(cls, path: str | Path) -> SensitivityFile:
        return sensitivity_file.read(path)

    @classmethod
    def _told(cls, document: SensitivityFile, evidence: Evidence | None) -> str:
        from swimid.sensitivity_analysis.evidence import summary

        return summary(document, evidence) if evidence else super()._told(document, evidence)

    def _write(self, path: Path) -> list[Path]:
        sensitivity_file.write(path, self.file)
        return [path]
