"""``swimid rwls``: a discrete-time model from input and output columns, and its evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.blackbox import difference
from swimid.blackbox.identified import WORSE, Identified, Scores, frequency_response, identify, pooled
from swimid.blackbox.model import NAME
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import read
from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.fitting import noise as rt
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers, parameters
from swimid.results import evidence as ev
from swimid.results.evidence import Check, Evidence, Figure, NoticeRecord, Panel, Span, Table, Trace
from swimid.results.fitted import Fitted
from swimid.results.parameters import ParameterFile

#: Warnings that tell the reason of a check that does not pass.
CODES = {"Largest pole": "SWM020", "Residuals white": "SWM013", "Coefficients determined": "SWM010"}


@takes(RwlsOptions)
def rwls(
    logs: Sequence[str | Path],
    *,
    options: RwlsOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify an ARX or ARMAX model by recursive weighted least squares.

    A trials file may name the columns instead. See :class:`swimid.blackbox.difference.Orders` for the orders,
    :mod:`swimid.blackbox.recursive` for weight, forgetting and P(0), and
    :func:`swimid.blackbox.identified.centre` for the means. Where the one-step residuals are not white
    (SWM013) the coefficients of an ARX model are biased: judge it by its free run, or give ``nc``.

    Parameters
    ----------
    logs : sequence of path, Log or DataFrame
        Logs, or trials files of the experiment ``arma``. One row a sample, at one rate.
    output : Path, optional
        Parameter file; its evidence goes beside it.
    progress : Progress
        Shows the order search.

    Returns
    -------
    Fitted
        ``.parameters`` has ``a1``, ... (1), ``b1``, ... (unit of the output over that of the input) and
        ``c1``, ... (1); ``.tables()`` has the ``errors`` of the predictions and the ``modes`` of the model,
        ``.data["orders_tried"]`` the orders of a search.

    Raises
    ------
    InputError
        For a log that cannot be read, a column that is missing, or rows held out that are fitted too.
    UsageError
        For options that do not fit together, or without orders.
    NoTrustworthyResult
        When there are too few rows, nothing moves in them, or the search for ``c1``, ... does not converge.

    References
    ----------
    .. [1] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic underwater
       vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159.
       Eq 3: the substitute input; Eqs 4 to 7: the model; Eqs 6 to 9: the recursion.
    .. [2] G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977), ch. 5: UD
       factors.
    .. [3] L. Ljung, *System Identification: Theory for the User*, 2nd ed. (1999), section 11.7: forgetting.
    .. [4] G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65
       (1978) 297-303, doi:10.1093/biomet/65.2.297: the test of whiteness.

    Examples
    --------
    A table made by y(k) = 0.8 y(k-1) + 0.5 u(k-1) + e(k):

    >>> import numpy as np, pandas as pd
    >>> rng = np.random.default_rng(1)
    >>> u, y = rng.normal(size=400), np.zeros(400)
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.01 * rng.normal()
    >>> table = pd.DataFrame({"t_s": np.arange(400) / 50, "cmd1_rad": u, "u_m_s": y})
    >>> fit = rwls([table], input_column="cmd1_rad", output_column="u_m_s", na=1, nb=1)
    >>> fit.parameters["value"].round(2).to_dict()
    {'a1': -0.8, 'b1': 0.5}
    >>> fit["b1"].unit
    '(m/s)/rad'
    """
    if options.order == "given" and (options.na is None or options.nb is None):
        raise UsageError("give --na and --nb, or --order auto")
    with recorded(repeat=True) as notices:
        data = read(logs, options.held_out, options.input_column, options.output_column, options.input_model)
        if output is not None:
            atomic.check_writable(output, inputs=data.files)
        m = identify(data, options, progress)
        checks = make_checks(m)
        _warn(m, checks)
    # held-out data are named by a share, a file, or a log in memory
    held_out = [
        str(v if isinstance(v, str | float | Path) else getattr(v, "name", "log")) for v in options.held_out
    ]
    settings = _settings(m)
    block = provenance.collect(data.files, settings={**settings, "validate": held_out})
    file = _parameter_file(m, settings, block)
    made = Fitted.of(file, build(m, file, checks, blocks.notices(notices)))
    made.data["orders_tried"] = [
        {**vars(c.orders), **{name: value for name, value in vars(c).items() if name != "orders"}}
        for c in m.candidates
    ]
    return made.saved(output)


