"""The verdict, checks, tables and text of ``swimid rwls``, as data for the report."""

from __future__ import annotations

import math

import numpy as np

from swimid.blackbox import figures as rwls_figures
from swimid.blackbox.identified import WORSE, Identified
from swimid.results import blocks, numbers
from swimid.results.evidence import Check, Evidence, NoticeRecord, Table, Verdict
from swimid.results.parameters import ParameterFile

PAPER = (
    "L. Shang, S. Wang, M. Tan, L. Cheng: Swimming locomotion modeling for biomimetic underwater vehicle "
    "with two undulating long-fins. Robotica 30 (2012) 913-923. doi:10.1017/S0263574711001159"
)
BIERMAN = "G. J. Bierman: Factorization Methods for Discrete Sequential Estimation. Academic Press, 1977."
LJUNG_BOX = (
    "G. M. Ljung, G. E. P. Box: On a measure of lack of fit in time series models. Biometrika 65 (1978) "
    "297-303. doi:10.1093/biomet/65.2.297"
)

#: Fit of the free run below which a model does not reproduce half of the output, %.
HALF_PERCENT = 50.0


def build(m: Identified, file: ParameterFile, *, notices: list[NoticeRecord]) -> Evidence:
    """Assemble the evidence."""
    return Evidence(
        verb="rwls",
        title=f"{m.kind} model, {m.data.columns.source} to {m.data.columns.output}",
        verdict=_verdict(m),
        checks=_checks(m),
        tables=[_errors(m), _poles(m), *_orders(m)],
        figures=rwls_figures.figures(m, file),
        notices=notices,
        methods=_methods(m),
        references=[PAPER, BIERMAN, LJUNG_BOX],
        provenance=file.provenance,
    )


def _verdict(m: Identified) -> Verdict:
    """Grade the model by its free run on held-out data; only held-out data can make it good."""
    if m.stability == "unstable" or m.diverged:
        text = "The model is unstable or its free run diverges: it predicts, but it cannot be simulated."
        return Verdict(level="bad", text=text)
    tested = m.scores or {"fitted": m.fit_scores}
    least = min(s.free_run.fit_percent for s in tested.values())
    where = "held-out" if m.scores else "fitted"
    if least < 0:
        text = f"On {where} data the free run is worse than the mean of the output ({least:.1f} % fit)."
        return Verdict(level="bad", text=text)
    reasons = []
    if not m.scores:
        reasons.append("no held-out data were tested (--validate)")
    if least < HALF_PERCENT:
        reasons.append("the model leaves most of the output unexplained")
    if m.worse:
        reasons.append(f"its error on {' and '.join(m.worse)} is more than {WORSE:g} times that of the fit")
    reasons += m.data.repeats
    if m.stability == "integrating":
        reasons.append("it integrates, so a free run drifts")
    if not m.estimate.whiteness.passed:
        reasons.append("its residuals are not white, so the coefficients are biased")
    if not np.isfinite(m.estimate.stderr).all():
        reasons.append("the data do not determine every coefficient")
    tail = f"; but {', and '.join(reasons)}" if reasons else ""
    return Verdict(
        level="caution" if reasons else "good",
        text=f"The free run reproduces {least:.1f} % of the {where} output{tail}.",
    )


def _checks(m: Identified) -> list[Check]:
    checks = []
    if m.poles:
        largest = m.poles[0]
        checks.append(
            blocks.check(
                "largest pole",
                f"|z| = {numbers.measured(largest.magnitude, largest.stderr)}",
                "below 1",
                largest.state == "stable",
                otherwise="fail" if largest.unstable else "warn",
                text=largest.state,
            )
        )
    for name, s in m.scores.items():
        fit, useless = s.free_run.fit_percent, s.diverged or s.free_run.fit_percent < 0
        checks.append(
            blocks.check(
                f"free run, {name}",
                "diverges" if s.diverged else f"{fit:.1f} % fit",
                f"at least {HALF_PERCENT:g} %, and an error below {WORSE:g} times that of the fit",
                fit >= HALF_PERCENT and name not in m.worse and not s.diverged,
                otherwise="fail" if useless else "warn",
            )
        )
    white, independent, known = m.estimate.whiteness, m.independent, m.estimate.determined
    rounding = "residuals at rounding level: nothing to test" if m.estimate.exact else ""
    lost = m.estimate.data.possible - len(m.estimate.data)
    repeated = Check(name="repeated samples", value="; ".join(m.data.repeats), verdict="warn")
    return [
        *checks,
        *([repeated] if m.data.repeats else []),
        blocks.check(
            "residuals white (Ljung-Box)", _p(white.p_value), "p ≥ 0.01", white.passed, text=rounding
        ),
        blocks.check(
            "residuals independent of the input",
            _p(independent.p_value),
            "p ≥ 0.01",
            independent.passed or m.estimate.exact,
        ),
        blocks.check(
            "input excites B",
            f"{known.input_rank} of {m.estimate.orders.nb}",
            "all",
            known.input_rank >= m.estimate.orders.nb,
            text=f"condition number of the regression {known.condition:.2g}",
        ),
        Check(
            name="rows used",
            value=f"{len(m.estimate.data)} of {m.estimate.data.possible}",
            verdict="warn" if lost > 0.2 * m.estimate.data.possible else "info",
        ),
    ]


