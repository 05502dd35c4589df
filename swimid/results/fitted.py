"""The result of a fit: its parameters with their uncertainty, and what they rest on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict, leaf_table
from swimid.results.parameters import Correlation, Estimate, Fit, ParameterFile, spoken
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd

#: Words for the status of an estimate.
STATUS = {"at-bound": "at its bound", "unidentifiable": "not identifiable"}


@dataclass(frozen=True, eq=False)
class Fitted(FileResult[ParameterFile]):
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

    file_type = ParameterFile

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

    def _own_facts(self) -> dict[str, str]:
        file = self.file
        facts = {"Model": file.model, "Robot": file.robot or ""}
        if file.fit is not None:
            facts["Trials"] = str(len(file.fit.trials))
        if file.sample_time_s is not None:
            facts["Sample time"] = numbers.number(file.sample_time_s, unit="s")
        if file.delay is not None:
            facts["Delay"] = f"{file.delay} sample{'s' if file.delay != 1 else ''}"
        return {name: value for name, value in facts.items() if value}

    def _own_notes(self) -> list[str]:
        return self.file.identifiability

    def _own_tables(self) -> list[Table]:
        file = self.file
        shared = {name: e for name, e in file.parameters.items() if "[" not in name}
        own = {name: e for name, e in file.parameters.items() if name not in shared}
        tables = [
            _estimates("parameters", "Parameters", shared),
            _estimates("parameters-of-trials", "Parameters of single trials", own, folded=True),
            _estimates("derived", "Derived quantities", file.derived),
            _channels(file.fit),
            _poles(file),
            _correlation(file.correlation),
        ]
        if file.fit is not None:
            more = file.fit.model_extra or {}
            single = {name: value for name, value in more.items() if not _is_records(value)}
            details = {"trials": file.fit.trials, "noise": file.fit.noise, **single}
            tables.append(leaf_table("fit", "Fit details", details))
        return [table for table in tables if table.rows]

    def bare(self) -> Evidence:
        """Return what a report shows of a parameter file whose evidence is missing."""
        parameters = self.file.parameters.items()
        weak = [spoken(name, e.meaning) for name, e in parameters if e.status == "unidentifiable"]
        verdict = Verdict(level="caution", text="No evidence file, so its checks cannot be shown.")
        if self.file.fit is not None and not self.file.fit.converged:
            verdict = Verdict(level="bad", text="The fit did not converge.")
        elif weak:
            estimated = any(e.status == "estimated" for e in self.file.parameters.values())
            level: Literal["caution", "bad"] = "caution" if estimated else "bad"
            verdict = Verdict(level=level, text=f"Not identifiable: {', '.join(weak)}. No evidence file.")
        title = f"Parameters of {self.file.model}"
        return Evidence(verb=self.verb, title=title, verdict=verdict, provenance=self.file.provenance)


def _is_records(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)


def _estimates(id: str, title: str, estimates: dict[str, Estimate], *, folded: bool = False) -> Table:
    """Return a table of estimates, rounded to two digits of their standard errors."""
    rows: list[list[Any]] = []
    for name, e in estimates.items():
        band = ""
        if e.status == "estimated":
            ends = interval95(e)
            band = numbers.bounds_text(e.ci95) if e.ci95 else ""
            band = numbers.interval(*ends, e.stderr) if ends else band
        status = STATUS.get(e.status, e.status)
        rows.append([name, value_text(e), band, status, e.meaning, numbers.bounds_text(e.bounds)])
    columns = ["parameter", "value ± sd", "95 % interval", "status", "meaning", "allowed"]
    if not any(e.meaning for e in estimates.values()):
        columns.remove("meaning")
        rows = [[*row[:4], *row[5:]] for row in rows]
    return Table(id=id, title=title, columns=columns, rows=rows, folded=folded)


def value_text(estimate: Estimate) -> str:
    """Return value and standard error of a parameter; a dash where the trials do not determine it."""
    if estimate.status == "unidentifiable":
        return numbers.NOTHING
    if estimate.status == "fixed":
        return numbers.number(estimate.value, 6, estimate.unit)
    return numbers.measured(estimate.value, estimate.stderr, estimate.unit)


def _correlation(correlation: Correlation | None) -> Table:
    names = [] if correlation is None else correlation.names
    matrix = [] if correlation is None else correlation.matrix
    rows: list[list[Any]] = [
        [name, *(numbers.fixed(r, 2) for r in row)] for name, row in zip(names, matrix, strict=True)
    ]
    return Table(
        id="correlation",
        title="Correlation of the estimates",
        columns=["", *names],
        rows=rows if len(rows) > 1 else [],
        caption="Above 0.9 in size the trials determine a combination of two better than either of them.",
        folded=True,
    )


def _channels(fit: Fit | None) -> Table:
    """Return the errors of fitted and of validation trials by channel, beside the noise."""
    rows: list[list[Any]] = []
    columns = ["channel", "data", "RMSE", "noise", "RMSE / noise", "NRMSE", "samples"]
    for label, entries in _data(fit).items():
        for name, entry in entries.items():
            unit = str(entry.get("unit", ""))
            rmse, nrmse = entry.get("rmse"), numbers.percent(entry.get("nrmse"))
            noise, ratio = _noise(fit, name, rmse, unit)
            row = [name, label, numbers.number(rmse, 3, unit), noise, ratio, nrmse, entry.get("samples")]
            rows.append(row)
    return Table(id="errors", title="Errors by channel", columns=columns, rows=rows)


def _data(fit: Fit | None) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the errors of each channel, of the fitted and of the validation trials."""
    if fit is None:
        return {}
    return {"fit": fit.channels, "validation": fit.validation.get("channels", {})}


def _noise(fit: Fit | None, channel: str, rmse: float | None, unit: str) -> tuple[str, str]:
    """Return the standard deviation of the noise, of values and of time, and the error over it."""
    known = {} if fit is None else fit.noise.get(channel, {})
    sd, time_sd_s = known.get("value_sd"), known.get("time_sd_s")
    text = numbers.number(sd, 3, unit)
    if time_sd_s:
        return f"{text}, {numbers.number(1e3 * time_sd_s, 3, 'ms')} in time", numbers.NOTHING
    return text, numbers.number(rmse / sd if rmse is not None and sd else None, 3)


def _poles(file: ParameterFile) -> Table:
    rows: list[list[Any]] = [
        [
            numbers.fixed(p.real, 4),
            numbers.fixed(p.imag, 4),
            numbers.measured(p.magnitude, p.stderr_magnitude),
            "inside" if p.magnitude < 1 else "on or outside",
        ]
        for p in file.poles or []
    ]
    return Table(
        id="poles", title="Poles", columns=["real", "imaginary", "magnitude", "unit circle"], rows=rows
    )


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
