"""Logs of rendered films of a pool, with known truth, by the command line."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from swimid.points.plane import plane_of
from swimid.results import evidence
from swimid.tracking import setup as setup_format
from tests.conftest import track
from tests.generators import pool_video
from tests.generators.pool_video import SEPARATION_M, Scene

PLAIN = Scene(duration_s=2.0, dropout_s=None)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """A film with noise, caustics, glare, drifting exposure, perspective and a dropout."""
    folder = tmp_path_factory.mktemp("pool")
    scene = Scene(duration_s=6.0, dropout_s=(3.0, 3.5))
    video, setup, truth = pool_video.write_scene(folder, scene)
    log = folder / "run.csv"
    output = track("video", video, "--setup", setup, "-o", log, "--overlay", folder / "overlay.mp4")
    return scene, folder, pd.read_csv(log, comment="#"), pd.read_csv(truth, comment="#"), output


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the path and the truth of a film of two seconds without a dropout."""
    video, _, truth = pool_video.write_scene(tmp_path_factory.mktemp("plain"), PLAIN)
    return video, pd.read_csv(truth, comment="#")


@pytest.fixture
def by_hand(tmp_path):
    """Return the setup of the plain film."""
    path = tmp_path / "hand.yaml"
    path.write_text(pool_video.setup_text(PLAIN))
    return path


def pixels_per_metre(scene, setup):
    ground = plane_of(setup_format.read(setup), scene.width, scene.height)
    return 1 / ground.size_of_pixel(scene.width / 2, scene.height / 2)


def test_position_and_heading_are_accurate(pool):
    """0.15 px rms over both axes together, 0.3 deg rms, in every frame that shows the markers."""
    scene, folder, log, truth, _ = pool
    seen = log.found == 1
    expected = ~truth.t_s.between(3.0, 3.4999)
    assert (seen == expected).all()
    scale = pixels_per_metre(scene, folder / "pool_setup.yaml")
    error = np.hypot(log.x_m - truth.x_m, log.y_m - truth.y_m)[seen]
    assert scale * np.sqrt(np.mean(error**2)) <= 0.15
    raw = np.hypot(log.x_raw_m - truth.x_m, log.y_raw_m - truth.y_m)[seen]
    assert scale * np.sqrt(np.mean(raw**2)) <= 0.2
    turn = np.degrees(np.angle(np.exp(1j * (log.yaw_rad - truth.yaw_rad))))[seen]
    assert np.sqrt(np.mean(turn**2)) <= 0.3


def test_speeds_are_accurate(pool):
    """Surge, sway and yaw rate agree with the truth, except near the dropout and the ends."""
    _, _, log, truth, _ = pool
    inner = (log.found == 1) & truth.t_s.between(0.3, 5.7) & ~truth.t_s.between(2.9, 3.6)
    for column, limit in (("u_m_s", 0.008), ("v_m_s", 0.008), ("yaw_rate_rad_s", 0.06)):
        assert np.sqrt(np.mean((log[column] - truth[column])[inner] ** 2)) < limit, column


def test_a_gap_is_interpolated_and_reported(pool):
    """The gap is within three standard deviations, is flagged, and is not reported as measured."""
    _, _, log, truth, output = pool
    gap = truth.t_s.between(3.0, 3.4999)
    assert (log.interpolated[gap] == 1).all()
    assert (log.found[gap] == 0).all()
    assert (log.status[gap] == "lost").all()
    assert log.red_x_px[gap].isna().all()
    assert log.x_raw_m[gap].isna().all()
    for column in ("x", "y", "yaw"):
        unit = "rad" if column == "yaw" else "m"
        error = log[f"{column}_{unit}"] - truth[f"{column}_{unit}"]
        if column == "yaw":
            error = np.angle(np.exp(1j * error))
        assert np.max(np.abs(error / log[f"{column}_sd_{unit}"])[gap]) < 3, column
    assert "found 165 of 180 frames" in " ".join(output.output.split())
    assert "SWM040" in output.output


