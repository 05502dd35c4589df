"""The result of a fit: its parameters with their uncertainty, and what they rest on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.results import numbers, parameters
from swimid.results.evidence import Evidence
from swimid.results.parameters import Estimate, ParameterFile
from swimid.results.result import Result

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Fitted(Result):
    """Parameters of a model, as ``fit_drag``, ``fit_propulsion``, ``fit_graybox`` and ``rwls`` give them.

    ``fitted["added_mass"]`` is one estimate, with ``value``, ``stderr``, ``unit``, ``bounds`` and ``status``.
    ``value`` is what a simulation uses, whatever the status; only of ``"estimated"`` the data support it.

    Attributes
    ----------
    parameters : DataFrame
        A row for each parameter: ``value``, ``stderr``, ``low95``, ``high95`` (in ``unit``), ``status``.
    derived : DataFrame
        Quantities that follow from the parameters, in the same columns.
    correlation : DataFrame
        Correlations of the estimates (1).
    converged : bool
        Whether the search ended at a minimum.
    file : ParameterFile
        What :meth:`save` writes.

    Examples
    --------
    >>> fitted = Fitted.load("sample_logs/gap/params.yaml")
    >>> fitted.parameters.loc["c_ma", "status"], round(fitted["c_ma"].stderr, 3), fitted["d_p"].unit
    ('estimated', 0.066, 'm')
    """

    format = parameters.FORMAT

    @property
    def file(self) -> ParameterFile:
        """What :meth:`save` writes."""
        assert isinstance(self.document, ParameterFile)
        return self.document

    @property
    def parameters(self) -> pd.DataFrame:
        """A row for each parameter: value, standard error, 95 % interval, unit, status."""
        return _frame(self.file.parameters)

    @property
    def derived(self) -> pd.DataFrame:
        """Quantities that follow from the parameters, in the same columns."""
        return _frame(self.file.derived)

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlations of the estimates; empty where fewer than two have an error."""
        import pandas as pd

        correlation = self.file.correlation
        return pd.DataFrame(
            correlation.matrix if correlation else [],
            index=correlation.names if correlation else [],
            columns=correlation.names if correlation else [],
        )

    @property
    def converged(self) -> bool:
        """Whether the search ended at a minimum."""
        return self.file.fit is not None and self.file.fit.converged

    def __getitem__(self, name: str) -> Estimate:
        return (self.file.parameters | self.file.derived)[name]

    def _write(self, path: Path) -> list[Path]:
        parameters.write(path, self.file)
        return [path]

    @classmethod
    def _read(cls, path: str | Path) -> ParameterFile:
        return parameters.read(path)

    @classmethod
    def _told(cls, document: ParameterFile, evidence: Evidence | None) -> str:
        name = document.model + (f" of {document.robot}" if document.robot else "")
        return "\n".join([name, rows(document), super()._told(document, evidence)]).rstrip()


def rows(file: ParameterFile) -> str:
    """The parameters as lines of plain text."""
    lines = []
    for name, e in {**file.parameters, **file.derived}.items():
        if e.status == "unidentifiable":
            text = "not identifiable from these trials"
        elif e.status == "fixed":
            if e.value == 0:
                continue
            text = f"{numbers.measured(e.value, None, e.unit)}  (fixed)"
        elif e.status == "at-bound":
            text = f"{numbers.measured(e.value, None, e.unit)}  (at its bound)"
        else:
            ends = interval95(e)
            band = f"   95 %: {numbers.interval(ends[0], ends[1], e.stderr)}" if ends else ""
            text = f"{numbers.measured(e.value, e.stderr, e.unit)}{band}"
        lines.append((name, text))
    width = max((len(name) for name, _ in lines), default=0)
    return "\n".join(f"  {name:<{width}}  {text}" for name, text in lines)


def interval95(estimate: Estimate) -> tuple[float, float] | None:
    """95 % interval: by profile likelihood where that was asked for, else by the standard error."""
    if estimate.ci95 and estimate.ci95[0] is not None and estimate.ci95[1] is not None:
        return estimate.ci95[0], estimate.ci95[1]
    return numbers.confidence95(estimate.value, estimate.stderr)


def _frame(estimates: dict[str, Estimate]) -> pd.DataFrame:
    import pandas as pd

    nothing = (float("nan"), float("nan"))
    return pd.DataFrame(
        [(e.value, e.stderr, *(interval95(e) or nothing), e.unit, e.status) for e in estimates.values()],
        columns=["value", "stderr", "low95", "high95", "unit", "status"],
        index=pd.Index(list(estimates), name="parameter"),
    )
