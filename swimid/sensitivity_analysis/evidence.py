"""Checks, tables, figures and sentences of ``swimid sensitivity``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.results import evidence as ev
from swimid.results import numbers
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


def headline(file: SensitivityFile) -> list[Output]:
    """One output for each quantity: of all trials together, or of the only trial that has it."""
    found: dict[str, Output] = {}
    for one in file.outputs:
        if one.trial is None or one.quantity not in found:
            found[one.quantity] = one
    return list(found.values())


def index_checks(file: SensitivityFile, step_change: float) -> list[ev.Check]:
    """Whether the indices can be relied on."""
    assert file.simulations is not None
    runs = file.simulations
    what = "rows of the design replaced" if file.method == "sobol" else "trajectories dropped"
    found = [
        ev.Check(
            name="simulations that broke down",
            value=f"{runs.broken} of {runs.evaluated}",
            limit="none (refused above 1 %)",
            verdict="warn" if runs.broken else "pass",
            text=f"{runs.left_out} {what}" if runs.broken else "",
        )
    ]
    width, where = _widest(file)
    found.append(
        ev.Check(
            name="narrow intervals",
            value=f"at most {numbers.number(width, 2)} wide",
            limit=f"≤ {NARROW:g}",
            verdict="pass" if width <= NARROW else "warn",
            text="" if width <= NARROW else f"{where}: take more --samples",
        )
    )
    if file.method == "sobol":
        alone = {
            o.quantity: sum(s.first.value for s in o.shares.values()) for o in headline(file) if o.shares
        }
        least = min(alone, key=lambda name: alone[name], default=None)
        if least is not None:
            found.append(
                ev.Check(
                    name="shares of single coefficients",
                    value=f"together at least {numbers.percent(alone[least], 2)}",
                    verdict="info",
                    text=f"the rest are interactions; most of them in {least}",
                )
            )
    found.append(
        ev.Check(
            name="integration step",
            value=f"{numbers.number(step_change, 2)} sd",
            limit=f"≤ {STEP_SHARE:g} sd",
            verdict="pass" if step_change <= STEP_SHARE else "warn",
            text="largest change of an output when the step is halved, over its deviation in the ranges",
        )
    )
    return found


def sweep_checks(sweep: Sweep, uncertain: bool) -> list[ev.Check]:
    """Whether every point of a sweep could be simulated, and its uncertainty told."""
    points = int(np.prod([len(a.values) for a in sweep.axes]))
    return [
        ev.Check(
            name="points of the sweep that broke down",
            value=f"{sweep.broken} of {points}",
            limit="none",
            verdict="warn" if sweep.broken else "pass",
            text="they are left empty" if sweep.broken else "",
        ),
        ev.Check(
            name="uncertainty of the sweep",
            value="from the coefficients' covariance" if uncertain else "not known",
            verdict="info",
            text="" if uncertain else "give a parameter file with standard errors: --params",
        ),
    ]


def correlation_check(strongest: tuple[float, str, str] | None) -> list[ev.Check]:
    """Whether ranges of two standard errors may be taken as independent: correlation and its pair."""
    if strongest is None:
        return []
    size, one, other = strongest
    return [
        ev.Check(
            name="ranges independent",
            value=f"correlation up to {numbers.number(size, 2)} ({one}, {other})",
            limit=f"≤ {CORRELATED:g} in size",
            verdict="warn" if abs(size) > CORRELATED else "pass",
            text="the estimates err together: the ranges hold more than is uncertain; the deviations of a "
            "sweep account for it"
            if abs(size) > CORRELATED
            else "",
        )
    ]


def _widest(file: SensitivityFile) -> tuple[float, str]:
    """The widest interval of the headline, and whose it is."""
    widest, where = 0.0, ""
    for o in headline(file):
        largest = max((e.mu_star for e in o.effects.values()), default=0.0)
        ends = {name: (s.total.ci95, 1.0) for name, s in o.shares.items()}
        if largest > 0:
            ends |= {name: (e.mu_star_ci95, largest) for name, e in o.effects.items()}
        for name, ((low, high), size) in ends.items():
            if (high - low) / size > widest:
                widest, where = (high - low) / size, f"{name} in {o.quantity}"
    return widest, where


# ------------------------------------------------------------ in words


def ranked(output: Output) -> list[tuple[str, float, tuple[float, float]]]:
    """Coefficients by total index or mu*, the largest first, with intervals."""
    found = [(n, s.total.value, s.total.ci95) for n, s in output.shares.items()]
    found += [(n, e.mu_star, e.mu_star_ci95) for n, e in output.effects.items()]
    return sorted(found, key=lambda item: -item[1])


def answer(file: SensitivityFile) -> str:
    """What the first outputs hang on, as a sentence."""
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
        told = headline(file)
        width = max(len(o.quantity) for o in told)
        for o in told:
            items = [
                f"{name} {numbers.number(value, 2)} ({numbers.number(low, 2)} … {numbers.number(high, 2)})"
                for name, value, (low, high) in ranked(o)[:NAMED]
            ]
            unit = f" {numbers.unit_text(o.unit)}" if o.effects and numbers.unit_text(o.unit) else ""
            lines.append(f"  {o.quantity:<{width}}  {', '.join(items) + unit if items else 'does not vary'}")
        nothing = _negligible(told)
        if nothing:
            lines += ["", f"  negligible in every output: {', '.join(nothing)}"]
    if file.sweep is not None:
        lines += ["", *_swept_lines(file.sweep)]
    lines += ["", f"{evidence.verdict.level.upper()}: {_judgement(evidence)}"]
    return "\n".join(lines)


def _negligible(told: Sequence[Output]) -> list[str]:
    names = dict.fromkeys(name for o in told for name in o.shares)
    return [n for n in names if all(o.shares[n].negligible for o in told if o.shares)]


def _swept_lines(sweep: Sweep) -> list[str]:
    axes = ", ".join(
        f"{a.name} {numbers.number(a.values[0])} to {numbers.number(a.values[-1])}" for a in sweep.axes
    )
    lines = [f"  drive of {sweep.trial} over {axes}"]
    width = max(len(o.quantity) for o in sweep.outputs)
    for o in sweep.outputs:
        known = np.array(o.values, dtype=float)
        text = "nothing"
        if np.isfinite(known).any():
            text = f"{numbers.interval(float(np.nanmin(known)), float(np.nanmax(known)), None, o.unit)}"
        if o.stderr is not None and np.isfinite(np.array(o.stderr, dtype=float)).any():
            worst = float(np.nanmax(np.array(o.stderr, dtype=float)))
            text += f", known to {numbers.number(worst, 2, o.unit)} at worst"
        lines.append(f"  {o.quantity:<{width}}  {text}")
    return lines


def _judgement(evidence: ev.Evidence) -> str:
    doubtful = [c.name for c in evidence.checks if c.verdict in ("warn", "fail")]
    return f"look at {', '.join(doubtful)}" if doubtful else "every check passes"


# ------------------------------------------------------------ tables


def tables(file: SensitivityFile) -> list[ev.Table]:
    """Every trial's indices, the values of the sweep, and actual errors on its axes."""
    found = []
    names = list(file.ranges)
    single = [o for o in file.outputs if o.trial is not None]
    if single:
        sobol = file.method == "sobol"
        found.append(
            ev.Table(
                id="trials",
                title="Trial by trial",
                columns=["output", "trial", "given", "mean", "sd", *names],
                rows=[
                    [
                        o.quantity,
                        o.trial,
                        numbers.number(o.value, 3, o.unit),
                        numbers.number(o.mean, 3, o.unit),
                        numbers.number(o.sd, 2, o.unit),
                        *(numbers.number(_size(o, name), 2) for name in names),
                    ]
                    for o in single
                ],
                caption="Value with the given coefficients, mean and standard deviation over the ranges, and "
                + ("total indices." if sobol else "mean magnitudes of the elementary effects, mu*."),
            )
        )
    if file.sweep is not None:
        found.append(_swept_table(file.sweep))
    if file.measured:
        axes = list(dict.fromkeys(name for m in file.measured for name in m.drive))
        channels = list(dict.fromkeys(name for m in file.measured for name in m.channels))
        found.append(
            ev.Table(
                id="measured",
                title="Actual errors on the axes of the sweep",
                columns=["trial", "role", *axes, "inside the grid", *channels],
                rows=[
                    [
                        m.trial,
                        "held out" if m.role == "validate" else "fit",
                        *(numbers.number(m.drive.get(a)) for a in axes),
                        m.inside,
                        *(
                            numbers.number(m.channels[c].rmse, 3, m.channels[c].unit)
                            + f" ({numbers.percent(m.channels[c].nrmse, 2)})"
                            if c in m.channels
                            else numbers.NOTHING
                            for c in channels
                        ),
                    ]
                    for m in file.measured
                ],
                caption="Root-mean-square error of each measured channel with the given coefficients, and "
                "the same over its measured range. An error that grows along an axis says that the "
                "coefficients do not carry over.",
            )
        )
    return found


