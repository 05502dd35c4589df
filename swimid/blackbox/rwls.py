"""Command ``swimid rwls``: identification of a discrete-time model from an input and an output column.

The command chooses the working point and the orders of an ARX or ARMAX model, estimates the model, and
computes its prediction errors. The model has no constant term, and describes deviations from a working point.
If data are recorded around a working point (20 degrees, half throttle), their means must be subtracted. Data
that obey the model without a constant term must not be changed. Predictions are computed one step ahead
and as a free run. The free run is a simulation that uses no measured output after its start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.blackbox.arx import (
    EXACT,
    ArxEstimate,
    Regression,
    check_enough,
    compute_arx_covariance,
    errors_and_gradient,
    find_directions,
    fit_arx,
    regression,
)
from swimid.blackbox.model import (
    INTEGRATING,
    NAME,
    PAPER,
    SINE_SETTINGS,
    ArxPole,
    ArxRecord,
    Data,
    Orders,
    best_level,
    find_poles,
    read,
    simulate,
    simulate_all,
)
from swimid.blackbox.options import RwlsOptions
from swimid.errors import NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.fitting import uncertainty as rt
from swimid.fitting.fit_common import VALIDATION_RATIO, SeriesScore, compute_score, is_still
from swimid.notices import Notice, Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers, parameters
from swimid.results.evidence import Check, Evidence, Figure, Table, Trace
from swimid.results.parameters import Fitted

#: Minimum absolute t value of a constant term in the regression at which the means of the data are subtracted
#: without further conditions.
CLEAR_T = 5.0
#: Minimum absolute t value of a constant term in the regression at which the means of the data are subtracted
#: if this also reduces the error of the free run by :data:`CLEAR_GAIN`. Fewer than one in a hundred records
#: that need no constant term reach both thresholds by chance, also for slow systems.
LIKELY_T = 3.5
#: Minimum absolute t value of a constant term in the regression at which the means of the data are subtracted
#: if the output is far from zero (:data:`FAR_LEVEL`) and the free run improves at all. The t value can be
#: small because a spurious pole near 1 replaces the constant term.
WEAK_T = 2.0
#: Minimum relative reduction of the root-mean-square error of the free run that counts as a clear improvement
#: when the means of the data are subtracted.
CLEAR_GAIN = 0.1
#: Minimum ratio of the absolute mean of the output to its standard deviation at which the output counts as
#: far from zero.
FAR_LEVEL = 3.0
#: Warning codes by the name of the check that issues the warning if it does not pass. The text of the warning
#: is the reason that the check gives.
WARNING_CODES = {"Largest pole": "SWM020", "Residuals white": "SWM013", "Coefficients determined": "SWM010"}
#: Minimum NRMSE fit (100 % minus the normalised root-mean-square error), %, at which a free run counts as
#: reproducing the output.
MIN_FIT_PERCENT = 50.0
#: Condition number of the scaled regression matrix above which the regression is reported as ill-conditioned.
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
    See :class:`swimid.blackbox.model.Orders` for the orders, :mod:`swimid.blackbox.arx` for
    weight, forgetting and P(0), and :func:`find_working_point` for the means. If
    the one-step residuals are not white (SWM013), the coefficients of an ARX model are biased. Judge such a
    model by its free run, or give ``nc``.

    Parameters
    ----------
    logs : sequence of path, Log or DataFrame
        Logs with one row for each sample, all at one rate; or a trials file of the experiment ``arma``.
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
    with record_warnings(repeat=True) as notices:
        data = read(logs, options)
        if output is not None:
            atomic.check_writable(output, inputs=data.files)
        m = identify(data, options, progress)
        checks = _checks(m)
        for code, text in _warnings(m, checks):
            warn(code, text)
    return _make_result(m, checks, notices).write_output(output)


def _make_result(m: Identified, checks: list[Check], notices: Sequence[Notice]) -> Fitted:
    """Return the parameter file of an identified model with its evidence."""
    file = _parameter_file(m)
    columns, where = m.data.columns, "held-out" if m.held_out else "fitted"
    least = min(part.free_run.fit_percent for part in m.assess_parts.values())
    answer = f"The free run does not reproduce the {where} output."
    if least >= 0:
        answer = f"The free run reproduces {least:.1f} % of the {where} output."
    evidence = Evidence(
        command="rwls",
        title=f"{m.kind} model, {columns.source} to {columns.output}",
        verdict=ev.make_verdict(answer, checks),
        facts={"Orders": str(m.estimate.orders), "Rows": str(len(m.estimate.data))},
        checks=checks,
        tables=[_errors(m), _modes(m)],
        figures=[_free_run(m), _residuals(m)],
        notices=list(notices),
        methods=_methods(m),
        references=REFERENCES,
        provenance=file.provenance,
    )
    made = Fitted.of(file, evidence)
    made.data["orders_tried"] = [{**asdict(orders), "bic": bic} for orders, bic in m.candidates]
    return made


# ---------------------------------------------------------------- checks and warnings


def _checks(m: Identified) -> list[Check]:
    fitted, pole, count = m.estimate, m.critical_pole, m.estimate.orders.count
    checks = [
        ev.make_check(
            "Held-out data", str(len(m.held_out)), bool(m.held_out), "some", reason="no data were held out"
        ),
        ev.make_check(
            "Repeated samples",
            "; ".join(m.data.repeats),
            not m.data.repeats,
            "none",
            reason=f"the log repeats samples: {'; '.join(m.data.repeats)}",
        ),
    ]
    otherwise: Literal["warn", "fail"] = "warn"
    if pole is not None:
        size = f"|z| = {numbers.format_estimate(pole.magnitude, pole.stderr_magnitude)}"
        reason, passed = f"the model integrates ({size}), so that a free run drifts", pole.state == "stable"
        if pole.state == "unstable":
            otherwise, reason = "fail", f"the model is unstable ({size}) and cannot be simulated"
        checks.append(
            ev.make_check(
                "Largest pole", size, passed, "below 1", pole.state, otherwise=otherwise, reason=reason
            )
        )
    runs, ratio = m.assess_parts, f"{VALIDATION_RATIO:g} times that of the fit"
    if m.fit.diverged:
        runs["the fitted part"] = m.fit
    for name, part in runs.items():
        fit, value = part.free_run.fit_percent, f"{part.free_run.fit_percent:.1f} % fit"
        otherwise, passed = "warn", False
        if part.diverged:
            otherwise, reason = "fail", f"the free run diverges on {name}"
        elif fit < 0 and not is_still(record.output for record in part.records):
            otherwise = "fail"
            reason = f"on {name} the free run is worse than the mean of the output ({value})"
        elif name in m.worse:
            reason = f"the error on {name} is more than {ratio}"
        else:
            passed = fit >= MIN_FIT_PERCENT
            reason = f"the free run reproduces less than half of {name} ({value})"
        limit = f"at least {MIN_FIT_PERCENT:g} %, and an error below {ratio}"
        checks.append(
            ev.make_check(f"Free run, {name}", value, passed, limit, otherwise=otherwise, reason=reason)
        )
    for name, test, fault, effect in (
        ("white", fitted.whiteness, "are not white", "the coefficients are biased"),
        ("independent of the input", m.independent, "depend on past inputs", "orders or delay are wrong"),
    ):
        p, passed = ev.p_text(test.p_value), test.is_passed or fitted.exact
        reason = f"the residuals {fault} ({p}), so that {effect}"
        checks.append(ev.make_check(f"Residuals {name}", p, passed, "p ≥ 0.01", reason=reason))
    lost = m.indeterminate
    value, reason = f"{count - len(lost)} of {count}", f"the data do not determine {', '.join(lost)}"
    excited = f"the input excites {fitted.known.input_rank} of the {fitted.orders.nb} coefficients of B"
    return [*checks, ev.make_check("Coefficients determined", value, not lost, "all", excited, reason=reason)]


def _warnings(m: Identified, checks: Sequence[Check]) -> Iterator[tuple[str, str]]:
    """Yield the code and the text of each warning about the data and the identified model."""
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
        yield (
            "SWM021",
            f"means of the fitted part subtracted: {data.columns.source} {point.source:.6g}, "
            f"{data.columns.output} {point.output:.6g} (constant term t = {point.t:.1f}); the model is of "
            "deviations from them",
        )
    for check in checks:
        if check.name in WARNING_CODES and check.verdict != "pass":
            yield WARNING_CODES[check.name], check.reason
    source = np.concatenate([record.source for record in data.fit])
    regressions = {
        "the input is constant: B is an offset of the output and says nothing of the input": np.nanmin(source)
        == np.nanmax(source),
        f"the input excites {known.input_rank} of the {nb} coefficients of B": known.input_rank < nb,
        f"the regression is ill-conditioned (condition number {known.condition:.1e}): lower the orders": (
            known.condition > MAX_CONDITION
        ),
    }
    for text in [text for text, applies in regressions.items() if applies][:1]:
        yield "SWM022", text
    if fitted.recursion.limited:
        yield (
            "SWM022",
            "with forgetting, P grew in directions that the input does not excite; it was limited at "
            f"{fitted.recursion.limited} of {len(fitted.data)} samples",
        )
    for name in m.worse:
        here, fit = (f"{part.free_run.rmse:.3g} {unit}".rstrip() for part in (m.held_out[name], m.fit))
        yield "SWM015", f"the free-run error is {here} on {name}, {fit} on the fitted part"


# ---------------------------------------------------------------- parameter file


def _parameter_file(m: Identified) -> parameters.ParameterFile:
    """Return the parameter file of an identified model.

    The settings in the file are the orders, the input and output columns, and the levels of the working
    point.
    """
    fitted, data, columns = m.estimate, m.data, m.data.columns
    orders, names, lost = fitted.orders, fitted.orders.names, m.indeterminate
    unit, channel, settings = columns.unit, columns.output, _list_settings(m)
    words = (
        f"The data span {fitted.known.rank} of {orders.na + orders.nb} directions; only combinations of "
        f"{', '.join(lost)} are determined."
    )
    validation: dict[str, Any] = {}
    if m.held_out:
        held_out = [record for part in m.held_out.values() for record in part.records]
        together = compute_score(*simulate_all(held_out, orders, fitted.theta))
        by_set = {name: part.as_dict(unit) for name, part in m.held_out.items()}
        validation[channel] = {**together.as_dict(unit), "data": by_set}
    # The provenance names held-out data by the fraction of each log, by a file, or by the name of a log in
    # memory.
    shares = [
        str(v if isinstance(v, str | float | Path) else getattr(v, "name", "log")) for v in m.options.held_out
    ]
    return parameters.ParameterFile(
        model=NAME,
        robot=data.robot,
        parameters=_list_estimates(m),
        identifiability=[words] * bool(lost),
        correlation=parameters.Correlation(
            names=[name for name in names if name not in lost], matrix=fitted.correlation.tolist()
        ),
        delay=orders.nk,
        sample_time_s=data.sample_time_s,
        poles=[*m.poles],
        stable=all(p.state != "unstable" for p in m.poles),
        settings=settings,
        fit=parameters.Fit(
            trials=data.logs,
            channels={channel: {**m.fit.free_run.as_dict(unit), **m.fit.as_dict(unit)}},
            validation=validation,
            converged=True,
            noise={
                "sd": fitted.noise_sd,
                "unit": unit,
                "white": fitted.whiteness.is_passed,
                "white_p": fitted.whiteness.p_value,
                "input_independent": m.independent.is_passed,
                "input_independent_p": m.independent.p_value,
                "standard_errors": "sandwich" if fitted.robust else "sigma^2 (H'H)^-1",
            },
            rows=len(fitted.data),  # type: ignore[call-arg]
            integrating=any(p.is_integrating for p in m.poles),  # type: ignore[call-arg]
        ),
        provenance=provenance.collect(data.files, settings={**settings, "validate": shares}),
    )


def _list_settings(m: Identified) -> dict[str, Any]:
    """Return the settings of a parameter file: orders, columns, and levels of the working point."""
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
        settings["input_model"] = {"kind": "sine", **dict(zip(SINE_SETTINGS, columns.sine, strict=True))}
    return settings


def _list_estimates(m: Identified) -> dict[str, parameters.Estimate]:
    """Return the coefficients of a model as entries of the parameter file."""
    fitted, units = m.estimate, {"a": "1", "b": m.data.columns.gain_unit, "c": "1"}
    estimates = {}
    for name, value, stderr in zip(fitted.orders.names, fitted.theta, fitted.stderr, strict=True):
        status = "unidentifiable" if name in m.indeterminate else "estimated"
        estimates[name] = parameters.Estimate(
            value=float(value), stderr=_finite(stderr), unit=units[name[0]], status=status
        )
    return estimates


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# ---------------------------------------------------------------- evidence


def _errors(m: Identified) -> Table:
    rows: list[list[ev.Cell]] = []
    for name, part in {"fitted": m.fit, **m.held_out}.items():
        kinds = {"one step": part.one_step, "free run": part.free_run}
        if part.strict is not None:
            kinds["free run, predicted level"] = part.strict
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
    """Return a table of the modes of the model: magnitude, frequency, damping and stability of each pole.

    Frequency and damping are those of the continuous-time pole ``log(z) / Ts``, with the sample time ``Ts``.
    """
    rows: list[list[ev.Cell]] = []
    for p in m.poles:
        size = numbers.format_estimate(p.magnitude, p.stderr_magnitude)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.log(np.complex128(complex(p.real, p.imag))) / m.data.sample_time_s
            damping = -rate.real / abs(rate)
        rows.append([size, _finite(abs(rate) / (2 * np.pi)), _finite(damping), p.state])
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
    """Return the figure of measured output and free run over time, for the worst and the best data set."""
    parts = m.assess_parts
    ranked = sorted(parts, key=lambda name: parts[name].free_run.fit_percent)
    panels = []
    for name in dict.fromkeys([ranked[0], ranked[-1]]):
        level = m.point.output + parts[name].level
        traces: list[Trace] = []
        for record in parts[name].records:
            run = simulate(record, m.estimate.orders, m.estimate.theta)
            for group, (label, y) in enumerate({"measured": record.output, "free run": run}.items()):
                x, shown = ev.thin_curve(record.time_s, y + level)
                traces.append(Trace(x=x, y=shown, label=label * (len(traces) < 2), group=group))
        y_label = numbers.column_title(m.data.columns.output)
        title = name.removesuffix(".csv") * (len(parts) > 1)
        panels.append(ev.panel("time (s)", y_label, traces, title=title))
    caption = "The free run is simulated from the input alone, after its first samples, about the mean level."
    if len(parts) > 2:
        caption += f" Shown are the worst and the best of {len(parts)} records."
    return ev.panels("free-run", "Measured and simulated output", caption, panels)


def _residuals(m: Identified) -> Figure:
    residuals, _, lags = m.residual_series
    own = rt.autocorrelation(residuals, max_lag=lags)
    caption = "Values outside of the 95 % band of white noise show that the model lacks an effect."
    panels = [ev.correlogram(own, "autocorrelation", "residuals", skip_zero=True)]
    return ev.panels("residuals", "Autocorrelation of the one-step residuals", caption, panels)


# ---------------------------------------------------------------- identification


@dataclass(frozen=True)
class WorkingPoint:
    """Means that are subtracted from the input and output of a model; zeros if none are subtracted."""

    source: float
    output: float
    #: t value of the constant term: its estimate in the regression divided by its standard error.
    t: float
    removed: bool


def find_working_point(records: Sequence[ArxRecord], orders: Orders, mode: str = "auto") -> WorkingPoint:
    """Decide whether the means of the fitted records must be subtracted, and return the working point.

    Parameters
    ----------
    mode : {"auto", "none", "mean"}
        ``none`` never subtracts the means, ``mean`` always does. ``auto`` subtracts them in four cases, where
        t is the t value of a constant term that is fitted together with A and B. (1) |t| is above
        :data:`CLEAR_T`. (2) |t| is above :data:`LIKELY_T`, and the free run improves by :data:`CLEAR_GAIN`.
        (3) The mean of the output is more than :data:`FAR_LEVEL` standard deviations from zero, and the free
        run improves by :data:`CLEAR_GAIN`, or by any amount if |t| is above :data:`WEAK_T`. (4) The mean of
        the output is as far from zero as in case 3, and a pole at 1 disappears.

    Raises
    ------
    NoTrustworthyResult
        There are not more rows than coefficients, or the output is constant.
    """
    data = regression(records, replace(orders, nc=0))
    check_enough(data, orders)
    source = float(np.nanmean(np.concatenate([r.source for r in records])))
    output = float(np.nanmean(np.concatenate([r.output for r in records])))
    constant, t = constant_term(data)
    size = abs(t) * bool(abs(constant) > EXACT * np.sqrt(np.mean(data.outputs**2)))
    far = bool(abs(output) > FAR_LEVEL * np.std(data.outputs))
    point = WorkingPoint(source, output, t, True)
    removed = mode == "mean" or (mode == "auto" and size > CLEAR_T)
    if mode == "auto" and not removed and (far or size > LIKELY_T):
        before, pole_before = _simulate_fit(records, orders)
        after, pole_after = _simulate_fit(subtract_levels(records, point), orders)
        needed_gain = CLEAR_GAIN
        if far and size > WEAK_T:
            needed_gain = 0.0
        loses_pole = far and pole_before > INTEGRATING >= pole_after
        removed = loses_pole or after < before * (1.0 - needed_gain)
    if removed:
        return point
    return WorkingPoint(0.0, 0.0, t, False)


def _simulate_fit(records: Sequence[ArxRecord], orders: Orders) -> tuple[float, float]:
    """Fit an ARX model by least squares, and return the error of its free run and its largest pole.

    The error is the root mean square, and infinite if the free run has no samples. The largest pole is given
    by its magnitude.
    """
    plain = replace(orders, nc=0)
    data = regression(records, plain)
    theta = np.linalg.lstsq(data.rows, data.outputs, rcond=None)[0]
    squared = np.subtract(*simulate_all(records, plain, theta)) ** 2
    error, compared = math.inf, squared[np.isfinite(squared)]
    if len(compared):
        error = float(np.sqrt(np.mean(compared)))
    roots = np.roots([1.0, *theta[: orders.na]])
    return error, float(np.max(np.abs(roots), initial=0.0))


def constant_term(data: Regression) -> tuple[float, float]:
    """Fit a regression with an additional constant term, and return this term and its t value.

    If the data do not determine the constant term, it is NaN and its t value is 0.
    """
    n, p = data.rows.shape
    rows = np.hstack((data.rows, np.ones((n, 1))))
    if n <= p + 1 or not find_directions(rows, np.zeros(p + 1)).determined[-1]:
        return float("nan"), 0.0
    theta = np.linalg.lstsq(rows, data.outputs, rcond=None)[0]
    residuals = data.outputs - rows @ theta
    absorbed = rt.count_absorbed(data.on_grid(rows), data.past_errors(residuals))
    white = rt.ljung_box(data.on_grid(residuals), fitted=absorbed).is_passed
    spread, _ = compute_arx_covariance(rows, residuals, np.ones(n), 0.0, data, robust=not white)
    constant, stderr = float(theta[-1]), float(np.sqrt(max(spread[-1, -1], 0.0)))
    if stderr > 0:
        return constant, constant / stderr
    return constant, 0.0 if constant == 0 else float("inf")


def subtract_levels(records: Sequence[ArxRecord], point: WorkingPoint) -> list[ArxRecord]:
    """Return copies of records with the levels of a working point subtracted from input and output."""
    if not point.removed:
        return list(records)
    return [replace(r, source=r.source - point.source, output=r.output - point.output) for r in records]


def predict(record: ArxRecord, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """Predict the output of a record one sample ahead from past samples; NaN if a past sample is missing."""
    data = regression([record], orders)
    errors, _ = errors_and_gradient(theta, data)
    return data.on_grid(data.outputs - errors)


def about_own_level(
    records: Sequence[ArxRecord], orders: Orders, theta: np.ndarray
) -> tuple[list[ArxRecord], float]:
    """Subtract from the outputs of records the level that minimises the free-run error of a model.

    Return the changed records and this level. It accounts for held-out data with another working point than
    the fitted data. The level is subtracted from all outputs, also from those that start the free run.
    """
    measured, run = simulate_all(records, orders, theta)
    _, raised = simulate_all([replace(r, output=r.output - 1.0) for r in records], orders, theta)
    level = best_level(measured, run, raised + 1.0)
    return [replace(r, output=r.output - level) for r in records], level


@dataclass(frozen=True)
class Part:
    """Set of records, without the working point, and the prediction errors of a model on these records."""

    records: list[ArxRecord]
    one_step: SeriesScore
    free_run: SeriesScore
    #: Whether the free run of a model that is not stable diverges from the measured output.
    diverged: bool
    #: Output level of held-out records, relative to the level of the fitted data.
    level: float = 0.0
    #: Free-run error of held-out records at the output level of the fitted data. It is None for fitted
    #: records, and if no means were subtracted. All other errors are computed at the level of the records
    #: themselves.
    strict: SeriesScore | None = None

    def as_dict(self, unit: str) -> dict[str, Any]:
        """Return the prediction errors as nested dictionaries for the parameter file."""
        free = {**self.free_run.as_dict(unit), "diverged": self.diverged}
        if self.strict is not None:
            free |= {"level_shift": self.level, "at_predicted_level": self.strict.as_dict(unit)}
        return {"one_step": self.one_step.as_dict(unit), "free_run": free}


def score_records(records: list[ArxRecord], model: ArxEstimate, poles: list[ArxPole]) -> Part:
    """Return the prediction errors of a model on a set of records, one step ahead and in a free run.

    Raises
    ------
    NoTrustworthyResult
        No record has more samples than the past samples that the model needs.
    """
    orders, theta = model.orders, model.theta
    longest = max((len(r) for r in records), default=0)
    if longest <= orders.lag:
        raise NoTrustworthyResult(
            f"the longest held-out part has {longest} samples; more than {orders.lag} are needed",
            hint="hold out a larger share, or validate on a longer log",
        )
    runs = [simulate(r, orders, theta) for r in records]
    measured = np.concatenate([r.output for r in records])
    one = compute_score(measured, np.concatenate([predict(r, orders, theta) for r in records]))
    free = compute_score(measured, np.concatenate(runs))
    stopped = False
    for record, run in zip(records, runs, strict=True):
        last = np.flatnonzero(np.isfinite(run))[-1:]
        stopped |= bool(len(last) and np.isfinite(record.source[last[0] + 1 :]).any())
    at_risk = any(pole.state != "stable" for pole in poles)
    return Part(records, one, free, bool(at_risk and (stopped or free.fit_percent < 0)))


@dataclass(frozen=True)
class Identified:
    """Identified ARX or ARMAX model with its data and its prediction errors."""

    options: RwlsOptions
    data: Data
    point: WorkingPoint
    fit: Part
    #: Held-out records with their prediction errors. The key is the name of the log or of its held-out part.
    held_out: Mapping[str, Part]
    estimate: ArxEstimate
    #: Poles of the model in the z plane, sorted by descending magnitude.
    poles: list[ArxPole]
    #: Orders that the order search tried, each with its Bayesian information criterion (BIC), lowest BIC
    #: first. It is empty if the user gave the orders.
    candidates: Sequence[tuple[Orders, float]]

    @property
    def kind(self) -> str:
        """Name of the model structure: ``ARX``, or ``ARMAX`` if the model has a noise polynomial C."""
        return "ARMAX" if self.estimate.orders.nc else "ARX"

    @property
    def assess_parts(self) -> dict[str, Part]:
        """Data sets whose free run the checks assess.

        These are the held-out data sets, or the fitted data if no data are held out.
        """
        return dict(self.held_out) or {"the fitted part": self.fit}

    @cached_property
    def residual_series(self) -> tuple[np.ndarray, np.ndarray, int]:
        """One-step residuals and input on the time grid of the fitted records, and number of lags to test."""
        data = self.estimate.data
        return data.on_grid(self.estimate.residuals), data.source, rt.default_lags(len(data))

    @cached_property
    def independent(self) -> rt.TestResult:
        """Result of the test that the one-step residuals are independent of past inputs."""
        residuals, source, lags = self.residual_series
        first, data = self.estimate.orders.nk, self.estimate.data
        past = rt.lag_matrix(source, range(first, first + lags))
        absorbed = rt.count_absorbed(data.on_grid(self.estimate.jacobian), past)
        return rt.independence(residuals, source, lags=lags, first=first, fitted=absorbed)

    @property
    def worse(self) -> list[str]:
        """Names of the held-out data whose free-run error is much larger than that of the fitted data.

        The limit of the ratio is :data:`swimid.fitting.fit_common.VALIDATION_RATIO`.
        """
        limit = VALIDATION_RATIO * self.fit.free_run.rmse
        return [name for name, part in self.held_out.items() if part.free_run.rmse > limit]

    @property
    def indeterminate(self) -> list[str]:
        """Names of the coefficients that the fitted data do not determine."""
        pairs = zip(self.estimate.orders.names, self.estimate.stderr, strict=True)
        return [name for name, stderr in pairs if not math.isfinite(stderr)]

    @property
    def critical_pole(self) -> ArxPole | None:
        """Pole that determines the stability of the model; None if the model has no pole.

        This is the largest unstable pole, else the largest integrating pole, else the largest stable pole.
        """
        states = ("unstable", "integrating", "stable")
        return min(self.poles, key=lambda pole: states.index(pole.state), default=None)


def identify(data: Data, options: RwlsOptions, progress: Progress) -> Identified:
    """Identify an ARX or ARMAX model: choose orders if none are given, fit, and compute prediction errors.

    Raises
    ------
    NoTrustworthyResult
        If the estimation fails; see :func:`swimid.blackbox.arx.fit_arx`.
    """
    candidates: list[tuple[Orders, float]] = []
    if options.na is None or options.nb is None:
        candidates = _search(data, options, progress)
        orders = replace(candidates[0][0], nc=options.nc)
    else:
        orders = Orders(options.na, options.nb, options.delay, options.nc)
    point = find_working_point(data.fit, orders, options.centre)
    how = options.model_dump(include={"weight", "forgetting", "prior_scale"})
    fitted = fit_arx(subtract_levels(data.fit, point), orders, **how)
    a, _, _ = orders.split(fitted.theta)
    poles = find_poles(a, fitted.covariance[: orders.na, : orders.na])
    held_out = {}
    for name, records in data.held_out.items():
        part = score_records(subtract_levels(records, point), fitted, poles)
        if point.removed:
            own, level = about_own_level(part.records, orders, fitted.theta)
            part = replace(score_records(own, fitted, poles), level=level, strict=part.free_run)
        held_out[name] = part
    fit = score_records(subtract_levels(data.fit, point), fitted, poles)
    return Identified(options, data, point, fit, held_out, fitted, poles, candidates)


def _search(data: Data, options: RwlsOptions, progress: Progress) -> list[tuple[Orders, float]]:
    """Search the grid of model orders that the options define, and rank the orders by BIC.

    BIC is the Bayesian information criterion. Warn if the best orders lie at the edge of the grid.
    """
    largest = options.max_order
    delays = range(options.max_nk + 1)
    if options.nk is not None:
        delays = range(options.delay, options.delay + 1)
    point = find_working_point(data.fit, Orders(largest, largest), options.centre)
    candidates = search_orders(subtract_levels(data.fit, point), largest, delays, progress=progress)
    best = candidates[0][0]
    edge = {name: "--max-order" for name in ("na", "nb") if getattr(best, name) == largest}
    if options.nk is None and best.nk == options.max_nk > 0:
        edge["nk"] = "--max-nk"
    if edge:
        flags = ", ".join(dict.fromkeys(edge.values()))
        warn(
            "SWM023",
            f"the order chosen ({best}) is the largest tried in {', '.join(edge)} (tried: na 0 to {largest}, "
            f"nb 1 to {largest}, nk {delays[0]} to {delays[-1]}): widen the grid with {flags}",
        )
    return candidates


def search_orders(
    records: Sequence[ArxRecord], largest: int, delays: range, *, progress: Progress = silent
) -> list[tuple[Orders, float]]:
    """Fit ARX models of all orders in a grid, and rank them by the Bayesian information criterion.

    The grid has na from 0 to ``largest``, nb from 1 to ``largest`` and nk in ``delays``.

    Returns
    -------
    list of (Orders, float)
        Orders and Bayesian information criterion (BIC) ``n ln(RSS / n) + p ln n``, lowest first. If criteria
        are equal, the model with fewer coefficients is first.

    Raises
    ------
    NoTrustworthyResult
        There are too few rows, or the output is constant.

    Notes
    -----
    All models are fitted to the same n rows, which are complete for the longest lags of the grid, so that the
    criteria can be compared. All fits use one QR decomposition, that of the regression with all lags.
    """
    widest = Orders(largest, delays[-1] + largest, 0)
    data = regression(records, widest)
    check_enough(data, widest)
    n = len(data)
    factor = np.asarray(np.linalg.qr(np.column_stack((data.rows, data.outputs)), mode="r"))
    # Set a lower limit for the sum of squared residuals (RSS), because noise-free data would otherwise favour
    # models with more coefficients.
    floor = max(n * (EXACT * float(np.std(data.outputs))) ** 2, float(np.finfo(float).tiny))
    grid = list(product(range(largest + 1), range(1, largest + 1), delays))
    found = []
    with progress("trying orders", total=len(grid)) as step:
        for na, nb, nk in grid:
            chosen = [*range(na), *range(largest + nk, largest + nk + nb)]
            theta = np.linalg.lstsq(factor[:, chosen], factor[:, -1], rcond=None)[0]
            rss = float(np.sum((factor[:, -1] - factor[:, chosen] @ theta) ** 2))
            bic = n * float(np.log(max(rss, floor) / n)) + float(np.log(n)) * (na + nb)
            found.append((Orders(na, nb, nk), bic))
            step()
    return sorted(found, key=lambda one: (one[1], one[0].count, one[0].nk))
