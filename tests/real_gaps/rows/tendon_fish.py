"""Tendon-driven fish from tracked films, whose measured beat is three quarters of the stated one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import yaml

from tests.real_gaps.row import Array, Known, Row, Sources, size_of, write_log, write_trials, write_yaml

ROBOT = Path(__file__).parents[3] / "docs" / "examples" / "fishsim.yaml"
#: Films by stated beat in Hz: fitted with the measured beat, and diagnosed with the stated one.
FITTED, DIAGNOSED = ("1_00", "1_75"), ("0_50", "2_00")
#: Measured over stated beat, by the films of more than four cycles.
RATIO = 0.7497
#: Pictures per second, distance of the first two points, and points.
RATE_HZ, HEAD_M, POINTS = 60.0, 0.142, 9
#: Labels of the tail that lie on the label behind them in one film.
MERGED = {"2_00": ("p4", "p5", "p6")}


def write_import(_sources: Sources, folder: Path) -> None:
    """Mapping and points files."""
    columns = []
    for point in range(POINTS):
        columns.append({"source": 2 * point + 1, "target": f"p{point}_x_px", "unit": "px"})
        columns.append({"source": 2 * point + 2, "target": f"p{point}_y_px", "unit": "px", "factor": -1})
    mapping = {"format": "swimid-mapping/1", "reader": {"header": False}, "time": {"rate_hz": RATE_HZ}}
    write_yaml(folder / "map.yaml", {**mapping, "columns": columns})
    scale = {"format": "swimid-points/1", "scale": {"between": ["p0", "p1"], "distance_m": HEAD_M}}
    places = yaml.safe_load(ROBOT.read_text())["multilink"]["points"]
    for film in (*FITTED, *DIAGNOSED):
        left_out = MERGED.get(film, ())
        kept = {name: place for name, place in places.items() if name not in left_out}
        write_yaml(folder / f"points{film}.yaml", {**scale, "points": kept} if left_out else scale)


def write(_sources: Sources, folder: Path) -> None:
    """Logs without the mean of the joint angles, and trials files."""
    logs = {film: _read(folder / f"film{film}.csv") for film in (*FITTED, *DIAGNOSED)}
    amplitudes = []
    for film, log in logs.items():
        beat = RATIO * _stated_hz(film)
        for name in ("joint1_rad", "joint2_rad"):
            mean, amplitude = _harmonic(log["t_s"], log[name], beat)
            log[name] = log[name] - mean
            if film in FITTED and name == "joint1_rad":
                amplitudes.append(amplitude)
        columns = ("t_s", "x_m", "y_m", "yaw_rad", "joint1_rad", "joint2_rad")
        write_log(folder / f"f{film}.csv", {name: log[name] for name in columns})
    degrees = round(float(np.degrees(np.mean(amplitudes))), 2)
    for name, films, ratio in (("measured", FITTED, RATIO), ("stated", DIAGNOSED, 1.0)):
        trials = []
        for film in films:
            drive = {"frequency_hz": ratio * _stated_hz(film), "amplitude_deg": degrees, "ramp_s": 0}
            trials.append({"log": f"f{film}.csv", "start_state": "steady", "drive": drive})
        write_trials(folder / f"{name}.yaml", "free-swim", os.path.relpath(ROBOT, folder), trials)


def _stated_hz(film: str) -> float:
    return float(film.replace("_", "."))


def _read(path: Path) -> dict[str, Array]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names or ()}


def _harmonic(time_s: Array, angle: Array, frequency_hz: float) -> tuple[float, float]:
    """Mean and amplitude of a record by least squares."""
    turn = 2 * np.pi * frequency_hz * time_s
    known = np.isfinite(angle)
    design = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn)])[known]
    weights = np.linalg.lstsq(design, angle[known], rcond=None)[0]
    return float(weights[0]), float(np.hypot(weights[1], weights[2]))


ROWS = (
    Row(
        name="tendon-fish-beat",
        model="fish that beats as stated",
        lacks="a motor that is a quarter slower",
        source="srl-ethz/fishsim",
        licence="MIT",
        steps=(
            write_import,
            *(
                f"import {{data}}/fishsim/markers_f{film}.csv --map map.yaml --robot {ROBOT}"
                f" --points points{film}.yaml --calibrate-points -o film{film}.csv"
                for film in (*FITTED, *DIAGNOSED)
            ),
            write,
            "fit-graybox measured.yaml --free camera_rotation -o fish.yaml",
            "diagnose stated.yaml --params fish.yaml -o gap.yaml",
        ),
        causes=frozenset({"clock-rate"}),
        known=Known(1 / RATIO - 1, "1", "joint angles of the films", size_of("rate")),
    ),
)
