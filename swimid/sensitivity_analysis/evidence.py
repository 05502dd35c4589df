"""Checks, tables, figures and sentences of ``swimid sensitivity``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.notices import Notice
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.sensitivity_analysis.file import Output, SensitivityFile

#: Largest width of a 95 % interval of a total index (or of mu* over the largest one).
MAX_WIDTH = 0.3
#: Largest change with half the integration step, over an output's deviation.
MAX_STEP_CHANGE = 0.05
#: Largest correlation of two estimates whose ranges are independent.
MAX_CORRELATION = 0.5
#: Number of coefficients named of an output, of outputs in the answer, and of panels of a figure.
N_NAMED, N_ANSWERED, MAX_PANELS = 3, 3, 8
#: Width of the terminal.
WIDTH = 100
#: Sources of each method.
REFERENCES = {
    "sobol": [
        "Saltelli, Annoni, Azzini, Campolongo, Ratto, Tarantola (2010): Variance based sensitivity "
        "analysis of model output. Computer Physics Communications 181, doi:10.1016/j.cpc.2009.09.018",
        "Gamboa, Janon, Klein, Lagnoux (2014): Sensitivity analysis for multidimensional and functional "
        "outputs. Electronic Journal of Statistics 8, doi:10.1214/14-EJS895",
    ],
    "morris": [
        "Morris (1991): Factorial sampling plans for preliminary computational experiments. "
        "Technometrics 33, doi:10.2307/1269043",
        "Campolongo, Cariboni, Saltelli (2007): An effective screening design for sensitivity analysis "
        "of large models. Environmental Modelling & Software 22, doi:10.1016/j.envsoft.2006.10.004",
        "Herman, Usher (2017): SALib: an open-source Python library for sensitivity analysis. Journal of "
        "Open Source Software 2, doi:10.21105/joss.00097",
    ],
}


def evidence(
    file: SensitivityFile,
    step_change: float,
    strongest: tuple[float, str, str] | None,
    notices: Sequence[Notice],
) -> ev.Evidence:
    """Return the evidence of a study.

    Parameters
    ----------
    step_change : float
        Largest change of an output when the step is halved, over its deviation in the ranges.
    strongest : (correlation, name, name) or None
        Of two coefficients whose ranges are their standard errors.
    """
    checks = _checks(file, step_change, strongest)
    figures = [_map(file)]
    if file.method == "sobol":
        figures.append(_intervals(file))
    return ev.Evidence(
        verb="sensitivity",
        title=f"Sensitivity of {file.robot}, {file.experiment}",
        verdict=blocks.verdict(checks, answer(file)),
        facts={
            "Robot": file.robot,
            "Parameters": file.params or "the robot file's",
            "Trials": str(len(file.trials)),
            "Method": _method(file),
        },
        checks=checks,
        tables=[_ranges(file), _trials(file)],
        figures=figures,
        notices=blocks.notices(notices),
        methods=_methods(file),
        references=list(REFERENCES[file.method]),
        provenance=file.provenance,
    )


def _method(file: SensitivityFile) -> str:
    what = "rows" if file.method == "sobol" else "trajectories"
    return f"{file.method.capitalize()}, {file.samples} {what} ({file.simulations.evaluated} points)"


def _headline(file: SensitivityFile) -> list[Output]:
    """One output for each quantity: of all trials together, or of the only trial that has it."""
    outputs: dict[str, Output] = {}
    for one in file.outputs:
        if one.trial is None or one.quantity not in outputs:
            outputs[one.quantity] = one
    return list(outputs.values())


def _ranked(output: Output) -> list[tuple[str, float, tuple[float, float]]]:
    """Coefficients by total index or mu*, the largest first, with intervals."""
    entries = [(n, s.total.value, s.total.ci95) for n, s in output.shares.items()]
    entries += [(n, e.mu_star, e.mu_star_ci95) for n, e in output.effects.items()]
    return sorted(entries, key=lambda item: -item[1])


# ------------------------------------------------------------ checks


def _checks(
    file: SensitivityFile, step_change: float, strongest: tuple[float, str, str] | None
) -> list[ev.Check]:
    runs = file.simulations
    what = "rows of the design replaced" if file.method == "sobol" else "trajectories dropped"
    widths = [(0.0, "")]
    for o in _headline(file):
        size = max((e.mu_star for e in o.effects.values()), default=1.0) or 1.0
        widths += [((high - low) / size, f"{name} in {o.quantity}") for name, _, (low, high) in _ranked(o)]
    width, where = max(widths)
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
            width <= MAX_WIDTH,
            f"≤ {MAX_WIDTH:g}",
            "" if width <= MAX_WIDTH else f"{where}: take more --samples",
        ),
        ev.check(
            "integration step",
            f"{numbers.number(step_change, 2)} sd",
            step_change <= MAX_STEP_CHANGE,
            f"≤ {MAX_STEP_CHANGE:g} sd",
            "largest change of an output when the step is halved, over its deviation in the ranges",
        ),
    ]
    if strongest is not None:
        size, one, other = strongest
        value = f"correlation up to {numbers.number(size, 2)} ({one}, {other})"
        sound = abs(size) <= MAX_CORRELATION
        text = "" if sound else "the estimates err together: the ranges hold more than is uncertain"
        checks.append(ev.check("ranges independent", value, sound, f"≤ {MAX_CORRELATION:g} in size", text))
    return checks


# ------------------------------------------------------------ in words


def answer(file: SensitivityFile) -> str:
    """Return what the first outputs are most sensitive to as a sentence."""
    parts = []
    for o in _headline(file)[:N_ANSWERED]:
        named = [f"{name} ({numbers.number(value, 2)})" for name, value, _ in _ranked(o)[:2]]
        if named:
            parts.append(f"{o.quantity} is most sensitive to {', '.join(named)}")
    return "; ".join(parts) + "."


def summary(file: SensitivityFile, evidence: ev.Evidence) -> str:
    """Return the text for the terminal."""
    lines = [
        f"{file.robot}, {file.experiment}: {len(file.trials)} trials, {len(file.ranges)} coefficients",
        _method(file),
        "",
        "  total index, 95 %" if file.method == "sobol" else "  mu*, 95 %",
    ]
    outputs = _headline(file)
    for o in outputs:
        items = [
            f"{name} {numbers.number(value, 2)} ({numbers.number(low, 2)} … {numbers.number(high, 2)})"
            for name, value, (low, high) in _ranked(o)[:N_NAMED]
        ]
        line = f"  {o.quantity:<22}  {', '.join(items) or 'does not vary'}"
        while len(line) > WIDTH:
            line = line.rpartition(", ")[0]
        lines.append(line)
    shares = [o.shares for o in outputs if o.shares]
    nothing = [n for n in file.ranges if shares and all(s[n].negligible for s in shares)]
    if nothing:
        lines += ["", f"  negligible in every output: {', '.join(nothing)}"]
    return "\n".join([*lines, "", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"])


# ------------------------------------------------------------ tables


def _ranges(file: SensitivityFile) -> ev.Table:
    rows: list[dict[str, blocks.Cell]] = [
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
    return blocks.table("ranges", "What was varied", rows, caption)


def _trials(file: SensitivityFile) -> ev.Table:
    rows = []
    for o in file.outputs:
        sizes = {name: value for name, value, _ in _ranked(o)}
        row: dict[str, blocks.Cell] = {
            "output": o.quantity,
            "trial": o.trial or "all",
            "given": numbers.number(o.value, 3, o.unit),
            "sd": numbers.number(o.sd, 2, o.unit),
            **{name: numbers.number(sizes.get(name), 2) for name in file.ranges},
        }
        rows.append(row)
    which = "total indices" if file.method == "sobol" else "mean magnitudes of the elementary effects, mu*"
    caption = f"Value with the given coefficients, standard deviation over the ranges, and {which}."
    return blocks.table("trials", "Trial by trial", rows, caption)


# ------------------------------------------------------------ figures


def _map(file: SensitivityFile) -> ev.Figure:
    """Indices, or effects over the largest of their output, as a map."""
    outputs = [o for o in _headline(file) if o.shares or o.effects]
    names, values = list(file.ranges), []
    for o in outputs:
        sizes = {name: value for name, value, _ in _ranked(o)}
        largest = max(sizes.values()) if o.effects else 1.0
        values.append([round(sizes[name] / (largest or 1.0), 3) for name in names])
    heat = ev.Heat(rows=[o.quantity for o in outputs], columns=names, values=values, scale="linear")  # type: ignore[arg-type]
    caption = "Total Sobol indices: the share of an output's variance that goes with a coefficient."
    if file.method == "morris":
        caption = "Mean magnitude of the elementary effects, over the largest of the output."
    title = "What each output is most sensitive to"
    return blocks.panels("indices", title, caption, [blocks.panel("", "", [], heat=heat)], columns=1)


def _intervals(file: SensitivityFile) -> ev.Figure:
    places, panels = np.arange(len(file.ranges), dtype=float), []
    for o in [o for o in _headline(file) if o.shares][:MAX_PANELS]:
        traces = []
        for kind, label, shift in (("first", "first order", -0.12), ("total", "total", 0.12)):
            index = [getattr(o.shares[n], kind) for n in file.ranges]
            half = [0.5 * (i.ci95[1] - i.ci95[0]) for i in index]
            values = [i.value for i in index]
            traces.append(ev.Trace(x=places + shift, y=values, y_error=half, style="points", label=label))
        panel = blocks.panel("", "index", traces, title=o.quantity, x_categories=list(file.ranges))
        panels.append(panel)
    caption = "A total index above the first order acts through interactions; bars are 95 % intervals."
    return blocks.panels("intervals", "Sobol indices with 95 % intervals", caption, panels)


# ------------------------------------------------------------ methods


def _methods(file: SensitivityFile) -> list[str]:
    shares = [text for text in file.provenance["settings"]["range"] if text.endswith("%")]
    sources = {
        "bounds": "their bounds",
        "stderr": "two standard errors to either side",
        "share": f"±{' '.join(shares).removesuffix('%')} % of their values within their bounds",
        "given": "given ranges",
    }
    used = " or ".join(dict.fromkeys(sources[r.source] for r in file.ranges.values()))
    over = f"{', '.join(file.ranges)}, independent and uniform over {used}"
    runs, trials = file.simulations, f"{len(file.trials)} {file.experiment} trials"
    sentences = [
        f"Elementary effects (Morris 1991) on the outputs of {trials} of {over}, were taken along "
        f"{file.samples} trajectories ({runs.evaluated} points) as implemented in SALib; mu* is the mean of "
        "their magnitudes (Campolongo et al. 2007), with intervals by the bootstrap over the trajectories."
    ]
    if file.method == "sobol":
        sentences = [
            f"First-order and total Sobol indices of the outputs of {trials} to {over}, were estimated from "
            f"{file.samples} rows of a scrambled Sobol sequence ({runs.evaluated} points) by the estimators "
            "of Saltelli et al. (2010) as implemented in SciPy, with intervals by the bootstrap over the "
            "rows; those of all trials together are shares of their summed variance (Gamboa et al. 2014)."
        ]
    if runs.broken:
        sentences.append(
            f"{runs.broken} of {runs.evaluated} simulations broke down; their rows were replaced by the next "
            "of the sequence, or their trajectories dropped."
        )
    return sentences