def _settings(m: Identified) -> dict[str, Any]:
    """Return the options as the file records them, with the orders, columns and levels they led to."""
    options, columns = m.options, m.data.columns
    settings: dict[str, Any] = {
        "orders": asdict(m.estimate.orders),
        "order": "given" if options.order == "given" else f"auto, {options.criterion}",
        "input": columns.source,
        "output": columns.output,
        "output_unit": columns.units[1],
        **options.model_dump(include={"weight", "forgetting", "prior_scale", "centre", "horizon"}),
        "input_level": m.point.source,
        "output_level": m.point.output,
    }
    if columns.sine:
        names = ("amplitude", "frequency_hz", "phase_rad")
        settings["input_model"] = {"kind": "sine", **dict(zip(names, columns.sine, strict=True))}
    return settings


def _warn(m: Identified, checks: Sequence[Check]) -> None:
    fitted, data, point = m.estimate, m.data, m.point
    orders, known = fitted.orders, fitted.determined
    unit = numbers.unit_text(data.columns.units[1])
    lost = fitted.data.possible - len(fitted.data)
    restarts = max(int(np.count_nonzero(fitted.data.fresh)) - len(data.logs), 0)
    if lost or restarts:
        warn(
            "SWM001",
            f"{lost} of {fitted.data.possible} regression rows left out around missing samples, and the "
            f"regression restarted {restarts} times at gaps; no value was filled in",
        )
    if point.removed:
        text = (
            f"means of the fitted part removed: {data.columns.source} {point.source:.6g}, "
            f"{data.columns.output} {point.output:.6g} (constant term t = {point.t:.1f}); the model is of "
            "deviations from them"
        )
        moved = [f"{name} by {s.level:.3g}" for name, s in m.scores.items() if abs(s.level) > s.free_run.rmse]
        if moved:
            text += f". Held-out data are at another level: {', '.join(moved)} {unit}".rstrip()
        warn("SWM021", text)
    for one in checks:
        if one.name in CODES and one.verdict != "pass":
            warn(CODES[one.name], one.reason)
    source = np.concatenate([record.source for record in data.fit])
    if np.ptp(source[np.isfinite(source)]) == 0:
        warn("SWM022", "the input is constant: B is an offset of the output and says nothing of the input")
    elif known.input_rank < orders.nb:
        text = f"the input excites {known.input_rank} of the {orders.nb} coefficients of B"
        warn("SWM022", f"{text}; a single sine excites two" if known.input_rank == 2 else text)
    elif known.condition > 1e6:
        text = f"the regression is ill-conditioned (condition number {known.condition:.1e}): lower the orders"
        warn("SWM022", text)
    if fitted.recursion.windup:
        warn(
            "SWM022",
            f"with forgetting, P grew without limit in directions the input does not excite; it was held at "
            f"{fitted.recursion.windup} of {len(fitted.data)} samples",
        )
    for name in m.worse:
        errors = (f"{s.free_run.rmse:.3g} {unit}".rstrip() for s in (m.scores[name], m.fit_scores))
        warn("SWM015", f"the free-run error is {next(errors)} on {name}, {next(errors)} on the fitted part")


