"""Checks, tables, figures and sentences of ``swimid sensitivity``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Array
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.sensitivity_analysis.file import Output, SensitivityFile, Sweep, SweptOutput

#: Width of a 95 % interval of a total index (or of mu* over the largest one) up to which it is narrow.
NARROW = 0.3
#: Change with half the integration step, over an output's deviation, that is small.
STEP_SHARE = 0.05
#: Correlation of two estimates from which their ranges are no longer independent.
CORRELATED = 0.5
#: Coefficients named of an output, and outputs named in the answer.
NAMED, ANSWERED = 3, 3
#: Panels of a figure.
MOST_PANELS = 8
#: Sources of each method.
REFERENCES = {
    "sobol": [
        "Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010): Variance based sensitivity "
        "analysis of model output. Computer Physics Communications 181, doi:10.1016/j.cpc.2009.09.018",
        "Gamboa, Janon, Klein, Lagnoux (2014): Sensitivity analysis for multidimensional and functional "
        "outputs. Electronic Journal of Statistics 8, doi:10.1214/14-EJS895",
        "Virtanen et al. (2020): SciPy 1.0. Nature Methods 17, doi:10.1038/s41592-019-0686-2",
    ],
    "morris": [
        "Morris (1991): Factorial sampling plans for preliminary computational experiments. "
        "Technometrics 33, doi:10.2307/1269043",
        "Campolongo, Cariboni, Saltelli (2007): An effective screening design for sensitivity analysis "
        "of large models. Environmental Modelling & Software 22, doi:10.1016/j.envsoft.2006.10.004",
        "Herman, Usher (2017): SALib: an open-source Python library for sensitivity analysis. Journal of "
        "Open Source Software 2, doi:10.21105/joss.00097",
    ],
    "none": [],
}


def headline(file: SensitivityFile) -> list[Output]:
    """One output for each quantity: of all trials together, or of the only trial that has it."""
    outputs: dict[str, Output] = {}
    for one in file.outputs:
        if one.trial is None or one.quantity not in outputs:
            outputs[one.quantity] = one
    return list(outputs.values())


# ------------------------------------------------------------ checks


def index_checks(file: SensitivityFile, step_change: float) -> list[ev.Check]:
    """Whether the indices can be relied on."""
    assert file.simulations is not None
    runs = file.simulations
    width, where = _widest(file)
    what = "rows of the design replaced" if file.method == "sobol" else "trajectories dropped"
    checks = [
        ev.check(
            "simulations that broke down",
            f"{runs.broken} of {runs.evaluated}",
            not runs.broken,
            "none (refused above 1 %)",
            f"{runs.left_out} {what}" if runs.broken else "",
        ),
        ev.check(
            "narrow intervals",
            f"at most {numbers.number(width, 2)} wide",
            width <= NARROW,
            f"≤ {NARROW:g}",
            "" if width <= NARROW else f"{where}: take more --samples",
        ),
    ]
    alone = {o.quantity: sum(s.first.value for s in o.shares.values()) for o in headline(file) if o.shares}
    if alone:
        least = min(alone, key=lambda name: alone[name])
        value = f"together at least {numbers.percent(alone[least], 2)}"
        text = f"the rest are interactions; most of them in {least}"
        checks.append(ev.check("shares of single coefficients", value, None, text=text))
    checks.append(
        ev.check(
            "integration step",
            f"{numbers.number(step_change, 2)} sd",
            step_change <= STEP_SHARE,
            f"≤ {STEP_SHARE:g} sd",
            "largest change of an output when the step is halved, over its deviation in the ranges",
        )
    )
    return checks


def sweep_checks(sweep: Sweep, uncertain: bool) -> list[ev.Check]:
    """Whether every point of a sweep could be simulated, and its uncertainty told."""
    points = int(np.prod([len(a.values) for a in sweep.axes]))
    return [
        ev.check(
            "points of the sweep that broke down",
            f"{sweep.broken} of {points}",
            not sweep.broken,
            "none",
            "they are left empty" if sweep.broken else "",
        ),
        ev.check(
            "uncertainty of the sweep",
            "from the coefficients' covariance" if uncertain else "not known",
            None,
            text="" if uncertain else "give a parameter file with standard errors: --params",
        ),
    ]


def correlation_check(strongest: tuple[float, str, str] | None) -> list[ev.Check]:
    """Whether ranges of two standard errors may be taken as independent: correlation and its pair."""
    if strongest is None:
        return []
    size, one, other = strongest
    passed = abs(size) <= CORRELATED
    text = (
        "the estimates err together: the ranges hold more than is uncertain; the deviations of a "
        "sweep account for it"
    )
    value = f"correlation up to {numbers.number(size, 2)} ({one}, {other})"
    limit = f"≤ {CORRELATED:g} in size"
    return [ev.check("ranges independent", value, passed, limit, "" if passed else text)]


def _widest(file: SensitivityFile) -> tuple[float, str]:
    """The widest interval of the headline, and whose it is."""
    widths = [(0.0, "")]
    for o in headline(file):
        size = max((e.mu_star for e in o.effects.values()), default=1.0)
        if size > 0:
            widths += [((high - low) / size, f"{name} in {o.quantity}") for name, _, (low, high) in ranked(o)]
    return max(widths, key=lambda one: one[0])


# ------------------------------------------------------------ in words


def ranked(output: Output) -> list[tuple[str, float, tuple[float, float]]]:
    """Coefficients by total index or mu*, the largest first, with intervals."""
    entries = [(n, s.total.value, s.total.ci95) for n, s in output.shares.items()]
    entries += [(n, e.mu_star, e.mu_star_ci95) for n, e in output.effects.items()]
    return sorted(entries, key=lambda item: -item[1])


def answer(file: SensitivityFile) -> str:
    """What the first outputs are most sensitive to, as a sentence."""
    parts = []
    for o in headline(file)[:ANSWERED]:
        named = [f"{name} ({numbers.number(value, 2)})" for name, value, _ in ranked(o)[:2]]
        if named:
            parts.append(f"{o.quantity} is most sensitive to {', '.join(named)}")
    if file.sweep is not None:
        parts.append(
            f"swept over {' and '.join(a.name for a in file.sweep.axes)} of trial {file.sweep.trial}"
        )
    return "; ".join(parts) + "."


def summary(file: SensitivityFile, evidence: ev.Evidence) -> str:
    """Plain text for the terminal."""
    count = len(file.trials)
    lines = [f"{file.robot}, {file.experiment}: {count} trial{'' if count == 1 else 's'}"]
    if file.simulations is not None:
        what = "rows" if file.method == "sobol" else "trajectories"
        lines[0] += (
            f", {len(file.ranges)} coefficients, {file.method.capitalize()}, {file.samples} {what} "
            f"({file.simulations.evaluated} points)"
        )
        lines += ["", "  total index, 95 %" if file.method == "sobol" else "  mu*, 95 %"]
        outputs = headline(file)
        width = max(len(o.quantity) for o in outputs)
        for o in outputs:
            items = [
                f"{name} {numbers.number(value, 2)} ({numbers.number(low, 2)} … {numbers.number(high, 2)})"
                for name, value, (low, high) in ranked(o)[:NAMED]
            ]
            unit = f" {numbers.unit_text(o.unit)}" if o.effects and numbers.unit_text(o.unit) else ""
            lines.append(f"  {o.quantity:<{width}}  {', '.join(items) + unit if items else 'does not vary'}")
        shares = [o.shares for o in outputs if o.shares]
        nothing = [n for n in shares[0] if all(s[n].negligible for s in shares)] if shares else []
        if nothing:
            lines += ["", f"  negligible in every output: {', '.join(nothing)}"]
    if file.sweep is not None:
        lines += ["", *_swept_lines(file.sweep)]
    lines += ["", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)


def _swept_lines(sweep: Sweep) -> list[str]:
    axes = ", ".join(
        f"{a.name} {numbers.number(a.values[0])} to {numbers.number(a.values[-1])}" for a in sweep.axes
    )
    lines = [f"  drive of {sweep.trial} over {axes}"]
    width = max(len(o.quantity) for o in sweep.outputs)
    for o in sweep.outputs:
        values, errors = _finite(o.values), _finite(o.stderr)
        text = numbers.interval(values.min(), values.max(), None, o.unit) if len(values) else "nothing"
        if len(errors):
            text += f", known to {numbers.number(float(errors.max()), 2, o.unit)} at worst"
        lines.append(f"  {o.quantity:<{width}}  {text}")
    return lines


def _finite(rows: Sequence[Sequence[float | None]] | None) -> Array:
    """The numbers of a grid, those that are missing left out."""
    values = np.array([] if rows is None else rows, dtype=float)
    return values[np.isfinite(values)]


# ------------------------------------------------------------ tables


def tables(file: SensitivityFile) -> list[ev.Table]:
    """Every trial's indices, the values of the sweep, and actual errors on its axes."""
    return [*_trials(file), *([_swept_table(file.sweep)] if file.sweep is not None else []), *_measured(file)]


