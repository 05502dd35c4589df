"""``track setup --pick``: the server of the page, its refusals, proposals, trials and the file it writes."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from swimid.tracking import setup as setup_format
from swimid.tracking.frames import Video
from tests.conftest import SAMPLES, Ran
from tests.generators import clutter_video as clutter
from tests.generators.clutter_video import RED, Pool
from tests.pick_page import CORNERS, NOSE, PICKS, POOL, TAIL, Served, served

FLOOR_M = [[-0.9, 0.65], [0.9, 0.65], [0.9, -0.65], [-0.9, -0.65]]
FLOOR = {"points_px": [list(point) for point in CORNERS], "points_m": FLOOR_M}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The page of the sample film, for requests that do not end the command."""
    with served(POOL, "--no-browser", "-o", tmp_path_factory.mktemp("pick") / "setup.yaml") as run:
        yield run


def test_the_page_loads_nothing_from_elsewhere(page: Served) -> None:
    status, headers, body = page.request("GET", "")
    assert status == 200
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "connect-src 'self'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert body.count(b"nonce=") == 3
    assert b"http:" not in body
    assert b"https:" not in body


def test_requests_of_others_are_refused(page: Served) -> None:
    token = page.address.rstrip("/").rpartition("/")[2]
    assert len(token) >= 32
    check = json.dumps({}).encode()
    for path in (
        "/",
        "/check",
        f"/{token[:-1]}/check",
        f"/{token}x/check",
        "/%00/check",
        "//check",
        "/../check",
    ):
        assert page.request("POST", path, check)[0] == 403
        assert page.request("GET", path)[0] == 403
    assert page.request("POST", "check", check, Host="rebound.example:80")[0] == 403
    assert page.request("GET", "", Host="rebound.example")[0] == 403
    assert page.request("POST", "check", check, Origin="http://site.example")[0] == 403
    assert page.request("POST", "check", check, Origin="null")[0] == 403
    assert page.request("POST", "check", check, Content_Type="text/plain")[0] == 415
    assert page.request("POST", "check", Content_Length="1000001")[0] == 413
    assert page.request("POST", "check", check, Content_Length="-1")[0] == 411
    assert page.request("POST", "check", b"{")[0] == 400
    assert page.request("POST", "check", b"[" * 100_000)[0] == 400
    assert page.request("DELETE", "check")[0] == 501
    # A tunnel may end at another port of the same machine.
    assert page.request("POST", "check", check, Host="localhost:9", Origin="http://localhost:9")[0] == 200


def test_no_file_is_served(page: Served) -> None:
    for name in ("../../pool.mp4", "setup.yaml", "pool.mp4", "frame/../../x", "%2e%2e/x", "/etc/passwd"):
        path = page.address.partition("127.0.0.1:")[2].partition("/")[2]
        assert page.request("GET", f"/{path}{name}")[0] == 404
    assert page.request("POST", "frame", b"{}")[0] == 404
    for query in ("n=-1", "n=x", "n=1e3", "time=x", "n=../x"):
        assert page.request("GET", f"frame?{query}")[0] == 422


def test_a_choice_names_no_other_keys_of_the_setup(page: Served) -> None:
    answer = page.post("check", {"robot": "/etc/passwd"}, 422)
    assert "unknown key 'robot'" in answer["error"]["message"]


def test_frames_are_those_that_the_tracker_reads(page: Served) -> None:
    film = {}
    for index, (time_s, frame) in enumerate(Video(POOL).frames()):
        if index in (0, 40, 41, 359):
            film[index] = time_s, frame.copy()
    for index in (40, 0, 41, 359, 40):
        time_s, frame = film[index]
        _, headers, body = page.request("GET", f"frame?n={index}")
        assert (headers["X-Frame"], float(headers["X-Time"])) == (str(index), pytest.approx(time_s, abs=1e-4))
        assert np.array_equal(cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR), frame)
    assert page.request("GET", f"frame?time={film[41][0] - 0.001}")[1]["X-Frame"] == "41"
    assert page.request("GET", "frame?n=99999")[1]["X-Frame"] == "359"
    assert page.request("GET", "frame?time=1e9")[1]["X-Frame"] == "359"


