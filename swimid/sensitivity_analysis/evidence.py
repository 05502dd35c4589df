"""Sensitivity file (``swimid-sensitivity/2``) and its evidence: checks, tables, figures and methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number
from swimid.notices import Notice
from swimid.results import evidence as ev
from swimid.results import numbers


class Range(yamlio.Document):
    """Range over which a coefficient was varied."""

    value: float
    low: float
    high: float
    unit: str
    #: Origin of the range: ``bounds`` of the parameter, ``stderr`` (two standard errors on either side),
    #: ``share`` (a fraction of the value on either side), or ``given``.
    source: Literal["bounds", "stderr", "share", "given"]


class Index(yamlio.Document):
    """Sobol index with its 95 % interval."""

    value: float
    ci95: tuple[float, float]


class Shares(yamlio.Document):
    """Fractions of an output's variance that a coefficient causes: alone, and with all its interactions."""

    first: Index
    total: Index
    #: Whether the interval of the first-order index lies above zero.
    first_told: bool
    #: Whether the interval of the total index lies below 0.01.
    negligible: bool


class Output(yamlio.Document):
    """Output of one trial or, without ``trial``, of all trials together."""

    quantity: str
    unit: str
    trial: str | None = None
    #: Value of the output with the given coefficients; None for all trials together.
    value: Number = None
    #: Mean and standard deviation of the output over the ranges of the coefficients.
    mean: Number = None
    sd: Number = None
    shares: dict[str, Shares] = {}


class Simulations(yamlio.Document):
    """Number of points that were simulated, and number of points whose simulation broke down."""

    evaluated: int
    broken: int
    #: Number of rows of the Sobol design that were replaced because a point broke down.
    left_out: int


class SensitivityFile(yamlio.ResultFile):
    """Content of a sensitivity file."""

    kind: ClassVar[str] = "sensitivity file"
    format: Literal["swimid-sensitivity/2"] = "swimid-sensitivity/2"
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str | None = None
    #: Number of rows of the Sobol design.
    samples: int
    trials: list[str]
    ranges: dict[str, Range]
    outputs: list[Output]
    simulations: Simulations
    provenance: dict[str, Any] = Field(default_factory=dict)


#: Maximum width of the 95 % interval of a total index.
MAX_WIDTH = 0.3
#: Maximum change of an output when the integration step is halved, divided by the standard deviation of the
#: output over the ranges.
MAX_STEP_CHANGE = 0.05
#: Maximum correlation of two estimates that are varied independently. A stronger one gives a warning.
MAX_CORRELATION = 0.5
REFERENCES = [
    "Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010): Variance based sensitivity analysis of "
    "model output. Computer Physics Communications 181, doi:10.1016/j.cpc.2009.09.018",
    "Gamboa, Janon, Klein, Lagnoux (2014): Sensitivity analysis for multidimensional and functional outputs. "
    "Electronic Journal of Statistics 8, doi:10.1214/14-EJS895",
]


def evidence(
    file: SensitivityFile,
    step_change: float,
    strongest: tuple[float, str, str] | None,
    notices: Sequence[Notice],
) -> ev.Evidence:
    """Return the evidence of a sensitivity analysis.

    Parameters
    ----------
    step_change : float
        Maximum change of an output when the integration step is halved, divided by the standard deviation of
        the output over the ranges.
    strongest : (correlation, name, name) or None
        Strongest correlation of two coefficients whose ranges follow from their standard errors, and their
        names.
    """
    checks = _checks(file, step_change, strongest)
    return ev.Evidence(
        command="sensitivity",
        title=f"Sensitivity of {file.robot}, {file.experiment}",
        verdict=ev.judged(_answer(file), checks),
        facts={
            "Robot": file.robot,
            "Parameters": file.params or "the robot file's",
            "Trials": str(len(file.trials)),
            "Method": f"Sobol, {file.samples} rows ({file.simulations.evaluated} points)",
        },
        checks=checks,
        tables=[_totals(file), _ranges(file)],
        figures=[_map(file)],
        notices=ev.notices(notices),
        methods=[_method(file)],
        references=list(REFERENCES),
        provenance=file.provenance,
    )


def _headline(file: SensitivityFile) -> list[Output]:
    """Return one output for each quantity: of all trials together, or of the only trial with the quantity."""
    outputs: dict[str, Output] = {}
    for one in file.outputs:
        if one.trial is None or one.quantity not in outputs:
            outputs[one.quantity] = one
    return list(outputs.values())


def _ranked(output: Output) -> list[tuple[str, Index]]:
    """Return the coefficients and their total indices, in descending order of the index."""
    entries = [(name, shares.total) for name, shares in output.shares.items()]
    return sorted(entries, key=lambda item: -item[1].value)