def _trials(file: SensitivityFile) -> list[ev.Table]:
    rows = []
    for o in file.outputs:
        if o.trial is not None:
            sizes = {name: value for name, value, _ in ranked(o)}
            row: dict[str, blocks.Cell] = {
                "output": o.quantity,
                "trial": o.trial,
                "given": numbers.number(o.value, 3, o.unit),
                "mean": numbers.number(o.mean, 3, o.unit),
                "sd": numbers.number(o.sd, 2, o.unit),
                **{name: numbers.number(sizes.get(name), 2) for name in file.ranges},
            }
            rows.append(row)
    which = "total indices" if file.method == "sobol" else "mean magnitudes of the elementary effects, mu*"
    caption = (
        "Value with the given coefficients, mean and standard deviation over the ranges, and " + which + "."
    )
    return [blocks.table("trials", "Trial by trial", rows, caption)] if rows else []


def _measured(file: SensitivityFile) -> list[ev.Table]:
    axes = list(dict.fromkeys(name for m in file.measured for name in m.drive))
    channels = list(dict.fromkeys(name for m in file.measured for name in m.channels))
    rows = []
    for m in file.measured:
        errors = {
            name: f"{numbers.number(c.rmse, 3, c.unit)} ({numbers.percent(c.nrmse, 2)})"
            for name, c in m.channels.items()
        }
        row: dict[str, blocks.Cell] = {
            "trial": m.trial,
            "role": "held out" if m.role == "validate" else "fit",
            **{name: numbers.number(m.drive.get(name)) for name in axes},
            "inside the grid": m.inside,
            **{name: errors.get(name, numbers.NOTHING) for name in channels},
        }
        rows.append(row)
    caption = (
        "Root-mean-square error of each measured channel with the given coefficients, and "
        "the same over its measured range. An error that grows along an axis says that the "
        "coefficients do not carry over."
    )
    return [blocks.table("measured", "Actual errors on the axes of the sweep", rows, caption)] if rows else []


