"""Result files with evidence of every kind, written for the report's tests."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from typing import Any

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


def png(width: int = 320, height: int = 180) -> str:
    """A small picture, base64: a water-like gradient with a bright spot."""
    y, x = np.mgrid[0:height, 0:width]
    spot = np.exp(-((x - 0.6 * width) ** 2 + (y - 0.45 * height) ** 2) / 300.0)
    rgb = np.stack([40 + 200 * spot, 90 + 0.2 * x + 90 * spot, 120 + 0.3 * y], axis=-1).clip(0, 255)
    rows = b"".join(b"\x00" + row.astype(np.uint8).tobytes() for row in rgb)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    raw = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    return base64.b64encode(raw).decode()


# ---------------------------------------------------------------- figures of every kind


def fit_figure() -> Figure:
    """Measured points and modelled lines of several trials, sharing colours by group."""
    rng = np.random.default_rng(RNG_SEED)
    traces = []
    for index, (grams, speed) in enumerate([(10, 0.166), (20, 0.26), (30, 0.328), (40, 0.384)]):
        time = np.arange(0.0, 1.2 / speed, 0.02)
        x = speed * (time - 0.9 * (1 - np.exp(-time / 0.9)))
        noisy = x + rng.normal(0, 0.004, len(x))
        traces += [
            Trace(x=time, y=noisy, label=f"{grams} g measured", style="points", group=index),
            Trace(x=time, y=x, label=f"{grams} g model", group=index),
        ]
    return Figure(
        id="fit",
        title="Displacement, measured and modelled",
        caption="Points are encoder samples, lines the fitted model. Good: the line runs through the points "
        "of every weight, at the start and at terminal speed alike.",
        panels=[Panel(x_label="time (s)", y_label="displacement (m)", traces=traces)],
    )


def residual_figure() -> Figure:
    """Two panels side by side: residuals with a gap, and their autocorrelation as stems."""
    rng = np.random.default_rng(RNG_SEED + 1)
    time = np.arange(0, 20, 0.01)
    residual = rng.normal(0, 0.0021, len(time))
    residual[600:700] = np.nan
    lags = np.arange(1, 26)
    return Figure(
        id="residuals",
        title="Residuals",
        caption="Left: residuals over time, gaps shaded. Right: their autocorrelation with the 95 % band of "
        "white noise. Good: no trend on the left, and 95 % of the stems inside the band.",
        panels=[
            Panel(
                title="Over time",
                x_label="time (s)",
                y_label="residual (m)",
                traces=[Trace(x=time, y=residual, style="points", label="residual")],
                spans=[Span(start=6.0, end=7.0, label="gap")],
                marks=[Mark(at=0.0, label="zero")],
            ),
            Panel(
                title="Autocorrelation",
                x_label="lag (samples)",
                y_label="correlation",
                traces=[Trace(x=lags, y=rng.normal(0, 0.05, 25), style="stems", label="estimate")],
                marks=[
                    Mark(at=-0.044, label="95 % of white noise"),
                    Mark(at=0.044, label="95 % of white noise"),
                ],
            ),
        ],
    )


def band_figure() -> Figure:
    """A speed with its uncertainty band, a measured table with error bars, and a dashed rival."""
    frequency = np.linspace(0.5, 5, 60)
    speed = 0.04 * frequency**1.1
    rng = np.random.default_rng(RNG_SEED + 2)
    points = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0])
    measured = 0.04 * points**1.1 * (1 + rng.normal(0, 0.03, 6))
    return Figure(
        id="speed",
        title="Cruising speed over frequency",
        caption="Band: 95 % of the model's uncertainty; bars: one standard error of the measurement. "
        "Good: the band covers the points.",
        panels=[
            Panel(
                x_label="beat frequency (Hz)",
                y_label="speed (m/s)",
                traces=[
                    Trace(
                        x=frequency, y=speed, lower=speed * 0.93, upper=speed * 1.07, label="model", group=0
                    ),
                    Trace(
                        x=points,
                        y=measured,
                        y_error=measured * 0.05,
                        style="points",
                        label="measured",
                        group=1,
                    ),
                    Trace(x=frequency, y=speed * 0.88, style="dashed", label="without recoil", group=2),
                ],
            )
        ],
    )


def categories_figure() -> Figure:
    """Two series of points over named categories."""
    names = ["2025Rect", "2925Rect", "3825Rect", "forked tail <wide>"]
    return Figure(
        id="fins",
        title="Propulsive force by fin",
        caption="Good: fit and validation of a fin agree within their standard errors.",
        panels=[
            Panel(
                x_label="fin",
                y_label="force (N)",
                x_categories=names,
                traces=[
                    Trace(
                        x=np.arange(4.0),
                        y=np.array([0.0029, 0.0191, 0.0485, 0.033]),
                        y_error=np.array([0.0004, 0.001, 0.003, 0.002]),
                        style="points",
                        label="fit",
                    ),
                    Trace(
                        x=np.arange(4.0),
                        y=np.array([0.0031, 0.018, 0.047, 0.036]),
                        style="points",
                        label="validation",
                    ),
                ],
            )
        ],
    )


def log_figure() -> Figure:
    """Logarithmic axes over several decades beside a narrow range in steps."""
    frequency = np.logspace(-1, 1.7, 400)
    gain = 1 / np.hypot(1 - (frequency / 3) ** 2, 0.1 * frequency)
    return Figure(
        id="spectrum",
        title="Spectra",
        caption="Good: the model follows the measurement up to the bandwidth.",
        panels=[
            Panel(
                x_label="frequency (Hz)",
                y_label="power spectral density of the surge speed (m²/s)",
                x_scale="log",
                y_scale="log",
                traces=[
                    Trace(x=frequency, y=gain**2 * 1e-5, label="measured", group=0),
                    Trace(x=frequency, y=gain**2 * 0.9e-5, style="dashed", label="model", group=0),
                ],
            ),
            Panel(
                x_label="order",
                y_label="BIC",
                traces=[
                    Trace(
                        x=np.arange(1.0, 9),
                        y=-12000 - 400 * np.tanh(np.arange(1.0, 9) / 2),
                        style="step",
                        label="BIC",
                    )
                ],
                marks=[Mark(at=4.0, axis="x", label="chosen")],
            ),
        ],
    )


def track_figure() -> Figure:
    """A path to scale, in two parts."""
    s = np.linspace(0, 4 * np.pi, 900)
    x, y = 0.12 * s, 0.25 * np.sin(s) * np.exp(-0.05 * s)
    return Figure(
        id="track",
        title="Path in the pool",
        caption="To scale. Good: one smooth path without jumps.",
        panels=[
            Panel(
                x_label="x (m)",
                y_label="y (m)",
                equal_aspect=True,
                traces=[
                    Trace(x=x, y=y, label="nose"),
                    Trace(x=x - 0.05, y=y * 0.9, label="tail"),
                    Trace(x=x[:1], y=y[:1], style="points", label="start"),
                ],
            )
        ],
    )


def all_figures() -> list[Figure]:
    """Every kind of panel once."""
    return [fit_figure(), residual_figure(), band_figure(), categories_figure(), log_figure(), track_figure()]


# ---------------------------------------------------------------- results


def drag(folder: Path, name: str = "drag.yaml", *, proof: bool = True) -> Path:
    """A falling-weight fit with full evidence."""
    block = provenance("swimid fit-drag trials.yaml -o drag.yaml", ["trials.yaml", "w10.csv", "w20.csv"])
    file = ParameterFile(
        model="falling-weight",
        robot="boxfish",
        parameters={
            "drag_coefficient": Estimate(
                value=0.70512,
                stderr=0.0331,
                unit="1",
                bounds=(0.0, 5.0),
                status="estimated",
                meaning="drag coefficient C_d",
            ),
            "added_mass": Estimate(
                value=0.6852, stderr=0.0372, unit="kg", bounds=(0.0, None), status="estimated"
            ),
            "pulley_friction": Estimate(
                value=0.0308, stderr=0.00101, unit="N", bounds=(0.0, None), status="estimated"
            ),
            "linear_drag": Estimate(
                value=0.0, stderr=None, unit="N s/m", bounds=(0.0, None), status="at-bound"
            ),
            "string_stiffness": Estimate(
                value=187654.321, stderr=9e9, unit="N/m", bounds=(0.0, None), status="unidentifiable"
            ),
            "pulley_inertia": Estimate(value=4.512e-5, stderr=1.2e-6, unit="kg m^2", status="estimated"),
            "water_density": Estimate(value=997.0, unit="kg/m^3", status="fixed"),
        },
        derived={"terminal_speed_m_s": Estimate(value=0.1661, stderr=0.0021, unit="m/s", status="estimated")},
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
    return Evidence(
        command="fit-drag",
        title="Drag and added mass of the boxfish",
        verdict=Verdict(
            level="caution",
            text="C_d = 0.705 ± 0.033, added mass 0.685 ± 0.037 kg; friction trades off against added mass.",
        ),
        checks=[
            Check(
                name="Converged",
                value="yes, 14 steps",
                limit="yes",
                verdict="pass",
                text="The optimum was reached.",
            ),
            Check(
                name="Residuals white (x_m)",
                value="p = 0.21",
                limit="p > 0.01",
                verdict="pass",
                text="What is left over looks like noise.",
            ),
            Check(
                name="Strongest correlation",
                value="0.954",
                limit="< 0.9",
                verdict="warn",
                text="Friction and added mass are told apart poorly; add a trial with a heavier weight.",
            ),
            Check(
                name="Validation / fit NRMSE",
                value="1.4",
                limit="< 1.5",
                verdict="pass",
                text="It generalises.",
            ),
            Check(name="Start-up samples", value="3 %", limit="", verdict="info", text="Left in."),
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
        notices=[
            NoticeRecord(code="SWM011", text="added_mass and pulley_friction correlate by -0.954"),
            NoticeRecord(code="SWM010", text="string_stiffness cannot be told from these trials"),
        ],
        methods=[
            "Drag and added mass were identified from falling-weight trials by maximum likelihood.",
            "Standard errors follow from the Fisher information at the optimum.",
        ],
        references=["Gauss, C. F. (1809). Theoria motus corporum coelestium."],
        provenance=block,
    )


def arma(folder: Path) -> Path:
    """A discrete-time model with an unstable pole: a bad verdict."""
    block = provenance("swimid rwls run.csv -o arma.yaml", ["run.csv"])
    file = ParameterFile(
        model="arx",
        parameters={
            "a1": Estimate(value=-1.8123, stderr=0.0042, unit="1", status="estimated"),
            "b1": Estimate(value=3.1e-4, stderr=2.2e-5, unit="m/s", status="estimated"),
        },
        delay=1,
        sample_time_s=0.04,
        poles=[Pole(real=1.0013, imag=0.0, magnitude=1.0013, stderr_magnitude=0.0004)],
        stable=False,
        fit=Fit(
            trials=["run"], channels={"u_m_s": {"rmse": 0.004, "nrmse": 0.05, "unit": "m/s"}}, converged=True
        ),
        provenance=block,
    )
    path = folder / "arma.yaml"
    record = Evidence(
        command="rwls",
        title="ARX model of the long-fin vehicle",
        verdict=Verdict(level="bad", text="The model is unstable: a free run grows without end."),
        checks=[
            Check(name="Largest pole", value="1.0013 ± 0.0004", limit="< 1", verdict="fail", text="Unstable.")
        ],
        figures=[log_figure(), band_figure()],
        methods=["An ARX model was fitted by recursive weighted least squares."],
        references=[
            "Gauss, C. F. (1809). Theoria motus corporum coelestium.",
            "Ljung, L. (1999). System Identification.",
        ],
        notices=[NoticeRecord(code="SWM020", text="a pole lies at 1.0013")],
        provenance=block,
    )
    Fitted.of(file, record).save(path)
    return path


def track(folder: Path, *, proof: bool = True, name: str = "run.csv") -> Path:
    """A tracked log with gaps; with overlay pictures where it has evidence."""
    rng = np.random.default_rng(RNG_SEED + 3)
    time = np.arange(0, 42, 0.02)
    x = 0.04 * time + rng.normal(0, 0.0005, len(time))
    y = 0.1 * np.sin(0.5 * time)
    yaw = 0.3 * np.sin(2 * np.pi * time)
    x[500:560], y[500:560], yaw[1500:1700] = np.nan, np.nan, np.nan
    path = folder / name
    log.write(
        path, {"t_s": time, "x_m": x, "y_m": y, "yaw_rad": yaw}, {"source": "pool.mp4", "camera": "overhead"}
    )
    if proof:
        record = Evidence(
            command="track video",
            title="Track of pool.mp4",
            verdict=Verdict(level="good", text="The marker was found in 2040 of 2100 frames."),
            checks=[
                Check(
                    name="Frames with markers",
                    value="97 %",
                    limit="> 90 %",
                    verdict="pass",
                    text="Few are lost.",
                )
            ],
            figures=[track_figure()],
            images=[
                Image(
                    id="frame",
                    title="Frame 1200",
                    caption="Good: the cross sits on the marker.",
                    media_type="image/png",
                    base64=png(),
                )
            ],
            provenance=provenance(
                "swimid track video pool.mp4 --setup setup.yaml -o run.csv", ["pool.mp4", "setup.yaml"]
            ),
        )
        Logged("track video", evidence=record, document=log.read(path)).save(path)
    return path
