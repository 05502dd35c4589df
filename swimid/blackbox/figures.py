"""The figures of ``swimid rwls``, as data for the report."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swimid.blackbox import difference, prediction
from swimid.blackbox.difference import Record
from swimid.blackbox.identified import Identified
from swimid.blackbox.model import to_control
from swimid.blackbox.order import Candidate
from swimid.fitting import residual_tests as rt
from swimid.results import blocks, numbers
from swimid.results.evidence import Figure, Mark, Span, Trace, thinned
from swimid.results.parameters import ParameterFile


def figures(m: Identified, file: ParameterFile) -> list[Figure]:
    """Every figure, in the order of the report."""
    return [
        *_measured(m),
        _horizon(m),
        _trajectories(m),
        _residuals(m),
        _pole_map(m),
        _bode(m, file),
        _step(m, file),
        *_order_figure(m),
    ]


def _measured(m: Identified) -> list[Figure]:
    figures = []
    sets = dict(m.held_out) or {"fitted": m.fit}
    title = numbers.column_title(m.data.columns.output)
    for number, (name, records) in enumerate(sets.items(), start=1):
        time, measured, one, run = _joined(records, m, m.scores[name].level if name in m.scores else 0.0)

        def curve(y: np.ndarray, time: np.ndarray = time, **look: Any) -> Trace:
            x, shown = thinned(time, np.where(np.isfinite(y), y, np.nan))
            return Trace(x=x, y=shown, **look)

        one_step: dict[str, Any] = {"label": "one step ahead", "style": "dashed", "group": 1}
        free_run: dict[str, Any] = {"label": "free run", "group": 2}
        curves = [curve(measured, label="measured", group=0), curve(one, **one_step), curve(run, **free_run)]
        errors = [curve(measured - one, **one_step), curve(measured - run, **free_run)]
        figures.append(
            blocks.panels(
                f"free-run-{number}",
                f"Measured, predicted and simulated: {name}",
                "The free run sees the input only, after its first samples. A good model's free run stays on "
                "the measurement, and its error shows neither drift nor the beat.",
                [
                    blocks.panel("t (s)", title, curves, title=name),
                    blocks.panel("t (s)", f"error, {title}", errors, marks=[Mark(at=0.0)]),
                ],
                columns=1,
            )
        )
    return figures


def _joined(
    records: list[Record], m: Identified, shift: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, output, one-step prediction and free run of a set of records, with breaks between them."""
    parts: list[np.ndarray] = []
    end = 0.0
    for k, record in enumerate(records):
        one = prediction.predict(record, m.estimate.orders, m.estimate.theta)
        run = difference.simulate(record, m.estimate.orders, m.estimate.theta)
        late = k > 0 and record.time_s[0] < end
        time = record.time_s + (end + m.data.sample_time_s - record.time_s[0] if late else 0.0)
        if k:
            parts.append(np.array([[end], [np.nan], [np.nan], [np.nan]]))
        parts.append(np.array([time, record.output, one, run]))
        end = float(time[-1])
    time, *rest = np.hstack(parts)
    return (time, *(values + m.point.output + shift for values in rest))  # type: ignore[return-value]


def _horizon(m: Identified) -> Figure:
    traces = []
    for group, (name, s) in enumerate({"fitted": m.fit_scores, **m.scores}.items()):
        x, y = [h * m.data.sample_time_s for h, _ in s.horizons], [e for _, e in s.horizons]
        traces.append(Trace(x=x, y=y, label=name, group=group))
        traces.append(Trace(x=x, y=y, style="points", group=group))
    return blocks.figure(
        "horizon",
        "Error over the prediction horizon",
        "How fast a prediction loses the measurement it started from. A stable model levels off; an "
        "integrating one keeps growing.",
        "horizon (s)",
        m.data.columns.rmse_title,
        traces,
        x_scale="log",
    )