def _size(output: Output, name: str) -> float | None:
    if name in output.shares:
        return output.shares[name].total.value
    return output.effects[name].mu_star if name in output.effects else None


def _swept_table(sweep: Sweep) -> ev.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for i, first in enumerate(sweep.axes[0].values):
        for j in range(len(sweep.outputs[0].values[i])):
            drive = [first] if len(sweep.axes) == 1 else [first, sweep.axes[1].values[j]]
            rows.append(
                [
                    *(numbers.number(v) for v in drive),
                    *(
                        numbers.measured(o.values[i][j], o.stderr[i][j] if o.stderr else None, o.unit)
                        if o.stderr
                        else numbers.number(o.values[i][j], 4, o.unit)
                        for o in sweep.outputs
                    ),
                ]
            )
    return ev.Table(
        id="sweep",
        title="Outputs over the grid of drives",
        columns=[*(a.name for a in sweep.axes), *(o.quantity for o in sweep.outputs)],
        rows=rows,
        caption="With the standard deviation from the coefficients' covariance where that is known.",
    )


# ------------------------------------------------------------ figures


def figures(file: SensitivityFile) -> list[ev.Figure]:
    """Maps of the indices, the indices with their intervals, and the sweep."""
    told = [o for o in headline(file) if o.shares or o.effects]
    found = []
    if told and file.method == "sobol":
        found = [_shares_map(file, told), _intervals(file, told)]
    elif told:
        found = [_effects_map(file, told), _effects_plane(told)]
    if file.sweep is not None:
        found.append(_swept_figure(file.sweep))
    return found


