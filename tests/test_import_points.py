"""``swimid import --points``: pose and joint angles from tracked points of films with known motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import swimid as package
from swimid.errors import InputError
from swimid.logs import log
from swimid.logs.log import Log
from swimid.results import parameters
from tests.conftest import Ran
from tests.generators import disc_film, point_films, swimmer, three_link
from tests.generators.point_films import PLACES, Film

Run = Callable[..., Ran]
Imported = Callable[..., tuple[Log, dict[str, Any]]]
NOISE_PX = [0.3, 0.5, 0.4, 1.0, 0.6, 0.7, 0.5, 0.3, 0.9, 0.8]
COLUMNS = ["x_m", "y_m", "yaw_rad", "joint1_rad", "joint2_rad", "joint3_rad", "joint4_rad"]
RATE_HZ = 60.0


@pytest.fixture
def imported(swimid: Run, tmp_path: Path) -> Imported:
    """Import a film with options; return the log and the result of the command."""

    def run(made: Film, *options: str | Path, sleap: bool = False) -> tuple[Log, dict[str, Any]]:
        write = point_films.write_sleap if sleap else point_films.write_deeplabcut
        path = write(made, tmp_path / "film.csv")
        words = ("--rate-hz", str(RATE_HZ), "-o", tmp_path / "run.csv", "--force", "--json")
        ran = swimid("import", path, *options, *words)
        assert ran.status == 0, ran.err
        return log.read(tmp_path / "run.csv"), ran.json["result"]

    return run


def _errors(record: Log, made: Film) -> dict[str, np.ndarray]:
    """Errors of all columns in their stated standard deviations; NaN where the log is empty."""
    rows = np.round(record.time_s * RATE_HZ).astype(int)
    truth = dict(zip(COLUMNS, [made.x, made.y, made.yaw, *made.joints.T], strict=False))
    found = {}
    for name in (name for name in COLUMNS if name in record):
        off = record[name] - truth[name][rows]
        if name.endswith("_rad"):
            off = (off + np.pi) % (2 * np.pi) - np.pi
        stem, _, unit = name.rpartition("_")
        found[name] = off / record[f"{stem}_sd_{unit}"]
    return found


def _check_coverage(errors: dict[str, np.ndarray]) -> None:
    """95 % intervals cover 92 to 98 % of the frames. With 600 frames three standard errors are 2.7 %."""
    for name, error in errors.items():
        known = error[np.isfinite(error)]
        assert 0.92 <= np.mean(np.abs(known) < 1.96) <= 0.98, name
        # a normal error exceeds five deviations in one of a million samples; a joint turned by half a turn
        # exceeds fifty
        assert np.max(np.abs(known)) < 6.0, name


@pytest.mark.slow
@pytest.mark.parametrize("sleap", [False, True], ids=["deeplabcut", "sleap"])
def test_pose_joints_and_faults(sleap: bool, imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=3, missing=0.05, strays=0.02, swaps=0.01, merges=0.005, noise_px=NOISE_PX)
    places = point_films.write_points(tmp_path / "points.yaml")
    record, result = imported(made, "--robot", "tfish", "--points", places, sleap=sleap)
    assert len(record) == 600
    assert list(record.columns)[1 : 1 + len(COLUMNS)] == COLUMNS
    _check_coverage(_errors(record, made))
    found = result["points"]
    # 600 frames give each noise to about 1 / sqrt(2 * 600) = 3 %, fewer where the leverage is large
    noise = np.array([found["noise_px"][name] for name in made.names])
    assert np.allclose(noise, NOISE_PX, rtol=0.15)
    scale = found["scale"]
    assert abs(scale["value"] - 1 / 1500) < 3 * scale["stderr"]
    assert scale["stderr"] < 1e-4 * scale["value"]
    # Strays of 15 px or more lie beyond the threshold of about 5.5 deviations of 1 px. A stray that lands on
    # another point is named as merged.
    named = {(one["fault"], f, tuple(one["points"])) for one in found["left_out"] for f in one["frames"]}
    true = {(kind, f, names) for kind, faults in made.faults.items() for f, names in faults}
    assert {(f, n) for _, f, names in true for n in names if _ == "exchanged"} <= {
        (f, n) for _, f, names in named for n in names
    }
    assert len(true) > 100
    assert len(named - true) <= 0.02 * len(true)
    assert len(true - named) <= 0.02 * len(true)
    assert {kind for kind, _, _ in named} == {"exchanged", "merged", "stray"}
    rows = [f for _, f, names in true if _ == "stray" and names == ("snout",)]
    assert np.isnan(record["snout_x_px"][rows]).mean() > 0.9
    # the sides of the polygon of links move with 1.2 Hz
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=0.005)


def test_warnings_name_points_and_frames(swimid: Run, tmp_path: Path) -> None:
    made = point_films.film(seed=5, frames=200)
    for side in (made.column, made.row):
        side[40:43, [0, 3]] = side[40:43, [3, 0]]
    made.row[70, 8] += 60.0
    path = point_films.write_deeplabcut(made, tmp_path / "film.csv")
    places = point_films.write_points(tmp_path / "points.yaml")
    ran = swimid(
        "import", path, "--rate-hz", "60", "--robot", "tfish", "--points", places, "-o", tmp_path / "run.csv"
    )
    assert ran.status == 0, ran.err
    assert "SWM120" in ran.err
    assert "exchanged labels, corrected 3 ×: snout and back 3 × (frames 40, 41, 42)" in ran.err
    assert "labels far from their points, left out 1 ×: web 1 × (frame 70)" in ran.err
    assert "3 exchanged, 1 stray" in " ".join(ran.out.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "share"), [(("hip", "tip"), 0.7), pytest.param(("snout", "back"), 1.0, marks=pytest.mark.slow)]
)
def test_labels_exchanged_in_most_frames(
    pair: tuple[str, str], share: float, imported: Imported, tmp_path: Path
) -> None:
    """The distances on the robot tell in which frames two labels are right."""
    made = point_films.film(seed=37, frames=200)
    wrong = np.random.default_rng(2).random(200) < share
    i, j = (made.names.index(name) for name in pair)
    for side in (made.column, made.row):
        side[np.ix_(wrong, [i, j])] = side[np.ix_(wrong, [j, i])]
    places = point_films.write_points(tmp_path / "points.yaml")
    record, result = imported(made, "--robot", "tfish", "--points", places)
    (fault,) = [one for one in result["points"]["left_out"] if one["fault"] == "exchanged"]
    assert fault["points"] == list(pair)
    assert fault["frames"] == np.flatnonzero(wrong).tolist()
    errors = _errors(record, made)
    for name in ("x_m", "y_m", "yaw_rad", "joint2_rad"):
        assert np.sqrt(np.nanmean(errors[name] ** 2)) == pytest.approx(1.0, abs=0.35), name
    assert max(result["points"]["noise_px"].values()) < 1.0


def test_exchanged_labels_are_exchanged_back(imported: Imported, tmp_path: Path) -> None:
    """Labels that are exchanged in many frames in a row, on links with one point each."""
    made = point_films.film(
        seed=41, frames=200, places=HINGES | {"back": PLACES["back"], "eye": PLACES["eye"]}
    )
    before = [side.copy() for side in (made.column, made.row)]
    at = [made.names.index(name) for name in ("heel", "tip")]
    for side in (made.column, made.row):
        side[60:140, at] = side[60:140, at[::-1]]
    places = {name: PLACES[name] for name in made.names}
    points = point_films.write_points(tmp_path / "points.yaml", places)
    record, result = imported(made, "--robot", "tfish", "--points", points)
    [fault] = result["points"]["left_out"]
    assert (fault["fault"], fault["points"], len(fault["frames"])) == ("exchanged", ["heel", "tip"], 80)
    errors = _errors(record, made)
    for name in COLUMNS:
        assert np.isfinite(record[name]).all(), name
        assert np.abs(errors[name]).max() < 5, name
    np.testing.assert_allclose(record["tip_x_px"], before[0][:, at[1]], atol=1e-3)


def test_a_bend_that_the_points_leave_open_is_empty(imported: Imported, tmp_path: Path) -> None:
    """Without knee, heel and ankle the tail bends to either side; no wrong bend has a small deviation."""
    made = point_films.film(seed=43, frames=300, amplitudes_deg=(15.0, 20.0, 25.0, 30.0))
    hidden = [made.names.index(name) for name in ("hip", "knee", "heel", "ankle")]
    for side in (made.column, made.row):
        side[100:200, hidden] = np.nan
    points = point_films.write_points(tmp_path / "points.yaml")
    record, _ = imported(made, "--robot", "tfish", "--points", points)
    errors = _errors(record, made)
    for name in COLUMNS:
        known = np.isfinite(record[name])
        assert known[:100].all(), name
        assert np.abs(errors[name][known]).max() < 6, name


@pytest.mark.slow
def test_a_mirrored_picture_is_bad(swimid: Run, tmp_path: Path) -> None:
    made = point_films.film(seed=47, frames=200)
    made.row = 1500.0 - made.row
    film = point_films.write_deeplabcut(made, tmp_path / "film.csv")
    points = point_films.write_points(tmp_path / "points.yaml")
    words = ("--rate-hz", "60", "--robot", "tfish", "--points", points, "-o", tmp_path / "run.csv")
    ran = swimid("import", film, *words, "--json")
    assert ran.json["verdict"]["level"] == "bad"
    assert "the picture is mirrored" in ran.err


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_perspective_is_named(tilt: float, imported: Imported, tmp_path: Path) -> None:
    """A picture whose scale changes from one side to the other, and one whose scale does not."""
    made = point_films.film(seed=53, frames=300, rate_hz=30.0)
    middle = made.column.mean()
    nearer = 1.0 + tilt * (made.column - middle) / np.ptp(made.column)
    made.column, made.row = middle + (made.column - middle) / nearer, made.row / nearer
    points = point_films.write_points(tmp_path / "points.yaml")
    _, result = imported(made, "--robot", "tfish", "--points", points)
    assert (result["points"]["perspective"] > 0.02) == bool(tilt)
    assert ("change by" in result["verdict"]["text"]) == bool(tilt)


def test_the_noise_follows_the_likelihood(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=8, noise_px=0.4, likelihood_slope=2.0)
    places = point_films.write_points(tmp_path / "points.yaml")
    record, result = imported(made, "--robot", "tfish", "--points", places)
    # likelihoods between 0.62 and 1 change the noise by a factor of 2.6
    assert 1.4 < result["points"]["likelihood_exponent"] < 2.6
    _check_coverage(_errors(record, made))


@pytest.mark.slow
def test_a_wrong_place_is_named(swimid: Run, imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=11, frames=300)
    wrong = dict(PLACES) | {"gill": ("head", -0.11, -0.04), "hip": ("tail1", -0.015, 0.018)}
    places = point_films.write_points(tmp_path / "points.yaml", wrong)
    _, result = imported(made, "--robot", "tfish", "--points", places)
    bad = [one for one in result["points"]["distances"] if one["wrong"]]
    # all pairs with the gill; the hip is the only point of its link
    assert sorted(tuple(sorted(one["names"])) for one in bad) == [
        ("back", "gill"),
        ("eye", "gill"),
        ("gill", "snout"),
    ]
    pair = next(one for one in bad if "snout" in one["names"])
    assert pair["stated"] == pytest.approx(np.hypot(0.11, 0.04))
    assert pair["measured"] == pytest.approx(np.hypot(0.12, 0.04), abs=3 * pair["stderr"] + 1e-5)
    assert result["points"]["misplaced"] == ["gill", "hip"]
    assert result["verdict"]["level"] == "caution"
    assert "snout and gill" in result["verdict"]["text"]


@pytest.mark.slow
def test_a_wrong_scale_is_named(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=11, frames=300)
    stated = "scale: {metres_per_pixel: 0.00068}"  # 2 % too large
    places = point_films.write_points(tmp_path / "points.yaml", extra=stated)
    _, result = imported(made, "--robot", "tfish", "--points", places)
    head = next(one for one in result["points"]["distances"] if one["names"] == ["snout", "back"])
    assert head["wrong"]
    assert head["measured"] / head["stated"] == pytest.approx(1.02, abs=0.001)


def test_missing_points_are_bridged_and_what_is_unknown_stays_empty(
    imported: Imported, tmp_path: Path
) -> None:
    made = point_films.film(seed=13, frames=300, noise_px=0.4)
    at = {name: k for k, name in enumerate(made.names)}
    for side in (made.column, made.row):
        side[50:80, [at["snout"], at["back"]]] = np.nan  # eye and gill show the head
        side[100:130, [at["web"], at["tip"]]] = np.nan  # nothing shows the fin
        side[200:210] = np.nan
    places = point_films.write_points(tmp_path / "points.yaml")
    record, result = imported(made, "--robot", "tfish", "--points", places)
    for name in COLUMNS[:6]:
        assert np.isfinite(record[name][:200]).all(), name
    assert np.isnan(record["joint4_rad"][100:130]).all()
    assert np.isfinite(record["joint4_rad"][:100]).all()
    frames = np.round(record.time_s * RATE_HZ).astype(int)
    assert not np.isfinite(record["x_m"][(frames >= 200) & (frames < 210)]).any()
    assert result["points"]["empty"] == {**dict.fromkeys(COLUMNS[:6], 10), "joint4_rad": 40}
    errors = _errors(record, made)
    for name in ("yaw_rad", "x_m"):
        assert np.sqrt(np.mean(errors[name][50:80] ** 2)) == pytest.approx(1.0, abs=0.4)


CHAIN = {
    "nose": ("head", 0.0, 0.0),
    "mid": ("head", -0.2, 0.0),
    "joint": ("rear", -0.11, 0.0),
    "tip": ("fin", -0.09, 0.0),
}
RODS = {"head": 0.2, "rear": 0.11, "fin": 0.09}


@pytest.mark.slow
def test_a_chain_needs_no_robot(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(
        seed=17, lengths=RODS, places=CHAIN, amplitudes_deg=(12, 20), noise_px=0.6, strays=0.01
    )
    (tmp_path / "chain.yaml").write_text(
        "chain: [nose, mid, joint, tip]\nscale: {metres_per_pixel: 0.0006666666666666667}\n"
    )
    record, result = imported(made, "--points", tmp_path / "chain.yaml")
    assert "joint2_rad" in record
    assert "joint3_rad" not in record
    _check_coverage(_errors(record, made))
    for name, length in zip(("nose_to_mid", "mid_to_joint", "joint_to_tip"), RODS.values(), strict=True):
        one = result["points"]["estimated"][f"length {name.replace('_', ' ')}"]
        assert abs(one["value"] - length) < 3 * one["stderr"]
    pixels = tmp_path / "pixels.yaml"
    pixels.write_text("chain: [nose, mid, joint, tip]\n")
    record, _ = imported(made, "--points", pixels)
    assert np.nanmax(np.abs(record["x_px"] - 1500 * made.x)) < 5
    assert "x_m" not in record


def test_two_points_give_a_heading(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=19, noise_px=0.5, missing=0.02)
    (tmp_path / "heading.yaml").write_text("chain: [snout, back]\n")
    record, _ = imported(made, "--points", tmp_path / "heading.yaml")
    # the back is 10 mm to port of the axis
    offset = np.arctan2(0.01, 0.22)
    off = (record["yaw_rad"] + offset - made.yaw + np.pi) % (2 * np.pi) - np.pi
    z = off / record["yaw_sd_rad"]
    assert 0.92 <= np.mean(np.abs(z[np.isfinite(z)]) < 1.96) <= 0.98
    assert "joint1_rad" not in record


@pytest.mark.slow
@pytest.mark.parametrize(
    "stated",
    [
        "scale: {metres_per_pixel: 0.0006666666666666667}",
        "scale: {between: [snout, back], distance_m: 0.2202271554554524}",
        "scale: {points_px: [[0, 0], [1500, 0]], distance_m: 1.0}",
        "scale: {points_px: [[0, 0], [1500, 0], [1500, 900], [0, 900]], "
        "points_m: [[0, 0], [1, 0], [1, -0.6], [0, -0.6]]}",
        "scale: {metres_per_pixel: 0.0005, refraction: 1.3333333333333333}",
    ],
    ids=["factor", "tracked points", "two points", "homography", "refraction"],
)
def test_stated_scales(stated: str, imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=23, frames=240)
    places = point_films.write_points(tmp_path / "points.yaml", extra=stated)
    record, result = imported(made, "--robot", "tfish", "--points", places)
    errors = _errors(record, made)
    for name in ("x_m", "y_m", "yaw_rad"):
        assert np.sqrt(np.mean(errors[name] ** 2)) == pytest.approx(1.0, abs=0.35), name
    assert not [one for one in result["points"]["distances"] if one["wrong"]]


@pytest.mark.slow
def test_places_are_calibrated(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=29, frames=300, noise_px=0.3)
    rng = np.random.default_rng(4)
    moved = {
        name: (link, x + 0.003 * np.cos(turn), y + 0.003 * np.sin(turn))
        for (name, (link, x, y)), turn in zip(PLACES.items(), rng.uniform(0, 2 * np.pi, 10), strict=True)
    }
    places = point_films.write_points(tmp_path / "points.yaml", moved)
    _, result = imported(made, "--robot", "tfish", "--points", places, "--calibrate-points")
    found = result["points"]["estimated"]
    for name, (_, *true) in PLACES.items():
        for axis, value in zip("xy", true, strict=True):
            one = found[f"{name} {axis}"]
            assert abs(one["value"] - value) < 3 * one["stderr"] + 1e-6, (name, axis)
    # joints at both ends fix the frame of a tail link; a rotation of the fin about its only joint stays open
    assert found["hip y"]["stderr"] < 0.0003
    assert found["tip y"]["stderr"] > 0.001


HINGES = {name: PLACES[name] for name in ("snout", "hip", "knee", "heel", "tip")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("places", "degrees", "weak"),
    [
        pytest.param(HINGES, (9, 11, 13, 18), {"snout": "x", "hip": "x", "knee": "x"}, id="one on each link"),
        pytest.param(HINGES, (25, 25, 25, 30), {}, id="larger angles"),
        pytest.param(PLACES, (9, 11, 13, 18), {}, id="two on a link"),
        pytest.param(PLACES, (0, 0, 13, 18), {"hip": "y"}, id="still joints"),
    ],
)
def test_places_that_the_film_does_not_determine(
    places: point_films.Places, degrees: tuple[float, ...], weak: dict[str, str], swimid: Run, tmp_path: Path
) -> None:
    """With one point on each link, all of them may move along a body that bends little."""
    made = point_films.film(seed=102, frames=300, noise_px=0.3, places=places, amplitudes_deg=degrees)
    rng = np.random.default_rng(2)
    moved = {
        name: (link, x + 0.003 * np.cos(turn), y + 0.003 * np.sin(turn))
        for (name, (link, x, y)), turn in zip(
            places.items(), rng.uniform(0, 2 * np.pi, len(places)), strict=True
        )
    }
    film = point_films.write_deeplabcut(made, tmp_path / "film.csv")
    scale = "scale: {metres_per_pixel: 0.0006666666666666667}"
    points = point_films.write_points(tmp_path / "points.yaml", moved, extra=scale)
    words = ("--rate-hz", "60", "--robot", "tfish", "--points", points, "--calibrate-points")
    ran = swimid("import", film, *words, "-o", tmp_path / "run.csv", "--json")
    found = ran.json["result"]["points"]["undetermined"]
    assert all(axis in found.get(name, "") for name, axis in weak.items())
    said = "the film does not determine these coordinates"
    assert (said in ran.err) == bool(weak)
    assert (said in ran.json["result"]["verdict"]["text"]) == bool(weak)
    if not weak:
        assert found == {}
        estimated = ran.json["result"]["points"]["estimated"]
        off = [
            (estimated[f"{name} {axis}"]["value"] - value) / estimated[f"{name} {axis}"]["stderr"]
            for name, (_, *true) in places.items()
            for axis, value in zip("xy", true, strict=True)
        ]
        assert np.abs(off).max() < 4


BAD = [
    (
        "points: {nose: {link: head, at_m: [0, 0]}}",
        ("--robot", "tfish"),
        3,
        "the point 'nose' is not in film.csv",
    ),
    (
        "points: {snout: {link: tale1, at_m: [0, 0]}, tip: {link: fin, at_m: [0, 0]}}",
        ("--robot", "tfish"),
        3,
        "the robot has no link 'tale1'",
    ),
    ("points: {snout: {link: head, at_m: [0]}}", ("--robot", "tfish"), 3, "at_m"),
    ("points: {snout: {link: head, at_mm: [0, 0]}}", ("--robot", "tfish"), 3, "unknown key 'at_mm'"),
    ("points: {snout: {link: head, at_m: [0, 0]}}", (), 2, "name it with --robot"),
    ("chain: [snout]", (), 3, "chain has only 'snout'; name two points"),
    ("chain: [snout, snout]", (), 3, "is listed twice"),
    ("chain: [snout, back]", ("--robot", "tfish"), 3, "a chain describes a body without a robot"),
    ("chain: [snout, back]\npoints: {tip: {link: fin, at_m: [0, 0]}}", (), 3, "not both"),
    ("chain: [snout, back]\nscale: {between: [snout, back]}", (), 3, "'between' needs distance_m"),
    ("chain: [snout, back]\nscale: {distance_m: 0.1}", (), 3, "the scale is incomplete"),
    ("chain: [snout, back]\nfacing: left", (), 3, "vertical plane"),
    ("chain: [snout, back]", ("--calibrate-points",), 2, "--robot"),
    ("{}", ("--robot", "tfish"), 3, "places no points"),
    ("{}", ("--robot", "boxfish"), 3, "no 'multilink' part"),
    (
        "points: {snout: {link: head, at_m: [0, 0]}, tip: {link: fin, at_m: [0, 0]}}",
        ("--robot", "tfish"),
        3,
        "do not determine the scale",
    ),
]


@pytest.mark.parametrize(("text", "options", "status", "said"), BAD, ids=[case[3] for case in BAD])
def test_bad_points_files(
    text: str, options: tuple[str, ...], status: int, said: str, swimid: Run, tmp_path: Path
) -> None:
    path = point_films.write_deeplabcut(point_films.film(frames=60), tmp_path / "film.csv")
    (tmp_path / "points.yaml").write_text(text + "\n")
    words = ("--points", tmp_path / "points.yaml", *options, "--rate-hz", "60", "-o", tmp_path / "run.csv")
    ran = swimid("import", path, *words)
    assert ran.status == status, ran.err
    assert said in ran.err
    assert not (tmp_path / "run.csv").exists()
    assert len(ran.err.splitlines()) <= 3  # one error and its hint


def test_errors_name_the_line(swimid: Run, tmp_path: Path) -> None:
    path = point_films.write_deeplabcut(point_films.film(frames=60), tmp_path / "film.csv")
    wrong = dict(PLACES) | {"hip": ("tail9", -0.015, 0.012)}
    places = point_films.write_points(tmp_path / "points.yaml", wrong)
    words = ("--robot", "tfish", "--points", places, "--rate-hz", "60", "-o", tmp_path / "run.csv")
    ran = swimid("import", path, *words)
    assert ran.status == 3
    assert "points.yaml, line 7, 'points.hip.link': the robot has no link 'tail9'" in ran.err


@pytest.mark.slow
def test_body_wave(imported: Imported, tmp_path: Path) -> None:
    made = point_films.film(seed=31, noise_px=0.3, turn_rad_s=0.0)
    places = point_films.write_points(tmp_path / "points.yaml")
    _, result = imported(made, "--robot", "tfish", "--points", places)
    wave = result["wave"]
    assert np.allclose(wave["stations_m"], [0, 0.27, 0.302, 0.334, 0.366, 0.466])
    # the truth: a sine of 1.2 Hz fitted to the lateral motion of the hinges, in the axes of the course
    turn = 2 * np.pi * 1.2 * made.time
    design = np.column_stack([np.cos(turn), np.sin(turn), np.ones(len(turn)), made.time])
    x, y, heading = made.x, made.y, made.yaw
    waves = []
    for k, length in enumerate([*point_films.TFISH.values(), 0.0]):
        a, b, *_ = np.linalg.lstsq(design, -np.sin(0.4) * x + np.cos(0.4) * y, rcond=None)[0]
        waves.append(a - 1j * b)
        if k and k < 5:
            heading = heading + made.joints[:, k - 1]
        x, y = x - length * np.cos(heading), y - length * np.sin(heading)
    waves = np.array(waves)
    low, high = np.array(wave["amplitude_ci95"]).T
    # twice the half-width of a 95 % interval of Student's t with four degrees of freedom: 0.5 % of six
    assert (np.abs(wave["amplitude_m"] - np.abs(waves)) < high - low).all()
    lag = np.angle(waves[-1] * np.conj(waves))
    off = (np.array(wave["phase_rad"]) - lag + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off[1:]).max() < 0.1
    weight, behind = np.abs(waves) ** 2, np.array(wave["stations_m"])
    off = weight * (behind - weight @ behind / weight.sum())
    length = 2 * np.pi / (-off @ np.unwrap(np.angle(waves)) / (off @ behind))
    short, long = wave["wavelength_ci95"]
    assert abs(wave["wavelength_m"] - length) < long - short
    assert wave["wavelength_m"] * 1.2 == pytest.approx(wave["wave_speed_m_s"], rel=0.01)


@pytest.mark.parametrize("facing", ["right", "left"])
def test_the_vertical_plane(facing: str, imported: Imported, tmp_path: Path) -> None:
    """A film from the side: heights, pitch, and a picture that is mirrored if the robot faces left."""
    rods = dict.fromkeys(("link1", "link2", "link3"), 0.12)
    points = {
        "nose": ("link1", 0.0, 0.0),
        "back": ("link1", -0.08, 0.03),
        "hip": ("link2", -0.10, 0.01),
        "tip": ("link3", -0.11, 0.0),
    }
    made = point_films.film(
        seed=41, frames=240, lengths=rods, places=points, amplitudes_deg=(12, 20), noise_px=0.4
    )
    if facing == "left":
        made.column = -made.column
    robot = three_link.robot(tmp_path)
    robot.write_text(robot.read_text().replace("plane: horizontal", "plane: vertical"))
    stated = f"facing: {facing}\nscale: {{metres_per_pixel: 0.0006666666666666667}}"
    places = point_films.write_points(tmp_path / "points.yaml", points, stated)
    record, _ = imported(made, "--robot", robot, "--points", places)
    for name, truth in (
        ("x_m", made.x),
        ("z_m", made.y),
        ("pitch_rad", made.yaw),
        ("joint2_rad", made.joints[:, 1]),
    ):
        stem, _, unit = name.rpartition("_")
        z = (record[name] - truth) / record[f"{stem}_sd_{unit}"]
        # 240 frames: the root mean square is known to 5 %
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2), name


@pytest.mark.slow
def test_the_log_is_fitted_without_an_edit(swimid: Run, imported: Imported, tmp_path: Path) -> None:
    """Films of the independent simulator become logs, which a gray-box fit takes as they are."""
    truth = {**swimmer.TFISH, "c_ma": 1.0, "c_Ia": 1.45, "c_d0": 4.1, "c_d13": 0.5}
    places = point_films.write_points(tmp_path / "points.yaml")
    rows = ["format: swimid-trials/1", "experiment: free-swim", "robot: tfish", "trials:"]
    for k, (frequency, amplitude, bias) in enumerate([(1.0, 30, 10), (1.6, 25, -10)]):
        drive = {"frequency_hz": frequency, "amplitude_deg": amplitude, "bias_deg": bias}
        run = swimmer.simulate("tfish", truth, drive, 5.0, rate_hz=RATE_HZ, rtol=1e-6)
        joints = np.column_stack([run[f"joint{j}_rad"] for j in range(1, 5)])
        motion = (run["t_s"], run["x_m"] + 0.6, run["y_m"] - 0.5, run["yaw_rad"], joints)
        made = point_films.film(seed=37 + k, motion=motion, missing=0.02, strays=0.005)
        imported(made, "--robot", "tfish", "--points", places)
        (tmp_path / "run.csv").rename(tmp_path / f"run{k}.csv")
        rows.append(f"  - {{log: run{k}.csv, drive: {{{', '.join(f'{n}: {v}' for n, v in drive.items())}}}}}")
    (tmp_path / "trials.yaml").write_text("\n".join(rows) + "\n")
    out = tmp_path / "fit.yaml"
    ran = swimid("fit-graybox", tmp_path / "trials.yaml", "-o", out)
    assert ran.status == 0, ran.err
    fit = parameters.read(out)
    assert {"x_m", "y_m", "yaw_rad", "joint4_rad"} <= set(fit.fit.channels)
    for name in ("c_ma", "c_Ia", "c_d0"):
        one = fit.parameters[name]
        assert one.status == "estimated"
        assert abs(one.value - truth[name]) < 3.5 * one.stderr, name


MARKERS = {
    "red": ("link1", -0.015, 0.0),
    "yellow": ("link1", -0.09, 0.0),
    "green": ("link2", -0.10, 0.0),
    "magenta": ("link3", -0.10, 0.0),
}
COLOURS = {"red": (38, 38, 205), "yellow": (45, 200, 225), "green": (60, 190, 60), "magenta": (190, 50, 190)}
MARKER_SETUP = """format: swimid-setup/1
markers:
  - {name: red, hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}}
  - {name: yellow, hsv: {hue_deg: [40, 75], saturation: [0.4, 1], value: [0.35, 1]}}
  - {name: green, hsv: {hue_deg: [100, 140], saturation: [0.4, 1], value: [0.35, 1]}}
  - {name: magenta, hsv: {hue_deg: [285, 320], saturation: [0.4, 1], value: [0.35, 1]}}
