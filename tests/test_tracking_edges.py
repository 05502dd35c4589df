"""Markers at the edge of the picture, among other things of their colour, and in and out of the picture."""

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner

from swimid.cli.main import track_group as track_command
from swimid.results import evidence
from swimid.tracking.setup import Setup
from swimid.tracking.tracker import Follower
from tests.generators.disc_film import ONE_RED, RED_AND_YELLOW, WATER, YELLOW, Disc, Film, still, straight


def followed(film, setup=ONE_RED):
    """Return the raw track of the pictures of a film, without a codec."""
    follower = Follower(Setup.model_validate(yaml.safe_load(setup)), film.width, film.height)
    for time, frame in zip(film.times(), film.frames(), strict=True):
        follower.step(time, frame)
    return follower.track()


def errors(track, film, marker=0):
    """Return the distance of each detection from the truth, px."""
    return np.hypot(*(np.array([track.x[marker], track.y[marker]]) - film.places(marker).T))


def tracked(folder, film, setup=ONE_RED, *options, status=0):
    """Track a film by the command line; return the log and the output."""
    path, log = folder / "setup.yaml", folder / "run.csv"
    path.write_text(setup)
    video = film.write(folder / "film.mp4")
    command = ["video", str(video), "--setup", str(path), "-o", str(log), *map(str, options)]
    result = CliRunner().invoke(track_command, command)
    assert result.exit_code == status, result.output
    return (None if status else pd.read_csv(log, comment="#")), result.output


def checked(folder):
    """Return the checks by name."""
    return {check.name: check for check in evidence.read(folder / "run.evidence.json").checks}


