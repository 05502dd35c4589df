"""Memory over time of long inputs: a film of two hours, and a Parquet recording of 10^8 rows.

The film is a loop of a few seconds, whose packets are copied until it is long enough. The recording is
written in row groups. Each command runs as a child process, whose resident memory is read from ``/proc``
(Linux) every 0.2 s. Run from the source folder: ``python -m benchmarks.bench_memory [--minutes 120]
[--rows 1e8] [--draw docs/figures/memory.svg]``. It needs 6 GB of free disk in the folder for temporary files.
"""

from __future__ import annotations

import argparse
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
from pyarrow import parquet as pq

from swimid.results import drawing
from swimid.results import evidence as ev
from tests.generators import film_writer
from tests.generators.disc_film import RED_AND_YELLOW, YELLOW, Disc, Film

#: Time between two samples of the memory, s.
INTERVAL_S = 0.2
#: Duration of the loop of which a film consists, s; frame rate, Hz; number of rows in one row group.
LOOP_S, RATE_HZ, GROUP = 20.0, 30.0, 1_000_000
#: Sampling rate of the recording, Hz.
LOG_RATE_HZ = 10_000.0
#: Number of rows that are averaged to one, and disk space for each row of the recording, bytes.
EVERY, BYTES_PER_ROW = 100, 50
SETUP = RED_AND_YELLOW + "scale: {metres_per_pixel: 0.005}\n"
MAP = """\
format: swimid-mapping/1
time: {source: stamp_us, unit: us, origin: first}
columns:
  - {source: force_x, target: force_x_N, unit: mN}
  - {source: force_y, target: force_y_N, unit: mN}
  - {source: angle, target: joint1_rad, unit: deg}
  - {source: gyr_z, target: wz_rad_s, unit: deg/s}
"""


@dataclass(frozen=True)
class Usage:
    """Memory of a command over time, and its processor time."""

    time_s: np.ndarray
    mib: np.ndarray
    work_s: float

    def __str__(self) -> str:
        return f"peak {self.mib.max():.0f} MiB, {self.time_s[-1]:.0f} s, processor {self.work_s:.0f} s"


def run(words: list[str]) -> Usage:
    """Run a command, and sample its resident memory."""
    samples = []
    start, before = time.perf_counter(), _work()
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    status = Path(f"/proc/{child.pid}/statm")
    while child.poll() is None:
        pages = int((status.read_text().split() or ["0", "0"])[1])
        samples.append((time.perf_counter() - start, pages * 4096 / 2**20))
        time.sleep(INTERVAL_S)
    assert child.stdout is not None
    text = child.stdout.read()
    assert child.returncode in (0, 3), text
    times, mib = np.array(samples).T
    return Usage(times, mib, _work() - before)


