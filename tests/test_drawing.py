"""What figures draw, by the data of matplotlib's artists; and a notebook that shows them."""

from __future__ import annotations

import os
import re
from pathlib import Path

import matplotlib as mpl
import nbformat
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from nbclient import NotebookClient
from pydantic import ValidationError

from swimid.results import drawing
from swimid.results import evidence as ev
from swimid.results.evidence import Figure, Heat, Mark, Panel, Span, Trace

ROOT = Path(__file__).parents[1]


def drawn(*traces: Trace, **panel: object) -> Axes:
    """Return the axes of a figure of one panel."""
    one = Panel(x_label="time (s)", y_label="x (m)", traces=list(traces), **panel)  # type: ignore[arg-type]
    return drawing.canvas([Figure(id="f", title="t", caption="c", panels=[one])]).axes[0]


def test_measured_points_lie_above_the_pale_line_of_their_model() -> None:
    x = np.linspace(0, 1, 30)
    axes = drawn(Trace(x=x, y=x**2, style="points", label="w10", group=4), Trace(x=x, y=x**2 + 0.01, group=4))
    points, line = axes.lines
    np.testing.assert_allclose(points.get_ydata(), x**2)
    np.testing.assert_allclose(line.get_ydata(), x**2 + 0.01)
    assert points.get_zorder() > line.get_zorder()
    assert points.get_color() == line.get_color()
    assert line.get_alpha() < 1
    assert axes.get_legend() is None  # one entry says nothing
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time (s)", "x (m)")


def test_a_figure_drawn_twice_is_the_same_text(tmp_path: Path) -> None:
    """The ids in an SVG file do not depend on the run, and those of two panels of a page differ."""
    traces = [Trace(x=[0.0, 1.0], y=[0.0, 1.0], style="points")]
    panels = [Panel(x_label="t", y_label=y, traces=traces) for y in "xy"]
    figure = Figure(id="f", title="t", caption="c", panels=panels)
    pages = [drawing.for_page(figure, "p") for _ in range(2)]
    assert pages[0] == pages[1]
    first, second = (set(re.findall(r'clipPath id="(\w+)"', text)) for text in pages[0])
    assert first
    assert second
    assert not first & second
    for name in "ab":
        drawing.write(tmp_path / f"{name}.svg", [figure], title="t")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_groups_have_colours_and_markers_of_their_own() -> None:
    traces = [Trace(x=[0.0, 1.0], y=[k, k], style="points", label=str(k), group=k) for k in range(6)]
    axes = drawn(*traces)
    assert len({(line.get_color(), line.get_marker()) for line in axes.lines}) == 6


def test_bands_marks_and_spans() -> None:
    axes = drawn(
        Trace(x=[0.0, 1.0], y=[1.0, 1.0], lower=[0.5, 0.5], upper=[1.5, 1.5], label="95 %"),
        marks=[Mark(at=0.7, label="limit")],
        spans=[Span(start=0.2, end=0.4, label="gap")],
    )
    vertices = axes.collections[0].get_paths()[0].vertices
    assert (vertices[:, 1].min(), vertices[:, 1].max()) == (0.5, 1.5)
    assert {text.get_text() for text in axes.get_legend().get_texts()} == {"95 %", "limit", "gap"}
    assert any(np.ptp(line.get_ydata()) == 0 and line.get_ydata()[0] == 0.7 for line in axes.lines)


def test_a_heat_map_says_each_number_and_shades_the_largest_most() -> None:
    heat = Heat(rows=["1 Hz", "2 Hz"], columns=["10", "20"], values=[[1.0, 2.0], [None, 4.0]], scale="linear")
    axes = drawn(heat=heat)
    assert [text.get_text() for text in axes.texts] == ["1", "2", "–", "4"]
    assert [patch.get_alpha() for patch in axes.patches] == pytest.approx([0.0, 0.55 / 3, 0.55])


@pytest.mark.parametrize(
    ("values", "scale", "alphas"),
    [
        ([[0.5, 1.0], [10.0, 100.0]], "log", [0.0, 0.0, 0.275, 0.55]),
        # cells up to three times the neutral number are pale
        ([[1.0, 1.5]], "log", [0.0, 0.55 * np.log(1.5) / np.log(3.0)]),
        ([[-1.0, 0.0, 3.0]], "linear", [0.0, 0.55 / 4, 0.55]),
        ([[2.0, 2.0]], "linear", [0.0, 0.0]),
        ([[None, None]], "linear", []),
    ],
)
def test_the_shade_of_a_heat_map(values: list[list[float]], scale: str, alphas: list[float]) -> None:
    rows, columns = (list("abc")[: len(names)] for names in (values, values[0]))
    axes = drawn(heat=Heat(rows=rows, columns=columns, values=values, scale=scale, neutral=1.0))
    assert [patch.get_alpha() for patch in axes.patches] == pytest.approx(alphas)


