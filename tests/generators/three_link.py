"""Small trials of a fish of three links, filmed from above: from rest, or in steady swimming.

An eel of the independent simulator (`swimmer`) with three links and two driven joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.generators import swimmer
from tests.generators.files import write_log, write_trials

TRUTH = {"c_d": 1.6, "c_f": 0.05, "c_ma": 0.8, "c_Ia": 0.8}
LINK_M, MASS_KG, HEIGHT_M, LAG_DEG = 0.12, 0.3, 0.08, 70.0
NOISE = {"x_m": 0.001, "y_m": 0.001, "yaw_rad": 0.003}
#: Robot file; ``drag`` is what its drag coefficients are stated as.
ROBOT = """format: swimid-robot/1
name: three-link
fluid: {{density_kg_m3: 1000}}
multilink:
  plane: horizontal
  coefficients:
    c_d: {{value: {c_d}, free: {free}, bounds: [0, 5], start: {c_d}}}
    c_f: {{value: {c_f}, free: {free}, bounds: [0, 0.5], start: {c_f}, scale: 0.02}}
  links:
{links}
  joints:
    - {{name: joint1, parent: link1, child: link2, driven: {{gain: 1.0}}}}
    - {{name: joint2, parent: link2, child: link3, driven: {{gain: 1.0, phase_lag_deg: {lag}}}}}
  elements:
{elements}
"""


def robot(
    folder: Path, *, c_d: float = 1.0, c_f: float = 0.03, free: bool = True, name: str = "fish"
) -> Path:
    """Write the robot file, with drag coefficients other than the true ones."""
    inertia = MASS_KG * LINK_M**2 / 12.0
    side, skin = HEIGHT_M * LINK_M, np.pi * HEIGHT_M * LINK_M
    links = [
        f"    - {{name: link{k}, length_m: {LINK_M}, mass_kg: {MASS_KG}, com_m: {LINK_M / 2}, "
        f"inertia_kg_m2: {inertia:.6e}, inertia_about: com}}"
        for k in (1, 2, 3)
    ]
    elements = [
        f"    - {{kind: added-mass, link: link{k}, sway_kg: {TRUTH['c_ma'] * MASS_KG}, "
        f"inertia_kg_m2: {TRUTH['c_Ia'] * inertia:.6e}, at_m: {LINK_M / 2}}}"
        for k in (1, 2, 3)
    ]
    elements += [
        f"    - {{kind: drag, link: link{k}, strips: 8, normal_area_m2: {side}, normal_coefficient: c_d, "
        f"axial_area_m2: {skin:.6f}, axial_coefficient: c_f}}"
        for k in (1, 2, 3)
    ]
    text = ROBOT.format(
        c_d=c_d, c_f=c_f, free=str(free).lower(), lag=LAG_DEG,
        links="\n".join(links), elements="\n".join(elements),
    )  # fmt: skip
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def write(
    folder: Path,
    frequencies_hz: Sequence[float],
    *,
    duration_s: float = 4.0,
    steady_after_s: float = 0.0,
    held_out: Sequence[float] = (),
    spoiled: Mapping[float, Callable[[dict[str, np.ndarray]], None]] | None = None,
    amplitude_factor: float = 1.0,
    robot_file: str = "fish.yaml",
    name: str = "trials",
    seed: int = 3,
) -> Path:
    """Write logs and a trials file.

    Parameters
    ----------
    steady_after_s : float
        The record begins after so many seconds of swimming.
    spoiled : mapping of frequency to function, optional
        Mistakes in the records of single trials: each changes the columns in place.
    amplitude_factor : float
        Mistake in the trials file.
    """
    rng = np.random.default_rng(seed)
    fish = swimmer.eel(
        TRUTH, links=3, link_length_m=LINK_M, link_mass_kg=MASS_KG, height_m=HEIGHT_M, lag_deg=LAG_DEG
    )
    lines = []
    for frequency in frequencies_hz:
        drive = {"frequency_hz": frequency, "amplitude_deg": 25.0}
        run = swimmer.swim(fish, drive, steady_after_s + duration_s, rate_hz=20.0, rtol=1e-7)
        kept = run["t_s"] >= steady_after_s - 1e-9
        columns = {n: run[n][kept] + rng.normal(0.0, sd, kept.sum()) for n, sd in NOISE.items()}
        if spoiled and frequency in spoiled:
            spoiled[frequency](columns)
        log = f"{name}_{frequency:g}.csv"
        write_log(folder / log, {"t_s": run["t_s"][kept] - steady_after_s, **columns}, "%.6f")
        phase = np.degrees(2 * np.pi * frequency * steady_after_s) % 360.0
        role = ", role: validate" if frequency in held_out else ""
        lines.append(
            f"id: f{frequency:g}, log: {log}, drive: {{frequency_hz: {frequency}, "
            f"amplitude_deg: {25.0 * amplitude_factor}, phase_deg: {phase:.6f}}}{role}"
        )
    return write_trials(folder / f"{name}.yaml", "free-swim", robot_file, lines)
