"""Memory that the tracking of a film takes does not grow with its pictures."""

import math
import tracemalloc

import numpy as np
import pytest
import yaml

import swimid
from swimid.errors import UsageError
from swimid.tracking.setup import Setup
from swimid.tracking.tracker import Follower
from tests.generators.disc_film import ONE_RED, RED_AND_YELLOW, YELLOW, Disc, Film

#: Maximum memory for each frame of a short film, bytes: half of a picture. Figures draw every frame of a film
#: of less than a minute, and take most of this memory.
MAX_BYTES_PER_FRAME = 128 * 100 * 3 / 2


def circling(t, behind=0.0):
    turn = 0.5 * t - behind
    return 60.0 + 30.0 * math.cos(turn), 40.0 + 20.0 * math.sin(turn)


def film_of(seconds, **layout):
    discs = (Disc(circling, 6.0), Disc(lambda t: circling(t, 0.7), 6.0, YELLOW))
    return Film(discs, seconds, 128, 100, 30.0, noise=1.0, **layout)


def peak_bytes(function, *args, **options):
    """Return the maximum memory that Python objects and arrays take during a call, bytes."""
    tracemalloc.start()
    try:
        function(*args, **options)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_for_each_further_frame_is_less_than_a_picture(tmp_path):
    films = [film_of(seconds).write(tmp_path / f"{seconds}.mp4") for seconds in (2, 6)]
    setup = yaml.safe_load(RED_AND_YELLOW)
    swimid.track_video(films[0], setup=setup)  # compiles and imports everything
    short, long = (peak_bytes(swimid.track_video, film, setup=setup) for film in films)
    assert (long - short) / (4 * 30) < MAX_BYTES_PER_FRAME


def test_memory_for_each_frame_while_tracking_is_that_of_its_detection():
    film = film_of(1.0)
    pictures = list(film.frames())
    rules = Setup.model_validate(yaml.safe_load(ONE_RED))

    def follow(laps):
        follower = Follower(rules, film.width, film.height)
        for k in range(laps * len(pictures)):
            follower.step(k / film.rate_hz, pictures[k % len(pictures)])
        assert follower.track().is_whole.mean() > 0.9

    follow(1)
    short, long = peak_bytes(follow, 5), peak_bytes(follow, 20)
    # ten numbers for a detection, and as many again in the table of the track
    assert (long - short) / (15 * len(pictures)) < 40 * 8


def test_a_long_film_is_not_drawn_into_a_gif(tmp_path, monkeypatch):
    monkeypatch.setattr("swimid.files.video.MAX_GIF_BYTES", 20 * 3 * 128 * 100)
    film = film_of(1.0).write(tmp_path / "film.mp4")
    with pytest.raises(UsageError, match=r"at most 20 frames.* not the 30 frames") as raised:
        swimid.track_video(film, setup=yaml.safe_load(ONE_RED), overlay_path=tmp_path / "overlay.gif")
    assert "overlay.mp4" in raised.value.hint
    assert not (tmp_path / "overlay.gif").exists()


def test_a_detection_is_stored_without_loss():
    film = film_of(0.5)
    follower = Follower(Setup.model_validate(yaml.safe_load(ONE_RED)), film.width, film.height)
    for time, picture in zip(film.times(), film.frames(), strict=True):
        follower.step(time, picture)
    track = follower.track()
    assert np.array_equal(track.times, film.times())
    assert np.hypot(*(np.array([track.x[0], track.y[0]]) - film.places().T)).max() < 0.3