def _parameter_file(
    m: Identified, settings: dict[str, Any], block: dict[str, Any]
) -> parameters.ParameterFile:
    fitted, data, horizon = m.estimate, m.data, m.options.horizon
    orders, names = fitted.orders, fitted.orders.names
    unit, channel = data.columns.units[1], data.columns.output
    estimates = {}
    for name, value, stderr in zip(names, fitted.theta, fitted.stderr, strict=True):
        known = math.isfinite(stderr)
        estimates[name] = parameters.Estimate(
            value=float(value),
            stderr=float(stderr) if known else None,
            unit=data.columns.gain_unit if name.startswith("b") else "1",
            status="estimated" if known else "unidentifiable",
        )
    identifiable = [name for name, e in estimates.items() if e.status == "estimated"]
    validation: dict[str, Any] = {}
    if m.scores:
        together = pooled([r for part in m.held_out.values() for r in part], fitted)
        by_set = {name: s.as_dict(unit, horizon) for name, s in m.scores.items()}
        validation[channel] = {**together.as_dict(unit), "data": by_set}
    words = []
    if len(identifiable) < orders.count:
        words.append(
            f"The data span {fitted.determined.rank} of {orders.na + orders.nb} directions; only "
            f"combinations of {', '.join(name for name in names if name not in identifiable)} are determined."
        )
    # deviations from the input's level, beyond which the model is extrapolated
    deviation = np.concatenate([record.source for record in data.fit]) - m.point.source
    details = {
        "rows": len(fitted.data),
        "rows_left_out": fitted.data.possible - len(fitted.data),
        "condition": fitted.determined.condition,
        "input_excites": fitted.determined.input_rank,
        "input_range": [float(np.nanmin(deviation)), float(np.nanmax(deviation))],
        "stability": m.stability,
        "integrating": any(p.integrating for p in m.poles),
        "recursion_end": dict(zip(names, fitted.recursion.theta.tolist(), strict=True)),
    }
    return parameters.ParameterFile(
        model=NAME,
        robot=data.robot,
        parameters=estimates,
        identifiability=words,
        correlation=parameters.Correlation(names=identifiable, matrix=fitted.correlation.tolist()),
        delay=orders.nk,
        sample_time_s=data.sample_time_s,
        poles=[
            parameters.Pole(
                real=p.value.real,
                imag=p.value.imag,
                magnitude=p.magnitude,
                stderr_magnitude=p.stderr if math.isfinite(p.stderr) else None,
            )
            for p in m.poles
        ],
        stable=not any(p.unstable for p in m.poles),
        settings=settings,
        fit=parameters.Fit(
            trials=data.logs,
            channels={
                channel: {**m.fit_scores.free_run.as_dict(unit), **m.fit_scores.as_dict(unit, horizon)}
            },
            validation=validation,
            converged=True,
            noise={
                "sd": fitted.noise_sd,
                "unit": unit,
                "white": fitted.whiteness.passed,
                "white_p": fitted.whiteness.p_value,
                "input_independent": m.independent.passed,
                "input_independent_p": m.independent.p_value,
                "standard_errors": "sandwich" if fitted.robust else "sigma^2 (H'H)^-1",
            },
            **details,
        ),
        provenance=block,
    )


REFERENCES = [
    "L. Shang, S. Wang, M. Tan, L. Cheng: Swimming locomotion modeling for biomimetic underwater vehicle "
    "with two undulating long-fins. Robotica 30 (2012) 913-923. doi:10.1017/S0263574711001159",
    "G. J. Bierman: Factorization Methods for Discrete Sequential Estimation. Academic Press, 1977.",
    "G. M. Ljung, G. E. P. Box: On a measure of lack of fit in time series models. Biometrika 65 (1978) "
    "297-303. doi:10.1093/biomet/65.2.297",
]
#: Fit of the free run below which a model does not reproduce half of the output, %.
HALF_PERCENT = 50.0