def _trajectories(m: Identified) -> Figure:
    run, data, orders = m.estimate.recursion, m.estimate.data, m.estimate.orders
    single = len(m.fit) == 1
    x = m.fit[0].time_s[data.sample[run.kept]] if single else run.kept.astype(float)
    scale = m.estimate.noise_sd * math.sqrt(m.options.weight)
    # The first rows only replace the prior; drawn, they would flatten everything else.
    settled = np.all(run.spreads <= 8 * run.spreads[-1], axis=1) & (run.kept >= 3 * orders.count)
    shown = slice(min(int(np.argmax(settled)), len(run.kept) // 2), None)
    panels = []
    for i, name in enumerate(orders.names):
        value, spread = run.thetas[shown, i], 1.96 * scale * run.spreads[shown, i]
        estimate = blocks.band(x[shown], value, spread, label="" if i else "estimate, 95 % band", group=0)
        final = Mark(at=float(m.estimate.theta[i]), label="" if i else "final")
        panels.append(blocks.panel("t (s)" if single else "row", name, [estimate], marks=[final]))
    return blocks.panels(
        "trajectories",
        "Parameters as the recursion proceeds",
        "A good run settles well before the end and stays inside its band. Steps late in the run mean that "
        "the robot, or its working point, changed. The band takes the residuals as white.",
        panels,
    )


def _residuals(m: Identified) -> Figure:
    residuals, source, lags = m.residual_series
    own = rt.autocorrelation(residuals, max_lag=lags)
    cross = rt.cross_correlation(residuals, source, max_lag=lags)
    return blocks.panels(
        "residuals",
        "What the one-step residuals still hold",
        "Autocorrelation, and correlation with the input at earlier (positive) and later (negative lag) "
        "samples. Good: 19 of 20 bars inside the band. Bars outside at positive lags: orders or delay are "
        "wrong. At negative lags: the input reacts to the output.",
        [
            blocks.correlogram(own, "autocorrelation", "residuals", skip_zero=True),
            blocks.correlogram(cross, "correlation with the input", "residuals", skip_zero=False),
        ],
    )


def _pole_map(m: Identified) -> Figure:
    angle = np.linspace(0, 2 * np.pi, 181)
    _, b, _ = m.estimate.orders.split(m.estimate.theta)
    zeros = np.roots(b) if len(b) > 1 and np.any(b != 0) else np.empty(0)
    near = zeros[np.abs(zeros) <= 3]
    traces = [
        Trace(x=np.cos(angle), y=np.sin(angle), label="unit circle", style="dashed", group=1),
        blocks.points(m.poles, lambda p: p.value.real, lambda p: p.value.imag, label="poles", group=0),
    ]
    if len(near):
        traces.append(Trace(x=near.real, y=near.imag, label="zeros", style="points", group=2))
    left_out = f" {len(zeros) - len(near)} zeros lie beyond |z| = 3." if len(near) < len(zeros) else ""
    return blocks.figure(
        "poles-map",
        "Poles and zeros in the z plane",
        "Good: every pole inside the circle by more than twice its uncertainty. A pole on top of a zero says "
        f"that the order is too high.{left_out}",
        "real part",
        "imaginary part",
        traces,
        equal_aspect=True,
    )


def _bode(m: Identified, file: ParameterFile) -> Figure:
    import control

    system = to_control(file)
    nyquist = np.pi / m.data.sample_time_s
    rows = len(m.estimate.data)
    omega = np.geomspace(max(4 * nyquist / rows, 1e-4 * nyquist), nyquist * 0.999, 300)
    response = control.frequency_response(system, omega)
    gain = np.atleast_1d(np.squeeze(np.abs(response.complex)))
    phase = np.unwrap(np.atleast_1d(np.squeeze(np.angle(response.complex))))
    log_gain, phase_sd = prediction.response_spread(
        m.estimate.orders, m.estimate.theta, m.estimate.covariance, m.data.sample_time_s, omega
    )
    hertz = omega / (2 * np.pi)
    factor, half = np.exp(np.clip(1.96 * log_gain, 0, 20)), 1.96 * np.minimum(phase_sd, np.pi)
    low, high = np.degrees(phase - half), np.degrees(phase + half)
    axis: dict[str, Any] = {"x_scale": "log", "spans": _excited(m)}
    gains = Trace(x=hertz, y=gain, lower=gain / factor, upper=gain * factor, label="model", group=0)
    phases = Trace(x=hertz, y=np.degrees(phase), lower=low, upper=high, group=0)
    gain_title = f"gain ({m.data.columns.gain_title})"
    return blocks.panels(
        "bode",
        "Frequency response",
        "Gain and phase of B / A with 95 % bands. Only where the input has power (shaded) do the data speak; "
        "elsewhere the curve is an extrapolation.",
        [
            blocks.panel("frequency (Hz)", gain_title, [gains], y_scale="log", **axis),
            blocks.panel("frequency (Hz)", "phase (deg)", [phases], **axis),
        ],
        columns=1,
    )


def _excited(m: Identified) -> list[Span]:
    """The band that holds the central 90 % of the input's power."""
    longest = max(m.fit, key=len)
    u = np.nan_to_num(longest.source - np.nanmean(longest.source))
    power = np.abs(np.fft.rfft(u * np.hanning(len(u)))) ** 2
    total = np.cumsum(power)
    if len(power) < 8 or total[-1] <= 0:
        return []
    hertz = np.fft.rfftfreq(len(u), m.data.sample_time_s)
    low, high = (hertz[int(np.searchsorted(total, q * total[-1]))] for q in (0.05, 0.95))
    step = hertz[1]
    return [
        Span(start=max(float(low), float(step)), end=float(high + step), label="90 % of the input's power")
    ]


def _step(m: Identified, file: ParameterFile) -> Figure:
    import control

    inside = [p.magnitude for p in m.poles if p.magnitude < difference.INTEGRATING]
    slowest = max(inside, default=0.5)
    count = (
        60 if any(p.unstable for p in m.poles) else int(np.clip(5 / -math.log(max(slowest, 0.1)), 30, 1000))
    )
    time = np.arange(count + 1) * m.data.sample_time_s
    answer = control.step_response(to_control(file), time)
    return blocks.figure(
        "step",
        "Step response",
        "The output after the input steps from 0 to 1. A stable model settles at its static gain; an "
        "integrating one climbs on, an unstable one runs away.",
        "t (s)",
        f"output ({m.data.columns.gain_title})",
        [Trace(x=time, y=np.atleast_1d(np.squeeze(answer.outputs)), style="step", group=0)],
    )


def _order_figure(m: Identified) -> list[Figure]:
    if not m.candidates:
        return []
    sizes: dict[int, list[Candidate]] = {}
    for c in sorted(m.candidates, key=lambda c: c.orders.count):
        sizes.setdefault(c.orders.count, []).append(c)
    x = [float(size) for size in sizes]

    def criterion(name: str, **look: Any) -> Trace:
        least = [min(float(getattr(c, name)) for c in same) for same in sizes.values()]
        return Trace(x=x, y=[value - min(least) for value in least], label=name.upper(), **look)

    fits = [max(float(c.free_run_fit) for c in same) for same in sizes.values()]
    chosen = Mark(at=float(m.estimate.orders.na + m.estimate.orders.nb), axis="x", label="chosen")
    where = "held-out data" if m.scores else "the fitted data"
    criteria = [criterion("bic", group=0), criterion("aic", style="dashed", group=1)]
    gained = f"free-run fit on {where} (%)"
    return [
        blocks.panels(
            "order-choice",
            "Choice of the order",
            "The best model of each size. The criteria fall while parameters earn their place and rise "
            "after; where the free run stops gaining, more parameters only describe noise.",
            [
                blocks.panel("parameters", "criterion above its least", criteria, marks=[chosen]),
                blocks.panel("parameters", gained, [Trace(x=x, y=fits, group=0)], marks=[chosen]),
            ],
        )
    ]
