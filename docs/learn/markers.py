"""Print the tables of docs/learn/markers.md: errors of markers by size, distance, background and height.

Run ``python -m docs.learn.markers`` in the root of the repository. The films are drawn by
``tests/generators/disc_film.py``, which uses nothing of the tracker. ``swimid.track_video`` follows the
markers.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

import swimid
from tests.generators.disc_film import RED, RED_AND_YELLOW, YELLOW, Disc, Film

#: Colours of hulls (BGR).
HULLS = {"white": (240, 240, 240), "grey": (190, 190, 190), "black": (40, 40, 40)}
#: Noise of the camera, of 255 levels, and size of the picture, px.
NOISE, SIZE = 6.0, (520, 200)

Place = Callable[[float], tuple[float, float]]


def ahead(distance_px: float, across_px: float = 0.0) -> Place:
    """Return the place of a point of a robot that swims to the right and sways, px at a time in s."""
    return lambda t: (80 + distance_px + 50 * t, 100 + across_px + 12 * np.sin(2 * np.pi * 0.7 * t))


def errors(diameter_px: float, distance_px: float, *, hull: str = "") -> tuple[float, float, float]:
    """Track a film of two markers. Return root-mean-square errors of position and heading, and found frames.

    The errors are those of single frames, before smoothing: px, degrees, and a share of the frames. With
    ``hull`` the rear half of the head marker is over a disc of this colour.
    """
    discs = [
        Disc(ahead(distance_px), diameter_px / 2, RED),
        Disc(ahead(0.0), diameter_px / 2, YELLOW),
    ]
    if hull:
        discs.insert(0, Disc(ahead(distance_px - 30), 30, HULLS[hull]))
    film = Film(tuple(discs), 4.0, *SIZE, noise=NOISE)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", swimid.SwimidWarning)
        video = film.write(Path(folder) / "film.mp4")
        log = swimid.track_video(video, setup=yaml.safe_load(RED_AND_YELLOW)).frame
    seen = log["found"].to_numpy(bool)
    measured = log[["red_x_px", "red_y_px"]].to_numpy()
    away = (measured - film.places(1 if hull else 0))[seen]
    position = np.sqrt(np.mean(away**2))
    heading = np.degrees(np.sqrt(np.mean(log["yaw_raw_rad"].to_numpy()[seen] ** 2)))
    return float(position), float(heading), float(seen.mean())


def sizes() -> None:
    """Print errors by the diameter of the markers."""
    print("| diameter | frames with both markers | position | heading, markers 80 px apart |")
    print("|---|---|---|---|")
    for diameter in (4, 6, 8, 12, 20, 30):
        try:
            position, heading, share = errors(diameter, 80.0)
        except swimid.SwimidError:
            print(f"| {diameter} px | refused | – | – |")
            continue
        print(f"| {diameter} px | {100 * share:.0f} % | {position:.3f} px | {heading:.3f}° |")


def distances() -> None:
    """Print the error of the heading by the distance of the markers."""
    print("| distance | heading |")
    print("|---|---|")
    for distance in (30, 60, 120, 240):
        print(f"| {distance} px | {errors(12, distance)[1]:.3f}° |")


def backgrounds() -> None:
    """Print the error of position on one background and on two."""
    print("| marker of 12 px | position |")
    print("|---|---|")
    print(f"| wholly over water | {errors(12, 80.0)[0]:.2f} px |")
    for hull in HULLS:
        print(f"| half over a {hull} hull | {errors(12, 80.0, hull=hull)[0]:.2f} px |")


def heights() -> None:
    """Print the error of the scale by the height of the markers over the calibrated plane."""
    print("| camera over the plane | marker over the plane | error of every length |")
    print("|---|---|---|")
    for camera, marker in ((2.0, 0.01), (2.0, 0.05), (4.0, 0.05)):
        print(f"| {camera:g} m | {100 * marker:g} cm | {100 * marker / (camera - marker):.1f} % |")


if __name__ == "__main__":
    for table in (sizes, distances, backgrounds, heights):
        table()
        print()