def test_proposals_are_those_of_the_command_line(
    page: Served, swimid: Callable[..., Ran], tmp_path: Path
) -> None:
    marks = [f"{pick['name']}@{pick['x']},{pick['y']}" for pick in PICKS]
    words = [word for mark in marks for word in ("--marker", mark)]
    assert swimid("track", "setup", POOL, "-o", tmp_path / "setup.yaml", *words).status == 0
    typed = setup_format.read(tmp_path / "setup.yaml").markers
    picked = page.post("check", {"frame": 0, "picks": PICKS})["markers"]
    for one, other in zip(typed, picked, strict=True):
        stated = one.model_dump(mode="json", exclude_none=True)
        assert {key: other[key] for key in stated} == stated
        # The outline of the marker is about the clicked pixel.
        assert other["patches"] == 1
        outline = np.array(other["outlines"][0])
        place = {"nose": NOSE, "tail": TAIL}[one.name]
        assert np.abs(outline.mean(axis=0) - place).max() < 3


@pytest.mark.parametrize(
    "picks", [[("a", 500, 300)], [("a", 900, 10)], [("a", *NOSE), ("a", *NOSE)], [("9 a", *NOSE)]]
)
def test_an_error_of_a_click_is_that_of_the_command_line(
    page: Served, swimid: Callable[..., Ran], tmp_path: Path, picks: list[tuple[str, int, int]]
) -> None:
    words = [word for name, x, y in picks for word in ("--marker", f"{name}@{x},{y}")]
    ran = swimid("track", "setup", POOL, "-o", tmp_path / "setup.yaml", *words, "--json")
    assert ran.status in (2, 3)
    choice = {"picks": [{"name": name, "x": x, "y": y} for name, x, y in picks]}
    shown = page.post("check", choice)["errors"]["picks"]
    assert shown == {key: ran.json["error"][key] for key in ("type", "message", "hint")}


def test_two_points_give_the_scale(page: Served) -> None:
    scale = {"points_px": [[100, 50], [400, 450]], "distance_m": 1.25}
    answer = page.post("check", {"scale": scale})
    assert answer["errors"] == {}
    assert answer["scale"]["metres_per_pixel"] == pytest.approx(1.25 / 500)


@pytest.mark.parametrize(
    "scale",
    [
        {"points_px": [[100, 50], [400, 450]], "distance_m": 0},
        {"points_px": [[100, 50], [100, 50]], "distance_m": 1},
        {"points_px": [[100, 50]], "distance_m": 1},
        {"points_px": [[10, 10], [20, 20], [30, 30], [10, 200]], "points_m": FLOOR_M},
        {"points_px": [list(point) for point in CORNERS], "points_m": [*FLOOR_M[:2], FLOOR_M[3], FLOOR_M[2]]},
        {"metres_per_pixel": -1},
        {**FLOOR, "heights": {"camera_m": 1, "marker_m": 2}},
    ],
    ids=["zero", "one-place", "one-point", "line", "crossed", "negative", "heights"],
)
def test_an_error_of_the_scale_is_that_of_the_command_line(
    page: Served, swimid: Callable[..., Ran], tmp_path: Path, scale: dict[str, object]
) -> None:
    shown = page.post("check", {"scale": scale})["errors"]["scale"]
    text = (SAMPLES / "pool" / "pool_setup.yaml").read_text().partition("scale:")[0]
    (tmp_path / "setup.yaml").write_text(f"{text}scale: {json.dumps(scale)}\n")
    ran = swimid(
        "track", "video", POOL, "--setup", tmp_path / "setup.yaml", "-o", tmp_path / "run.csv", "--json"
    )
    assert ran.status == 3
    assert shown["message"].endswith(ran.json["error"]["reason"])
    assert shown["hint"] == ran.json["error"]["hint"]
    refused = page.post("done", {"picks": PICKS, "scale": scale}, 422)
    assert refused["error"]["message"].endswith(ran.json["error"]["reason"])


def test_each_error_stands_at_its_part_of_the_page(page: Served) -> None:
    choice = {
        "picks": [{"name": "a", "x": 500, "y": 300}], "plane": "sloping", "frame_rate_hz": -1,
        "scale": {"metres_per_pixel": 0}, "ignore_px": [[10, 10, 5, 20]],
    }  # fmt: skip
    assert set(page.post("check", choice)["errors"]) == {
        "picks",
        "plane",
        "frame_rate_hz",
        "scale",
        "ignore_px",
    }
    mirrored = {**FLOOR, "points_m": [[-x, y] for x, y in FLOOR_M]}
    assert [notice["code"] for notice in page.post("check", {"scale": mirrored})["notices"]] == ["SWM048"]