def _swept_table(sweep: Sweep) -> ev.Table:
    rows = []
    for i, first in enumerate(sweep.axes[0].values):
        for j in range(len(sweep.outputs[0].values[i])):
            drive = [first] if len(sweep.axes) == 1 else [first, sweep.axes[1].values[j]]
            row = {a.name: numbers.number(v) for a, v in zip(sweep.axes, drive, strict=True)}
            for o in sweep.outputs:
                value = o.values[i][j]
                row[o.quantity] = (
                    numbers.measured(value, o.stderr[i][j], o.unit)
                    if o.stderr
                    else numbers.number(value, 4, o.unit)
                )
            rows.append(row)
    caption = "With the standard deviation from the coefficients' covariance where that is known."
    return blocks.table("sweep", "Outputs over the grid of drives", rows, caption)


# ------------------------------------------------------------ figures


def figures(file: SensitivityFile) -> list[ev.Figure]:
    """Maps of the indices, the indices with their intervals, and the sweep."""
    outputs = [o for o in headline(file) if o.shares or o.effects]
    names = list(file.ranges)
    figures = []
    if outputs and file.method == "sobol":
        figures = [_shares_map(names, outputs), _intervals(names, outputs)]
    elif outputs:
        figures = [_effects_map(names, outputs), _effects_plane(outputs)]
    if file.sweep is not None:
        figures.append(_swept_figure(file.sweep))
    return figures