def _work() -> float:
    """Processor time of the child processes that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def swimid(*words: str | Path) -> Usage:
    """Run a command of swimid."""
    return run([sys.executable, "-m", "swimid", *map(str, words), "--force", "-q"])


def place(offset_px: float, t: float) -> tuple[float, float]:
    """Centre of a disc that circles once in a loop and beats four times."""
    turn = 2 * math.pi * t / LOOP_S
    radius = 70.0 + 4.0 * math.sin(2 * math.pi * 1.2 * t)
    behind = turn - offset_px / 70.0
    return 160.0 + radius * math.cos(behind), 120.0 + radius * math.sin(behind)


def make_film(path: Path, minutes: float) -> None:
    """Write a film of one loop after the other, by copying the packets of the first."""
    discs = (Disc(lambda t: place(0.0, t)), Disc(lambda t: place(30.0, t), colour=YELLOW))
    loop = path.with_name("loop.mp4")
    film = Film(discs, duration_s=LOOP_S, rate_hz=RATE_HZ, noise=1.0)
    size = (film.width, film.height)
    film_writer.write(loop, film.frames(), size=size, times=film.times(), rate_hz=RATE_HZ, crf=23)
    with av.open(str(loop)) as source, av.open(str(path), "w") as target:
        template = source.streams.video[0]
        stream = target.add_stream_from_template(template)
        shift = round(LOOP_S / template.time_base)
        packets = [(packet, packet.pts, packet.dts) for packet in source.demux(template) if packet.size]
        for k in range(math.ceil(60 * minutes / LOOP_S)):
            for packet, pts, dts in packets:
                packet.stream = stream
                packet.pts, packet.dts = pts + k * shift, dts + k * shift
                target.mux(packet)


def make_recording(path: Path, rows: int) -> None:
    """Write a recording of a rig: time stamps, two forces, an angle, a turn rate, and a spare column."""
    rng = np.random.default_rng(1)
    names = ("force_x", "force_y", "angle", "gyr_z", "spare")
    schema = pa.schema([("stamp_us", pa.int64()), *((name, pa.float64()) for name in names)])
    with pq.ParquetWriter(path, schema, use_dictionary=False) as writer:
        for start in range(0, rows, GROUP):
            row = np.arange(start, min(start + GROUP, rows), dtype=np.int64)
            stamp = 1_700_000_000_000_000 + row * round(1e6 / LOG_RATE_HZ)
            phase = 2 * np.pi * 1.2 / LOG_RATE_HZ * row
            noise = rng.normal(size=(5, len(row))).astype(np.float32)
            waves = (
                800 * np.sin(2 * phase) + 20 * noise[0],
                300 * np.sin(phase) + 20 * noise[1],
                25 * np.sin(phase + 0.4) + 0.1 * noise[2],
                180 * np.cos(phase) + noise[3],
                noise[4],
            )
            writer.write_table(pa.Table.from_arrays([pa.array(stamp), *map(pa.array, waves)], schema=schema))


def run_film(folder: Path, minutes: float) -> dict[str, Usage]:
    """Track a film, and return the memory of the command by its name."""
    (folder / "setup.yaml").write_text(SETUP)
    make_film(folder / "film.mp4", minutes)
    words = (folder / "film.mp4", "--setup", folder / "setup.yaml", "-o", folder / "track.parquet")
    return {"track video": swimid("track", "video", *words)}


def run_recording(folder: Path, rows: int) -> dict[str, Usage]:
    """Import a recording and plot the log; return the memory of each command by its name."""
    (folder / "map.yaml").write_text(MAP)
    make_recording(folder / "rig.parquet", rows)
    words = (
        folder / "rig.parquet",
        "--map",
        folder / "map.yaml",
        "--every",
        EVERY,
        "-o",
        folder / "rig_log.parquet",
    )
    used = {"import": swimid("import", *words)}
    (folder / "rig.parquet").unlink()
    return used | {"plot": swimid("plot", folder / "rig_log.parquet", "-o", folder / "rig.png")}


def panel(title: str, used: dict[str, Usage]) -> ev.Panel:
    """Draw the memory of commands over time."""
    traces = [
        ev.Trace(x=one.time_s, y=one.mib, label=name, group=k) for k, (name, one) in enumerate(used.items())
    ]
    return ev.Panel(title=title, x_label="time (s)", y_label="memory (MiB)", traces=traces)


def main() -> None:
    """Run the commands, print peak memory and time, and draw memory over time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--rows", type=float, default=1e8)
    parser.add_argument("--draw", type=Path)
    options = parser.parse_args()
    minutes, rows = options.minutes, int(options.rows)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        free = shutil.disk_usage(folder).free
        assert free > 2 * BYTES_PER_ROW * rows, f"{folder} has {free / 1e9:.1f} GB only"
        film = run_film(folder, minutes)
        recording = run_recording(folder, rows)
    for command, usage in (film | recording).items():
        print(f"{command}: {usage}", flush=True)
    if options.draw:
        frames = round(60 * minutes * RATE_HZ)
        panels = [
            panel(f"{frames} frames of 320 x 240 px", film),
            panel(f"{rows:.0e} rows of 5 columns", recording),
        ]
        drawing.write(options.draw, [ev.panels("memory", "Memory over time", "", panels)], title="")


if __name__ == "__main__":
    main()
