"""Tracking speed against decoding alone, and accuracy, on rendered 1080p and 4K films.

::

    python -m benchmarks.bench_tracking [--frames 240] [--repeats 5] [--only 1080p]

Renders each film once into a folder of the system's temporary directory, then interleaves
runs of "decode only" (OpenCV read into one buffer, OpenCV's own settings), of the tracker's reader
alone (one decoder thread more than cores) and of the tracker, and prints medians of the rates and of
the ratios of runs made one after the other. Compare ratios: absolute rates depend on the
machine and its load.

Then the smoothing of three coordinates of the track, a heading and a place, with the search for the noise, as
a share of the time that decoding the same film took just before.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from swimid.points.plane import plane_of
from swimid.tracking import pose
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import Video
from swimid.tracking.tracker import Follower
from tests.generators import pool_video
from tests.generators.pool_video import Scene

#: Constant rate factors chosen for about 12 and 45 Mbit/s; the third film is easy to decode.
FULL_HD = Scene(width=1920, height=1080, preset="veryfast", dropout_s=None, duration_s=8.0)
FILMS = {
    "1080p": (replace(FULL_HD, noise=4.0, crf=22.5), 240),
    "1080p easy": (replace(FULL_HD, noise=1.0, crf=22), 240),
    "4K": (replace(FULL_HD, width=3840, height=2160, noise=4.0, crf=24), 90),
}


def film(name: str, scene: Scene, frames: int) -> tuple[Path, Path, Scene]:
    """Render the film unless it is there already."""
    scene = replace(scene, duration_s=frames / scene.rate_hz)
    folder = Path(tempfile.gettempdir()) / "swimid-bench-tracking"
    stem = f"{name.replace(' ', '-')}-{frames}"
    video, setup, truth = (folder / f"{stem}{end}" for end in (".mp4", "_setup.yaml", "_truth.csv"))
    if not truth.exists():
        pool_video.write_scene(folder, scene, stem)
    return video, setup, scene


def decode(video: Path) -> float:
    """Frames per second of reading alone, with OpenCV's own settings."""
    cv2.setNumThreads(1)
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    begin = time.perf_counter()
    count, frame = 0, None
    while True:
        ok, frame = capture.read(frame)
        if not ok:
            break
        count += 1
    rate = count / (time.perf_counter() - begin)
    capture.release()
    return rate


def read(video: Path) -> float:
    """Frames per second of reading alone, with the tracker's reader and decoder threads."""
    begin = time.perf_counter()
    count = sum(1 for _ in Video(video).frames())
    return count / (time.perf_counter() - begin)


def track(video: Path, rules: setup_format.Setup) -> tuple[float, Follower]:
    """Frames per second of reading and tracking."""
    begin = time.perf_counter()
    source = Video(video)
    follower = Follower(rules, source.width, source.height)
    count = 0
    for stamp, frame in source.frames():
        follower.step(stamp, frame)
        count += 1
    return count / (time.perf_counter() - begin), follower


def smoothing(follower: Follower) -> float:
    """Seconds a frame of the smoother, the search for the noise included."""
    raw = follower.track()
    rows = np.array(
        [np.where(raw.is_visible[0], values, np.nan) for values in (raw.x[0], raw.y[0], raw.x[-1])]
    )
    begin = time.perf_counter()
    pose.smooth_path(raw.times, rows, np.ones(len(raw.times)), [(0, len(raw.times))])
    return (time.perf_counter() - begin) / len(raw.times)


def accuracy(follower: Follower, scene: Scene) -> tuple[int, float]:
    """Misses, and RMS error per axis of the nose marker in px."""
    raw = follower.track()
    truth = pool_video.motion(scene.swims[0], scene.times())
    ground = plane_of(follower.setup, scene.width, scene.height)
    x, y = ground.to_image(truth.x_m, truth.y_m)
    head = raw.names.index(follower.setup.head_name)
    n = min(len(x), raw.x.shape[1])
    error = np.stack([raw.x[head, :n] - x[:n], raw.y[head, :n] - y[:n]])
    return int(np.isnan(error[0]).sum()), float(np.sqrt(np.nanmean(error**2)))


def main() -> None:
    """Print one row per film."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", choices=list(FILMS))
    options = parser.parse_args()
    shares: dict[str, float] = {}
    columns = ["film", "Mbit/s", "decode fps", "own reader fps", "track fps", "of decode", "of own reader"]
    print("| " + " | ".join([*columns, "misses", "rmse px"]) + " |")
    print("|---" * (len(columns) + 2) + "|")
    for name, (scene, frames) in FILMS.items():
        if options.only and name != options.only:
            continue
        count = options.frames or frames
        video, setup_path, scene = film(name, scene, count)
        rules = setup_format.read(setup_path)
        track(video, rules)  # compiles
        pairs = []
        for repeat in range(options.repeats):
            if repeat % 2:
                tracked, follower = track(video, rules)
                alone, own = decode(video), read(video)
            else:
                own, alone = read(video), decode(video)
                tracked, follower = track(video, rules)
            pairs.append((alone, own, tracked))
        rate = video.stat().st_size * 8 / 1e6 / scene.duration_s
        misses, rmse = accuracy(follower, scene)
        smoothing(follower)  # compiles
        shares[name] = statistics.median(smoothing(follower) * decode(video) for _ in range(options.repeats))
        print(
            f"| {name} | {rate:.1f} | {statistics.median(p[0] for p in pairs):.0f} "
            f"| {statistics.median(p[1] for p in pairs):.0f} "
            f"| {statistics.median(p[2] for p in pairs):.0f} "
            f"| {statistics.median(p[2] / p[0] for p in pairs):.3f} "
            f"| {statistics.median(p[2] / p[1] for p in pairs):.3f} | {misses} | {rmse:.3f} |",
            flush=True,
        )
    print("\n| film | smoothing, of decode |")
    print("|---" * 2 + "|")
    for name, share in shares.items():
        print(f"| {name} | {share:.4f} |")


if __name__ == "__main__":
    main()
