"""A table of cruising speeds computed without swimid, in the boxfish paper's cgs units.

Speeds follow from integrating the approach to terminal speed over the swum distance, not from
the closed-form velocity ratio; fins flex at 4 Hz, and the stop watch is read with an error.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from tests.generators.marks import mark

EFFICIENCY = 0.341
OFFSET_DEG = 5.42
#: Height, length (cm); the arbitrary fin works like a smaller rectangle, unknown to the user.
FINS = {"2025Rect": (6.36, 3.18), "2925Rect": (7.65, 3.82), "3825Rect": (8.75, 4.37), "2925Arb": (7.0, 3.70)}
GAP_CM = 0.7
DISTANCE_CM = 115.0
#: Share of the speed the fins lose by flexing at 4 Hz.
FLEX_LOSS = 0.031


def fin_inertia(height: float, length: float) -> float:
    """Hydrodynamic moment of inertia of a rectangular plate swung about an edge offset, g cm2."""
    whole, gap = (length + GAP_CM), GAP_CM
    return 9.0 * np.pi * 0.997 * height * (whole**2 - gap**2) * (whole**2 + gap**2) / 128.0


def swim_time(
    inertia: float,
    frequency: float,
    amplitude_deg: float,
    *,
    efficiency: float = EFFICIENCY,
    offset_deg: float = OFFSET_DEG,
) -> float:
    """Seconds from rest over the distance, with the force that balances drag at terminal speed."""
    theta = np.deg2rad(amplitude_deg - offset_deg)
    drag = 0.5 * 0.997 * 0.705 * 69.8
    power = 8.0 * efficiency * np.pi**2 * frequency**3 * inertia * theta**2
    terminal = (power / drag) ** (1.0 / 3.0)
    force, mass = drag * terminal**2, 1196.0 + 685.0

    def arrived(_: float, s: np.ndarray) -> float:
        return s[0] - DISTANCE_CM

    arrived.terminal = True
    run = solve_ivp(
        lambda _, s: [s[1], (force - drag * s[1] ** 2) / mass],
        (0.0, 1000.0),
        [0.0, 0.0],
        method="Radau",
        rtol=1e-8,
        atol=1e-9,
        events=arrived,
    )
    return float(run.t_events[0][0])


def settings() -> list[tuple[str, float, float]]:
    """Fin, frequency (Hz) and amplitude (deg) of every run, as in the paper's section 3.4."""
    runs = [(fin, f, 16.0) for fin in FINS for f in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)]
    runs += [(fin, f, a) for fin in FINS for f in (2.5, 3.5) for a in (10.0, 12.0, 14.0, 18.0, 20.0)]
    return runs


def table(
    rng: np.random.Generator, *, time_sd_s: float = 0.05, flex_loss: float = FLEX_LOSS, **law: float
) -> list[tuple[str, float, float, float, float]]:
    """Rows of fin, frequency, amplitude, distance (m) and time (s)."""
    rows = []
    for fin, f, a in settings():
        time = swim_time(fin_inertia(*FINS[fin]), f, a, **law)
        if f == 4.0:
            time /= 1.0 - flex_loss
        rows.append((fin, f, a, DISTANCE_CM / 100.0, round(time + rng.normal(0.0, time_sd_s), 2)))
    return rows


def write_table(path: Path, rows: list[tuple[str, float, float, float, float]]) -> None:
    """The table as CSV."""
    text = "fin,frequency_hz,amplitude_deg,distance_m,time_s\n"
    text += "".join(f"{fin},{f:g},{a:g},{d:g},{t:g}\n" for fin, f, a, d, t in rows)
    path.write_text(text)


def write_sample(folder: Path, *, seed: int = 21) -> None:
    """A speeds table of the boxfish's four fins and its trials file."""
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "speeds.csv", table(np.random.default_rng(seed)))
    mark(folder)
    (folder / "trials.yaml").write_text(
        "# Cruising speeds of the boxfish with four caudal fins (synthetic, seeded).\n"
        "format: swimid-trials/1\nexperiment: cruise\nrobot: boxfish\ntable: speeds.csv\n"
    )