def _shares_map(file: SensitivityFile, told: Sequence[Output]) -> ev.Figure:
    names = list(file.ranges)
    panels = []
    for kind in ("total", "first"):
        values = [[round(getattr(o.shares[n], kind).value, 3) for n in names] for o in told]
        title = "Total" if kind == "total" else "First order"
        panels.append(_map(title, [o.quantity for o in told], names, values))
    return ev.Figure(
        id="indices",
        title="What each output is most sensitive to",
        caption="Sobol indices: the share of an output's variance over the ranges that goes with a "
        "coefficient, alone (first order) and with all interactions it takes part in (total). Of several "
        "trials, the share of their summed variance. A column that is pale throughout belongs to a "
        "coefficient these trials cannot tell.",
        panels=panels,
    )


def _map(
    title: str, rows: list[str], columns: list[str], values: Sequence[Sequence[float | None]]
) -> ev.Panel:
    return ev.Panel(
        title=title,
        x_label="",
        y_label="",
        heat=ev.Heat(rows=rows, columns=columns, values=list(values), scale="linear"),  # type: ignore[arg-type]
    )


def _intervals(file: SensitivityFile, told: Sequence[Output]) -> ev.Figure:
    names = list(file.ranges)
    places = np.arange(len(names), dtype=float)
    panels = []
    for o in told[:MOST_PANELS]:
        traces = []
        for kind, label, shift in (("first", "first order", -0.12), ("total", "total", 0.12)):
            index = [getattr(o.shares[n], kind) for n in names]
            low, high = np.array([i.ci95 for i in index]).T
            traces.append(
                ev.Trace(
                    x=places + shift,
                    y=[i.value for i in index],
                    y_error=0.5 * (high - low),
                    style="points",
                    label=label,
                )
            )
        panels.append(
            ev.Panel(
                title=o.quantity,
                x_label="",
                y_label="index",
                traces=traces,
                marks=[ev.Mark(at=0.0)],
                x_categories=names,
            )
        )
    return ev.Figure(
        id="intervals",
        title="Sobol indices with 95 % intervals",
        caption="Bars are half the width of the bootstrap interval. A first-order index whose bar reaches "
        "zero is not told from zero; a total index above it means that the coefficient acts through "
        "interactions.",
        panels=panels,
        columns=2,
    )