def build(m: Identified, file: ParameterFile, checks: list[Check], notices: list[NoticeRecord]) -> Evidence:
    """Assemble the evidence; a model is good only on held-out data."""
    columns = m.data.columns
    least = min(s.free_run.fit_percent for s in _deciding_scores(m).values())
    where = "held-out" if m.scores else "fitted"
    answer = f"The free run does not reproduce the {where} output."
    if least >= 0:
        answer = f"The free run reproduces {least:.1f} % of the {where} output."
    figures = [_free_run(m), _frequency_response(m), _residuals(m)]
    if m.options.forgetting < 1:
        figures.append(_trajectories(m))
    return Evidence(
        verb="rwls",
        title=f"{m.kind} model, {columns.source} to {columns.output}",
        verdict=ev.judged(answer, checks),
        facts={"Orders": str(m.estimate.orders), "Rows": str(len(m.estimate.data))},
        checks=checks,
        tables=[_errors(m), _modes(m), *_orders(m)],
        figures=figures,
        notices=notices,
        methods=_methods(m),
        references=REFERENCES,
        provenance=file.provenance,
    )


def _deciding_scores(m: Identified) -> dict[str, Scores]:
    """Return the errors that decide on the model: on held-out data, or else on the fitted ones."""
    return dict(m.scores) or {"the fitted part": m.fit_scores}


def make_checks(m: Identified) -> list[Check]:
    """Return the checks of a model."""
    fitted, pole = m.estimate, m.critical_pole
    checks = [
        ev.check("Held-out data", str(len(m.scores)), bool(m.scores), "some", reason="no data were held out"),
        ev.check("Repeated samples", "; ".join(m.data.repeats), not m.data.repeats, "none"),
    ]
    if pole is not None:
        size, grade = f"|z| = {numbers.measured(pole.magnitude, pole.stderr)}", pole.state
        reason = f"the model integrates ({size}), so that a free run drifts"
        if pole.unstable:
            reason = f"the model is unstable ({size}) and cannot be simulated"
        otherwise: Literal["warn", "fail"] = "fail" if pole.unstable else "warn"
        passed = pole.state == "stable"
        checks.append(
            ev.check("Largest pole", size, passed, "below 1", grade, otherwise=otherwise, reason=reason)
        )
    runs = _deciding_scores(m)
    if m.fit_scores.diverged:
        runs["the fitted part"] = m.fit_scores
    for name, s in runs.items():
        fit, value = s.free_run.fit_percent, f"{s.free_run.fit_percent:.1f} % fit"
        reason = f"the free run reproduces less than half of {name} ({value})"
        if s.diverged:
            reason = f"the free run diverges on {name}"
        elif fit < 0:
            reason = f"on {name} the free run is worse than the mean of the output ({value})"
        elif name in m.worse:
            reason = f"the error on {name} is more than {WORSE:g} times that of the fit"
        otherwise = "fail" if s.diverged or fit < 0 else "warn"
        passed = fit >= HALF_PERCENT and name not in m.worse and not s.diverged
        limit = f"at least {HALF_PERCENT:g} %, and an error below {WORSE:g} times that of the fit"
        checks.append(ev.check(f"Free run, {name}", value, passed, limit, otherwise=otherwise, reason=reason))
    for name, test, reason in (
        ("white", fitted.whiteness, "are not white, so that the coefficients are biased"),
        ("independent of the input", m.independent, "depend on past inputs: orders or delay are wrong"),
    ):
        p = blocks.p_text(test.p_value)
        passed = test.passed or fitted.exact
        checks.append(
            ev.check(f"Residuals {name}", p, passed, "p ≥ 0.01", reason=f"the residuals {reason} ({p})")
        )
    known = int(np.isfinite(fitted.stderr).sum())
    value = f"{known} of {fitted.orders.count}"
    why = f"the input excites {fitted.determined.input_rank} of the {fitted.orders.nb} coefficients of B"
    lost = [n for n, ok in zip(fitted.orders.names, np.isfinite(fitted.stderr), strict=True) if not ok]
    reason = f"the data do not determine {', '.join(lost)}"
    passed = known == fitted.orders.count
    return [*checks, ev.check("Coefficients determined", value, passed, "all", why, reason=reason)]