#: A small marker below more large things of its colour than are measured in one picture.
CROWD = Film(
    (
        Disc(straight(60, 150, 40, 5), radius=5),
        *(Disc(still(12 + 20 * (k % 15), 14 + 18 * (k // 15)), radius=7) for k in range(30)),
    ),
    duration_s=1.0,
)


def test_things_in_ignored_boxes_do_not_hide_the_marker():
    """Thirty things larger than the marker are where the setup does not allow a search."""
    track = followed(CROWD, ONE_RED + "ignore_px: [[0, 0, 320, 60]]\n")
    assert track.is_whole.all()
    assert np.nanmax(errors(track, CROWD)) < 0.3


def test_a_marker_lost_in_a_crowd_is_found_again_by_its_size():
    """The marker vanishes and returns elsewhere among more things of its colour than are measured."""

    def there_and_back(t):
        return None if 0.8 < t < 2.2 else (60 + 40 * t, 150.0)

    crowd = [Disc(lambda t, d=d: d.place(t) if t > 1 else None, radius=9) for d in CROWD.discs[1:]]
    film = Film((Disc(there_and_back, radius=5), *crowd), duration_s=3.0)
    track = followed(film, ONE_RED + "max_gap_s: 0.5\n")
    there = np.isfinite(film.places()[:, 0])
    assert track.is_whole[0][there].all()
    assert np.nanmax(errors(track, film)) < 0.3


def whole(film, disc=0):
    """Return the frames in which a disc is inside the picture and away from its edge."""
    return np.isfinite(film.places(disc)[:, 0]) & ~film.cut(disc)


@pytest.mark.parametrize("speed", [20, 60, 200])
def test_a_marker_that_swims_in_is_found_once_it_is_whole(speed):
    """At first the edge cuts the marker, so that its size is unknown."""
    film = Film((Disc(straight(-15, 120, speed, 4), radius=12),), duration_s=min(300 / speed, 3.0))
    track = followed(film)
    # a blurred rim that touches the edge counts as cut too, for a frame or two more than the disc itself
    late = np.flatnonzero(track.is_whole[0])[0] - np.flatnonzero(whole(film))[0]
    assert 0 <= late <= 2 + 60 / speed
    assert track.is_whole[0][np.flatnonzero(track.is_whole[0])[0] : whole(film).nonzero()[0][-1] + 1].all()
    assert np.nanmax(errors(track, film)[track.is_whole[0]]) < 0.3


def test_a_marker_that_waits_at_the_edge_is_found_when_it_enters():
    """A small part is visible for two seconds, then the marker enters."""
    film = Film((Disc(lambda t: (-9.0 + 80 * max(t - 2, 0), 120.0), radius=12),), duration_s=4.0)
    track = followed(film)
    assert track.is_whole[0][whole(film)].mean() > 0.95
    assert np.nanmax(errors(track, film)[track.is_whole[0]]) < 0.3


def test_equal_markers_that_enter_one_after_the_other_keep_their_names():
    """Each marker keeps its name, and is measured only when it is whole."""
    film = Film((Disc(straight(-55, 120, 60, 4), 12), Disc(straight(-15, 120, 60, 4), 12)), duration_s=3.0)
    track = followed(film, ONE_RED + "    number: 2\nhead: red1\ntail: red2\n")
    for marker in (0, 1):
        found = track.is_whole[marker]
        assert found[whole(film, 0)].mean() > 0.95
        away = np.hypot(*(np.array([track.x[marker], track.y[marker]]) - film.places(marker).T))
        assert np.nanmax(away[found]) < 0.3


def test_equal_markers_are_told_apart_by_their_distances_from_another():
    """Two red discs are hidden while their body turns by half a rotation, so that they exchange places."""

    def turned(along, hidden=True):
        def place(t):
            angle = np.pi * np.clip((t - 1.5) / 0.5, 0.0, 1.0)
            if hidden and 1.4 < t < 2.1:
                return None
            return 160 + along * np.cos(angle), 120 + along * np.sin(angle)

        return place

    discs = Disc(turned(30), 8), Disc(turned(-30), 8), Disc(turned(75, hidden=False), 8, YELLOW)
    film = Film(discs, duration_s=2.6)
    track = followed(
        film,
        RED_AND_YELLOW.replace("- name: red\n", "- name: red\n    number: 2\n").replace(
            "head: red", "head: red1"
        ),
    )
    names = [0, 1]
    if errors(track, film, 0)[0] > 30:
        names = [1, 0]  # the names are given by chance
    for marker, disc in zip(names, (0, 1), strict=True):
        found = track.is_whole[marker]
        away = np.hypot(*(np.array([track.x[marker], track.y[marker]]) - film.places(disc).T))
        assert found[-10:].all()
        assert np.nanmax(away[found]) < 0.5


def test_the_marker_replaces_a_reflection_that_was_tracked_first():
    """A small bright thing is visible for six frames before the marker, which is four times larger."""

    def reflection(t):
        return (200 + 30 * t, 60.0) if t < 0.17 or 0.4 < t < 0.5 else None

    marker = Disc(lambda t: (60 + 50 * t, 150.0) if t > 0.3 else None, radius=12)
    film = Film((marker, Disc(reflection, radius=3)), duration_s=3.0)
    track = followed(film)
    assert track.is_whole[0][whole(film)].mean() > 0.95
    assert np.nanmax(errors(track, film)[track.is_whole[0]]) < 0.3
    count, area = track.mistaken["red"]
    assert 6 <= count <= 9
    assert area < 60


def test_the_marker_replaces_a_thing_at_the_edge():
    """The edge always cuts a thing of the colour; the marker appears inside the picture, at rest."""
    film = Film(
        (Disc(lambda t: (100.0, 150.0) if t > 0.5 else None), Disc(still(-2, 60), 12)), duration_s=2.0
    )
    track = followed(film)
    assert track.is_whole[0][whole(film)].mean() > 0.95
    assert np.nanmax(errors(track, film)[track.is_whole[0]]) < 0.3
    assert not track.mistaken


@pytest.mark.parametrize("later", [straight(60, 80, 20), still(60, 80)])
def test_a_thing_that_comes_after_the_marker_is_not_tracked(later):
    """The marker leaves. Then a larger thing comes, which moves for a similar time or stays at rest."""
    film = Film(
        (
            Disc(lambda t: (60 + 120 * t, 150.0) if t < 1.5 else None, radius=8),
            Disc(lambda t: later(t) if t > 2 else None, radius=25),
        ),
        duration_s=5.0,
    )
    track = followed(film)
    assert (track.is_whole[0] == np.isfinite(film.places()[:, 0])).all()
    assert not track.mistaken


def test_a_marker_cut_by_the_edge_is_not_measured(tmp_path):
    """Half of the marker leaves and returns repeatedly; the log is right within its standard deviation."""

    def out_and_back(t):
        return (280 + 35 * np.sin(2 * np.pi * t / 1.6), 120.0)

    behind = Disc(lambda t: (out_and_back(t)[0] - 40, 120.0), 12, YELLOW)
    film = Film((Disc(out_and_back, radius=12), behind), duration_s=4.0)
    run, output = tracked(tmp_path, film, RED_AND_YELLOW)
    assert "SWM045" in output
    cut = (run.red_at_edge == 1).to_numpy()
    assert cut[film.cut()].all()
    assert (run.found[cut] == 0).all()
    assert (run.status[cut] == "cut").all()
    assert run.red_x_px[cut].isna().all()
    assert (run.red_status[cut] == "window").all()
    assert run.yellow_x_px.notna().all()
    inner = run.segment == 1
    assert inner.mean() > 0.9
    assert (run.interpolated[cut] == 1)[inner].all()
    off = np.abs(run.x_px - film.places()[:, 0]) / run.x_sd_px
    assert off[inner & ~cut].max() < 4
    assert off[inner & cut].max() < 4


def test_a_marker_that_is_always_cut_is_refused_with_the_reason(tmp_path):
    film = Film((Disc(lambda t: (-2.0, 60 + 30 * t), radius=12),), duration_s=1.0)
    _, output = tracked(tmp_path, film, status=4)
    assert "found in no frame of 30 (in 30 frames the edge of the picture cuts the marker)" in output


def test_a_body_that_leaves_the_picture_is_reported(tmp_path):
    """It is visible in a third of the film. It is found in these frames, and its exit is reported."""
    film = Film((Disc(straight(200, 120, 40, 4), radius=12),), duration_s=8.0)
    log, output = tracked(tmp_path, film)
    last = np.flatnonzero(log.found == 1)[-1]
    assert f"last detected at {log.t_s[last]:.2f} of 7.97 s" in output
    assert "SWM065" in output
    assert "then they left the picture" in " ".join(output.split())
    checks = checked(tmp_path)
    assert checks["First and last detection"].verdict == "warn"
    # nothing was lost, but most of the film is empty: the check warns
    assert checks["Frames found"].verdict == "warn"


def test_a_body_lost_inside_the_picture_is_not_reported_as_left(tmp_path):
    """It vanishes in the middle of the picture: the check fails and states the place."""
    film = Film((Disc(lambda t: (100 + 40 * t, 120.0) if t < 2 else None, radius=12),), duration_s=8.0)
    _, output = tracked(tmp_path, film)
    assert "not detected afterwards" in " ".join(output.split())
    assert "frame 59, at 179, 120 px" in output
    assert checked(tmp_path)["Frames found"].verdict == "fail"


def test_a_body_that_enters_late_is_reported(tmp_path):
    film = Film((Disc(lambda t: (-15 + 60 * max(t - 2, 0), 120.0), radius=12),), duration_s=5.0)
    log, output = tracked(tmp_path, film)
    first = np.flatnonzero(log.found == 1)[0]
    assert f"first detected at {log.t_s[first]:.2f} s" in output
    assert "last detected" not in output
    assert checked(tmp_path)["Frames found"].verdict == "warn"


def behind(cover, speed, duration):
    """Return a film of a marker that emerges from behind a thing, or passes behind it."""
    start, hidden = (80, Disc(still(-900, 120), 1000, WATER)) if cover == "bridge" else (40, POLE)
    return Film((Disc(straight(start, 120, speed), radius=12), hidden), duration_s=duration)


POLE = Disc(still(160, 120), radius=10, colour=WATER)


@pytest.mark.slow
@pytest.mark.parametrize(
    "film", [behind("bridge", 30, 4.0), behind("bridge", 60, 3.0), behind("pole", 60, 4.0)]
)
def test_the_standard_deviation_covers_the_error_of_a_partly_hidden_marker(tmp_path, film):
    """The visible part is up to 10 px off; the path is within its standard deviation, with a warning."""
    log, output = tracked(tmp_path, film)
    raw = np.abs(log.red_x_px - film.places()[:, 0])
    assert raw.max() > 5
    known = log.x_px.notna()
    assert (np.abs(log.x_px - film.places()[:, 0]) / log.x_sd_px)[known].max() < 4
    clear = known & (raw < 0.3)
    assert log.x_sd_px[clear].median() < 0.15
    assert "SWM066" in output
    assert checked(tmp_path)["Hidden in part"].verdict == "warn"
