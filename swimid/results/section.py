"""Parameter files (``swimid-parameters/1``)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from swimid.results import numbers, parameters
from swimid.results.evidence import Evidence, Verdict
from swimid.results.parameters import Correlation, Estimate, Fit, ParameterFile
from swimid.results.reader import reader, status_cell
from swimid.results.sections import (
    Block,
    Cell,
    Grid,
    Note,
    Section,
    cell,
    is_records,
    mapping_grid,
    records_grid,
    words,
)

#: From here on a pair of estimates is called strongly correlated.
STRONG = 0.9

_COLUMNS = ["Parameter", "Value ± std. error", "95 % interval", "Unit", "Allowed", "Status"]
_PARAMETER_CAPTION = (
    "Rounded to two digits of the standard error. Good: an interval that is narrow against its value and "
    "stays clear of the allowed range's ends. The interval is value ± 1.96 standard errors"
)


@reader(format=parameters.FORMAT, read=parameters.read)
def section(path: Path, file: ParameterFile, evidence: Evidence | None) -> Section:
    """The section of a parameter file."""
    return Section(
        path=path,
        kind="Parameters",
        title=f"Parameters of {file.model}",
        verdict=_verdict(file),
        facts=_facts(file),
        blocks=_blocks(file),
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


def _verdict(file: ParameterFile) -> Verdict:
    """What can be said without evidence."""
    if file.fit is not None and not file.fit.converged:
        return Verdict(level="bad", text="The fit did not converge.")
    statuses = [estimate.status for estimate in file.parameters.values()]
    weak = [name for name, estimate in file.parameters.items() if estimate.status == "unidentifiable"]
    if weak and "estimated" not in statuses:
        return Verdict(level="bad", text="No parameter is identifiable.")
    if weak:
        return Verdict(level="caution", text=f"Not identifiable: {', '.join(weak)}. No evidence file.")
    return Verdict(level="caution", text="No evidence file, so its checks cannot be shown.")


def _facts(file: ParameterFile) -> list[tuple[str, str]]:
    facts = [("Model", file.model)]
    if file.robot:
        facts.append(("Robot", file.robot))
    if file.fit is not None:
        facts.append(("Trials", str(len(file.fit.trials))))
        facts.append(("Converged", "yes" if file.fit.converged else "no"))
    if file.delay is not None:
        facts.append(("Delay", f"{file.delay} sample{'s' if file.delay != 1 else ''}"))
    if file.sample_time_s is not None:
        facts.append(("Sample time", numbers.number(file.sample_time_s, unit="s")))
    if file.stable is not None:
        facts.append(("Stable", "yes" if file.stable else "no"))
    return facts


def _blocks(file: ParameterFile) -> list[Block]:
    profiled = any(estimate.ci95 is not None for estimate in file.parameters.values())
    end = ", or that of the profile likelihood where one was computed (marked *)." if profiled else "."
    shared = {name: e for name, e in file.parameters.items() if "[" not in name}
    own = {name: e for name, e in file.parameters.items() if name not in shared}
    blocks: list[Block] = [_estimates("Parameters", shared, _PARAMETER_CAPTION + end)]
    if own:
        grid = _estimates("Parameters of single trials", own, "Estimated for each trial anew.")
        blocks.append(replace(grid, folded=True))
    if file.derived:
        # what is computed is not bounded
        caption = "Computed from the parameters; their uncertainty is carried over."
        blocks.append(_estimates("Derived quantities", file.derived, caption, without="Allowed"))
    if file.identifiability:
        blocks.append(Note(file.identifiability, title="Identifiability"))
    if file.correlation is not None and len(file.correlation.names) > 1:
        blocks.append(_correlation(file.correlation))
    if file.fit is not None:
        blocks += _fit(file.fit)
    if file.poles:
        blocks.append(_poles(file))
    return blocks


# ---------------------------------------------------------------- estimates


def _estimates(title: str, estimates: dict[str, Estimate], caption: str, *, without: str = "") -> Grid:
    rows = []
    for name, estimate in estimates.items():
        unit, bounds = numbers.unit_text(estimate.unit), numbers.bounds_text(estimate.bounds)
        cells = [
            Cell(name, "code"),
            *_shown(estimate),
            Cell(unit),
            Cell(bounds),
            status_cell(estimate.status),
        ]
        rows.append([cell for cell, column in zip(cells, _COLUMNS, strict=True) if column != without])
    return Grid(title, [column for column in _COLUMNS if column != without], rows, caption)


def _shown(estimate: Estimate) -> tuple[Cell, Cell]:
    nothing = Cell(numbers.NOTHING, numeric=True)
    if estimate.status == "unidentifiable":
        return Cell("not determined by these trials", "muted"), nothing
    if estimate.status == "fixed":
        return Cell(numbers.number(estimate.value, 6), numeric=True), nothing
    value = Cell(numbers.measured(estimate.value, estimate.stderr), numeric=True)
    if estimate.ci95 is not None:
        return value, Cell(f"{_profile(estimate)} *", numeric=True)
    ends = numbers.confidence95(estimate.value, estimate.stderr)
    if ends is None or estimate.status == "at-bound":
        return value, nothing
    return value, Cell(numbers.interval(*ends, estimate.stderr), numeric=True)


def _profile(estimate: Estimate) -> str:
    low, high = estimate.ci95 or (None, None)
    if low is not None and high is not None:
        return numbers.interval(low, high, estimate.stderr)
    return numbers.bounds_text((low, high)) if low is not None or high is not None else "unbounded"


def _correlation(correlation: Correlation) -> Grid:
    names, matrix = correlation.names, correlation.matrix
    rows = []
    strong = []
    for i, name in enumerate(names):
        row = [Cell(name, "code")]
        for j, value in enumerate(matrix[i]):
            mark = "" if i == j or abs(value) < STRONG else "! "
            row.append(Cell(f"{mark}{numbers.fixed(value, 2)}", numeric=True, level=0.0 if i == j else value))
            if i > j and abs(value) >= STRONG:
                strong.append(f"{name} and {names[j]} ({numbers.fixed(value, 2)})")
        rows.append(row)
    pairs = f"Strong pairs, marked !: {'; '.join(strong)}." if strong else "No pair is strongly correlated."
    caption = (
        f"{pairs} Good: below {STRONG} in size; above it the trials fix a combination of the two "
        "better than either of them."
    )
    return Grid("Correlation of the estimates", ["", *names], rows, caption)


# ---------------------------------------------------------------- fit


def _fit(fit: Fit) -> list[Block]:
    blocks: list[Block] = []
    validation = fit.validation.get("channels", fit.validation)
    validation = {k: v for k, v in validation.items() if isinstance(v, dict)} if validation else {}
    if fit.channels or validation:
        blocks.append(_channels(fit.channels, validation))
    other = {k: v for k, v in fit.validation.items() if k != "channels" and k not in validation}
    listed = {"trials": fit.trials, "validation": other, "noise": fit.noise}
    details = {name: value for name, value in listed.items() if value} | (fit.model_extra or {})
    records = {name: value for name, value in details.items() if is_records(value)}
    details = {name: value for name, value in details.items() if name not in records}
    if details:
        blocks.append(mapping_grid("Fit details", details))
    blocks += [records_grid(words(name).capitalize(), value) for name, value in records.items()]
    return blocks


def _channels(fit: dict[str, dict[str, Any]], validation: dict[str, dict[str, Any]]) -> Grid:
    measures = list(dict.fromkeys(k for entry in [*fit.values(), *validation.values()] for k in entry))
    measures = [k for k in measures if k != "unit" and not _nested(k, fit, validation)]
    columns = ["Channel", "Data", *(words(k) for k in measures)]
    rows = []
    for name in dict.fromkeys([*fit, *validation]):
        for label, table in (("fit", fit), ("validation", validation)):
            if name not in table:
                continue
            entry = table[name]
            unit = str(entry.get("unit", ""))
            measured = [_measure(key, entry.get(key), unit) for key in measures]
            rows.append([Cell(name, "code"), Cell(label), *measured])
    caption = (
        "RMSE in the channel's unit, NRMSE as a share of its range or spread. Good: validation close to fit."
        if validation
        else "No trial was held out, so there is no validation."
    )
    return Grid("Fit and validation by channel", columns, rows, caption)


#: Measures that carry the channel's unit.
_IN_UNIT = {"rmse", "mae", "max_error", "bias", "sd", "noise", "stderr"}


def _measure(key: str, value: Any, unit: str) -> Cell:
    if isinstance(value, int | float) and not isinstance(value, bool):
        if key == "nrmse":
            return Cell(numbers.percent(value), numeric=True)
        return Cell(numbers.number(value, 3, unit if key in _IN_UNIT else ""), numeric=True)
    return cell(value if isinstance(value, str | bool) else None)


def _nested(key: str, *tables: dict[str, dict[str, Any]]) -> bool:
    return any(isinstance(entry.get(key), dict | list) for table in tables for entry in table.values())


def _poles(file: ParameterFile) -> Grid:
    rows = []
    for pole in file.poles or []:
        size = numbers.measured(pole.magnitude, pole.stderr_magnitude)
        texts = [numbers.fixed(pole.real, 4), numbers.fixed(pole.imag, 4), size]
        place = Cell("inside", "good") if pole.magnitude < 1 else Cell("on or outside", "bad")
        rows.append([*(Cell(text, numeric=True) for text in texts), place])
    caption = "Good: every magnitude below 1, by more than its standard error. Outside, a free run grows."
    return Grid("Poles", ["Real", "Imaginary", "Magnitude", "Unit circle"], rows, caption)