head: red
tail: yellow
scale: {metres_per_pixel: 0.001}
"""


def _marker_film(folder: Path) -> tuple[Path, dict[str, np.ndarray]]:
    """Write a film of markers on three links, and its robot; return the robot and the true columns."""
    time = np.arange(66) / 30.0
    turn = 2 * np.pi * 1.5 * time
    joints = np.radians(20) * np.column_stack([np.sin(turn), np.sin(turn - 1.2)])
    motion = (time, 0.40 + 0.02 * time, -0.16 + 0.01 * np.sin(turn), 0.1 * np.sin(turn + 0.5), joints)
    rods = dict.fromkeys(("link1", "link2", "link3"), 0.12)
    made = point_films.film(motion=motion, lengths=rods, places=MARKERS, pixels_per_m=1000.0, noise_px=0.0)

    def at(k: int) -> Callable[[float], tuple[float, float]]:
        return lambda t: (made.column[round(30 * t), k], made.row[round(30 * t), k])

    discs = tuple(disc_film.Disc(at(k), 7.0, COLOURS[name]) for k, name in enumerate(made.names))
    disc_film.Film(discs, 2.2, 520, 320).write(folder / "film.mp4")
    (folder / "setup.yaml").write_text(MARKER_SETUP)
    # the log of the camera counts y from the lowest row
    truth = {"x_m": made.x, "y_m": made.y + 0.319, "yaw_rad": made.yaw}
    truth |= {"joint1_rad": joints[:, 0], "joint2_rad": joints[:, 1]}
    return three_link.robot(folder), truth


@pytest.mark.slow
def test_markers_of_a_tracked_film(swimid: Run, tmp_path: Path) -> None:
    """The log of a rendered film, with markers on all links, becomes pose and joint angles."""
    robot, truth = _marker_film(tmp_path)
    tracked = tmp_path / "markers.csv"
    ran = swimid("track", "video", tmp_path / "film.mp4", "--setup", tmp_path / "setup.yaml", "-o", tracked)
    assert ran.status == 0, ran.err
    places = point_films.write_points(tmp_path / "points.yaml", MARKERS)
    ran = swimid("import", tracked, "--robot", robot, "--points", places, "-o", tmp_path / "run.csv")
    assert ran.status == 0, ran.err
    record = log.read(tmp_path / "run.csv")
    for name, values in truth.items():
        # the centre of a disc is measured to 0.2 px, and the shortest arm of a joint has 75 px
        limit = 0.0004 if name.endswith("_m") else 0.01
        assert np.sqrt(np.mean((record[name] - values) ** 2)) < limit, name
    assert "u_m_s" not in record


@pytest.mark.slow
def test_track_video_computes_joint_angles(swimid: Run, tmp_path: Path) -> None:
    """The robot file places the markers, and the setup names the robot."""
    robot, truth = _marker_film(tmp_path)
    rows = [f"    {name}: {{link: {link}, at_m: [{x}, {y}]}}" for name, (link, x, y) in MARKERS.items()]
    text = robot.read_text().replace("  elements:", "\n".join(["  points:", *rows, "  elements:"]), 1)
    robot.write_text(text)
    (tmp_path / "setup.yaml").write_text(MARKER_SETUP + f"robot: {robot.name}\n")
    words = ("--setup", tmp_path / "setup.yaml", "-o", tmp_path / "direct.csv", "--json")
    ran = swimid("track", "video", tmp_path / "film.mp4", *words)
    assert ran.status == 0, ran.err
    direct = log.read(tmp_path / "direct.csv")
    for name in ("joint1_rad", "joint2_rad"):
        assert np.sqrt(np.mean((direct[name] - truth[name]) ** 2)) < 0.01, name
        assert np.median(direct[name.replace("_rad", "_sd_rad")]) < 0.01
    assert np.sqrt(np.mean((direct["x_m"] - truth["x_m"]) ** 2)) < 0.001
    assert ran.json["result"]["points"]["left_out"] == []


def test_points_of_a_robot_file_in_space(tmp_path: Path) -> None:
    """The robot file places the points, one of which is not tracked; a vertical plane takes x and z."""
    places = {"nose": ("link1", 0.0, 0.0), "back": ("link1", -0.1, 0.02), "tip": ("link3", -0.11, 0.0)}
    places |= {"hip": ("link2", -0.1, 0.0)}
    rods = dict.fromkeys(("link1", "link2", "link3"), 0.12)
    made = point_films.film(seed=47, frames=90, lengths=rods, places=places, amplitudes_deg=(10, 20))
    rows = [f"    {name}: {{link: {link}, at_m: [{x}, {y}]}}" for name, (link, x, y) in places.items()]
    rows = ["  points:", *rows, "    rib: {link: link1, at_m: [-0.05, 0]}", "  elements:"]
    robot = three_link.robot(tmp_path)
    text = robot.read_text().replace("plane: horizontal", "plane: vertical")
    robot.write_text(text.replace("  elements:", "\n".join(rows), 1))
    table = pd.DataFrame({"t_s": made.time})
    for k, name in enumerate(made.names):
        table[f"{name}_x_m"], table[f"{name}_z_m"] = made.column[:, k] / 1500, -made.row[:, k] / 1500
        table[f"{name}_y_m"] = 0.3
    result = package.import_log(table, robot=str(robot))
    for name, truth in (("z_m", made.y), ("pitch_rad", made.yaw), ("joint2_rad", made.joints[:, 1])):
        assert np.allclose(result.frame[name], truth, atol=0.04), name
    assert "rib" not in result.data["points"]["noise_m"]


def test_points_and_tables_in_memory() -> None:
    made = point_films.film(seed=43, frames=120)
    table = pd.DataFrame({"t_s": made.time})
    for k, name in enumerate(made.names):
        table[f"{name}_x_m"], table[f"{name}_y_m"] = made.column[:, k] / 1500, -made.row[:, k] / 1500
    spots = {name: {"link": link, "at_m": [x, y]} for name, (link, x, y) in PLACES.items()}
    result = package.import_log(table, robot="tfish", points={"points": spots})
    assert np.max(np.abs(result.frame["x_m"] - made.x)) < 0.002
    assert result.data["points"]["scale"] is None
    assert {"points", "log"} <= set(result.evidence.provenance["inputs"])
    with pytest.raises(InputError, match="are in metres: omit the scale"):
        package.import_log(
            table, robot="tfish", points={"points": spots, "scale": {"metres_per_pixel": 1e-3}}
        )


@pytest.mark.slow
def test_a_real_film(real_data: Path, swimid: Run, tmp_path: Path) -> None:
    """Nine points on a tendon-driven fish, tracked by its makers, as a chain."""
    film = real_data / "fishsim" / "markers_f1_75.csv"
    rows = ["format: swimid-mapping/1", "reader: {header: false}", "time: {rate_hz: 60}", "columns:"]
    for k in range(9):
        rows.append(f"  - {{source: {2 * k + 1}, target: p{k}_x_px, unit: px}}")
        rows.append(f"  - {{source: {2 * k + 2}, target: p{k}_y_px, unit: px, factor: -1}}")
    (tmp_path / "map.yaml").write_text("\n".join(rows) + "\n")
    names = ", ".join(f"p{k}" for k in range(9))
    (tmp_path / "points.yaml").write_text(
        f"chain: [{names}]\nscale: {{between: [p0, p1], distance_m: 0.142}}\n"
    )
    words = ("--map", tmp_path / "map.yaml", "--points", tmp_path / "points.yaml", "--json")
    ran = swimid("import", film, *words, "-o", tmp_path / "run.csv")
    assert ran.status == 0, ran.err
    result = ran.json["result"]
    # the beat is 0.747 +- 0.009 of the stated one, the speed by a straight line 0.1613 m/s
    assert result["stroke"]["frequency_hz"] == pytest.approx(0.747 * 1.75, abs=0.02)
    assert result["speed"]["line_m_s"] == pytest.approx(0.1613, rel=0.03)
    points = np.genfromtxt(film, delimiter=",").reshape(-1, 9, 2)
    apart = np.hypot(*(points[:, 6] - points[:, 7]).T)
    merged = [one for one in result["points"]["left_out"] if one["points"] == ["p6", "p7"]]
    frames = merged[0]["frames"]
    assert len(frames) > 20
    assert np.max(apart[frames]) < 0.5 * np.median(apart)
    assert result["wave"]["wave_speed_m_s"] > 2 * result["speed"]["line_m_s"]


def test_the_mean_of_a_part_of_a_swing_is_doubted(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator
) -> None:
    """The mean of 1.3 cycles is not that of the swing, and a turn of the tail would be lost with it."""
    time = np.arange(0.0, 1.3 / 0.9, 1 / 60)
    tip = 0.1 * time - 0.2 - 0.15 * np.exp(1j * (0.3 + 0.5 * np.sin(2 * np.pi * 0.9 * time + 0.4)))
    still = np.zeros_like(time)
    points = np.column_stack([0.1 * time, still, 0.1 * time - 0.2, still, tip.real, tip.imag])
    table = pd.DataFrame(points, columns=[f"{name}_{axis}_m" for name in "abc" for axis in "xy"])
    table += rng.normal(0.0, 0.0005, table.shape)
    table.insert(0, "t_s", time)
    table.to_csv(tmp_path / "film.csv", index=False)
    for zero in ("stated", "mean"):
        (tmp_path / "points.yaml").write_text(f"format: swimid-points/1\nchain: [a, b, c]\nzero: {zero}\n")
        ran = swimid(
            "import",
            tmp_path / "film.csv",
            "--points",
            tmp_path / "points.yaml",
            "-o",
            tmp_path / f"{zero}.csv",
        )
        assert ran.status == 0, ran.err
        assert ("SWM179" in ran.err) is (zero == "mean")


@pytest.mark.parametrize("cycles", [2.4, 6.3])
def test_joint_angles_relative_to_their_mean(
    swimid: Callable[..., Ran], tmp_path: Path, rng: np.random.Generator, cycles: float
) -> None:
    """``zero: mean`` takes off the mean of a swing, which a part of a cycle does not shift."""
    time = np.arange(0.0, cycles / 0.9, 1 / 60)
    bend = 0.3 + 0.5 * np.sin(2 * np.pi * 0.9 * time + 0.4)
    nose, hip = 0.1 * time, 0.1 * time - 0.2
    tip = hip - 0.15 * np.exp(1j * bend)
    points = np.column_stack([nose, 0 * time, hip, 0 * time, tip.real, tip.imag])
    table = pd.DataFrame(points, columns=[f"{name}_{axis}_m" for name in "abc" for axis in "xy"])
    table += rng.normal(0.0, 0.0005, table.shape)
    table.insert(0, "t_s", time)
    table.to_csv(tmp_path / "film.csv", index=False)
    logs = {}
    for zero in ("stated", "mean"):
        spec = tmp_path / f"{zero}.yaml"
        spec.write_text(f"format: swimid-points/1\nchain: [a, b, c]\nzero: {zero}\n")
        ran = swimid(
            "import", tmp_path / "film.csv", "--points", spec, "-o", tmp_path / f"{zero}.csv", "--json"
        )
        assert ran.status == 0, ran.err
        (swing,) = ran.json["result"]["points"]["swings"].values()
        assert swing["mean_rad"] == pytest.approx(0.3, abs=0.003)
        assert swing["amplitude_rad"] == pytest.approx(0.5, abs=0.003)
        assert swing["frequency_hz"] == pytest.approx(0.9, rel=0.02)
        logs[zero] = log.read(tmp_path / f"{zero}.csv")["joint1_rad"]
    assert np.median(logs["stated"] - logs["mean"]) == pytest.approx(0.3, abs=0.003)
    assert np.std(logs["mean"] - (bend - 0.3)) < 0.01