def test_standard_deviations_agree_with_the_errors(pool):
    """Normalised errors of measured frames have a size of one, within a factor of 1.6."""
    _, _, log, truth, _ = pool
    seen = log.found == 1
    for column in ("x", "y"):
        size = np.sqrt(
            np.mean(((log[f"{column}_m"] - truth[f"{column}_m"]) / log[f"{column}_sd_m"])[seen] ** 2)
        )
        assert 0.5 < size < 1.6


def test_the_log_has_its_columns_and_its_evidence(pool):
    """The log has the columns that a fit reads; the evidence has checks, figures and frames."""
    _, folder, log, _, _ = pool
    assert list(log.columns[:7]) == ["t_s", "x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s"]
    for column in ("x_sd_m", "red_x_px", "yellow_area_px", "segment", "confidence", "red_status"):
        assert column in log
    proof = evidence.read(folder / "run.evidence.json")
    assert {c.name for c in proof.checks} >= {
        "Frames found",
        "Longest gap",
        "Marker separation",
        "Frame timing",
    }
    assert {f.id for f in proof.figures} == {"path", "pose", "speed"}
    assert 3 <= len(proof.images) <= 6
    assert (folder / "run.png").stat().st_size > 10_000
    assert (folder / "run.evidence.json").stat().st_size < 3_000_000


def test_speed_and_stroke_are_accurate(pool):
    """The table agrees with the scene; the nose, averaged over a stroke, is on a larger circle."""
    scene, folder, _, _, output = pool
    swim = scene.swims[0]
    table = evidence.read(folder / "run.evidence.json").tables[0]
    found = {row[0]: row[1:4] for row in table.rows}
    nose = np.hypot(swim.speed_m_s, swim.turn_rad_s * SEPARATION_M / 2)
    for name, truth, near in (
        ("steady speed", nose, 0.005),
        ("stroke frequency", swim.beat_hz, 0.01),
        ("yaw amplitude", np.degrees(swim.beat_rad), 0.01),
        ("sway amplitude", SEPARATION_M / 2 * swim.beat_rad, 0.03),
    ):
        value, low, high = found[name]
        assert value == pytest.approx(truth, rel=near), name
        assert low < value < high
    assert "speeds over" in " ".join(output.output.split())


def test_the_overlay_is_a_film_of_the_same_length(pool):
    """The overlay has one frame for each of the film, with a drawing in it."""
    _, folder, log, _, _ = pool
    capture = cv2.VideoCapture(str(folder / "overlay.mp4"))
    count = 0
    while capture.read()[0]:
        count += 1
    assert count == len(log)


@pytest.mark.slow
def test_a_variable_frame_rate_is_read_from_the_stamps(tmp_path):
    """Times equal the stamps to a tick, speeds are right, and a warning is given."""
    scene = Scene(duration_s=2.5, dropout_s=None, variable_rate=True)
    video, setup, truth_path = pool_video.write_scene(tmp_path, scene)
    output = track("video", video, "--setup", setup, "-o", tmp_path / "run.csv")
    log, truth = pd.read_csv(tmp_path / "run.csv", comment="#"), pd.read_csv(truth_path, comment="#")
    np.testing.assert_allclose(log.t_s, truth.t_s, atol=1e-4)
    inner = slice(10, -10)
    assert np.sqrt(np.mean((log.u_m_s - truth.u_m_s)[inner] ** 2)) < 0.01
    assert "SWM043" in output.output
    even = track("video", video, "--setup", setup, "-o", tmp_path / "even.csv", "--fps", "30")
    np.testing.assert_allclose(
        np.diff(pd.read_csv(tmp_path / "even.csv", comment="#").t_s), 1 / 30, atol=1e-9
    )
    assert "SWM043" not in even.output


