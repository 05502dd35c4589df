"""Command ``swimid rwls``: identifies a discrete-time model from an input and an output column."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.blackbox import difference
from swimid.blackbox.identified import MAX_RATIO, Identified, Scores, identify
from swimid.blackbox.model import NAME, PAPER
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import read
from swimid.files import atomic, provenance
from swimid.fitting import uncertainty as rt
from swimid.fitting.fit_common import score
from swimid.notices import Progress, recorded, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers, parameters
from swimid.results.evidence import Check, Evidence, Figure, NoticeRecord, Table, Trace
from swimid.results.parameters import Fitted

#: Codes of the warnings whose text is the reason of a check, by the name of the check.
CODES = {"Largest pole": "SWM020", "Residuals white": "SWM013", "Coefficients determined": "SWM010"}
#: Minimum NRMSE fit of a free run that counts as reproducing the output, %.
MIN_FIT_PERCENT = 50.0
#: Maximum condition number of the scaled regression. A regression with a larger condition number is reported
#: as ill-conditioned.
MAX_CONDITION = 1e6
REFERENCES = [
    PAPER,
    "G. J. Bierman: Factorization Methods for Discrete Sequential Estimation. Academic Press, 1977.",
    "G. M. Ljung, G. E. P. Box: On a measure of lack of fit in time series models. Biometrika 65 (1978) "
    "297-303. doi:10.1093/biomet/65.2.297",
]


@takes(RwlsOptions)
def rwls(
    logs: Sequence[str | Path],
    *,
    options: RwlsOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify an ARX or ARMAX model by recursive weighted least squares.

    A trials file can state the columns. Without ``na`` and ``nb`` the orders with the lowest BIC are chosen.
    See :class:`swimid.blackbox.difference.Orders` for the orders, :mod:`swimid.blackbox.recursive` for
    weight, forgetting and P(0), and :func:`swimid.blackbox.identified.find_working_point` for the means. If
    the one-step residuals are not white (SWM013), the coefficients of an ARX model are biased. Judge such a
    model by its free run, or give ``nc``.

    Parameters
    ----------
    logs : sequence of path, Log or DataFrame
        Logs with one row for each sample, all at one rate; or trials files of the experiment ``arma``.
    output : Path, optional
        Parameter file to write. The evidence file is written to the same folder.
    progress : Progress
        Shows the progress of the order search.

    Returns
    -------
    Fitted
        ``.parameters`` has ``a1``, ... (1), ``b1``, ... (unit of the output divided by that of the input) and
        ``c1``, ... (1). ``.tables()`` has the ``errors`` of the predictions and the ``modes`` of the model.
        ``.data["orders_tried"]`` has the orders of an order search with their BIC, lowest first.

        The errors contain ``fit_percent``, the NRMSE fit ``100 (1 - ||y - yhat|| / ||y - mean(y)||)`` as the
        System Identification Toolbox defines it. The mean is taken over the compared samples of the measured
        output in all records of a data set.

    Raises
    ------
    InputError
        A log cannot be read, a column is missing, or held-out rows are also fitted.
    UsageError
        The options contradict each other.
    NoTrustworthyResult
        There are too few rows, input or output are constant, or the search for ``c1``, ... does not converge.

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
    A table simulated with y(k) = 0.8 y(k-1) + 0.5 u(k-1) + e(k):

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
    with recorded(repeat=True) as notices:
        data = read(logs, options)
        if output is not None:
            atomic.check_writable(output, inputs=data.files)
        m = identify(data, options, progress)
        checks = _checks(m)
        for code, text in _warnings(m, checks):
            warn(code, text)
    file = _parameter_file(m)
    made = Fitted.of(file, _evidence(m, file.provenance, checks, ev.notices(notices)))
    made.data["orders_tried"] = [{**asdict(orders), "bic": bic} for orders, bic in m.candidates]
    return made.saved(output)


# ---------------------------------------------------------------- checks and warnings


def _deciding_scores(m: Identified) -> dict[str, Scores]:
    """Return the errors by which the model is judged: on held-out data, or on the fitted data if none."""
    return dict(m.scores) or {"the fitted part": m.fit_scores}


def _checks(m: Identified) -> list[Check]:
    fitted, pole = m.estimate, m.critical_pole
    checks = [
        ev.check("Held-out data", str(len(m.scores)), bool(m.scores), "some", reason="no data were held out"),
        ev.check("Repeated samples", "; ".join(m.data.repeats), not m.data.repeats, "none"),
    ]
    otherwise: Literal["warn", "fail"] = "warn"
    if pole is not None:
        size = f"|z| = {numbers.measured(pole.magnitude, pole.stderr)}"
        reason, passed = f"the model integrates ({size}), so that a free run drifts", pole.state == "stable"
        if pole.state == "unstable":
            otherwise, reason = "fail", f"the model is unstable ({size}) and cannot be simulated"
        checks.append(
            ev.check("Largest pole", size, passed, "below 1", pole.state, otherwise=otherwise, reason=reason)
        )
    runs = _deciding_scores(m)
    if m.fit_scores.diverged:
        runs["the fitted part"] = m.fit_scores
    for name, s in runs.items():
        fit, value = s.free_run.fit_percent, f"{s.free_run.fit_percent:.1f} % fit"
        otherwise, passed = "warn", False
        if s.diverged:
            otherwise, reason = "fail", f"the free run diverges on {name}"
        elif fit < 0:
            otherwise = "fail"
            reason = f"on {name} the free run is worse than the mean of the output ({value})"
        elif name in m.worse:
            reason = f"the error on {name} is more than {MAX_RATIO:g} times that of the fit"
        else:
            passed = fit >= MIN_FIT_PERCENT
            reason = f"the free run reproduces less than half of {name} ({value})"
        limit = f"at least {MIN_FIT_PERCENT:g} %, and an error below {MAX_RATIO:g} times that of the fit"
        checks.append(ev.check(f"Free run, {name}", value, passed, limit, otherwise=otherwise, reason=reason))
    for name, test, reason in (
        ("white", fitted.whiteness, "are not white, so that the coefficients are biased"),
        ("independent of the input", m.independent, "depend on past inputs: orders or delay are wrong"),
    ):
        p, passed = ev.p_text(test.p_value), test.passed or fitted.exact
        checks.append(
            ev.check(f"Residuals {name}", p, passed, "p ≥ 0.01", reason=f"the residuals {reason} ({p})")
        )
    lost = _undetermined(m)
    value = f"{fitted.orders.count - len(lost)} of {fitted.orders.count}"
    reason = f"the data do not determine {', '.join(lost)}"
    excited = f"the input excites {fitted.known.input_rank} of the {fitted.orders.nb} coefficients of B"
    return [*checks, ev.check("Coefficients determined", value, not lost, "all", excited, reason=reason)]


def _undetermined(m: Identified) -> list[str]:
    """Return the names of the coefficients that the data do not determine."""
    pairs = zip(m.estimate.orders.names, m.estimate.stderr, strict=True)
    return [name for name, stderr in pairs if not math.isfinite(stderr)]


def _warnings(m: Identified, checks: Sequence[Check]) -> Iterator[tuple[str, str]]:
    """Yield the code and the text of each warning about the data and the model."""
    fitted, data, point = m.estimate, m.data, m.point
    known, nb = fitted.known, fitted.orders.nb
    unit = numbers.unit_text(data.columns.unit)
    lost = fitted.data.possible - len(fitted.data)
    restarts = max(int(np.count_nonzero(fitted.data.fresh)) - len(data.logs), 0)
    if lost or restarts:
        yield (
            "SWM001",
            f"{lost} of {fitted.data.possible} regression rows left out around missing samples, and the "
            f"regression restarted {restarts} times at gaps; no value was filled in",
        )
    if point.removed:
        text = (
            f"means of the fitted part subtracted: {data.columns.source} {point.source:.6g}, "
            f"{data.columns.output} {point.output:.6g} (constant term t = {point.t:.1f}); the model is of "
            "deviations from them"
        )
        yield "SWM021", text
    for check in checks:
        if check.name in CODES and check.verdict != "pass":
            yield CODES[check.name], check.reason
    source = np.concatenate([record.source for record in data.fit])
    if np.ptp(source[np.isfinite(source)]) == 0:
        yield "SWM022", "the input is constant: B is an offset of the output and says nothing of the input"
    elif known.input_rank < nb:
        text = f"the input excites {known.input_rank} of the {nb} coefficients of B"
        yield "SWM022", text
    elif known.condition > MAX_CONDITION:
        text = f"the regression is ill-conditioned (condition number {known.condition:.1e})"
        yield "SWM022", f"{text}: lower the orders"
    if fitted.recursion.limited:
        yield (
            "SWM022",
            "with forgetting, P grew in directions that the input does not excite; it was limited at "
            f"{fitted.recursion.limited} of {len(fitted.data)} samples",
        )
    for name in m.worse:
        here, fit = (f"{s.free_run.rmse:.3g} {unit}".rstrip() for s in (m.scores[name], m.fit_scores))
        yield "SWM015", f"the free-run error is {here} on {name}, {fit} on the fitted part"


# ---------------------------------------------------------------- parameter file


def _settings(m: Identified) -> dict[str, Any]:
    """Return the options as the parameter file contains them, with the orders, columns and levels in use."""
    columns = m.data.columns
    settings: dict[str, Any] = {
        "orders": asdict(m.estimate.orders),
        "order": "least BIC" if m.candidates else "given",
        "input": columns.source,
        "output": columns.output,
        "output_unit": columns.unit,
        **m.options.model_dump(include={"weight", "forgetting", "prior_scale", "centre"}),
        "input_level": m.point.source,
        "output_level": m.point.output,
    }
    if columns.sine:
        names = ("amplitude", "frequency_hz", "phase_rad")
        settings["input_model"] = {"kind": "sine", **dict(zip(names, columns.sine, strict=True))}
    return settings


def _parameter_file(m: Identified) -> parameters.ParameterFile:
    fitted, data = m.estimate, m.data
    orders, names, lost = fitted.orders, fitted.orders.names, _undetermined(m)
    unit, channel = data.columns.unit, data.columns.output
    estimates = {
        name: parameters.Estimate(
            value=float(value),
            stderr=_finite(stderr),
            unit=data.columns.gain_unit if name.startswith("b") else "1",
            status="unidentifiable" if name in lost else "estimated",
        )
        for name, value, stderr in zip(names, fitted.theta, fitted.stderr, strict=True)
    }
    validation: dict[str, Any] = {}
    if m.scores:
        held_out = [record for part in m.held_out.values() for record in part]
        together = score(*difference.simulate_all(held_out, orders, fitted.theta))
        by_set = {name: s.as_dict(unit) for name, s in m.scores.items()}
        validation[channel] = {**together.as_dict(unit), "data": by_set}
    words = []
    if lost:
        words.append(
            f"The data span {fitted.known.rank} of {orders.na + orders.nb} directions; only combinations of "
            f"{', '.join(lost)} are determined."
        )
    details = {
        "rows": len(fitted.data),
        "rows_left_out": fitted.data.possible - len(fitted.data),
        "condition": fitted.known.condition,
        "input_excites": fitted.known.input_rank,
        "stability": m.critical_pole.state if m.critical_pole else "stable",
        "integrating": any(p.integrating for p in m.poles),
    }
    settings = _settings(m)
    # held-out data are named by a fraction, a file, or a log in memory
    shares = [
        str(v if isinstance(v, str | float | Path) else getattr(v, "name", "log")) for v in m.options.held_out
    ]
    return parameters.ParameterFile(
        model=NAME,
        robot=data.robot,
        parameters=estimates,
        identifiability=words,
        correlation=parameters.Correlation(
            names=[name for name in names if name not in lost], matrix=fitted.correlation.tolist()
        ),
        delay=orders.nk,
        sample_time_s=data.sample_time_s,
        poles=[
            parameters.Pole(
                real=p.value.real,
                imag=p.value.imag,
                magnitude=p.magnitude,
                stderr_magnitude=_finite(p.stderr),
            )
            for p in m.poles
        ],
        stable=all(p.state != "unstable" for p in m.poles),
        settings=settings,
        fit=parameters.Fit(
            trials=data.logs,
            channels={channel: {**m.fit_scores.free_run.as_dict(unit), **m.fit_scores.as_dict(unit)}},
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
        provenance=provenance.collect(data.files, settings={**settings, "validate": shares}),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# ---------------------------------------------------------------- evidence


def _evidence(
    m: Identified, provenance: dict[str, Any], checks: list[Check], notices: list[NoticeRecord]
) -> Evidence:
    columns = m.data.columns
    least = min(s.free_run.fit_percent for s in _deciding_scores(m).values())
    where = "held-out" if m.scores else "fitted"
    answer = f"The free run does not reproduce the {where} output."
    if least >= 0:
        answer = f"The free run reproduces {least:.1f} % of the {where} output."
    return Evidence(
        command="rwls",
        title=f"{m.kind} model, {columns.source} to {columns.output}",
        verdict=ev.judged(answer, checks),
        facts={"Orders": str(m.estimate.orders), "Rows": str(len(m.estimate.data))},
        checks=checks,
        tables=[_errors(m), _modes(m)],
        figures=[_free_run(m), _residuals(m)],
        notices=notices,
        methods=_methods(m),
        references=REFERENCES,
        provenance=provenance,
    )


def _errors(m: Identified) -> Table:
    rows: list[list[ev.Cell]] = []
    for name, s in {"fitted": m.fit_scores, **m.scores}.items():
        kinds = {"one step": s.one_step, "free run": s.free_run}
        if s.strict is not None:
            kinds["free run, predicted level"] = s.strict
        for kind, q in kinds.items():
            share = numbers.percent(q.nrmse)
            rows.append([name, kind, _finite(q.fit_percent), _finite(q.rmse), share, q.samples])
    caption = (
        "Judge a simulation model by its free run: one-step errors are small for almost any model. The NRMSE "
        "fit is 100 (1 - ||y - ŷ|| / ||y - mean(y)||), with the mean of the measured output of the same data."
    )
    if m.point.removed:
        caption += (
            " The means of the fitted part were subtracted. Held-out data are compared about their own level."
        )
    rmse = f"RMSE ({numbers.unit_text(m.data.columns.unit) or '1'})"
    columns = ["data", "prediction", "NRMSE fit (%)", rmse, "RMSE over the range", "samples"]
    title = "Errors on fitted and held-out data"
    return Table(id="errors", title=title, columns=columns, rows=rows, caption=caption)


def _modes(m: Identified) -> Table:
    rows: list[list[ev.Cell]] = []
    for p in m.poles:
        size = numbers.measured(p.magnitude, p.stderr)
        rows.append([size, _finite(p.frequency_hz), _finite(p.damping_ratio), p.state])
    columns = ["|z|", "natural frequency (Hz)", "damping ratio", "stability"]
    return Table(id="modes", title="Modes of the model", columns=columns, rows=rows, folded=True)


def _methods(m: Identified) -> list[str]:
    o, columns = m.options, m.data.columns
    text = (
        f"An {m.kind} model with {m.estimate.orders} from {columns.source} to {columns.output} "
        f"(sample time {m.data.sample_time_s:.6g} s) was identified from {len(m.estimate.data)} samples by "
        "recursive weighted least squares (Shang et al. 2012, Eq 9) in UD factors (Bierman 1977), with the "
        f"weight {o.weight:g}, the forgetting factor {o.forgetting:g} and P(0) = ({o.prior_scale:g})² I."
    )
    for applies, more in (
        (m.estimate.orders.nc, "From its result the one-step error was minimised by Gauss-Newton steps."),
        (m.point.removed, "The means of the fitted part were subtracted from input and output first."),
        (m.estimate.robust, "Standard errors have the sandwich form for correlated residuals."),
    ):
        if applies:
            text += f" {more}"
    return [text]


# ---------------------------------------------------------------- figures


def _free_run(m: Identified) -> Figure:
    """Return the figure of measured output and free run, for the worst and the best data set."""
    sets, scores = dict(m.held_out) or {"the fitted part": m.fit}, _deciding_scores(m)
    ranked = sorted(sets, key=lambda name: scores[name].free_run.fit_percent)
    panels = []
    for name in dict.fromkeys([ranked[0], ranked[-1]]):
        level = m.point.output + scores[name].level
        traces: list[Trace] = []
        for record in sets[name]:
            run = difference.simulate(record, m.estimate.orders, m.estimate.theta)
            labels = ("", "") if traces else ("measured", "free run")
            for group, y in enumerate((record.output, run)):
                x, shown = ev.thinned(record.time_s, y + level)
                traces.append(Trace(x=x, y=shown, label=labels[group], group=group))
        y_label = numbers.column_title(m.data.columns.output)
        title = name.removesuffix(".csv") * (len(sets) > 1)
        panels.append(ev.panel("time (s)", y_label, traces, title=title))
    caption = "The free run is simulated from the input alone, after its first samples, about the mean level."
    if len(sets) > 2:
        caption += f" Shown are the worst and the best of {len(sets)} records."
    return ev.panels("free-run", "Measured and simulated output", caption, panels)


def _residuals(m: Identified) -> Figure:
    residuals, _, lags = m.residual_series
    own = rt.autocorrelation(residuals, max_lag=lags)
    caption = "Values outside of the 95 % band of white noise show that the model lacks an effect."
    panels = [ev.correlogram(own, "autocorrelation", "residuals", skip_zero=True)]
    return ev.panels("residuals", "Autocorrelation of the one-step residuals", caption, panels)