def _shares_map(names: list[str], outputs: Sequence[Output]) -> ev.Figure:
    quantities = [o.quantity for o in outputs]
    total = [[round(o.shares[n].total.value, 3) for n in names] for o in outputs]
    first = [[round(o.shares[n].first.value, 3) for n in names] for o in outputs]
    return blocks.panels(
        "indices",
        "What each output is most sensitive to",
        "Sobol indices: the share of an output's variance over the ranges that goes with a "
        "coefficient, alone (first order) and with all interactions it takes part in (total). Of several "
        "trials, the share of their summed variance. A column that is pale throughout belongs to a "
        "coefficient these trials cannot tell.",
        [_map("Total", quantities, names, total), _map("First order", quantities, names, first)],
        columns=1,
    )


def _map(
    title: str, rows: list[str], columns: list[str], values: Sequence[Sequence[float | None]], *labels: str
) -> ev.Panel:
    heat = ev.Heat(rows=rows, columns=columns, values=list(values), scale="linear")  # type: ignore[arg-type]
    x_label, y_label = labels or ("", "")
    return blocks.panel(x_label, y_label, [], title=title, heat=heat)


def _intervals(names: list[str], outputs: Sequence[Output]) -> ev.Figure:
    places = np.arange(len(names), dtype=float)
    panels = []
    for o in outputs[:MOST_PANELS]:
        traces = []
        for kind, label, shift in (("first", "first order", -0.12), ("total", "total", 0.12)):
            index = [getattr(o.shares[n], kind) for n in names]
            low, high = np.array([i.ci95 for i in index]).T
            values, half = [i.value for i in index], 0.5 * (high - low)
            traces.append(ev.Trace(x=places + shift, y=values, y_error=half, style="points", label=label))
        panels.append(
            blocks.panel("", "index", traces, title=o.quantity, marks=[ev.Mark(at=0.0)], x_categories=names)
        )
    return blocks.panels(
        "intervals",
        "Sobol indices with 95 % intervals",
        "Bars are half the width of the bootstrap interval. A first-order index whose bar reaches "
        "zero is not told from zero; a total index above it means that the coefficient acts through "
        "interactions.",
        panels,
    )


def _effects_map(names: list[str], outputs: Sequence[Output]) -> ev.Figure:
    values = []
    for o in outputs:
        largest = max(e.mu_star for e in o.effects.values()) or 1.0
        values.append([round(o.effects[n].mu_star / largest, 3) for n in names])
    return blocks.panels(
        "effects",
        "What each output is most sensitive to",
        "Mean magnitude of the elementary effects, over the largest of the output.",
        [_map("", [o.quantity for o in outputs], names, values)],
        columns=1,
    )


def _effects_plane(outputs: Sequence[Output]) -> ev.Figure:
    panels = []
    for o in outputs[:MOST_PANELS]:
        unit = numbers.unit_text(o.unit)
        text = f" ({unit})" if unit else ""
        traces = [
            ev.Trace(x=[e.mu_star], y=[e.sigma], style="points", label=name, group=k)
            for k, (name, e) in enumerate(o.effects.items())
        ]
        marks = [ev.Mark(at=0.0, axis="x"), ev.Mark(at=0.0)]
        panels.append(blocks.panel(f"mu*{text}", f"sigma{text}", traces, title=o.quantity, marks=marks))
    return blocks.panels(
        "plane",
        "Elementary effects",
        "Far right: the output is sensitive to the coefficient. High up: its effect depends on where "
        "it and the others are, by curvature or interaction.",
        panels,
    )


def _swept_figure(sweep: Sweep) -> ev.Figure:
    flat = len(sweep.axes) > 1
    panels = [p for o in sweep.outputs for p in (_swept_maps if flat else _swept_curve)(sweep, o)]
    caption = f"Trial {sweep.trial} under other drives, from rest, with the given coefficients."
    if any(o.stderr for o in sweep.outputs):
        which = "Beside each map its standard deviation" if flat else "Bands: two standard deviations,"
        caption += f" {which} from the coefficients' covariance."
    columns = 2 if flat else 1
    return blocks.panels("sweep", "Outputs over the drive", caption, panels, columns=columns)


