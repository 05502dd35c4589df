"""Import of 10 million IMU rows against ``pandas.read_csv`` alone: ratio of speeds, peak memory.

Timed are the reading itself, with the units, times and checks of a mapping, and the whole command, from
starting Python to the log and its evidence on the disk; of pandas only the reading. Run from the source
folder: ``python benchmarks/bench_import.py [ROWS]``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv
from pyarrow import parquet as pq

ROWS = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10_000_000
PIECE = 1_000_000
NAMES = ["stamp_ms", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
MAP = """\
format: swimid-mapping/1
time: {source: stamp_ms, unit: ms}
columns:
  - {source: acc_x, target: ax_m_s2, unit: g}
  - {source: acc_y, target: ay_m_s2, unit: g}
  - {source: acc_z, target: az_m_s2, unit: g}
  - {source: gyr_x, target: wx_rad_s, unit: deg/s}
  - {source: gyr_y, target: wy_rad_s, unit: deg/s}
  - {source: gyr_z, target: wz_rad_s, unit: deg/s}
"""
PANDAS = """\
import sys, time, pandas
wall, work = time.perf_counter(), time.process_time()
pandas.read_csv(sys.argv[1])
print(time.perf_counter() - wall, time.process_time() - work)
"""
READING = """\
import sys, time
from pathlib import Path
from swimid.imports import mapping
from swimid.notices import silent
rules = mapping.read_mapping(sys.argv[2])
wall, work = time.perf_counter(), time.process_time()
mapping.apply(rules, Path(sys.argv[1]), progress=silent)
print(time.perf_counter() - wall, time.process_time() - work)
"""


def make(folder: Path) -> None:
    """The same samples as CSV and Parquet, with the digits of a 16-bit sensor."""
    rng = np.random.default_rng(1)
    schema = pa.schema([(name, pa.float64()) for name in NAMES])
    with (
        csv.CSVWriter(folder / "imu.csv", schema) as text,
        pq.ParquetWriter(folder / "imu.parquet", schema) as table,
    ):
        for start in range(0, ROWS, PIECE):
            t = np.arange(start, min(start + PIECE, ROWS), dtype=float)
            phase = 2 * np.pi * 1.5e-3 * t
            columns = [t]
            for k in range(3):
                columns.append(
                    np.round((k == 2) + 0.05 * np.sin(phase + k) + 0.002 * rng.normal(size=len(t)), 5)
                )
            for k in range(3):
                columns.append(np.round(30 * np.sin(phase + k) + 0.1 * rng.normal(size=len(t)), 4))
            piece = pa.Table.from_arrays([pa.array(c) for c in columns], schema=schema)
            text.write_table(piece)
            table.write_table(piece)


def run(words: list[str]) -> tuple[float, float, float, str]:
    """Wall time and processor time, s, peak memory, GiB, and output of a command."""
    start = time.perf_counter()
    child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    text = child.stdout.read()
    _, status, usage = os.wait4(child.pid, 0)
    assert status == 0, f"{words} failed"
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20, text


def main() -> None:
    """Print one line per way."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder)
        (folder / "map.yaml").write_text(MAP)
        python = [sys.executable, "-c", PANDAS, str(folder / "imu.csv")]
        size = (folder / "imu.csv").stat().st_size / 2**20
        print(f"{ROWS} rows of {len(NAMES)} columns, {size:.0f} MiB as CSV; wall and processor time")
        for source in ("csv", "parquet"):
            peer, peer_work = (float(x) for x in run(python)[3].split())
            words = [sys.executable, "-c", READING, str(folder / f"imu.{source}"), str(folder / "map.yaml")]
            seconds, work = (float(x) for x in run(words)[3].split())
            _print(f"read {source:7} to memory    ", seconds, work, peer, peer_work)
        for source, target in (
            ("csv", "parquet"),
            ("csv", "csv"),
            ("parquet", "parquet"),
            ("parquet", "csv"),
        ):
            words = [sys.executable, "-m", "swimid", "import", str(folder / f"imu.{source}")]
            output = folder / target / f"out.{target}"
            output.parent.mkdir(exist_ok=True)
            words += ["--map", str(folder / "map.yaml"), "-o", str(output), "--force", "-q"]
            # the peer right before: whatever else the machine does, it does to both
            peer, peer_work = (float(x) for x in run(python)[3].split())
            seconds, work, peak, _ = run(words)
            _print(
                f"import {source:7} -> {target:7}", seconds, work, peer, peer_work, f", peak {peak:.2f} GiB"
            )


def _print(what: str, seconds: float, work: float, peer: float, peer_work: float, more: str = "") -> None:
    print(
        f"{what} {seconds:5.1f} s {work:5.1f} s, pandas.read_csv {peer:5.1f} s {peer_work:5.1f} s: "
        f"{peer / seconds:.2f} ({peer_work / work:.2f}) of its speed{more}",
        flush=True,
    )


if __name__ == "__main__":
    main()