def test_lists_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValidationError, match="1 numbers of 'y' for 2 of 'x'"):
        Trace(x=[0.0, 1.0], y=[1.0])
    with pytest.raises(ValidationError, match="heat map"):
        Heat(rows=["a"], columns=["b", "c"], values=[[1.0]])


class Series:
    """A trial with residuals of a given size."""

    def __init__(self, trial: str, size: float, role: str = "fit") -> None:
        self.trial, self.role = trial, role
        self.time_s = np.linspace(0, 1, 50)
        self.simulated = self.time_s
        self.z_scores = size * np.cos(np.arange(50.0))
        self.measured = self.simulated + 0.01 * self.z_scores


def test_the_worst_the_best_and_the_worst_held_out_trial_are_shown() -> None:
    trials = [Series(f"t{k}", size) for k, size in enumerate((1.0, 3.0, 0.5, 2.0))]
    trials += [Series("v0", 1.0, "validate"), Series("v1", 4.0, "validate")]
    figure = ev.make_fit_figure("f", "t", "c", "x (m)", trials)
    assert [panel.title for panel in figure.panels] == [
        "t1 (largest error)",
        "t2 (smallest error)",
        "v1 (held out)",
    ]
    points, line = figure.panels[0].traces
    np.testing.assert_allclose(points.y, trials[1].measured)
    np.testing.assert_allclose(line.y, trials[1].simulated)


def test_residuals_have_one_row_for_each_trial() -> None:
    """A residual of 4 standard deviations reaches less than half a row."""
    trials = [Series("a", 1.0), Series("b", 50.0)]
    lags = np.arange(5)
    correlation = type("Correlation", (), {"lags": lags, "values": 0.1 * lags, "bound": 0.2 + 0.0 * lags})
    rows, lagged = ev.make_residual_figure("f", "t", "c", trials, correlation).panels
    assert rows.y_categories == ["a", "b"]
    for k, trace in enumerate(rows.traces):
        assert np.abs(np.array(trace.y) - k).max() < 0.5
    assert lagged.traces[0].x == [1.0, 2.0, 3.0, 4.0]


def test_the_twelve_trials_with_the_largest_residuals_are_shown() -> None:
    trials = [Series(f"t{k}", 1.0 + (7 * k) % 15) for k in range(15)]
    (rows,) = ev.make_residual_figure("f", "t", "c", trials, None).panels
    smallest = {f"t{k}" for k in range(15) if (7 * k) % 15 < 3}
    assert rows.y_categories == [f"t{k}" for k in range(15) if f"t{k}" not in smallest]
    assert len(rows.y_categories) == 12


def test_settings_of_the_user_stay() -> None:
    before = dict(mpl.rcParams)
    assert isinstance(drawing.canvas([_empty()]), Canvas)
    assert dict(mpl.rcParams) == before


def _empty() -> Figure:
    return Figure(id="f", title="t", caption="c", panels=[Panel(x_label="x", y_label="y")])


@pytest.mark.slow
def test_a_notebook_shows_pictures() -> None:
    """``plot`` at the end of a cell gives an image, as it does for a user of Jupyter."""
    cells = [
        "import swimid",
        "drag = swimid.fit_drag('sample_logs/rig/trials.yaml')\ndrag",
        "drag.plot('overlay-x_m')",
        "drag.plot('residuals-x_m')\n2 + 2",
    ]
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
    environment["PYTHONPATH"] = str(ROOT)
    client = NotebookClient(book, timeout=300, resources={"metadata": {"path": str(ROOT)}})
    client.execute(env=environment)
    shown = [[set(output.get("data", {})) for output in cell.outputs] for cell in book.cells]
    assert any("text/html" in kinds for kinds in shown[1])
    for outputs in shown[2:]:
        assert any("image/png" in kinds for kinds in outputs)


@pytest.mark.parametrize(("height", "aspect"), [(1.0, 1.0), (0.05, "auto")])
def test_a_path_is_drawn_to_scale_unless_it_is_flat(height: float, aspect: float | str) -> None:
    axes = drawn(Trace(x=[0.0, 1.0], y=[0.0, height]), equal_aspect=True)
    assert axes.get_aspect() == aspect