def _effects_map(file: SensitivityFile, told: Sequence[Output]) -> ev.Figure:
    names = list(file.ranges)
    values = []
    for o in told:
        largest = max(e.mu_star for e in o.effects.values()) or 1.0
        values.append([round(o.effects[n].mu_star / largest, 3) for n in names])
    return ev.Figure(
        id="effects",
        title="What each output is most sensitive to",
        caption="Mean magnitude of the elementary effects, over the largest of the output.",
        panels=[_map("", [o.quantity for o in told], names, values)],
    )


def _effects_plane(told: Sequence[Output]) -> ev.Figure:
    panels = []
    for o in told[:MOST_PANELS]:
        unit = numbers.unit_text(o.unit)
        text = f" ({unit})" if unit else ""
        traces = [
            ev.Trace(x=[e.mu_star], y=[e.sigma], style="points", label=name, group=k)
            for k, (name, e) in enumerate(o.effects.items())
        ]
        panels.append(
            ev.Panel(
                title=o.quantity,
                x_label=f"mu*{text}",
                y_label=f"sigma{text}",
                traces=traces,
                marks=[ev.Mark(at=0.0, axis="x"), ev.Mark(at=0.0)],
            )
        )
    return ev.Figure(
        id="plane",
        title="Elementary effects",
        caption="Far right: the output is sensitive to the coefficient. High up: its effect depends on where "
        "it and the others are, by curvature or interaction.",
        panels=panels,
        columns=2,
    )


def _swept_figure(sweep: Sweep) -> ev.Figure:
    flat = len(sweep.axes) > 1
    panels = []
    for o in sweep.outputs:
        panels += _swept_maps(sweep, o) if flat else [_swept_curve(sweep, o)]
    known = any(o.stderr for o in sweep.outputs)
    caption = f"Trial {sweep.trial} under other drives, from rest, with the given coefficients."
    if known:
        which = "Beside each map" if flat else "Bands: two standard deviations,"
        what = " its standard deviation" if flat else ""
        caption += f" {which}{what} from the coefficients' covariance."
    return ev.Figure(
        id="sweep",
        title="Outputs over the drive",
        caption=caption,
        panels=panels,
        columns=2 if flat else 1,
    )