def _p(value: float) -> str:
    return f"p = {numbers.number(value, 2)}"


def _errors(m: Identified) -> Table:
    rows: list[dict[str, blocks.Cell]] = []
    for name, s in {"fitted": m.fit_scores, **m.scores}.items():
        lines = {"one step": s.one_step, f"{m.options.horizon} steps": s.k_step, "free run": s.free_run}
        if s.strict is not None:
            lines["free run, predicted level"] = s.strict
        for kind, q in lines.items():
            rows.append(
                {
                    "data": name,
                    "prediction": kind,
                    "fit (%)": _finite(q.fit_percent),
                    m.data.columns.rmse_title: _finite(q.rmse),
                    "NRMSE (of the range)": numbers.percent(q.nrmse),
                    "samples": q.samples,
                }
            )
    caption = (
        "A simulation model must be judged by its free run: one-step errors are small for almost any model."
    )
    if m.point.removed:
        caption += (
            " The working point was removed: held-out data are judged about a level of their own, and "
            "the free run beside it at the level the fitted part predicts."
        )
    return blocks.table("errors", "Errors on fitted and held-out data", rows, caption)


def _poles(m: Identified) -> Table:
    columns = ["z", "|z|", "natural frequency (Hz)", "damping ratio", "verdict"]
    rows = [
        (
            _complex(p.value),
            numbers.measured(p.magnitude, p.stderr),
            _finite(p.frequency_hz),
            _finite(p.damping_ratio),
            p.state,
        )
        for p in m.poles
    ]
    caption = "Standard errors by the delta method from the covariance of a1, a2, ..."
    named = [dict(zip(columns, row, strict=True)) for row in rows]
    return blocks.table("modes", "What the poles mean in time", named, caption, columns)


def _complex(z: complex) -> str:
    if abs(z.imag) < 1e-12:
        return numbers.number(z.real)
    return f"{numbers.number(z.real)} {'+' if z.imag > 0 else '−'} {numbers.number(abs(z.imag))}i"


def _orders(m: Identified) -> list[Table]:
    if not m.candidates:
        return []
    ranked = sorted(m.candidates, key=lambda c: c.score(m.options.criterion))[:12]
    aic, bic = (min(getattr(c, name) for c in m.candidates) for name in ("aic", "bic"))
    where = "held-out data" if m.scores else "the fitted data"
    rows: list[dict[str, blocks.Cell]] = [
        {
            "na": c.orders.na,
            "nb": c.orders.nb,
            "nk": c.orders.nk,
            "AIC above least": round(_finite(c.aic - aic) or 0.0, 1),
            "BIC above least": round(_finite(c.bic - bic) or 0.0, 1),
            f"free-run fit on {where} (%)": _finite(c.free_run_fit),
            "stable": c.stable,
        }
        for c in ranked
    ]
    caption = (
        f"The best {len(rows)} of {len(m.candidates)} by {m.options.criterion}; all fitted on the same rows."
    )
    return [blocks.table("orders", "Orders tried", rows, caption)]


def _methods(m: Identified) -> list[str]:
    o = m.estimate.orders
    text = [
        f"An {m.kind} model with {o} from {m.data.columns.source} to {m.data.columns.output} (sample time "
        f"{m.data.sample_time_s:.6g} s) was identified from {len(m.estimate.data)} samples by recursive "
        "weighted least squares (Shang et al. 2012, Eq 9) in UD factors (Bierman 1977), with weight "
        f"{m.options.weight:g}, P(0) = ({m.options.prior_scale:g})² I and zero initial parameters."
    ]
    decay = f"Old samples were discounted exponentially with the factor {m.options.forgetting:g} per sample."
    gauss = "From the extended recursion's result the one-step error was minimised by Gauss-Newton steps."
    if m.options.forgetting < 1:
        text.append(decay)
    elif m.options.weight != 1:
        text.append("The weight is constant, so that it rescales P(0) and discounts nothing.")
    if o.nc:
        text.append(gauss)
    if m.point.removed:
        text.append("The means of the fitted part were removed from input and output first.")
    sandwich, plain = "of the sandwich form for correlated", "those of least squares with white"
    text.append(
        f"Standard errors are {sandwich if m.estimate.robust else plain} residuals. Residual whiteness was "
        "tested after Ljung and Box (1978)."
    )
    return text


def _finite(value: float) -> float | None:
    value = float(value)
    return value if math.isfinite(value) else None
