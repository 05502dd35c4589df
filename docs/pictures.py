"""Draw the pictures of the manuals into docs/figures: ``make demo pictures``. ``batch.png`` is a screenshot.

The results are those of ``make demo`` in ``demo_out``, and of short runs on the sample logs. The quick ones
are drawn anew for each site (``docs/make_site.py``). The drawings ``home``, ``rig``, ``markers`` and ``imu``
are written by hand. ``python docs/pictures.py FOLDER`` draws ``real-fish`` from the files that the commands
of ``docs/real-fish.md`` have written to a folder.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import swimid

ROOT = Path(__file__).parents[1]
DEMO, SAMPLES, FIGURES = ROOT / "demo_out", ROOT / "sample_logs", ROOT / "docs" / "figures"

#: Picture of a manual: result of the demo, figure of the result.
FROM_THE_DEMO = {
    "diagnose": ("gap.yaml", "waterfall"),
    "tracking": ("run.csv", "pose"),
    "fit-drag": ("drag.yaml", "overlay-x_m"),
    "fit-graybox": ("tfish.yaml", "overlay-x_m"),
    "fit-propulsion": ("propulsion.yaml", "speeds"),
    "compare": ("comparison.yaml", "overlay"),
    "rwls": ("arma.yaml", "free-run"),
}


def draw(name: str, result: swimid.Result, figure: str, folder: Path = FIGURES) -> None:
    """Draw one figure of a result, and write it as NAME.svg."""
    axes = result.plot(figure)
    first = axes[0] if isinstance(axes, list) else axes
    write(name, first.get_figure(root=True), folder)


def write(name: str, canvas: Figure, folder: Path) -> None:
    """Write a figure as NAME.svg, with the same bytes each time."""
    with plt.rc_context({"svg.hashsalt": "swimid"}):
        canvas.savefig(folder / f"{name}.svg", metadata={"Date": None})
    plt.close(canvas)


def draw_falls(folder: Path) -> None:
    """Draw the speed of falling weights over time, simulated with the drag of the sample logs."""
    drag = swimid.fit_drag(SAMPLES / "rig" / "trials.yaml")
    canvas, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    for weight in (10, 20, 40):
        run = swimid.simulate(params=drag, pulling_mass_kg=weight / 1000, duration_s=12).frame
        run = run[run["x_m"] <= 1.15]
        axes.plot(run["t_s"], run["u_m_s"], label=f"{weight} g")
        axes.axhline(drag.quantities.loc[f"terminal_speed[w{weight}]", "value"], color="0.7", lw=0.8, ls="--")
    axes.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0, None), ylim=(0, None))
    axes.legend(title="pulling mass", frameon=False, loc="upper right")
    write("falls", canvas, folder)


def draw_quick(folder: Path) -> None:
    """Draw the pictures that take a few seconds and need no other results."""
    draw_falls(folder)
    rules = ROOT / "docs" / "examples" / "camera.yaml"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)  # the sample has faults
        log = swimid.import_log(SAMPLES / "camera" / "polled.csv", map_path=rules)
    draw("import", log, "spectra-polled", folder)


#: Film of the fish that is drawn.
FILM = "f1_50"
#: Colours of the measurement, of the fitted films and of the others.
INK, BLUE, ORANGE = "#222222", "#2a6f97", "#d1495b"


def draw_fish(results: Path, folder: Path = FIGURES) -> None:
    """Draw the points of a real fish with its simulation over them, and the speeds of all films."""
    canvas, (left, right) = plt.subplots(
        1, 2, figsize=(9.6, 4.0), width_ratios=[1.25, 1], layout="constrained"
    )
    _draw_beat(left, results)
    _draw_speeds(right, results)
    write("real-fish", canvas, folder)


def _draw_beat(axes: Axes, results: Path) -> None:
    """Draw four moments of one beat: midline of the fish in the film, and of the simulated fish."""
    trials = yaml.safe_load((results / "fish" / "unseen.yaml").read_text())["trials"]
    entry = next(one for one in trials if one["id"] == FILM)
    drive = entry["drive"]
    film = swimid.read_log(results / "fish" / entry["log"]).frame
    beat = 1.0 / drive["frequency_hz"]
    run = swimid.simulate(params=results / "fish.yaml", duration_s=40, **drive).frame
    time, made = film["t_s"].to_numpy(), run["t_s"].to_numpy()
    # the beat in the middle of the film, and the simulated one with the same phase of the tail
    start = 0.5 * (time[-1] - beat)

    def phase(t: NDArray[np.float64], angle: NDArray[np.float64], since: float) -> float:
        turn = 2j * np.pi * (t - since) / beat
        rows = np.isfinite(angle) & (np.abs(t - since) < 1.5 * beat)
        return float(np.angle(np.mean((angle * np.exp(-turn))[rows])))

    begin = made[-1] - 2 * beat
    ahead = phase(time, film["joint1_rad"].to_numpy(), start)
    ahead -= phase(made, run["joint1_rad"].to_numpy(), begin)
    begin += (ahead / (2 * np.pi) % 1.0 - 1.0) * beat
    moments = np.arange(4) / 4 * beat
    body = yaml.safe_load((results / "fish" / "robot.yaml").read_text())["multilink"]["links"]
    lengths = [link["length_m"] for link in body]
    seen = np.array([_midline(film, lengths, start + one) for one in moments])
    lines = np.array([_midline(run, lengths, begin + one) for one in moments])
    # one rotation and one shift for all moments: where and in which direction the fish swims
    middle, of_film = lines.mean(), seen.mean()
    turn = np.vdot(lines - middle, seen - of_film)
    lines = (lines - middle) * turn / abs(turn)
    way = np.mean(seen[:, 0] - seen[:, 1])
    seen, lines = ((one * np.conj(way) / abs(way)) for one in (seen - of_film, lines))
    for k, (dots, line) in enumerate(zip(seen, lines, strict=True)):
        down = -0.15j * k
        for part, wide in enumerate((11, 7, 4)):
            link = (line + down)[part : part + 2]
            axes.plot(link.real, link.imag, color=ORANGE, lw=wide, alpha=0.4, solid_capstyle="round")
        axes.plot((dots + down).real, (dots + down).imag, "o-", ms=4.5, lw=1.2, color=INK)
        when = "start of a beat"
        if k:
            when = f"{k}/4 of a beat later"
        axes.annotate(when, (0.45, (dots + down).imag[0]), fontsize=8, color="0.4", va="center")
    axes.plot([], [], color=ORANGE, lw=9, alpha=0.4, label="simulated fish")
    axes.plot([], [], "o-", ms=4.5, lw=1.2, color=INK, label="real fish, from its film")
    axes.set(aspect="equal", xlabel="along the path (m)", yticks=[], xlim=(-0.3, 0.75), ylim=(-0.55, 0.14))
    axes.set_title(f"A held-out film, {drive['frequency_hz']:.4g} beats a second", fontsize=10)
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left", ncols=2, fontsize=8)


def _midline(log: pd.DataFrame, lengths: list[float], at_s: float) -> NDArray[np.complex128]:
    """Return the front end of each link of a fish, and the rear end of the last, at a time of a log."""
    names = ("x_m", "y_m", "yaw_rad", "joint1_rad", "joint2_rad")
    x, y, heading, *joints = (float(np.interp(at_s, log["t_s"], log[name])) for name in names)
    line = [x + 1j * y]
    for length, bend in zip(lengths, [*joints, 0.0], strict=True):
        line.append(line[-1] - length * np.exp(1j * heading))
        heading += bend
    return np.array(line)


def _draw_speeds(axes: Axes, results: Path) -> None:
    """Draw measured and simulated mean speeds over the beat."""
    rows = []
    for name, fitted in (("seen", True), ("unseen", False)):
        for trial in yaml.safe_load((results / f"{name}.yaml").read_text())["trials"]:
            speed = trial["mean_speed"]
            rows.append((trial["frequency_hz"], speed["measured"], speed["simulated"], fitted))
    rows.sort()
    beat, measured, simulated, fitted = (np.array(column) for column in zip(*rows, strict=True))
    axes.plot(beat, simulated, color="0.7", lw=1, zorder=0)
    axes.plot(beat, measured, "o", ms=8, mfc="none", mec=INK, label="measured")
    axes.plot(beat[fitted], simulated[fitted], "s", ms=5, color=BLUE, label="simulated, film fitted")
    axes.plot(beat[~fitted], simulated[~fitted], "D", ms=5, color=ORANGE, label="simulated, film held out")
    error = np.mean(np.abs(simulated - measured)[~fitted])
    axes.set_title(f"Mean error of the held-out films: {error:.4f} m/s", fontsize=10)
    axes.set(xlabel="tail beats a second", ylabel="swimming speed (m/s)", xlim=(0, None), ylim=(0, None))
    axes.spines[["right", "top"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left", fontsize=8)


def main() -> None:
    """Draw all pictures, or that of the real fish from the folder of its results."""
    if len(sys.argv) > 1:
        draw_fish(Path(sys.argv[1]))
        return
    for name, (file, figure) in FROM_THE_DEMO.items():
        draw(name, swimid.load_result(DEMO / file), figure)
    draw_quick(FIGURES)
    trials = SAMPLES / "tfish" / "trials.yaml"
    draw("sensitivity", swimid.sensitivity(trials, ranges=["20%"], samples=64), "indices")


if __name__ == "__main__":
    main()
