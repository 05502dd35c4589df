"""Command ``swimid compare-runs``: estimates that differ between runs, or between days of one robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError, UsageError
from swimid.files import provenance, yamlio
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult, load_result
from swimid.runs import status
from swimid.runs.options import CompareRunsOptions
from swimid.runs.plan import Resolved, folder_of
from swimid.runs.status import Metric

#: Maximum number of panels in the figure of a comparison, and of rows in its unfolded table of estimates.
MAX_COMPARISON_PANELS, MAX_COMPARISON_ROWS = 12, 12


class ComparedQuantity(yamlio.Document):
    """Estimates of one quantity of one item in all runs. An estimate that a run lacks is null."""

    item: str
    quantity: str
    unit: str
    values: yamlio.Numbers
    stderr: yamlio.Numbers
    #: p-value of the chi-squared test of the hypothesis that the quantity is the same in all runs; null if a
    #: standard error is unknown, or if all values are equal.
    p: float | None = None
    changed: bool = False


class RunComparison(yamlio.ResultFile):
    """Content of a comparison of runs."""

    kind: ClassVar[str] = "comparison of runs"
    format: Literal["swimid-run-comparison/1"] = "swimid-run-comparison/1"
    runs: list[str]
    false_discovery_rate: float
    quantities: list[ComparedQuantity]
    #: Differences between the runs, such as other inputs or steps, for each item that is not the same in all.
    differences: dict[str, list[str]] = {}
    provenance: yamlio.Provenance = Field(default_factory=dict)


class ComparedRuns(FileResult[RunComparison]):
    """Result of ``compare-runs``: estimates of all runs side by side, and those that changed.

    Attributes
    ----------
    file : RunComparison
        Estimates of each quantity in each run, tests, and differences of items. :meth:`save` writes this
        file.
    """

    file_type = RunComparison


@dataclass
class _Found:
    """Estimates, inputs, steps, version and state of one item in one run."""

    metrics: Mapping[str, Metric]
    state: str
    version: str = "unknown"
    inputs: Mapping[str, str] = field(default_factory=dict)
    steps: str = ""


@takes(CompareRunsOptions)
def compare_runs(
    runs: Sequence[str | Path], *, options: CompareRunsOptions, output: str | Path | None = None
) -> ComparedRuns:
    """Compare the estimates of several runs, or results of one robot from several days.

    A quantity is tested with the weighted sum of squared deviations from the weighted mean, which is
    chi-squared distributed if the quantity is the same in all runs. The false discovery rate over all
    quantities is controlled (Benjamini and Hochberg 1995).

    Parameters
    ----------
    runs : sequence of paths
        Two or more folders of runs, or result files, in the order of time.
    output : path, optional
        Comparison file to write.

    Returns
    -------
    ComparedRuns

    Raises
    ------
    UsageError
        If fewer than two runs are given.
    InputError
        If a folder is not that of a run, a file is not a result, or the runs have no estimate in common.

    Examples
    --------
    >>> again = compare_runs(["sample_logs/gap/params.yaml", "sample_logs/gap/params.yaml"])
    >>> [quantity.quantity for quantity in again.file.quantities if quantity.changed]
    []
    """
    paths = [Path(run) for run in runs]
    if len(paths) < 2:
        raise UsageError("a comparison needs two runs", hint="swimid compare-runs run1 run2")
    found = [_read(path) for path in paths]
    names = _names(paths)
    quantities = _quantities(found)
    if not quantities:
        have = ", ".join(sorted({item or "one result" for run in found for item in run}))
        raise InputError("the runs share no estimate", file=paths[0], hint=f"items of the runs: {have}")
    _mark_changes(quantities, options.false_discovery_rate)
    quantities.sort(key=lambda q: (not q.changed, 2.0 if q.p is None else q.p))
    inputs = [path / "plan.json" if path.is_dir() else path for path in paths]
    origin = provenance.collect(inputs, settings=options.settings())
    file = RunComparison(
        runs=names,
        false_discovery_rate=options.false_discovery_rate,
        quantities=quantities,
        differences=_differences(found, names),
        provenance=origin,
    )
    return ComparedRuns.of(file, _evidence(file)).write_output(output)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the name of the folder or file of each run, or its path if two names are equal."""
    names = [path.resolve().name for path in paths]
    if len(set(names)) < len(names):
        return [path.as_posix() for path in paths]
    return names


