"""Print the page that compares the built-in robots with links with their papers, and write its pictures.

python docs/reproduction.py

Every result of a model is computed here from the robot files. Published values are those of the tables and of
the text of the papers. The pictures are written to docs/figures.
"""

from __future__ import annotations

import csv
import math
import re
import textwrap
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from swimid.fitting.drives import TailBeat
from swimid.fitting.model import SwimInput, Trial
from swimid.optimisation.optimise_stiffness import StiffnessRule, optimise_stiffness
from swimid.optimisation.performance_map import performance_map
from swimid.results import drawing
from swimid.results import evidence as ev
from swimid.results.evidence import Figure, Panel, Trace
from swimid.robots import file as robot_format
from swimid.robots.file import Robot
from swimid.swimmer.planar.model import MultilinkModel

SAMPLE_RATE_HZ = 100
#: Duration of a run in the tank of 5 m, of a run that becomes steady, and of a run of the dolphin, s.
TANK_S, STEADY_S, SHORT_S = 15.0, 60.0, 10.0
TFISH_CYCLES, DOLPHIN_CYCLES = 3, 4


# ------------------------------------------------------------------ running a robot


@dataclass(frozen=True)
class Figures:
    """Quantities of a run as the papers print them, angles in degrees.

    ``surge`` is the mean velocity of the nose along the head. ``yaw_peak`` is the largest magnitude of the
    head's rate. ``rear`` is half the range of the last joint's angle.
    """

    surge: float
    yaw_peak: float
    rear: float


@cache
def robot(name: str, readings: tuple[tuple[str, str], ...] = ()) -> Robot:
    return robot_format.read(name, readings=dict(readings))


def changed(original: Robot, joint: str, **update: Any) -> Robot:
    """Return the robot with the fields of one joint replaced."""
    body = original.multilink
    assert body is not None
    joints = [j.model_copy(update=update) if j.name == joint else j for j in body.joints]
    return original.model_copy(update={"multilink": body.model_copy(update={"joints": joints})})


def cranked(crank_m: float) -> Robot:
    """Return the tendon fish with another crank."""
    original = robot("tfish")
    assert original.multilink is not None
    passive = next(j.passive for j in original.multilink.joints if j.passive is not None)
    assert passive.tendon is not None
    tendon = passive.tendon.model_copy(update={"crank_m": crank_m})
    return changed(original, "joint4", passive=passive.model_copy(update={"tendon": tendon}))


def doubled(name: str, *coefficients: str) -> dict[str, float]:
    """Return twice the values of the robot file."""
    body = robot(name).multilink
    assert body is not None
    return {c: 2.0 * body.coefficients[c].value for c in coefficients}


def simulate(body: Robot, beat: TailBeat, seconds: float, **coefficients: float) -> dict[str, np.ndarray]:
    """Return the channels of a run from rest, with the coefficients of the robot file or the given ones."""
    model = MultilinkModel(body)
    assert body.multilink is not None
    known = {name: c.value for name, c in body.multilink.coefficients.items()} | coefficients
    values = np.array([known.get(p.name, p.start) for p in model.parameters])
    time = np.arange(round(seconds * SAMPLE_RATE_HZ) + 1) / SAMPLE_RATE_HZ
    found = model.simulate(values, Trial("run", "fit", time, {}, swim=SwimInput(beat)))
    return {"t_s": time, **found}


def figures(run: Mapping[str, np.ndarray], frequency_hz: float, at_s: float, cycles: int) -> Figures:
    """Return the quantities over the last whole beats before an instant."""
    time = run["t_s"]
    window = (time > at_s - cycles / frequency_hz + 1e-9) & (time <= at_s + 1e-9)
    turn = "yaw" if "yaw_rad" in run else "pitch"
    rear = max(name for name in run if name.startswith("joint") and "rate" not in name)
    return Figures(
        float(run["u_m_s"][window].mean()),
        math.degrees(np.abs(run[f"{turn}_rate_rad_s"][window]).max()),
        0.5 * math.degrees(np.ptp(run[rear][window])),
    )


def beat(
    frequency_hz: float, amplitude_deg: float, bias_deg: float = 0.0, h: float = 0.0, waveform: str = "sine"
) -> TailBeat:
    return TailBeat(waveform, frequency_hz, math.radians(amplitude_deg), math.radians(bias_deg), h)


# ------------------------------------------------------------------ printing