@pytest.mark.slow
def test_equal_markers_keep_their_names_through_a_crossing(tmp_path):
    """Two robots of the same colours cross, and every marker keeps its name."""
    scene = pool_video.crossing()
    video, setup, _ = pool_video.write_scene(tmp_path, scene)
    track("video", video, "--setup", setup, "-o", tmp_path / "run.csv")
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    for body, number in ((0, 1), (1, 2)):
        truth = pool_video.motion(scene.swims[body], scene.times())
        for name, behind in (("red", 0.0), ("yellow", SEPARATION_M)):
            x = truth.x_m - behind * np.cos(truth.yaw_rad)
            y = truth.y_m - behind * np.sin(truth.yaw_rad)
            error = np.hypot(log[f"{name}{number}_x_m"] - x, log[f"{name}{number}_y_m"] - y)
            # other markers are 0.16 m away, and a half-hidden disc may be off by half a radius
            assert error.max() < 0.012, name
            assert error.notna().mean() > 0.75


def test_a_setup_without_scale_gives_pixels_and_a_warning(tmp_path, plain, by_hand):
    """Without a calibration no column is in metres, and y points up."""
    text = by_hand.read_text()
    start, end = text.index("scale:"), text.index("max_gap_s")
    by_hand.write_text(text[:start] + text[end:])
    output = track("video", plain[0], "--setup", by_hand, "-o", tmp_path / "run.csv")
    assert "SWM041" in output.output
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    assert not [c for c in log.columns if c.endswith(("_m", "_m_s"))]
    np.testing.assert_allclose(log.y_raw_px, PLAIN.height - 1 - log.red_y_px)


@pytest.mark.parametrize("kind", ["factor", "distance", "homography"])
def test_all_kinds_of_scale_agree(tmp_path, kind):
    """A factor, two points and four points of the same vertical view give the same metres."""
    scale = {
        "factor": {"metres_per_pixel": 0.002},
        "distance": {"points_px": [[100, 100], [100, 350]], "distance_m": 0.5},
        "homography": {
            "points_px": [[0, 479], [500, 479], [500, 79], [0, 79]],
            "points_m": [[0, 0], [1.0, 0], [1.0, 0.8], [0, 0.8]],
        },
    }[kind]
    rules = setup_format.Setup.model_validate(
        {
            "format": "swimid-setup/1",
            "markers": [{"name": "a", "hsv": {"hue_deg": [340, 20]}}],
            "scale": scale,
        }
    )
    ground = plane_of(rules, 640, 480)
    x, y = ground.to_world(np.array([0.0, 320.0, np.nan]), np.array([479.0, 100.0, 3.0]))
    np.testing.assert_allclose(x[:2], [0, 0.64], atol=1e-9)
    np.testing.assert_allclose(y[:2], [0, 0.758], atol=1e-9)
    assert np.isnan(x[2])
    back = ground.to_image(x, y)
    np.testing.assert_allclose(back[0][:2], [0, 320], atol=1e-6)


def test_lens_distortion_and_height_are_corrected():
    """Distorted points are mapped to those of a pin-hole camera; markers above the plane are scaled down."""
    matrix = [[600.0, 0, 320.0], [0, 600.0, 240.0], [0, 0, 1.0]]
    distortion = [-0.25, 0.08, 0.001, -0.0005, 0.0]
    rays = np.array([[-0.4, -0.3, 1], [0.3, 0.1, 1], [0.0, 0.0, 1]])
    seen = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.array(matrix), np.array(distortion))[
        0
    ].reshape(-1, 2)
    rules = setup_format.Setup.model_validate(
        {
            "format": "swimid-setup/1",
            "markers": [{"name": "a", "hsv": {"hue_deg": [340, 20]}}],
            "camera": {"matrix": matrix, "distortion": distortion, "size_px": [640, 480]},
            "scale": {"metres_per_pixel": 2.0 / 600, "heights": {"camera_m": 2.0, "marker_m": 0.05}},
        }
    )
    ground = plane_of(rules, 640, 480)
    x, y = ground.to_world(*seen.T)
    # the camera is 2 m above the plane, so that a marker 5 cm above the plane is at a distance of 1.95 m
    np.testing.assert_allclose(x - x[2], 1.95 * rays[:, 0], atol=2e-4)
    np.testing.assert_allclose(y - y[2], -1.95 * rays[:, 1], atol=2e-4)