def _read(path: Path) -> dict[str, _Found]:
    """Read the items of a run, or one result file as a run with a single item without a name."""
    if not path.is_dir():
        result = load_result(path)
        data = result.data or {}
        origin = getattr(result.document, "provenance", {})
        metrics = status.metrics_of(data, ["channels.*.nrmse"])
        return {"": _Found(metrics, "done", str(origin.get("version", "unknown")))}
    items = {}
    for item in Resolved.of_run(path).items:
        shown = status.read(folder_of(path, item.id))
        if shown is None:
            items[item.id] = _Found({}, "missing")
        else:
            items[item.id] = _Found(
                shown.metrics, shown.state, shown.version, shown.inputs, shown.steps_sha256
            )
    return items


def _quantities(runs: Sequence[Mapping[str, _Found]]) -> list[ComparedQuantity]:
    """Return the quantities that two or more runs have in the same unit, with the test of equality."""
    quantities = []
    for item in dict.fromkeys(name for run in runs for name in run):
        metrics = [run[item].metrics if item in run else {} for run in runs]
        for name in dict.fromkeys(name for entries in metrics for name in entries):
            quantities.append(_quantity(item, name, [entries.get(name) for entries in metrics]))
    return [quantity for quantity in quantities if quantity is not None]


def _quantity(item: str, name: str, estimates: Sequence[Metric | None]) -> ComparedQuantity | None:
    """Return a quantity with its estimates in all runs; None unless two runs have it in the same unit."""
    known = [estimate for estimate in estimates if estimate is not None]
    units = {estimate.unit for estimate in known}
    if len(known) < 2 or len(units) > 1:
        return None
    return ComparedQuantity(
        item=item,
        quantity=name,
        unit=units.pop(),
        values=[estimate and estimate.value for estimate in estimates],
        stderr=[estimate and estimate.stderr for estimate in estimates],
        p=_p_value(known),
    )


def _mark_changes(quantities: Sequence[ComparedQuantity], rate: float) -> None:
    """Mark the quantities that differ between the runs, with the given false discovery rate."""
    tested = [quantity for quantity in quantities if quantity.p is not None]
    if not tested:
        return
    from scipy import stats

    adjusted = stats.false_discovery_control([quantity.p for quantity in tested])
    for quantity, p in zip(tested, adjusted, strict=True):
        quantity.changed = bool(p <= rate)


def _p_value(known: Sequence[Metric]) -> float | None:
    """Return the p-value of the hypothesis that all estimates have the same true value; None if untested."""
    from scipy import stats

    errors = np.array([one.stderr for one in known])
    values = np.array([one.value for one in known], dtype=float)
    if not (np.isfinite(errors).all() and (errors > 0).all()) or np.ptp(values) == 0:
        return None
    weights = errors**-2
    mean = (weights * values).sum() / weights.sum()
    return float(stats.chi2.sf((weights * (values - mean) ** 2).sum(), len(values) - 1))


def _differences(runs: Sequence[Mapping[str, _Found]], names: Sequence[str]) -> dict[str, list[str]]:
    """Return the differences between the runs for each item: presence, state, version, steps, inputs."""
    differences = {}
    for item in dict.fromkeys(name for run in runs for name in run):
        entries = {name: run[item] for name, run in zip(names, runs, strict=True) if item in run}
        texts = _item_differences(entries)
        if len(entries) < len(names):
            texts.insert(0, f"only in {', '.join(entries)}")
        if texts:
            differences[item] = texts
    return differences


def _item_differences(entries: Mapping[str, _Found]) -> list[str]:
    """Return sentences on the differences of an item between the runs that have it (keys: run names)."""
    texts = []
    for what in ("state", "version"):
        values = [getattr(entry, what) for entry in entries.values()]
        if len(set(values)) > 1:
            stated = map("{1} in {0}".format, entries, values)
            texts.append(f"{what}: {', '.join(stated)}")
    if len({entry.steps for entry in entries.values()}) > 1:
        texts.append("other steps, options or version")
    inputs = [{Path(path).name: sha for path, sha in entry.inputs.items()} for entry in entries.values()]
    names = sorted({name for digests in inputs for name in digests})
    changed = [name for name in names if len({digests.get(name) for digests in inputs}) > 1]
    if changed:
        texts.append(f"other content of {', '.join(changed)}")
    return texts