WIDTH = 105
FILL: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}


def deviation(value: float, published: float) -> str:
    return f"{100.0 * (value / published - 1.0):+.1f} %".replace("-", "−")


#: Rows of each table that :func:`page` has computed, with the head as first row, by the name of its file.
sheets: dict[str, list[list[str]]] = {}


def table(name: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Keep the rows of a table, and return the link to its file."""
    sheets[f"reproduction-{name}.csv"] = [list(columns), *map(list, rows)]
    return f"[All rows](measured/reproduction-{name}.csv)"


def wrapped(parts: Iterable[str]) -> str:
    """Return Markdown blocks with paragraphs and list items filled to the width of the page."""
    found = []
    for block in re.split(r"\n\s*\n", "\n\n".join(parts).strip()):
        text = block.strip()
        filled = re.sub(r"\s+", " ", text)
        if text.startswith(("|", "#")):
            found.append(text)
        elif text.startswith("- "):
            items = re.split(r"\n(?=- )", text)
            items = [re.sub(r"\s+", " ", item) for item in items]
            found.append("\n".join(textwrap.fill(i, WIDTH, subsequent_indent="  ", **FILL) for i in items))
        else:
            found.append(textwrap.fill(filled, WIDTH, **FILL))
    return "\n\n".join(found)


def rms_deviation(values: Sequence[float], published: Sequence[float]) -> float:
    return float(np.sqrt(np.mean((np.array(values) / np.array(published) - 1.0) ** 2)))


# ------------------------------------------------------------------ tendon fish

#: Table IV: frequency (Hz), amplitude (deg), E_V (m/s), its normalised value, E_Omega (deg/s), its
#: normalised value, and a remark on the row. The third row is printed with amplitude 30.
TABLE_IV = (
    (1.0, 20.0, 0.019, 0.091, 0.816, 0.029, ""),
    (1.0, 30.0, 0.016, 0.053, 1.186, 0.028, ""),
    (1.4, 20.0, 0.019, 0.070, 0.390, 0.014, "doubtful"),
    (1.4, 30.0, 0.016, 0.053, 1.186, 0.049, "doubtful"),
    (1.8, 20.0, 0.028, 0.076, 1.198, 0.034, ""),
    (1.8, 30.0, 0.046, 0.069, 1.856, 0.054, "doubtful"),
)
CLEAN_YAW = ((1.0, 20.0), (1.0, 30.0), (1.4, 20.0))
TOP_SPEED = (2.2, 35.0, 0.47)
CLEAN_SPEED = ((1.0, 20.0), (1.0, 30.0), (1.4, 20.0), (1.8, 20.0), TOP_SPEED[:2])


def published_speed(f: float, a: float) -> float:
    if (f, a) == TOP_SPEED[:2]:
        return TOP_SPEED[2]
    return next(row[2] / row[3] for row in TABLE_IV if row[:2] == (f, a))


def published_yaw(f: float, a: float) -> float:
    return next(row[4] / row[5] for row in TABLE_IV if row[:2] == (f, a))


@cache
def straight(f: float, a: float) -> dict[str, np.ndarray]:
    """Return a straight run of the tendon fish of a minute."""
    return simulate(robot("tfish"), beat(f, a), STEADY_S)


def tfish_yaw_deviations(cycles: int) -> list[float]:
    """Return the relative deviations of the yaw peaks at the rows of Table IV that are not doubtful."""
    return [
        figures(straight(f, a), f, TANK_S, cycles).yaw_peak / published_yaw(f, a) - 1.0 for f, a in CLEAN_YAW
    ]


def rise_time(run: Mapping[str, np.ndarray], f: float) -> float:
    """Return the time at which the mean surge over a beat reaches 63 % of its last value, s."""
    count = round(SAMPLE_RATE_HZ / f)
    mean = np.convolve(run["u_m_s"], np.ones(count) / count, "valid")
    return float(run["t_s"][int(np.argmax(mean >= (1.0 - math.exp(-1.0)) * mean[-1]))] + 0.5 / f)


def tfish_straight() -> str:
    speed, yaw, rises = [], [], []
    for f, a in [row[:2] for row in TABLE_IV] + [TOP_SPEED[:2]]:
        run = straight(f, a)
        note = next((row[6] for row in TABLE_IV if row[:2] == (f, a)), "text")
        label = f"{f:g} Hz, {a:g}°" + (f" ({note})" if note else "")
        known = published_speed(f, a)
        tank, steady = (figures(run, f, at, TFISH_CYCLES) for at in (TANK_S, STEADY_S))
        rises.append(rise_time(run, f))
        speed.append(
            [
                label,
                f"{known:.3f}",
                f"{tank.surge:.3f}",
                deviation(tank.surge, known),
                f"{steady.surge:.3f}",
                deviation(steady.surge, known),
            ]
        )
        if (f, a) == TOP_SPEED[:2]:
            continue
        known = published_yaw(f, a)
        cells = [label, f"{known:.1f}"]
        for cycles in (1, TFISH_CYCLES):
            peak = figures(run, f, TANK_S, cycles).yaw_peak
            cells += [f"{peak:.1f}", deviation(peak, known)]
        yaw.append(cells)
    speeds = table(
        "tfish-speeds",
        [
            "beat",
            "published, m/s",
            f"model at {TANK_S:g} s",
            "deviation",
            f"at {STEADY_S:g} s",
            "deviation",
        ],
        speed,
    )
    peaks = table(
        "tfish-yaw-peaks",
        [
            "beat",
            "published",
            f"last beat at {TANK_S:g} s",
            "deviation",
            f"{TFISH_CYCLES} beats",
            "deviation",
        ],
        yaw,
    )
    return f"""Table IV gives errors and normalised errors, whose quotient is a speed or a yaw rate. Three
  of its rows contradict others, and are marked as doubtful. The tank allows about {TANK_S:g} s. With the
published friction the model needs {min(rises):.0f} to {max(rises):.0f} s to reach 63 % of its speed.

Speeds:

{speeds}

Peaks of the yaw rate, deg/s:

{peaks}"""


#: Table V: bias (deg), mode, R (m), xi (deg), largest and mean yaw rate (deg/s).
TABLE_V = (
    (25.0, "CPG", 0.44, 26.9, 96.2, 17.3),
    (25.0, "A-CPG", 0.45, 19.8, 119.1, 17.1),
    (30.0, "CPG", 0.44, 30.4, 80.8, 37.3),
    (30.0, "A-CPG", 0.30, 21.2, 118.5, 41.2),
    (35.0, "CPG", 0.22, 28.4, 133.2, 24.7),
    (35.0, "A-CPG", 0.14, 21.1, 153.3, 30.9),
)
TURN_HZ, TURN_ASYMMETRY, TURN_AMPLITUDE_DEG, TURN_S, TURN_CYCLES = 1.0, 0.4, 35.0, 20.0, 5


@cache
def turning(bias_deg: float, asymmetry: float, amplitude_deg: float) -> tuple[float, float, float, float]:
    """Return radius (m), range of the yaw in a beat (deg), largest and mean yaw rate (deg/s) of a turn."""
    command = beat(TURN_HZ, amplitude_deg, bias_deg, asymmetry, "a-cpg")
    run = simulate(robot("tfish"), command, TURN_S)
    per_beat = round(SAMPLE_RATE_HZ / TURN_HZ)
    last = slice(-TURN_CYCLES * per_beat - 1, None)
    x, y, yaw = (run[name][last] for name in ("x_m", "y_m", "yaw_rad"))
    # a circle through the positions averaged over a beat
    window = np.ones(per_beat) / per_beat
    px, py = np.convolve(x, window, "valid"), np.convolve(y, window, "valid")
    cx, cy, offset = np.linalg.lstsq(np.column_stack([2 * px, 2 * py, np.ones_like(px)]), px**2 + py**2)[0]
    return (
        math.sqrt(offset + cx**2 + cy**2),
        math.degrees(np.ptp(yaw[-per_beat - 1 :])),
        math.degrees(np.abs(run["yaw_rate_rad_s"][last]).max()),
        abs(math.degrees(yaw[-1] - yaw[0])) * TURN_HZ / TURN_CYCLES,
    )


def table_v_row(bias_deg: float, mode: str) -> tuple[float, float, float, float]:
    """Return the quantities of the model for a row of Table V."""
    return turning(bias_deg, TURN_ASYMMETRY if mode == "A-CPG" else 0.0, TURN_AMPLITUDE_DEG)


def tfish_turning() -> str:
    rows, slower = [], []
    for bias, mode, *published in TABLE_V:
        found = table_v_row(bias, mode)
        slower.append(100 * (1 - found[2] / published[2]))
        cells = [f"{bias:g}°, {mode}"]
        for value, known, digits in zip(found, published, (2, 0, 0, 1), strict=True):
            cells += [f"{known:g}", f"{value:.{digits}f}", deviation(value, known)]
        rows.append(cells)
    tighter = [
        100 * (1 - turning(b, TURN_ASYMMETRY, a)[0] / turning(b, 0.0, a)[0])
        for a in (30.0, TURN_AMPLITUDE_DEG)
        for b in (25.0, 30.0, 35.0)
    ]
    smallest = min(turning(b, TURN_ASYMMETRY, TURN_AMPLITUDE_DEG)[0] for b in (25.0, 30.0, 35.0))
    columns = ["bias, mode"]
    for name in ("R, m", "ξ, deg", "ω max, deg/s", "ω mean, deg/s"):
        columns += [name, "model", "deviation"]
    return f"""In turns (Table V, amplitude {TURN_AMPLITUDE_DEG:g}° chosen), asymmetry tightens the path by
  {min(tighter):.0f} to {max(tighter):.0f} % (published: 36 %). The largest yaw rate is {min(slower):.0f} to
  {max(slower):.0f} % below the published one, and the radius does not fall below {smallest:.2f} m.

{table("tfish-turning", columns, rows)}

![Published and modelled turns](figures/steering.svg)
"""


#: Grid of Algorithm 1 (section IV.B): frequencies in Hz, amplitudes in degrees.
RULE_HZ, RULE_DEG = (0.6, 2.0, 8), (15.0, 35.0, 5)
#: Published highest speeds with the fixed and with the variable stiffness, m/s (section V.C).
PUBLISHED_GAIN = (0.32, 0.45)


RULE = {"robot": "tfish", "over": {"frequency_hz": RULE_HZ, "amplitude_deg": RULE_DEG}}


@cache
def stiffness_rule() -> StiffnessRule:
    """Return the rule of Algorithm 1 as ``swimid optimise stiffness`` finds it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return optimise_stiffness(**RULE)


def tfish_rule() -> str:
    file = stiffness_rule().file
    ruled = max(float(o.ruled["mean_speed_m_s"] or 0.0) for o in file.optima)
    fixed = max(float(o.reference["mean_speed_m_s"] or 0.0) for o in file.optima)
    wider = sum(
        float(o.best["yaw_rate_range_rad_s"] or 0.0) > float(o.reference["yaw_rate_range_rad_s"] or 0.0)
        for o in file.optima
        if float(o.stiffness or 0.0) > file.reference
    )
    stiffer = sum(float(o.stiffness or 0.0) > file.reference for o in file.optima)
    low, high = PUBLISHED_GAIN
    ends = [
        [f"{1e3 * float(o.stiffness or 0.0):.0f}" for o in file.optima if o.amplitude_deg == a]
        for a in RULE_DEG[:2]
    ]
    ranges = ", ".join(f"{mm[0]} to {mm[-1]} mm at {a:g}°" for mm, a in zip(ends, RULE_DEG, strict=False))
    return f"""`swimid optimise stiffness` finds a pretension that rises with frequency and amplitude, as
  in Fig 9: {ranges}, from {RULE_HZ[0]:g} to {RULE_HZ[1]:g} Hz. The highest speed rises from {fixed:.2f} to
  {ruled:.2f} m/s ({100 * (ruled / fixed - 1):.0f} %); the paper has {low:g} and {high:g} m/s
  ({100 * (high / low - 1):.0f} %). Unlike in Fig 10, the best spring widens the range of the yaw rate, at
  {wider} of {stiffer} points.

![The rule for each amplitude](figures/stiffness-rule.svg)
"""


def readings_of(name: str) -> list[tuple[str, str, bool]]:
    """Return each reading and option, and whether the option is the chosen one."""
    return [
        (key, option, option == reading.chosen)
        for key, reading in robot(name).readings.items()
        for option in reading.options
    ]


def _reading_row(
    label: str, values: Sequence[Sequence[float]], targets: Sequence[Sequence[float]], digits: Sequence[int]
) -> list[str]:
    """Return a row with the values of each group and their root-mean-square deviation."""
    cells = [label]
    for group, published, d in zip(values, targets, digits, strict=True):
        cells += [f"{v:.{d}f}".replace("-", "−") if np.isfinite(v) else "unstable" for v in group]
        off = 100 * rms_deviation(group, published)
        cells.append(f"{off:.0f} %" if math.isfinite(off) else "")
    return cells


def tfish_readings() -> str:
    targets = ([published_speed(*b) for b in CLEAN_SPEED], [published_yaw(*b) for b in CLEAN_YAW])

    def row(label: str, body: Robot, **coefficients: float) -> list[str]:
        found = {
            b: figures(simulate(body, beat(*b), TANK_S, **coefficients), b[0], TANK_S, TFISH_CYCLES)
            for b in CLEAN_SPEED
        }
        values = ([found[b].surge for b in CLEAN_SPEED], [found[b].yaw_peak for b in CLEAN_YAW])
        return _reading_row(label, values, targets, (3, 1))

    twice = doubled("tfish", "c_ma", "c_Ia")
    speeds, peaks = [f"{v:.3f}" for v in targets[0]], [f"{v:.1f}" for v in targets[1]]
    rows = [["published", *speeds, "", *peaks, ""], row("as chosen", robot("tfish"))]
    rows += [
        row(f"`{key}={option}`", robot("tfish", ((key, option),)))
        for key, option, chosen in readings_of("tfish")
        if not chosen
    ]
    rows += [
        row("crank 16 mm", cranked(0.016)),
        row("crank 24 mm", cranked(0.024)),
        row("added mass counted in T and again in Eq 8", robot("tfish"), **twice),
    ]
    columns = ["reading", *(f"V {f:g}/{a:g}" for f, a in CLEAN_SPEED), "rms"]
    columns += [*(f"yaw {f:g}/{a:g}" for f, a in CLEAN_YAW), "rms"]
    return f"""Other readings of the paper (`--reading NAME=OPTION`), one at a time, and other lengths of
  the crank than the chosen 20 mm:

{table("tfish-readings", columns, rows)}
"""


# ------------------------------------------------------------------ dolphin

#: Highest speeds in the text (sections 4.2.1 and 4.3): name, stiffness, frequency, m/s.
DOLPHIN_SPEEDS = (("JN1", 0.31, 2.9, 0.65), ("JN2", 0.62, 2.89, 0.71), ("JN4", 0.8, 2.88, 0.74))
WAIST_DEG = 27.0
MAP_HZ = tuple(1.0 + 0.5 * k for k in range(9))
#: Highest speed with a locked joint: frequency (Hz) and speed (m/s).
PUBLISHED_RIGID = (2.53, 0.45)


@cache
def rigid_dolphin() -> Robot:
    return changed(robot("dolphin"), "caudal", passive=None)


def dolphin(f: float, seconds: float, body: Robot | None = None, **coefficients: float) -> Figures:
    run = simulate(body or robot("dolphin"), beat(f, WAIST_DEG), seconds, **coefficients)
    return figures(run, f, seconds, DOLPHIN_CYCLES)


@cache
def steady_speed(f: float, stiffness: float) -> float:
    return dolphin(f, STEADY_S, K_s=stiffness).surge


def dolphin_deviations() -> list[float]:
    """Return the relative deviations from the three published top speeds."""
    return [dolphin(f, SHORT_S, K_s=k).surge / known - 1.0 for _, k, f, known in DOLPHIN_SPEEDS]


@cache
def best_stiffness(f: float) -> float:
    """Return the stiffness of the highest steady speed, N m/rad; 0.02 if it is 0.02 or less."""
    grid = np.geomspace(0.02, 4.0, 14)
    at = int(np.argmax([steady_speed(f, float(k)) for k in grid]))
    if at == 0:
        return float(grid[0])
    low, high = grid[at - 1], grid[min(at + 1, len(grid) - 1)]
    objective: Callable[[float], float] = lambda k: -steady_speed(f, float(k))  # noqa: E731
    return float(minimize_scalar(objective, bounds=(low, high), method="bounded", options={"xatol": 1e-3}).x)


def dolphin_speeds() -> str:
    rows = []
    for name, stiffness, f, known in DOLPHIN_SPEEDS:
        found = dolphin(f, SHORT_S, K_s=stiffness)
        rows.append(
            [
                f"{name}, {stiffness:g} N m/rad, {f:g} Hz",
                f"{known:.2f}",
                f"{found.surge:.3f}",
                deviation(found.surge, known),
                f"{found.rear:.0f}°",
            ]
        )
    misses = [dolphin(f, SHORT_S, K_s=k).surge - v for _, k, f, v in DOLPHIN_SPEEDS]
    off = 100 * float(np.sqrt(np.mean(np.square(misses))))
    top_hz, known = PUBLISHED_RIGID
    rigid, faster = (dolphin(f, STEADY_S, rigid_dolphin()).surge for f in (top_hz, MAP_HZ[-1]))
    return f"""Top speeds of Figs 8 and 11b, waist ±{WAIST_DEG:g}°, have a root-mean-square error of
  {off:.1f} cm/s. In the paper the stiffer joint is faster; in the model the best stiffness at 2.88 Hz is
  {best_stiffness(2.88):.2f} N m/rad. With a locked joint the model swims {rigid:.2f} m/s at {top_hz:g} Hz
  (published {known:g}), and {faster:.2f} m/s at 5 Hz, where the published speed falls.

{table("dolphin-speeds", ["joint", "published, m/s", "model", "deviation", "fluke swings ±"], rows)}
"""


def dolphin_readings() -> str:
    targets = ([v for *_, v in DOLPHIN_SPEEDS],)

    def row(label: str, body: Robot, **coefficients: float) -> list[str]:
        found = [dolphin(f, SHORT_S, body, K_s=k, **coefficients).surge for _, k, f, _ in DOLPHIN_SPEEDS]
        return _reading_row(label, (found,), targets, (3,))

    usual = robot("dolphin")
    twice = doubled("dolphin", "c_m0", "c_m1", "c_m2")
    rows = [["published", *(f"{v:.2f}" for v in targets[0]), ""], row("as chosen", usual)]
    rows += [
        row(f"`{key}={option}`", robot("dolphin", ((key, option),)))
        for key, option, chosen in readings_of("dolphin")
        if not chosen
    ]
    rows += [
        row("added mass counted in T and again in Eq 10", usual, **twice),
        row(
            "polar of a flat plate, untuned: 1.2, 0.02, 1.2",
            usual,
            fluke_lift=1.2,
            fluke_drag_0=0.02,
            fluke_drag_1=1.2,
        ),
        row("polar of a thin aerofoil: lift π sin 2a", usual, fluke_lift=math.pi),
    ]
    columns = ["reading", *(f"{name}, {k:g} N m/rad" for name, k, *_ in DOLPHIN_SPEEDS), "rms"]
    return f"""Other readings of the paper:

{table("dolphin-readings", columns, rows)}
"""


#: Least cost of transport measured with a compliant joint, J/m (section 4.2.2).
PUBLISHED_COST = 114.3


def dolphin_costs() -> str:
    made = performance_map(
        robot="dolphin",
        amplitude_deg=WAIST_DEG,
        duration_s=STEADY_S,
        over={"frequency_hz": (2.0, 3.0, 3), "K_s": (0.31, 0.62, 2)},
    ).frame
    rows = []
    for f, at in made.groupby("frequency_hz"):
        cells = [f"{v:.2f}" for name in ("mean_positive_power_W", "cost_of_transport_J_m") for v in at[name]]
        rows.append([f"{f:g}", *cells])
    largest = float(made["cost_of_transport_J_m"].max())
    columns = ["f, Hz", "W at 0.31 N m/rad", "W at 0.62", "J/m at 0.31", "J/m at 0.62"]
    return f"""The published cost of transport, {PUBLISHED_COST:g} J/m or more, is electrical. The joints
  of the model need {100 * largest / PUBLISHED_COST:.0f} % of it or less. As in the paper, the softer joint
  has the lower cost.

{table("dolphin-costs", columns, rows)}
"""


# ------------------------------------------------------------------ the page


def checks() -> list[tuple[str, bool]]:
    """Return each claim of the page, and whether it holds."""
    optima_text = ", ".join(f"{best_stiffness(f):.2f}" for f in MAP_HZ)
    peaks = tfish_yaw_deviations(1)
    wider = tfish_yaw_deviations(TFISH_CYCLES)
    speeds = dolphin_deviations()
    optima = [best_stiffness(f) for f in MAP_HZ]

    def listed(values: Sequence[float]) -> str:
        return ", ".join(f"{100 * v:+.1f}" for v in values).replace("-", "−") + " %"

    return [
        (
            f"the dolphin's speed is within 10 % at all three stiffnesses ({listed(speeds)})",
            all(abs(v) < 0.10 for v in speeds),
        ),
        (
            "the dolphin's best stiffness rises with the frequency, from 1 to 5 Hz in steps of 0.5 Hz: "
            f"{optima_text} N m/rad",
            all(b > a for a, b in pairwise(optima)),
        ),
        (
            "the tendon fish's yaw peaks are within 5 % at the rows 1.0/20, 1.0/30 and 1.4/20 of Table IV, "
            f"in the last beat before {TANK_S:g} s ({listed(peaks)}; over {TFISH_CYCLES} beats "
            f"{listed(wider)})",
            all(abs(v) < 0.05 for v in peaks),
        ),
    ]


FIG_11A = """![Speed over frequency and stiffness](figures/speed-map.svg)
"""


NOT_REPRODUCED = """## What cannot be reproduced, and why

- Curves over time and maps are printed as pictures without data.
- Eq 10 of the tendon fish is corrected. As printed, the bias drops out of the output.
- Inertias and masses of the tendon fish contradict each other. Table II is used.
- The profile and the polar of the dolphin are not published. The polar was chosen to fit the three speeds, so
  that their agreement is a fit and no prediction.
- L_c = 0.4 m of the dolphin contradicts the inertias of its Table 2, which put it at 0.31 m.
"""


INTRODUCTION = """`make reproduction` writes this page and its tables. The models are the robot files `tfish`
and `dolphin` with the published coefficients."""


def page() -> str:
    """Return the whole page as Markdown."""
    claims = "\n".join(f"- {'holds' if holds else 'FAILS'}: {text}" for text, holds in checks())
    return wrapped(
        [
            "# Reproduction of the published figures",
            INTRODUCTION,
            "The claims of this page:",
            claims,
            "## Tendon fish",
            tfish_straight(),
            tfish_turning(),
            tfish_rule(),
            tfish_readings(),
            "## Dolphin",
            dolphin_speeds(),
            FIG_11A,
            dolphin_costs(),
            dolphin_readings(),
            NOT_REPRODUCED,
        ]
    )


def table_v() -> Figure:
    """Return a figure of the rows of Table V, published and of the model."""
    rows = [f"{bias:g} {mode}" for bias, mode, *_ in TABLE_V]
    published = np.array([values for _, _, *values in TABLE_V])
    found = np.array([table_v_row(bias, mode) for bias, mode, *_ in TABLE_V])
    names = (
        "radius (m)",
        "range of yaw in a beat (deg)",
        "largest yaw rate (deg/s)",
        "mean yaw rate (deg/s)",
    )
    panels = [
        Panel(
            x_label="bias (deg), mode",
            y_label=name,
            traces=[
                Trace(x=np.arange(len(rows)), y=values[:, k], label=label, style="points")
                for label, values in (("published", published), ("model", found))
            ],
            x_categories=rows,
        )
        for k, name in enumerate(names)
    ]
    caption = "Good: the model on the published values."
    return ev.panels("table-v", "Turning: Table V", caption, panels)


def speed_map() -> list[Figure]:
    """Return the figures of speed against frequency and stiffness, as ``swimid map`` draws them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = performance_map(
            robot="dolphin",
            over={"frequency_hz": (1.0, 5.0, 9), "K_s": (0.2, 3.0, 15)},
            amplitude_deg=WAIST_DEG,
        )
    assert found.evidence is not None
    return [
        f.model_copy(update={"panels": [p for p in f.panels if p.title.startswith("mean speed")]})
        for f in found.evidence.figures
        if f.id in ("map", "contours")
    ]


def pictures(folder: Path) -> None:
    """Write the pictures of the page."""
    folder.mkdir(exist_ok=True)
    evidence = stiffness_rule().evidence
    assert evidence is not None
    drawn = {f.id: f for f in evidence.figures}
    for name, title, figures_of in (
        ("stiffness-rule", "Tendon fish: stiffness rule (Fig 9)", [drawn["rule"]]),
        ("steering", "Tendon fish: turning (Table V)", [table_v()]),
        ("speed-map", "Dolphin: speed (Fig 11a)", speed_map()),
    ):
        drawing.write(folder / f"{name}.svg", figures_of, title=title)


def write_tables(folder: Path) -> None:
    """Write the tables of the page."""
    for name, rows in sheets.items():
        with (folder / name).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    print(page())
    write_tables(Path(__file__).parent / "measured")
    pictures(Path(__file__).parent / "figures")