def _errors(m: Identified) -> Table:
    rows: list[list[blocks.Cell]] = []
    for name, s in {"fitted": m.fit_scores, **m.scores}.items():
        kinds = {"one step": s.one_step, f"{m.options.horizon} steps": s.k_step, "free run": s.free_run}
        if s.strict is not None:
            kinds["free run, predicted level"] = s.strict
        for kind, q in kinds.items():
            nrmse = numbers.percent(q.nrmse)
            rows.append([name, kind, _finite(q.fit_percent), _finite(q.rmse), nrmse, q.samples])
    caption = "Judge a simulation model by its free run: one-step errors are small for almost any model."
    if m.point.removed:
        caption += (
            " The means of the fitted part were removed; held-out data are judged about a level of their own."
        )
    rmse = f"RMSE ({numbers.unit_text(m.data.columns.units[1]) or '1'})"
    columns = ["data", "prediction", "fit (%)", rmse, "NRMSE (of the range)", "samples"]
    title = "Errors on fitted and held-out data"
    return Table(id="errors", title=title, columns=columns, rows=rows, caption=caption)


def _modes(m: Identified) -> Table:
    rows: list[list[blocks.Cell]] = []
    for p in m.poles:
        size = numbers.measured(p.magnitude, p.stderr)
        rows.append([size, _finite(p.frequency_hz), _finite(p.damping_ratio), p.state])
    columns = ["|z|", "natural frequency (Hz)", "damping ratio", "verdict"]
    return Table(id="modes", title="What the poles mean in time", columns=columns, rows=rows, folded=True)


def _orders(m: Identified) -> list[Table]:
    if not m.candidates:
        return []
    aic, bic = (min(getattr(c, name) for c in m.candidates) for name in ("aic", "bic"))
    rows: list[list[blocks.Cell]] = []
    for c in sorted(m.candidates, key=lambda c: c.score(m.options.criterion))[:15]:
        rows.append([str(c.orders), c.aic - aic, c.bic - bic, _finite(c.free_run_fit_percent), c.stable])
    columns = ["orders", "AIC above least", "BIC above least", "free-run fit (%)", "stable"]
    title = f"The best of {len(m.candidates)} orders by {m.options.criterion}"
    return [Table(id="orders", title=title, columns=columns, rows=rows, folded=True)]


def _methods(m: Identified) -> list[str]:
    o = m.options
    text = (
        f"An {m.kind} model with {m.estimate.orders} from {m.data.columns.source} to {m.data.columns.output} "
        f"(sample time {m.data.sample_time_s:.6g} s) was identified from {len(m.estimate.data)} samples by "
        "recursive weighted least squares (Shang et al. 2012, Eq 9) in UD factors (Bierman 1977), with the "
        f"weight {o.weight:g}, the forgetting factor {o.forgetting:g} and P(0) = ({o.prior_scale:g})² I."
    )
    if m.estimate.orders.nc:
        text += " From its result the one-step error was minimised by Gauss-Newton steps."
    if m.point.removed:
        text += " The means of the fitted part were removed from input and output first."
    if m.estimate.robust:
        text += " Standard errors are of the sandwich form for correlated residuals (Ljung and Box 1978)."
    return [text]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# ---------------------------------------------------------------- figures


def _free_run(m: Identified) -> Figure:
    """Return measured output and free run of the records with the worst and the best free run."""
    sets = dict(m.held_out) or {"the fitted part": m.fit}
    ranked = sorted(sets, key=lambda name: _deciding_scores(m)[name].free_run.fit_percent)
    panels = []
    for name in dict.fromkeys([ranked[0], ranked[-1]]):
        level = m.point.output + _deciding_scores(m)[name].level
        traces: list[Trace] = []
        for record in sets[name]:
            run = difference.simulate(record, m.estimate.orders, m.estimate.theta)
            curves = {"measured": record.output, "free run": run}
            for group, (label, y) in enumerate(curves.items()):
                x, shown = ev.thinned(record.time_s, y + level)
                label = label if len(traces) < len(curves) else ""
                traces.append(Trace(x=x, y=shown, label=label, group=group))
        y_label = numbers.column_title(m.data.columns.output)
        panels.append(Panel(x_label="time (s)", y_label=y_label, traces=traces, title=name))
    caption = "The free run has only the input after its first samples, and the mean level of the record."
    if len(sets) > 2:
        caption += f" Shown are the worst and the best of {len(sets)} records."
    return Figure(id="free-run", title="Measured and simulated output", caption=caption, panels=panels)


