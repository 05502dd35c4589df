"""Draw the pictures of the manuals into docs/figures: ``make demo pictures``. ``batch.png`` is a screenshot.

The results are those of ``make demo`` in ``demo_out``, and of short runs on the sample logs. The quick ones
are drawn anew for each site (``docs/make_site.py``). The drawings ``home``, ``rig``, ``markers`` and ``imu``
are written by hand.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

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
        axes.axhline(drag.derived.loc[f"terminal_speed[w{weight}]", "value"], color="0.7", lw=0.8, ls="--")
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


def main() -> None:
    """Draw all pictures."""
    for name, (file, figure) in FROM_THE_DEMO.items():
        draw(name, swimid.load_result(DEMO / file), figure)
    draw_quick(FIGURES)
    trials = SAMPLES / "tfish" / "trials.yaml"
    draw("sensitivity", swimid.sensitivity(trials, ranges=["20%"], samples=64), "indices")


if __name__ == "__main__":
    main()