def _swept_maps(sweep: Sweep, output: SweptOutput) -> list[ev.Panel]:
    rows, columns = ([numbers.number(v, 3) for v in axis.values] for axis in sweep.axes)
    title = numbers.column_title(output.quantity)
    along, down = (numbers.column_title(axis.name) for axis in reversed(sweep.axes))
    return [
        ev.Panel(
            title=what,
            x_label=along,
            y_label=down,
            heat=ev.Heat(rows=rows, columns=columns, values=list(values), scale="linear"),
        )
        for values, what in ((output.values, title), (output.stderr, f"standard deviation of {title}"))
        if values is not None
    ]


def _swept_curve(sweep: Sweep, output: SweptOutput) -> ev.Panel:
    x = sweep.axes[0].values
    y = np.array(output.values, dtype=float)[:, 0]
    band = None if output.stderr is None else 2 * np.array(output.stderr, dtype=float)[:, 0]
    trace = ev.Trace(
        x=x,
        y=y,
        style="line",
        lower=None if band is None else y - band,
        upper=None if band is None else y + band,
    )
    return ev.Panel(
        x_label=numbers.column_title(sweep.axes[0].name),
        y_label=numbers.column_title(output.quantity),
        traces=[trace],
    )


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
    said = []
    if file.simulations is not None:
        used = list(dict.fromkeys(_source(file, r.source) for r in file.ranges.values()))
        over = f"{', '.join(file.ranges)}, independent and uniform over {' or '.join(used)}"
        runs = file.simulations
        trials = f"{len(file.trials)} {file.experiment} trials"
        if file.method == "sobol":
            said.append(
                f"First-order and total Sobol indices of the outputs of {trials} to {over}, were estimated "
                f"from {file.samples} rows of a scrambled Sobol sequence ({runs.evaluated} points) by the "
                "estimators of Saltelli et al. (2010) as implemented in SciPy (sobol_indices). Intervals are "
                "percentiles of 1000 bootstrap samples of the rows; those of all trials together are shares "
                "of the trials' summed variance (Gamboa et al. 2014)."
            )
        else:
            said.append(
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
            said.append(
                f"{runs.broken} of {runs.evaluated} simulations broke down; {what}, so that the indices hold "
                "for the part of the ranges in which the model can be simulated."
            )
        if any("misfit_" in o.quantity for o in file.outputs):
            said.append(
                "The misfit of a channel is the root-mean-square difference of the trial's samples from the "
                "simulation, start states held, over the noise of that channel where it is known."
            )
    if file.sweep is not None:
        axes = " and ".join(f"{a.name} ({len(a.values)} values)" for a in file.sweep.axes)
        said.append(
            f"The drive of trial {file.sweep.trial} was varied over {axes}, each run from rest"
            + (
                "; standard deviations of the outputs follow from the coefficients' covariance by the delta "
                "method."
                if any(o.stderr for o in file.sweep.outputs)
                else "."
            )
        )
    return said


def references(file: SensitivityFile) -> list[str]:
    """Sources of the method."""
    if file.method == "sobol":
        return [
            "Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010): Variance based sensitivity "
            "analysis of model output. Computer Physics Communications 181, doi:10.1016/j.cpc.2009.09.018",
            "Gamboa, Janon, Klein, Lagnoux (2014): Sensitivity analysis for multidimensional and functional "
            "outputs. Electronic Journal of Statistics 8, doi:10.1214/14-EJS895",
            "Virtanen et al. (2020): SciPy 1.0. Nature Methods 17, doi:10.1038/s41592-019-0686-2",
        ]
    if file.method == "morris":
        return [
            "Morris (1991): Factorial sampling plans for preliminary computational experiments. "
            "Technometrics 33, doi:10.2307/1269043",
            "Campolongo, Cariboni, Saltelli (2007): An effective screening design for sensitivity analysis "
            "of large models. Environmental Modelling & Software 22, doi:10.1016/j.envsoft.2006.10.004",
            "Herman, Usher (2017): SALib: an open-source Python library for sensitivity analysis. Journal of "
            "Open Source Software 2, doi:10.21105/joss.00097",
        ]
    return []