def _swept_maps(sweep: Sweep, output: SweptOutput) -> list[ev.Panel]:
    rows, columns = ([numbers.number(v, 3) for v in axis.values] for axis in sweep.axes)
    title = numbers.column_title(output.quantity)
    along, down = (numbers.column_title(axis.name) for axis in reversed(sweep.axes))
    return [
        _map(what, rows, columns, values, along, down)
        for values, what in ((output.values, title), (output.stderr, f"standard deviation of {title}"))
        if values is not None
    ]


def _swept_curve(sweep: Sweep, output: SweptOutput) -> list[ev.Panel]:
    x, y = sweep.axes[0].values, np.array(output.values, dtype=float)[:, 0]
    trace = ev.Trace(x=x, y=y)
    if output.stderr is not None:
        trace = blocks.band(x, y, 2 * np.array(output.stderr, dtype=float)[:, 0])
    x_label, y_label = numbers.column_title(sweep.axes[0].name), numbers.column_title(output.quantity)
    return [blocks.panel(x_label, y_label, [trace])]


# ------------------------------------------------------------ methods


def _source(file: SensitivityFile, source: str) -> str:
    """Where ranges come from, in words."""
    shares = [text for text in file.provenance["settings"]["range"] if text.endswith("%")]
    return {
        "bounds": "their bounds",
        "stderr": "two standard errors to either side",
        "share": f"±{' '.join(shares).removesuffix('%')} % of their values within their bounds",
        "given": "given ranges",
    }[source]


def methods(file: SensitivityFile) -> list[str]:
    """Sentences for a paper."""
    sentences = []
    if file.simulations is not None:
        used = list(dict.fromkeys(_source(file, r.source) for r in file.ranges.values()))
        over = f"{', '.join(file.ranges)}, independent and uniform over {' or '.join(used)}"
        runs = file.simulations
        trials = f"{len(file.trials)} {file.experiment} trials"
        if file.method == "sobol":
            sentences.append(
                f"First-order and total Sobol indices of the outputs of {trials} to {over}, were estimated "
                f"from {file.samples} rows of a scrambled Sobol sequence ({runs.evaluated} points) by the "
                "estimators of Saltelli et al. (2010) as implemented in SciPy (sobol_indices). Intervals are "
                "percentiles of 1000 bootstrap samples of the rows; those of all trials together are shares "
                "of the trials' summed variance (Gamboa et al. 2014)."
            )
        else:
            sentences.append(
                f"Elementary effects (Morris 1991) on the outputs of {trials} of {over}, were taken along "
                f"{file.samples} trajectories on four levels ({runs.evaluated} points) as implemented in "
                "SALib; mu* is the mean of their magnitudes (Campolongo et al. 2007), with 1.96 standard "
                "deviations over 1000 bootstrap samples of the trajectories."
            )
        if runs.broken:
            what = (
                f"{runs.left_out} rows with such a point were replaced by the next of the sequence"
                if file.method == "sobol"
                else f"{runs.left_out} trajectories with such a point were dropped"
            )
            sentences.append(
                f"{runs.broken} of {runs.evaluated} simulations broke down; {what}, so that the indices hold "
                "for the part of the ranges in which the model can be simulated."
            )
        if any("misfit_" in o.quantity for o in file.outputs):
            sentences.append(
                "The misfit of a channel is the root-mean-square difference of the trial's samples from the "
                "simulation, start states held, over the noise of that channel where it is known."
            )
    if file.sweep is not None:
        axes = " and ".join(f"{a.name} ({len(a.values)} values)" for a in file.sweep.axes)
        sentences.append(
            f"The drive of trial {file.sweep.trial} was varied over {axes}, each run from rest"
            + (
                "; standard deviations of the outputs follow from the coefficients' covariance by the delta "
                "method."
                if any(o.stderr for o in file.sweep.outputs)
                else "."
            )
        )
    return sentences