def _frequency_response(m: Identified) -> Figure:
    fitted, step = m.estimate, m.data.sample_time_s
    nyquist = np.pi / step
    omega = np.geomspace(max(4 * nyquist / len(fitted.data), 1e-4 * nyquist), nyquist * 0.999, 300)
    response, log_gain, phase_sd = frequency_response(
        fitted.orders, fitted.theta, fitted.covariance, step, omega
    )
    gain, phase = np.abs(response), np.unwrap(np.angle(response))
    factor, half = np.exp(np.clip(1.96 * log_gain, 0, 20)), 1.96 * np.minimum(phase_sd, np.pi)
    hertz = omega / (2 * np.pi)
    gains = Trace(x=hertz, y=gain, lower=gain / factor, upper=gain * factor, group=0)
    phases = blocks.band(hertz, np.degrees(phase), np.degrees(half), group=0)
    spans = _excited(m)
    panels = [
        Panel(
            x_label="frequency (Hz)", y_label=label, traces=[trace], spans=spans, x_scale="log", y_scale=scale
        )
        for label, trace, scale in (
            (f"gain ({numbers.unit_text(m.data.columns.gain_unit) or 1})", gains, "log"),
            ("phase (°)", phases, "linear"),
        )
    ]
    caption = "Gain and phase with 95 % bands. Outside of the shaded band the input has little power."
    return Figure(id="bode", title="Frequency response", caption=caption, panels=panels)


def _excited(m: Identified) -> list[Span]:
    """Return the band that holds the central 90 % of the input's power."""
    longest = max(m.fit, key=len)
    u = np.nan_to_num(longest.source - np.nanmean(longest.source))
    total = np.cumsum(np.abs(np.fft.rfft(u * np.hanning(len(u)))) ** 2)
    if len(total) < 8 or total[-1] <= 0:
        return []
    hertz = np.fft.rfftfreq(len(u), m.data.sample_time_s)
    low, high = (float(hertz[np.searchsorted(total, q * total[-1])]) for q in (0.05, 0.95))
    step = float(hertz[1])
    return [Span(start=max(low, step), end=high + step, label="90 % of the input's power")]


def _residuals(m: Identified) -> Figure:
    residuals, source, lags = m.residual_series
    own = rt.autocorrelation(residuals, max_lag=lags)
    cross = rt.cross_correlation(residuals, source, max_lag=lags)
    return Figure(
        id="residuals",
        title="Correlation of the one-step residuals",
        caption="With themselves, and with the input at earlier (positive lag) and later samples.",
        panels=[
            blocks.correlogram(own, "autocorrelation", "residuals", skip_zero=True),
            blocks.correlogram(cross, "correlation with the input", "residuals", skip_zero=False),
        ],
        columns=2,
    )


def _trajectories(m: Identified) -> Figure:
    run, names = m.estimate.recursion, m.estimate.orders.names
    scale = m.estimate.noise_sd * math.sqrt(m.options.weight)
    # The first rows only replace the prior; drawn, they would flatten everything else.
    settled = np.all(run.spreads <= 8 * run.spreads[-1], axis=1) & (run.kept >= 3 * len(names))
    shown = slice(min(int(np.argmax(settled)), len(run.kept) // 2), None)
    panels = []
    for i, name in enumerate(names):
        half = 1.96 * scale * run.spreads[shown, i]
        estimate = blocks.band(run.kept[shown].astype(float), run.thetas[shown, i], half, group=0)
        panels.append(Panel(x_label="row", y_label=name, traces=[estimate]))
    caption = "Each coefficient with its 95 % band for white residuals. A step says that the robot changed."
    title = "Coefficients over the record"
    return Figure(id="trajectories", title=title, caption=caption, panels=panels, columns=2)
