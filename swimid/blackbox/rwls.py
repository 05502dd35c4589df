"""``swimid rwls``: a discrete-time model from input and output columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.blackbox import difference, prediction, working_point
from swimid.blackbox import evidence as rwls_evidence
from swimid.blackbox import order as order_search
from swimid.blackbox.arx import estimate, regression
from swimid.blackbox.difference import Orders
from swimid.blackbox.identified import Identified
from swimid.blackbox.model import NAME
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.prediction import Scores
from swimid.blackbox.trials import Data, read
from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers, parameters
from swimid.results.fitted import Fitted

#: Rows of the trajectory kept when no stride is given.
KEPT = 1000
#: A scaled regression above this condition number is worth a warning.
ILL_CONDITIONED = 1e6


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
    :func:`swimid.blackbox.working_point.centre` for the means. Where the one-step residuals are not white
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
        m = _identified(data, options, progress)
        _warn(m)
    settings = _settings(m)
    block = provenance.collect(
        data.files, settings={**settings, "validate": [_name(v) for v in options.held_out]}
    )
    file = _parameter_file(m, settings, block)
    shown = rwls_evidence.build(m, file, notices=blocks.notices(notices))
    result = file.model_dump(mode="python")
    result["orders_tried"] = [c.as_dict() for c in m.candidates]
    answer = f"{shown.verdict.level.upper()}: {shown.verdict.text}"
    return Fitted("rwls", f"{_summary(m, file)}\n\n{answer}", result, evidence=shown, document=file).saved(
        output
    )


# ---------------------------------------------------------------- computing


def _identified(data: Data, options: RwlsOptions, progress: Progress) -> Identified:
    orders = Orders(options.na or 0, options.nb or 1, options.nk, options.nc)
    candidates: list[order_search.Candidate] = []
    if options.order == "auto":
        orders, candidates = _choose(data, orders, options, progress)
    point = working_point.centre(data.fit, orders, options.centre)
    fit = working_point.shifted(data.fit, point)
    held = {name: working_point.shifted(part, point) for name, part in data.held_out.items()}
    fitted = estimate(
        fit,
        orders,
        weight=options.weight,
        forgetting=options.forgetting,
        prior_scale=options.prior_scale,
        stride=options.stride or max(1, -(-len(regression(fit, orders)) // KEPT)),
    )
    a, _, _ = orders.split(fitted.theta)
    poles = difference.poles(a, fitted.covariance[: orders.na, : orders.na], data.sample_time_s)
    fit_scores = prediction.scores(fit, fitted, poles, options.horizon)
    scores: dict[str, Scores] = {}
    for name, part in held.items():
        if point.removed:
            held[name], scores[name] = prediction.scores_about_own_level(part, fitted, poles, options.horizon)
        else:
            scores[name] = prediction.scores(part, fitted, poles, options.horizon)
    return Identified(options, data, point, fit, held, fitted, poles, fit_scores, scores, candidates)


def _choose(
    data: Data, orders: Orders, options: RwlsOptions, progress: Progress
) -> tuple[Orders, list[order_search.Candidate]]:
    grid = {"max_na": options.max_na, "max_nb": options.max_nb, "max_nk": options.max_nk}
    point = working_point.centre(data.fit, Orders(options.max_na, options.max_nb, 1), options.centre)
    fit = working_point.shifted(data.fit, point)
    held = [working_point.shifted(part, point) for part in data.held_out.values()]
    candidates = order_search.search(fit, held, **grid, level_removed=point.removed, progress=progress)
    best = order_search.best(candidates, options.criterion).orders
    edge = order_search.on_edge(best, **grid)
    if edge:
        flags = ", ".join(f"--max-{name}" for name in edge)
        warn(
            "SWM023",
            f"the order chosen ({best}) is the largest tried in {', '.join(edge)} (tried: na 0 to "
            f"{options.max_na}, nb 1 to {options.max_nb}, nk 0 to {options.max_nk}): widen the grid with "
            f"{flags}",
        )
    if options.criterion == "free-run" and held:
        warn(
            "SWM023",
            "the order was chosen on the held-out data, which therefore no longer judge the model "
            "independently",
        )
    return replace(best, nc=orders.nc), candidates


def _name(held_out: Any) -> str:
    """What held-out data are called: a share, a file, or a log in memory."""
    plain = isinstance(held_out, str | int | float | Path)
    return str(held_out if plain else getattr(held_out, "name", "log"))


def _settings(m: Identified) -> dict[str, Any]:
    """The options as the file records them, with the orders, columns and levels they led to."""
    settings: dict[str, Any] = {
        "orders": asdict(m.estimate.orders),
        "order": m.options.order if m.options.order == "given" else f"auto, {m.options.criterion}",
        "input": m.data.columns.source,
        "output": m.data.columns.output,
        "output_unit": m.data.columns.units[1],
        "weight": m.options.weight,
        "forgetting": m.options.forgetting,
        "prior_scale": m.options.prior_scale,
        "centre": m.options.centre,
        "input_level": m.point.source,
        "output_level": m.point.output,
        "horizon": m.options.horizon,
    }
    if m.data.columns.sine:
        names = ("amplitude", "frequency_hz", "phase_rad")
        settings["input_model"] = {"kind": "sine", **dict(zip(names, m.data.columns.sine, strict=True))}
    return settings


# ---------------------------------------------------------------- telling


def _warn(m: Identified) -> None:
    fitted, data, point = m.estimate, m.data, m.point
    orders, unit = fitted.orders, data.columns.units[1]
    lost = fitted.data.possible - len(fitted.data)
    restarts = int(np.count_nonzero(fitted.data.fresh)) - len(data.logs)
    if lost or restarts > 0:
        warn(
            "SWM001",
            f"{lost} of {fitted.data.possible} regression rows left out around missing samples, and the "
            f"regression restarted {max(restarts, 0)} times at gaps; no value was filled in",
        )
    if point.removed:
        text = (
            f"working point removed: {data.columns.source} {point.source:.6g}, {data.columns.output} "
            f"{point.output:.6g} (means of the fitted part; constant term t = {point.t:.1f}); the model "
            "describes deviations from it"
        )
        moved = [f"{name} by {s.level:.3g}" for name, s in m.scores.items() if abs(s.level) > s.free_run.rmse]
        if moved:
            suffix = f" {unit}" if unit != "1" else ""
            text += f". Held-out data sit at another level: {', '.join(moved)}{suffix}"
        warn("SWM021", text)
    undetermined = [n for n, ok in zip(orders.names, fitted.determined.determined, strict=True) if not ok]
    if undetermined:
        warn(
            "SWM010",
            f"the data do not determine {', '.join(undetermined)}; their values are arbitrary in part",
        )
    rank = fitted.determined.input_rank
    source = np.concatenate([record.source for record in data.fit])
    if np.ptp(source[np.isfinite(source)]) == 0:
        warn("SWM022", "the input is constant: B is an offset of the output and says nothing of the input")
    elif rank < orders.nb:
        why = "; a single sine excites two" if rank == 2 else ""
        warn("SWM022", f"the input excites {rank} of the {orders.nb} coefficients of B{why}")
    elif fitted.determined.condition > ILL_CONDITIONED:
        warn(
            "SWM022",
            f"the regression is ill-conditioned (condition number {fitted.determined.condition:.1e}): the "
            "orders are higher than the excitation supports",
        )
    if fitted.recursion.windup:
        warn(
            "SWM022",
            f"with forgetting, P grew without limit in directions the input does not excite; it was held at "
            f"{fitted.recursion.windup} of {len(fitted.data)} samples",
        )
    if fitted.robust:
        cure = "raise the orders" if orders.nc else "raise the orders or model the noise with --nc"
        warn(
            "SWM013",
            f"one-step residuals are not white (Ljung-Box p = {fitted.whiteness.p_value:.2g}): ARX "
            "coefficients are then biased, and the standard errors (a sandwich for correlated residuals) do "
            f"not cover that bias; {cure}",
        )
    _warn_stability(m)
    suffix = "" if unit == "1" else f" {unit}"
    for name in m.worse:
        warn(
            "SWM015",
            f"the free-run error is {m.scores[name].free_run.rmse:.3g}{suffix} on {name}, "
            f"{m.fit_scores.free_run.rmse:.3g}{suffix} on the fitted part",
        )


def _warn_stability(m: Identified) -> None:
    if m.stability == "stable":
        return
    diverged = [n for n, s in {"the fitted part": m.fit_scores, **m.scores}.items() if s.diverged]
    tail = f"; its free run diverges on {', '.join(diverged)}" if diverged else ""
    pole = next(p for p in m.poles if p.state == m.stability)
    size = f"|z| = {numbers.measured(pole.magnitude, pole.stderr)}"
    kind = " (not to be told from an integrator)" if pole.integrating else ""
    if pole.unstable:
        text = f"is UNSTABLE{kind}: {size}; judge it by its prediction, do not simulate far{tail}"
    else:
        text = f"integrates: {size} cannot be told from 1; a free run drifts{tail}"
    warn("SWM020", f"the model {text}")


def _parameter_file(
    m: Identified, settings: dict[str, Any], block: dict[str, Any]
) -> parameters.ParameterFile:
    fitted, data, horizon = m.estimate, m.data, m.options.horizon
    orders = fitted.orders
    unit, channel = data.columns.units[1], data.columns.output
    estimates, identifiable = {}, []
    for name, value, stderr in zip(orders.names, fitted.theta, fitted.stderr, strict=True):
        known = math.isfinite(stderr)
        estimates[name] = parameters.Estimate(
            value=float(value),
            stderr=float(stderr) if known else None,
            unit=data.columns.gain_unit if name.startswith("b") else "1",
            status="estimated" if known else "unidentifiable",
        )
        if known:
            identifiable.append(name)
    validation: dict[str, Any] = {}
    if m.scores:
        together = prediction.pooled([r for part in m.held_out.values() for r in part], fitted)
        by_set = {name: s.as_dict(unit, horizon) for name, s in m.scores.items()}
        validation[channel] = {**together.as_dict(unit), "data": by_set}
    words = []
    if len(identifiable) < orders.count:
        words.append(
            f"the data span {fitted.determined.rank} of {orders.na + orders.nb} directions; only "
            f"combinations of {', '.join(n for n in orders.names if n not in identifiable)} are determined"
        )
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
                "white": m.estimate.whiteness.passed,
                "white_p": m.estimate.whiteness.p_value,
                "input_independent": m.independent.passed,
                "input_independent_p": m.independent.p_value,
                "standard_errors": "sandwich" if fitted.robust else "sigma^2 (H'H)^-1",
            },
            rows=len(fitted.data),  # type: ignore[call-arg]
            rows_left_out=fitted.data.possible - len(fitted.data),  # type: ignore[call-arg]
            condition=fitted.determined.condition,  # type: ignore[call-arg]
            input_excites=fitted.determined.input_rank,  # type: ignore[call-arg]
            # deviations from the input's level; beyond them the model is extrapolated
            input_range=_input_range(data, float(settings.get("input_level", 0.0))),  # type: ignore[call-arg]
            stability=m.stability,  # type: ignore[call-arg]
            integrating=any(p.integrating for p in m.poles),  # type: ignore[call-arg]
            recursion_end=dict(zip(orders.names, fitted.recursion.theta.tolist(), strict=True)),  # type: ignore[call-arg]
        ),
        provenance=block,
    )


def _input_range(data: Data, level: float) -> list[float]:
    """Least and largest deviation of the input from its level in the fitted logs."""
    values = np.concatenate([record.source for record in data.fit]) - level
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def _summary(m: Identified, file: parameters.ParameterFile) -> str:
    fitted, data = m.estimate, m.data
    lines = [
        f"{m.kind} {fitted.orders}: {data.columns.source} -> {data.columns.output}, "
        f"{len(fitted.data)} rows every {data.sample_time_s:.6g} s",
        "",
    ]
    for name, e in file.parameters.items():
        remark = "" if e.status == "estimated" else f"   {e.status}"
        lines.append(f"  {name:<4} {numbers.measured(e.value, e.stderr, e.unit)}{remark}")
    lines += ["", f"  {'fit %':<28}{'one step':>10}{f'{m.options.horizon} steps':>10}{'free run':>10}"]
    for name, s in {"fitted": m.fit_scores, **m.scores}.items():
        cells = "".join(f"{_percent(x.fit_percent):>10}" for x in (s.one_step, s.k_step, s.free_run))
        extra = f"   ({_percent(s.strict.fit_percent)} at the predicted level)" if s.strict else ""
        lines.append(f"  {name:<28}{cells}{extra}{'   DIVERGES' if s.diverged else ''}")
    state, poles = m.stability, m.poles
    largest = f", largest pole |z| = {numbers.measured(poles[0].magnitude, poles[0].stderr)}" if poles else ""
    lines += ["", f"  {state.upper() if state == 'unstable' else state}{largest}"]
    return "\n".join(lines)


def _percent(value: float) -> str:
    return numbers.NOTHING if not math.isfinite(value) else f"{value:.1f}"