def test_a_trial_says_where_each_marker_was_found(page: Served) -> None:
    trial = page.post("try", {"choice": {"picks": PICKS}, "first": 20, "count": 50})
    assert (trial["first"], trial["count"]) == (20, 50)
    truth = pd.read_csv(SAMPLES / "pool" / "pool_truth.csv", comment="#")[20:70]
    metres, pixels = np.array(FLOOR_M, np.float32), np.array(CORNERS, np.float32)
    matrix = cv2.getPerspectiveTransform(metres, pixels)
    poses = truth[["x_m", "y_m"]].to_numpy()
    for marker in trial["markers"]:
        assert marker["share"] == 1.0
        places = np.array(marker["circles"])[:, :2]
        expected = cv2.perspectiveTransform(poses[None], matrix)[0]
        # The disc is at a constant distance from the reference point, which the film shows.
        apart = np.hypot(*(places - expected).T)
        assert np.ptp(apart) < 6, marker["name"]
    nothing = page.post("try", {"choice": {}, "first": 0, "count": 50}, 422)
    assert "no marker is picked" in nothing["error"]["message"]
    late = page.post("try", {"choice": {"picks": PICKS}, "first": 999, "count": 5}, 422)
    assert "has no frame 999" in late["error"]["message"]
    ignored = {"picks": PICKS, "ignore_px": [[0, 0, 639, 479]]}
    hidden = page.post("try", {"choice": ignored, "first": 0, "count": 20})
    assert [marker["share"] for marker in hidden["markers"]] == [0.0, 0.0]


def test_two_windows_do_not_disturb_each_other(page: Served) -> None:
    choices = [{"picks": PICKS[:1]}, {"picks": PICKS}, {"scale": {"metres_per_pixel": 0.5}}, {"frame": 7}] * 4
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda choice: page.post("check", choice), choices))
    assert [len(answer["markers"]) for answer in answers] == [1, 2, 0, 0] * 4
    assert [bool(answer["scale"]) for answer in answers] == [False, False, True, False] * 4


@pytest.mark.slow
def test_done_writes_a_setup_that_track_video_takes(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    output = tmp_path / "setup.yaml"
    with served(POOL, "--no-browser", "-o", output, "--json") as run:
        places = ([0.03, 0.0], [-0.15, 0.0])
        picks = [{**pick, "at_m": at} for pick, at in zip(PICKS, places, strict=True)]
        choice = {"picks": picks, "scale": FLOOR, "ignore_px": [[0, 0, 30, 20]], "plane": "horizontal"}
        refused = run.post("done", {**choice, "picks": [picks[0], PICKS[1]]}, 422)
        assert "needs at_m, too" in str(refused)
        run.post("done", {**choice, "picks": []}, 422)
        assert not output.exists()
        shown = run.post("done", choice)
        status, out, _ = run.end()
    assert status == 0
    document = json.loads(out)
    assert document["result"]["found_share"]["nose"] > 0.9
    assert document["outputs"] == [str(output), str(tmp_path / "setup.markers.png")] == shown["outputs"]
    assert shown["next"] == f"swimid track video {POOL} --setup {output} -o run.csv"
    assert document["next"] == [shown["next"]]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["setup.markers.png", "setup.yaml"]
    text = output.read_text()
    assert text.startswith("# Drafted by swimid track setup from pool.mp4")
    assert "# nose: found in" in text
    rules = setup_format.read(output)
    assert rules.scale is not None
    assert rules.scale.points_m == tuple(map(tuple, FLOOR_M))
    assert rules.ignore_px == [(0, 0, 30, 20)]
    assert [list(marker.at_m or ()) for marker in rules.markers] == list(places)
    assert swimid("track", "video", POOL, "--setup", output, "-o", tmp_path / "run.csv").status == 0
    log = pd.read_csv(tmp_path / "run.csv", comment="#")
    truth = pd.read_csv(SAMPLES / "pool" / "pool_truth.csv", comment="#")
    turned = np.unwrap(log.yaw_rad) - np.unwrap(truth.yaw_rad)
    assert np.nanmax(np.abs(turned - np.nanmedian(turned))) < 0.1


@pytest.mark.slow
def test_the_file_is_that_of_the_command_line(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    """The same picks and scale give the same text, byte for byte."""
    marks = [word for pick in PICKS for word in ("--marker", f"{pick['name']}@{pick['x']},{pick['y']}")]
    options = ["--metres-per-pixel", "0.003", "--plane", "vertical"]
    assert swimid("track", "setup", POOL, "-o", tmp_path / "typed.yaml", *marks, *options).status == 0
    with served(POOL, "--no-browser", "-o", tmp_path / "picked.yaml", *marks, *options) as run:
        page = run.request("GET", "")[2].decode()
        start = json.loads(page.partition('id="data"')[2].partition(">")[2].partition("<")[0])["start"]
        assert start["picks"] == PICKS
        run.post("done", {key: start[key] for key in ("frame", "picks", "background", "plane", "scale")})
        assert run.end()[0] == 0
    assert (tmp_path / "picked.yaml").read_bytes() == (tmp_path / "typed.yaml").read_bytes()


@pytest.mark.slow
def test_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    with served(POOL, "--no-browser", "-o", tmp_path / "setup.yaml") as run:
        port = int(run.address.split(":")[2].split("/")[0])
        run.post("check", {"picks": PICKS})
        status, out, err = run.interrupt()
    assert status == 130
    assert out == ""
    assert "interrupted; nothing was written" in err
    assert list(tmp_path.iterdir()) == []
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


@pytest.mark.slow
def test_numbered_pictures_need_a_frame_rate(tmp_path: Path) -> None:
    fish = clutter.straight(60, 118, 60, 0)
    discs = (clutter.disc(fish, 7, RED, ahead=24), clutter.disc(fish, 7, RED, ahead=-24))
    pictures = clutter.frames(Pool(discs, duration_s=1.0))
    for index, frame in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"a_{index:03d}.png"), frame)
    picks = [{"name": "red", "x": 84, "y": 118}, {"name": "red", "x": 36, "y": 118}]
    with served(tmp_path / "a_%03d.png", "--no-browser", "-o", tmp_path / "setup.yaml") as run:
        _, headers, body = run.request("GET", "frame?n=3")
        assert headers["X-Time"] == "nan"
        assert np.array_equal(cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR), pictures[3])
        refused = run.post("try", {"choice": {"picks": picks}, "first": 0, "count": 10}, 422)
        assert "time stamp" in refused["error"]["message"]
        choice = {"picks": picks, "frame_rate_hz": 30}
        trial = run.post("try", {"choice": choice, "first": 2, "count": 10})
        assert {marker["name"]: marker["share"] for marker in trial["markers"]} == {"red1": 1.0, "red2": 1.0}
        names = [{**picks[0], "name": "one"}, {**picks[1], "name": "two"}]
        alike = run.post("check", {"picks": names})["errors"]["picks"]
        assert "have one colour" in alike["message"]
        run.post("done", choice)
        assert run.end()[0] == 0
    rules = setup_format.read(tmp_path / "setup.yaml")
    assert (rules.markers[0].number, rules.head, rules.tail, rules.frame_rate_hz) == (2, "red1", "red2", 30)


