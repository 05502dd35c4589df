"""Result files with evidence of every kind, written for the report's tests."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from swimid.kinematics.logged import Logged
from swimid.logs import log
from swimid.results.evidence import (
    Check,
    Evidence,
    Figure,
    Image,
    Mark,
    NoticeRecord,
    Panel,
    Span,
    Table,
    Trace,
    Verdict,
)
from swimid.results.parameters import Correlation, Estimate, Fit, Fitted, ParameterFile, Pole

RNG_SEED = 20240611
GAUSS = "Gauss, C. F. (1809). Theoria motus corporum coelestium."


def provenance(command: str, inputs: list[str]) -> dict[str, Any]:
    """A block as every verb writes it."""
    return {
        "command": command,
        "version": "0.1.0",
        "created": "2026-03-02T10:15:00+00:00",
        "inputs": {name: f"{zlib.crc32(name.encode()):08x}" * 8 for name in inputs},
        "packages": {"python": "3.12.4", "numpy": "2.4.0", "scipy": "1.17.0"},
        "settings": {"method": "ml", "dt_s": 0.005, "bounds": {"drag_coefficient": [0.0, 5.0]}},
    }


def trace(x: Any, y: Any, label: str, style: Any = "line", **more: Any) -> Trace:
    return Trace(x=np.asarray(x, dtype=float), y=y, label=label, style=style, **more)


def panel(x_label: str, y_label: str, *traces: Trace, **more: Any) -> Panel:
    return Panel(x_label=x_label, y_label=y_label, traces=list(traces), **more)


def figure(name: str, title: str, caption: str, *panels: Panel) -> Figure:
    return Figure(id=name, title=title, caption=caption, panels=list(panels))


def check(name: str, value: str, limit: str, verdict: Any, text: str) -> Check:
    return Check(name=name, value=value, limit=limit, verdict=verdict, text=text)


# ---------------------------------------------------------------- figures of every kind


def fit_figure() -> Figure:
    """Measured points and modelled lines of several trials, sharing colours by group."""
    rng, traces = np.random.default_rng(RNG_SEED), []
    for index, (grams, speed) in enumerate([(10, 0.166), (20, 0.26), (30, 0.328), (40, 0.384)]):
        time = np.arange(0.0, 1.2 / speed, 0.02)
        x = speed * (time - 0.9 * (1 - np.exp(-time / 0.9)))
        noisy = x + rng.normal(0, 0.004, len(x))
        traces += [trace(time, noisy, f"{grams} g measured", "points", group=index)]
        traces += [trace(time, x, f"{grams} g model", group=index)]
    caption = "Points are encoder samples, lines the fitted model."
    return figure("fit", "Displacement", caption, panel("time (s)", "displacement (m)", *traces))


def residual_figure() -> Figure:
    """Two panels side by side: residuals with a gap, and their autocorrelation as stems."""
    rng, time = np.random.default_rng(RNG_SEED + 1), np.arange(0, 20, 0.01)
    residual = rng.normal(0, 0.0021, len(time))
    residual[600:700] = np.nan
    limits = [Mark(at=at, label="95 % of white noise") for at in (-0.044, 0.044)]
    stems = trace(np.arange(1, 26), rng.normal(0, 0.05, 25), "estimate", "stems")
    return figure(
        "residuals", "Residuals", "Left: residuals over time, gaps shaded. Right: their autocorrelation.",
        panel(
            "time (s)", "residual (m)", trace(time, residual, "residual", "points"), title="Over time",
            spans=[Span(start=6.0, end=7.0, label="gap")], marks=[Mark(at=0.0, label="zero")],
        ),
        panel("lag (samples)", "correlation", stems, title="Autocorrelation", marks=limits),
    )  # fmt: skip


def band_figure() -> Figure:
    """A speed with its uncertainty band, a measured table with error bars, and a dashed rival."""
    frequency, points = np.linspace(0.5, 5, 60), np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
    speed = 0.04 * frequency**1.1
    measured = 0.04 * points**1.1 * (1 + np.random.default_rng(RNG_SEED + 2).normal(0, 0.03, 6))
    traces = [
        trace(frequency, speed, "model", lower=speed * 0.93, upper=speed * 1.07, group=0),
        trace(points, measured, "measured", "points", y_error=measured * 0.05, group=1),
        trace(frequency, speed * 0.88, "without recoil", "dashed", group=2),
    ]
    caption = "Band: 95 % of the model's uncertainty; bars: one standard error of the measurement."
    return figure("speed", "Cruising speed", caption, panel("beat frequency (Hz)", "speed (m/s)", *traces))


def categories_figure() -> Figure:
    """Two series of points over named categories."""
    names = ["2025Rect", "2925Rect", "3825Rect", "forked tail <wide>"]
    error = np.array([0.0004, 0.001, 0.003, 0.002])
    traces = [
        trace(range(4), np.array([0.0029, 0.0191, 0.0485, 0.033]), "fit", "points", y_error=error),
        trace(range(4), np.array([0.0031, 0.018, 0.047, 0.036]), "validation", "points"),
    ]
    fins = panel("fin", "force (N)", *traces, x_categories=names)
    return figure("fins", "Propulsive force by fin", "Good: fit and validation agree.", fins)


def log_figure() -> Figure:
    """Logarithmic axes over several decades beside a narrow range in steps."""
    frequency, order = np.logspace(-1, 1.7, 400), np.arange(1.0, 9)
    power = (1 / np.hypot(1 - (frequency / 3) ** 2, 0.1 * frequency)) ** 2
    spectra = panel(
        "frequency (Hz)", "power spectral density of the surge speed (m²/s)",
        trace(frequency, power * 1e-5, "measured", group=0),
        trace(frequency, power * 0.9e-5, "model", "dashed", group=0), x_scale="log", y_scale="log",
    )  # fmt: skip
    steps = trace(order, -12000 - 400 * np.tanh(order / 2), "BIC", "step")
    chosen = panel("order", "BIC", steps, marks=[Mark(at=4.0, axis="x", label="chosen")])
    return figure("spectrum", "Spectra", "Good: the model follows the measurement.", spectra, chosen)


def track_figure() -> Figure:
    """A path to scale, in two parts."""
    s = np.linspace(0, 4 * np.pi, 900)
    x, y = 0.12 * s, 0.25 * np.sin(s) * np.exp(-0.05 * s)
    traces = [trace(x, y, "nose"), trace(x - 0.05, y * 0.9, "tail"), trace(x[:1], y[:1], "start", "points")]
    return figure("track", "Path", "To scale.", panel("x (m)", "y (m)", *traces, equal_aspect=True))


# ---------------------------------------------------------------- results


def estimate(
    value: float, stderr: float | None, unit: str, status: Any = "estimated", **more: Any
) -> Estimate:
    return Estimate(value=value, stderr=stderr, unit=unit, status=status, **more)


def drag(folder: Path, name: str = "drag.yaml", *, proof: bool = True) -> Path:
    """A falling-weight fit with full evidence."""
    block = provenance("swimid fit-drag trials.yaml -o drag.yaml", ["trials.yaml", "w10.csv", "w20.csv"])
    positive = {"bounds": (0.0, None)}
    file = ParameterFile(
        model="falling-weight",
        robot="boxfish",
        parameters={
            "drag_coefficient": estimate(
                0.70512, 0.0331, "1", bounds=(0.0, 5.0), meaning="drag coefficient C_d"
            ),
            "added_mass": estimate(0.6852, 0.0372, "kg", **positive),
            "pulley_friction": estimate(0.0308, 0.00101, "N", **positive),
            "linear_drag": estimate(0.0, None, "N s/m", "at-bound", **positive),
            "string_stiffness": estimate(187654.321, 9e9, "N/m", "unidentifiable", **positive),
            "pulley_inertia": estimate(4.512e-5, 1.2e-6, "kg m^2"),
            "water_density": estimate(997.0, None, "kg/m^3", "fixed"),
        },
        derived={"terminal_speed_m_s": estimate(0.1661, 0.0021, "m/s")},
        identifiability=["The trials determine drag and added mass; the string is too stiff to show."],
        correlation=Correlation(
            names=["drag_coefficient", "added_mass", "pulley_friction"],
            matrix=[[1.0, -0.42, 0.31], [-0.42, 1.0, -0.954], [0.31, -0.954, 1.0]],
        ),
        fit=Fit(
            trials=["w10", "w20", "w30"],
            channels={"x_m": {"rmse": 0.00213, "nrmse": 0.00185, "unit": "m"}},
            validation={
                "trials": ["w40"],
                "channels": {"x_m": {"rmse": 0.00291, "nrmse": 0.0026, "unit": "m"}},
            },
            converged=True,
            noise={"x_m": {"value_sd": 0.0021, "time_sd_s": 0.0, "autoregression": []}},
        ),
        provenance=block,
    )
    path = folder / name
    if proof:
        Fitted.of(file, drag_evidence(block)).save(path)
    else:
        file.write(path)
    return path


def drag_evidence(block: dict[str, Any]) -> Evidence:
    """The evidence of :func:`drag`."""
    text = "C_d = 0.705 ± 0.033, added mass 0.685 ± 0.037 kg; friction trades off against added mass."
    return Evidence(
        command="fit-drag",
        title="Drag and added mass of the boxfish",
        verdict=Verdict(level="caution", text=text),
        checks=[
            check("Converged", "yes, 14 steps", "yes", "pass", "The optimum was reached."),
            check("Strongest correlation", "0.954", "< 0.9", "warn", "Add a trial with a heavier weight."),
            check("Start-up samples", "3 %", "", "info", "Left in."),
        ],
        tables=[
            Table(
                id="methods",
                title="Likelihood and two-point method side by side",
                columns=["Parameter", "Maximum likelihood", "Two-point", "Difference"],
                rows=[["drag_coefficient", 0.70512, 0.698, "−1.0 %"], ["added_mass", 0.6852, None, "none"]],
                caption="Good: within two standard errors of each other.",
            )
        ],
        figures=[fit_figure(), residual_figure(), categories_figure()],
        notices=[NoticeRecord(code="SWM011", text="added_mass and pulley_friction correlate by -0.954")],
        methods=["Standard errors follow from the Fisher information at the optimum."],
        references=[GAUSS],
        provenance=block,
    )


def arma(folder: Path) -> Path:
    """A discrete-time model with an unstable pole: a bad verdict."""
    block = provenance("swimid rwls run.csv -o arma.yaml", ["run.csv"])
    channels = {"u_m_s": {"rmse": 0.004, "nrmse": 0.05, "unit": "m/s"}}
    file = ParameterFile(
        model="arx",
        parameters={"a1": estimate(-1.8123, 0.0042, "1"), "b1": estimate(3.1e-4, 2.2e-5, "m/s")},
        delay=1,
        sample_time_s=0.04,
        poles=[Pole(real=1.0013, imag=0.0, magnitude=1.0013, stderr_magnitude=0.0004)],
        stable=False,
        fit=Fit(trials=["run"], channels=channels, converged=True),
        provenance=block,
    )
    record = Evidence(
        command="rwls",
        title="ARX model of the long-fin vehicle",
        verdict=Verdict(level="bad", text="The model is unstable: a free run grows without end."),
        checks=[check("Largest pole", "1.0013 ± 0.0004", "< 1", "fail", "Unstable.")],
        figures=[log_figure(), band_figure()],
        methods=["An ARX model was fitted by recursive weighted least squares."],
        references=[GAUSS, "Ljung, L. (1999). System Identification."],
        notices=[NoticeRecord(code="SWM020", text="a pole lies at 1.0013")],
        provenance=block,
    )
    path = folder / "arma.yaml"
    Fitted.of(file, record).save(path)
    return path


def track(folder: Path, *, proof: bool = True, name: str = "run.csv") -> Path:
    """A tracked log with gaps; with overlay pictures where it has evidence."""
    time = np.arange(0, 42, 0.02)
    x = 0.04 * time + np.random.default_rng(RNG_SEED + 3).normal(0, 0.0005, len(time))
    y, yaw = 0.1 * np.sin(0.5 * time), 0.3 * np.sin(2 * np.pi * time)
    x[500:560], y[500:560], yaw[1500:1700] = np.nan, np.nan, np.nan
    path = folder / name
    log.write(path, {"t_s": time, "x_m": x, "y_m": y, "yaw_rad": yaw}, {"source": "pool.mp4"})
    if proof:
        picture = cv2.imencode(".png", np.full((180, 320, 3), 90, dtype=np.uint8))[1].tobytes()
        frame = {"id": "frame", "title": "Frame 1200", "caption": "Good: the cross sits on the marker."}
        record = Evidence(
            command="track video",
            title="Track of pool.mp4",
            verdict=Verdict(level="good", text="The marker was found in 2040 of 2100 frames."),
            checks=[check("Frames with markers", "97 %", "> 90 %", "pass", "Few are lost.")],
            figures=[track_figure()],
            images=[Image(media_type="image/png", base64=base64.b64encode(picture).decode(), **frame)],
            provenance=provenance("swimid track video pool.mp4 --setup setup.yaml -o run.csv", ["pool.mp4"]),
        )
        Logged("track video", evidence=record, document=log.read(path)).save(path)
    return path