def _answer(file: RunComparison) -> ev.Verdict:
    """Return the verdict on a comparison, with the numbers of changed and of equal estimates."""
    changed, tested = _count_changes(file)
    equal = sum(len(set(quantity.values)) == 1 for quantity in file.quantities)
    sentences = []
    if tested:
        differ = "tested estimates differ between the runs by more than their errors."
        sentences.append(f"{changed} of {tested} {differ}")
    if equal:
        sentences.append(f"{equal} of {len(file.quantities)} estimates are equal to the last digit.")
    if not sentences:
        sentences.append("No estimate has a standard error in two runs, so no change can be tested.")
    if changed:
        return ev.Verdict(level="caution", text=" ".join(sentences), word="changed")
    return ev.Verdict(level="good" if tested or equal else "caution", text=" ".join(sentences))


def _count_changes(file: RunComparison) -> tuple[int, int]:
    """Return the number of quantities that changed, and the number of quantities that were tested."""
    tested = [quantity for quantity in file.quantities if quantity.p is not None]
    return sum(quantity.changed for quantity in tested), len(tested)


def _tables(file: RunComparison) -> list[ev.Table]:
    rows = [[_label(q), _finding(q), *_cells(q)] for q in file.quantities]
    columns = ["estimate", "finding", *file.runs]
    first = max(_count_changes(file)[0], min(len(rows), MAX_COMPARISON_ROWS))
    tables = [ev.Table(id="estimates", title="Estimates", columns=columns, rows=rows[:first])]
    if rows[first:]:
        title = f"{len(rows) - first} more estimates"
        tables.append(ev.Table(id="more", title=title, columns=columns, rows=rows[first:], folded=True))
    lines: list[list[Any]] = []
    for item, texts in file.differences.items():
        lines += [[item or "result", text] for text in texts]
    if lines:
        title = "Items that are not the same"
        tables.append(ev.Table(id="differences", title=title, columns=["item", "difference"], rows=lines))
    return tables


def _evidence(file: RunComparison) -> ev.Evidence:
    changed, tested = _count_changes(file)
    rate = f"{100 * file.false_discovery_rate:g} %"
    check = ev.make_check(
        "Estimates that differ", f"{changed} of {tested}", None, f"false discovery rate {rate}",
        "Chi-squared test of each estimate, with the false discovery rate of Benjamini and Hochberg.",
    )  # fmt: skip
    panels = [_panel(q, file.runs) for q in file.quantities[:MAX_COMPARISON_PANELS]]
    caption = "Estimates in the order of the runs; bars are 95 % intervals."
    return ev.Evidence(
        command="compare-runs",
        title=f"Comparison of {len(file.runs)} runs",
        verdict=_answer(file),
        facts={"Runs": ", ".join(file.runs), "False discovery rate": rate},
        checks=[check],
        tables=_tables(file),
        figures=[ev.panels("runs", "Estimates over the runs", caption, panels)],
        methods=[
            "Estimates of the runs were compared with a chi-squared test of homogeneity each, with the false "
            f"discovery rate controlled at {rate} (Benjamini and Hochberg, 1995)."
        ],
        references=[
            "Y. Benjamini, Y. Hochberg, Controlling the false discovery rate, "
            "J. R. Stat. Soc. B 57, 289-300, 1995."
        ],
        provenance=file.provenance,
    )


def _label(quantity: ComparedQuantity) -> str:
    return ", ".join(filter(None, [quantity.item, quantity.quantity]))


def _cells(quantity: ComparedQuantity) -> list[str]:
    return [
        numbers.format_estimate(value, error, quantity.unit)
        for value, error in zip(quantity.values, quantity.stderr, strict=True)
    ]


def _finding(quantity: ComparedQuantity) -> str:
    if len(set(quantity.values)) == 1:
        return "equal"
    if quantity.p is None:
        return "not tested"
    if quantity.changed:
        return f"changed, p {numbers.probability_text(quantity.p)}"
    return f"p {numbers.probability_text(quantity.p)}"


def _panel(quantity: ComparedQuantity, runs: Sequence[str]) -> ev.Panel:
    known = [k for k, value in enumerate(quantity.values) if value is not None]
    half = [numbers.Z95 * (quantity.stderr[k] or math.nan) for k in known]
    points = ev.Trace(x=known, y=[quantity.values[k] for k in known], y_error=half, style="points")
    title = _label(quantity)
    if quantity.changed:
        title += " (changed)"
    return ev.panel(
        "", numbers.unit_text(quantity.unit) or "1", [points], title=title, x_categories=list(runs)
    )
