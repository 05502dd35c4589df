"""Sensitivity files (``swimid-sensitivity/1``)."""

from __future__ import annotations

from pathlib import Path

from swimid.results import numbers
from swimid.results.evidence import Evidence, Verdict
from swimid.results.reader import reader
from swimid.results.sections import LONG_TABLE, Block, Cell, Grid, Section, Tone
from swimid.sensitivity_analysis.evidence import ranked
from swimid.sensitivity_analysis.file import FORMAT, Index, Output, SensitivityFile

_SOURCES = {"bounds": "bounds", "stderr": "± 2 std. errors", "share": "share of the value", "given": "given"}


@reader(format=FORMAT, read=SensitivityFile.read)
def section(path: Path, file: SensitivityFile, evidence: Evidence | None) -> Section:
    """The section of a sensitivity file."""
    blocks: list[Block] = []
    if file.outputs:
        pooled = [o for o in file.outputs if o.trial is None]
        outputs = pooled or file.outputs
        blocks += [_ranges(file), _shares(outputs) if file.method == "sobol" else _effects(outputs)]
    return Section(
        path=path,
        kind="Sensitivity",
        title=f"Sensitivity of {file.robot}",
        verdict=Verdict(level=file.verdict, text="No evidence file, so its checks cannot be shown."),
        facts=_facts(file),
        blocks=blocks,
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


def _facts(file: SensitivityFile) -> list[tuple[str, str]]:
    facts = [
        ("Robot", file.robot),
        ("Model", file.model),
        ("Experiment", file.experiment),
        ("Parameters", file.params or "the robot file's"),
        ("Trials", str(len(file.trials))),
    ]
    if file.simulations is not None:
        rows = "rows" if file.method == "sobol" else "trajectories"
        facts.append(("Method", f"{file.method.capitalize()}, {file.samples} {rows}"))
        facts.append(("Points", f"{file.simulations.evaluated}, {file.simulations.broken} broke down"))
    if file.sweep is not None:
        axes = ", ".join(f"{a.name} × {len(a.values)}" for a in file.sweep.axes)
        facts.append(("Sweep", f"{axes} of {file.sweep.trial}"))
    return facts


def _ranges(file: SensitivityFile) -> Grid:
    rows = [
        [
            Cell(name, "code"),
            Cell(numbers.number(r.value), numeric=True),
            Cell(numbers.number(r.low), numeric=True),
            Cell(numbers.number(r.high), numeric=True),
            Cell(numbers.unit_text(r.unit)),
            Cell(_SOURCES[r.source]),
        ]
        for name, r in file.ranges.items()
    ]
    caption = (
        "Uniform and independent of each other. Indices hold for these ranges: a wider range of one "
        "coefficient raises its share."
    )
    return Grid("What was varied", ["Coefficient", "Given", "From", "To", "Unit", "Range"], rows, caption)


def _index(index: Index) -> Cell:
    low, high = (numbers.fixed(end, 2) for end in index.ci95)
    return Cell(f"{numbers.fixed(index.value, 2)} ({low} … {high})", numeric=True)


def _ranked(outputs: list[Output]) -> list[tuple[Output, str]]:
    return [(o, name) for o in outputs for name, _, _ in ranked(o)]


def _shares(outputs: list[Output]) -> Grid:
    rows = []
    for o, name in _ranked(outputs):
        s = o.shares[name]
        verdict = "negligible" if s.negligible else "told" if s.first_told else "first not told from zero"
        tone: Tone = "muted" if s.negligible else "good" if s.first_told else "caution"
        names = [Cell(o.quantity, "code"), Cell(name, "code")]
        rows.append([*names, _index(s.first), _index(s.total), Cell(verdict, tone)])
    caption = (
        "Shares of an output's variance, with 95 % intervals: by the coefficient alone, and with every "
        "interaction it takes part in. Good: narrow intervals. Negligible: the total's whole interval lies "
        "below 0.01, so the coefficient may be fixed anywhere in its range."
    )
    columns = ["Output", "Coefficient", "First order", "Total", "Verdict"]
    return Grid("Sobol indices", columns, rows, caption, folded=len(rows) > LONG_TABLE)


def _effects(outputs: list[Output]) -> Grid:
    rows = []
    for o, name in _ranked(outputs):
        e = o.effects[name]
        texts = [
            numbers.number(e.mu_star, 3, o.unit),
            numbers.interval(*e.mu_star_ci95),
            numbers.number(e.mu, 3),
            numbers.number(e.sigma, 3),
        ]
        names = [Cell(o.quantity, "code"), Cell(name, "code")]
        rows.append([*names, *(Cell(text, numeric=True) for text in texts)])
    caption = (
        "Elementary effects per whole range of the coefficient. mu* is their mean magnitude; a sigma as "
        "large means interactions or curvature; mu far below mu* means that the effect changes its sign."
    )
    columns = ["Output", "Coefficient", "mu*", "95 % interval", "mu", "sigma"]
    return Grid("Elementary effects", columns, rows, caption, folded=len(rows) > LONG_TABLE)
