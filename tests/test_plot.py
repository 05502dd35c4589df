"""swimid plot: what is on the figures, in every kind of file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid.kinematics import plot
from swimid.logs import log
from tests.conftest import Ran
from tests.generators.polled_camera import polled

Run = Callable[..., Ran]


@pytest.fixture
def camera(tmp_path: Path) -> Path:
    made = polled(2, duration_s=20.0)
    t, x, y, yaw = np.array(made.rows).T
    log.write(tmp_path / "camera.csv", {"t_s": t, "x_m": x, "y_m": y, "yaw_rad": yaw})
    return tmp_path / "camera.csv"


@pytest.fixture
def imu(tmp_path: Path) -> Path:
    t = np.arange(0, 20, 0.01)
    log.write(
        tmp_path / "imu.csv",
        {"t_s": t, "yaw_rad": 0.2 * np.cos(2.4 * np.pi * t), "wz_rad_s": np.sin(2.4 * np.pi * t)},
    )
    return tmp_path / "imu.csv"


@pytest.mark.parametrize("ending,start", [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_every_kind_of_file(ending: str, start: bytes, camera: Path, swimid: Run, tmp_path: Path) -> None:
    out = tmp_path / f"plot.{ending}"
    ran = swimid("plot", camera, "-o", out, "--json")
    assert ran.status == 0, ran.err
    assert out.read_bytes()[: len(start)].lower() == start.lower()
    assert ran.json["result"]["figures"] == ["channels", "path", "spectra-camera"]
    assert out.stat().st_size < 3_000_000


def test_no_colour_stands_for_a_role_in_a_picture(camera: Path, swimid: Run, tmp_path: Path) -> None:
    swimid("plot", camera, "-o", tmp_path / "plot.svg")
    assert not re.search(r"#[ab]0000\d", (tmp_path / "plot.svg").read_text())


def test_gaps_are_shaded_and_not_drawn_across(camera: Path) -> None:
    figure = plot.channels([log.read(camera)])
    panel = figure.panels[0]
    assert [span.end - span.start for span in panel.spans] == pytest.approx([2.0], abs=0.1)
    gap = panel.spans[0]
    inside = [y for x, y in zip(panel.traces[0].x, panel.traces[0].y, strict=True) if gap.start < x < gap.end]
    assert inside == [None]


def test_arrows_point_along_the_heading(camera: Path) -> None:
    record = log.read(camera)
    figure = plot.track([record])
    assert figure is not None
    arrows = next(trace for trace in figure.panels[0].traces if trace.style == "arrows")
    assert arrows.x[0] == record["x_m"][0]
    assert np.arctan2(arrows.y[1] - arrows.y[0], arrows.x[1] - arrows.x[0]) == pytest.approx(
        record["yaw_rad"][0]
    )


def test_the_stroke_is_marked(camera: Path) -> None:
    figures = plot.figures_of([log.read(camera)])
    spectra = next(figure for figure in figures if figure.id.startswith("spectra"))
    marks = spectra.panels[0].marks
    assert marks[0].label == "stroke"
    assert marks[0].at == pytest.approx(1.2, abs=0.01)


def test_two_sensors_of_one_trial(camera: Path, imu: Path, swimid: Run, tmp_path: Path) -> None:
    ran = swimid("plot", imu, camera, "-o", tmp_path / "both.svg")
    assert ran.status == 0, ran.err
    figure = plot.channels([log.read(imu), log.read(camera)])
    assert figure.panels[0].y_label == "yaw (rad)"
    assert [trace.label for trace in figure.panels[0].traces] == ["imu.csv", "camera.csv"]
    assert [span.label for span in figure.panels[0].spans] == ["missing in camera.csv"]


def test_the_report_of_a_log_has_the_same_figures(camera: Path, swimid: Run, tmp_path: Path) -> None:
    ran = swimid("report", camera, "-o", tmp_path / "report.html")
    assert ran.status == 0, ran.err
    text = (tmp_path / "report.html").read_text()
    for title in ("Channels over time", "Path from above", "Spectra of camera.csv"):
        assert title in text


@pytest.mark.parametrize("name", ["plot.pdf", "plot"])
def test_other_endings_are_refused(name: str, camera: Path, swimid: Run, tmp_path: Path) -> None:
    ran = swimid("plot", camera, "-o", tmp_path / name)
    assert ran.status == 2
    assert ".svg or .png" in ran.err