def _checks(
    file: SensitivityFile, step_change: float, strongest: tuple[float, str, str] | None
) -> list[ev.Check]:
    runs = file.simulations
    totals = [(name, o.quantity, index) for o in _headline(file) for name, index in _ranked(o)]
    widths = [(index.ci95[1] - index.ci95[0], f"{name} in {output}") for name, output, index in totals]
    width, where = max(widths, default=(0.0, ""))
    replaced, samples = "", ""
    if runs.broken:
        replaced = f"{runs.left_out} rows of the design replaced"
    if width > MAX_WIDTH:
        samples = f"{where}: take more --samples"
    broken, wide = f"{runs.broken} of {runs.evaluated}", f"at most {numbers.number(width, 2)} wide"
    change, steady = f"{numbers.number(step_change, 2)} sd", step_change <= MAX_STEP_CHANGE
    halved = "maximum change of an output when the step is halved, over its deviation in the ranges"
    none, limit = "none (refused above 1 %)", f"≤ {MAX_WIDTH:g}"
    checks = [
        ev.check("simulations that broke down", broken, not runs.broken, none, replaced),
        ev.check("narrow intervals", wide, width <= MAX_WIDTH, limit, samples),
        ev.check("integration step", change, steady, f"≤ {MAX_STEP_CHANGE:g} sd", halved),
    ]
    if strongest is not None:
        size, one, other = strongest
        value = f"correlation up to {numbers.number(size, 2)} ({one}, {other})"
        sound, text = abs(size) <= MAX_CORRELATION, ""
        if not sound:
            text = "the estimates are correlated: the ranges hold more than is uncertain"
        checks.append(ev.check("ranges independent", value, sound, f"≤ {MAX_CORRELATION:g} in size", text))
    return checks


def _answer(file: SensitivityFile) -> str:
    """Return the most influential coefficients of the first outputs as a sentence."""
    parts = []
    for o in _headline(file)[:3]:
        named = [f"{name} ({numbers.number(index.value, 2)})" for name, index in _ranked(o)[:2]]
        if named:
            parts.append(f"{o.quantity} is most sensitive to {', '.join(named)}")
    return "; ".join(parts) + "."


# ------------------------------------------------------------ tables


def _totals(file: SensitivityFile) -> ev.Table:
    """Return a table of the most influential coefficients of each output."""
    ranks = ("largest", "second", "third")
    rows: list[dict[str, ev.Cell]] = []
    for o in _headline(file):
        row: dict[str, ev.Cell] = {"output": o.quantity, **dict.fromkeys(ranks, "")}
        for rank, (name, index) in zip(ranks, _ranked(o), strict=False):
            low, high = (numbers.number(end, 2) for end in index.ci95)
            row[rank] = f"{name} {numbers.number(index.value, 2)} ({low} … {high})"
        rows.append(row)
    return ev.table("totals", "Total indices, 95 %", rows)


def _ranges(file: SensitivityFile) -> ev.Table:
    rows: list[dict[str, ev.Cell]] = [
        {
            "coefficient": name,
            "given": numbers.number(r.value),
            "from": numbers.number(r.low),
            "to": numbers.number(r.high),
            "unit": numbers.unit_text(r.unit),
            "range": r.source,
        }
        for name, r in file.ranges.items()
    ]
    caption = "Uniform and independent of each other; a wider range of a coefficient raises its share."
    return ev.table("ranges", "Ranges of the coefficients", rows, caption)


# ------------------------------------------------------------ figures


def _map(file: SensitivityFile) -> ev.Figure:
    outputs = [o for o in _headline(file) if o.shares]
    names = list(file.ranges)
    values = [[round(o.shares[name].total.value, 2) for name in names] for o in outputs]
    heat = ev.Heat(rows=[o.quantity for o in outputs], columns=names, values=values, scale="linear")  # type: ignore[arg-type]
    caption = "Total Sobol indices: the share of an output's variance that a coefficient takes part in."
    title = "Sensitivity of each output"
    return ev.panels("indices", title, caption, [ev.panel("", "", [], heat=heat)])


def _method(file: SensitivityFile) -> str:
    """Return a sentence for the methods section of a paper."""
    shares = [text for text in file.provenance["settings"]["range"] if text.endswith("%")]
    sources = {
        "bounds": "their bounds",
        "stderr": "two standard errors on either side",
        "share": f"±{' '.join(shares).removesuffix('%')} % of their values within their bounds",
        "given": "given ranges",
    }
    used = " or ".join(dict.fromkeys(sources[r.source] for r in file.ranges.values()))
    over = f"{', '.join(file.ranges)}, independent and uniform over {used}"
    runs, trials = file.simulations, f"{len(file.trials)} {file.experiment} trials"
    return (
        f"First-order and total Sobol indices of the outputs of {trials} to {over}, were estimated from "
        f"{file.samples} rows of a scrambled Sobol sequence ({runs.evaluated} points, {runs.broken} of which "
        "broke down) by the estimators of Saltelli et al. (2010) as implemented in SciPy, with intervals by "
        "the bootstrap over the rows; those of all trials together are shares of their summed variance "
        "(Gamboa et al. 2014)."
    )