@pytest.mark.slow
def test_the_whole_body_can_be_followed(tmp_path: Path) -> None:
    video = clutter.write(tmp_path / "fish.mp4", Pool((clutter.fish(clutter.straight(20, 118, 93, 0)),)))
    with served(video, "--no-browser", "-o", tmp_path / "setup.yaml") as run:
        assert [marker["name"] for marker in run.post("check", {"background": True})["markers"]] == ["body"]
        run.post("done", {"background": True, "scale": {"metres_per_pixel": 0.002}})
        assert run.end()[0] == 0
    assert setup_format.read(tmp_path / "setup.yaml").markers[0].method == "background"


@pytest.mark.slow
def test_the_browser_is_opened_at_the_address(tmp_path: Path) -> None:
    seen = tmp_path / "seen.txt"
    browser = tmp_path / "browser.sh"
    browser.write_text(f'#!/bin/sh\necho noise\nprintf "%s" "$1" > {seen}\n')
    browser.chmod(0o755)
    with served(POOL, "-o", tmp_path / "setup.yaml", BROWSER=f"{browser} %s") as run:
        for _ in range(600):
            if seen.exists() and seen.read_text():
                break
            run.post("check", {})
        # Other users see the words of a command, but not the file that leads to the page.
        page = Path(seen.read_text().removeprefix("file://"))
        assert run.address in page.read_text()
        assert page.parent.stat().st_mode & 0o077 == 0
        assert "ssh" not in run.told
        assert run.interrupt()[1] == ""
        assert not page.exists()
    with served(POOL, "-o", tmp_path / "setup.yaml") as run:
        port = run.address.split(":")[2].split("/")[0]
        assert f"ssh -N -L {port}:127.0.0.1:{port}" in run.told


def test_wrong_use_is_refused_at_once(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    output = tmp_path / "setup.yaml"
    for words in (["--port", "8000"], ["--no-browser"]):
        ran = swimid("track", "setup", POOL, "-o", output, *words)
        assert ran.status == 2
        assert "--pick" in ran.err
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        ran = swimid("track", "setup", POOL, "-o", output, "--pick", "--port", str(taken.getsockname()[1]))
    assert ran.status == 2
    assert "cannot be used" in ran.err
    output.write_text("mine")
    ran = swimid("track", "setup", POOL, "-o", output, "--pick")
    assert ran.status == 2
    assert output.read_text() == "mine"
    assert swimid("track", "setup", tmp_path / "no.mp4", "-o", tmp_path / "a.yaml", "--pick").status == 3
