"""Draw the pictures of the manuals into docs/figures: ``make demo pictures``. ``batch.png`` is a screenshot.

The results are those of ``make demo`` in ``demo_out``, and of three short runs on the sample logs.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

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


def draw(name: str, result: swimid.Result, figure: str) -> None:
    """Draw one figure of a result, and write it as docs/figures/NAME.svg."""
    axes = result.plot(figure)
    first = axes[0] if isinstance(axes, list) else axes
    canvas = first.get_figure(root=True)
    canvas.savefig(FIGURES / f"{name}.svg", metadata={"Date": None})
    plt.close(canvas)


def main() -> None:
    """Draw all pictures."""
    plt.rcParams["svg.hashsalt"] = "swimid"
    for name, (file, figure) in FROM_THE_DEMO.items():
        draw(name, swimid.load_result(DEMO / file), figure)
    rules = ROOT / "docs" / "examples" / "camera.yaml"
    draw("import", swimid.import_log(SAMPLES / "camera" / "polled.csv", map_path=rules), "spectra-polled")
    trials = SAMPLES / "tfish" / "trials.yaml"
    draw("sensitivity", swimid.sensitivity(trials, ranges=["20%"], samples=64), "indices")


if __name__ == "__main__":
    main()