def test_the_vertical_plane_has_z_and_pitch(tmp_path, plain, by_hand):
    """A vertical plane gives the columns of the sagittal plane."""
    by_hand.write_text(by_hand.read_text().replace("plane: horizontal", "plane: vertical"))
    track("video", plain[0], "--setup", by_hand, "-o", tmp_path / "run.parquet")
    names = pd.read_parquet(tmp_path / "run.parquet").columns
    assert list(names[:7]) == ["t_s", "x_m", "z_m", "pitch_rad", "u_m_s", "w_m_s", "pitch_rate_rad_s"]


@pytest.mark.slow
def test_a_proposed_setup_tracks_as_accurately_as_one_by_hand(tmp_path, plain, by_hand):
    """From the film alone both markers and the right head are found, with the same accuracy in pixels."""
    video, _ = plain
    proposed = tmp_path / "proposed.yaml"
    output = track("setup", video, "-o", proposed)
    assert "head red, tail yellow" in output.output
    assert (tmp_path / "proposed.markers.png").stat().st_size > 10_000
    track("video", video, "--setup", proposed, "-o", tmp_path / "a.csv")
    track("video", video, "--setup", by_hand, "-o", tmp_path / "b.csv")
    a, b = (pd.read_csv(tmp_path / f"{name}.csv", comment="#") for name in "ab")
    assert a.found.mean() == 1
    assert np.sqrt(np.mean((a.red_x_px - b.red_x_px) ** 2)) < 0.15
    track("setup", video, "-o", proposed, status=2)
    small, _, _ = pool_video.write_scene(tmp_path, replace(PLAIN, width=320, height=240, duration_s=1.0))
    track("setup", small, "-o", proposed, "--force", "--metres-per-pixel", "0.003")
    assert setup_format.read(proposed).scale.metres_per_pixel == 0.003


def test_a_marker_can_be_picked_by_hand(tmp_path, plain):
    """--marker needs no display. A grey pixel is refused, and the message states its colour."""
    video, truth = plain
    x, y = pool_video._Canvas(PLAIN).pixel(truth.x_m[0], truth.y_m[0])
    track("setup", video, "-o", tmp_path / "s.yaml", "--marker", f"nose@{x:.0f},{y:.0f}")
    rules = setup_format.read(tmp_path / "s.yaml")
    assert rules.marker_names == ["nose"]
    track("video", video, "--setup", tmp_path / "s.yaml", "-o", tmp_path / "run.csv")
    assert pd.read_csv(tmp_path / "run.csv", comment="#").found.mean() == 1
    bad = track("setup", video, "-o", tmp_path / "t.yaml", "--marker", "nose@9999,5", status=3)
    assert "outside the picture" in bad.output
    assert not (tmp_path / "t.yaml").exists()


def test_the_sample_film_is_small_and_can_be_tracked(tmp_path, samples):
    """The sample in the source has less than 2.5 MB."""
    video, setup, truth = (samples / "pool" / f"pool{end}" for end in (".mp4", "_setup.yaml", "_truth.csv"))
    assert video.stat().st_size < 2_500_000
    track("video", video, "--setup", setup, "-o", tmp_path / "run.csv")
    log, exact = pd.read_csv(tmp_path / "run.csv", comment="#"), pd.read_csv(truth, comment="#")
    seen = log.found == 1
    error = np.hypot(log.x_m - exact.x_m, log.y_m - exact.y_m)[seen]
    assert np.sqrt(np.mean(error**2)) < 0.0007


def test_a_scale_a_thousand_times_too_large_is_never_good(tmp_path, plain, by_hand):
    """Corners in millimetres that are stated as metres give a fish of 200 m/s."""
    text = by_hand.read_text()
    line = next(line for line in text.splitlines() if "points_m" in line)
    key, numbers = line.split(":", 1)
    points = [[1000 * float(x) for x in pair.split(",")] for pair in numbers.strip(" []").split("], [")]
    by_hand.write_text(text.replace(line, f"{key}: {points}"))
    output = track("video", plain[0], "--setup", by_hand, "-o", tmp_path / "run.csv")
    assert "SWM002" in output.output
    assert evidence.read(tmp_path / "run.evidence.json").verdict.level == "caution"
