"""Recordings that are too long for memory: batches, means of successive rows, and statistics of all rows."""

import tracemalloc

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet as pq

import swimid
from swimid.errors import InputError
from swimid.logs import log as log_format

MAP = {
    "time": {"source": "us", "unit": "us", "origin": "first"},
    "columns": [
        {"source": "force", "target": "force_N", "unit": "mN"},
        {"source": "yaw", "target": "yaw_rad", "unit": "deg"},
    ],
}
RATE_HZ = 1000.0


def recording(rows, *, spare=0):
    """Return a table of a force in mN with gaps, and a heading in degrees that passes 180."""
    rng = np.random.default_rng(3)
    t = np.arange(rows) / RATE_HZ
    force = 500 * np.sin(2 * np.pi * 1.3 * t) + rng.normal(size=rows)
    force[rng.random(rows) < 0.01] = np.nan
    yaw = (175 + 20 * np.sin(2 * np.pi * 1.3 * t) + 180) % 360 - 180
    table = {"us": 1_700_000_000_000_000 + 1000 * np.arange(rows), "force": force, "yaw": yaw}
    return pd.DataFrame(table | {f"spare{k}": rng.normal(size=rows) for k in range(spare)})


def write(frame, path, group):
    """Write a table to a Parquet file in groups of rows."""
    pq.write_table(pa.Table.from_pandas(frame, preserve_index=False), path, row_group_size=group)
    return path


def means(values, every):
    """Return the means of successive rows."""
    whole = len(values) // every * every
    parts = [*values[:whole].reshape(-1, every), *[values[whole:]] * (whole < len(values))]
    return np.array([np.nanmean(part) for part in parts])


@pytest.mark.parametrize("every", [None, 70])
def test_a_log_does_not_depend_on_the_batches_in_which_it_is_read(tmp_path, monkeypatch, every):
    frame = recording(5030)
    monkeypatch.setattr(log_format, "ROWS", 10_000)
    whole = swimid.import_log(write(frame, tmp_path / "a.parquet", 10_000), map_path=MAP, every=every)
    monkeypatch.setattr(log_format, "ROWS", 333)
    pieces = swimid.import_log(write(frame, tmp_path / "b.parquet", 117), map_path=MAP, every=every)
    assert list(whole.frame) == list(pieces.frame) == ["t_s", "force_N", "yaw_rad"]
    assert np.array_equal(whole.frame.to_numpy(), pieces.frame.to_numpy(), equal_nan=True)
    assert len(whole.frame) == (5030 if every is None else 72)


@pytest.mark.parametrize(
    "time",
    [
        {"source": "count", "unit": "ms", "wraps_at": 1000},
        {"rate_hz": 1000},
        {"source": "clock"},
        {"source": "date", "origin": "first"},
        {"source": ["s", "ns"], "unit": ["s", "ns"], "origin": "first"},
    ],
)
def test_every_clock_goes_on_from_batch_to_batch(tmp_path, monkeypatch, time):
    rows = 3500
    ms = np.arange(rows)
    date = pd.Timestamp("2024-05-05 23:59:58") + pd.to_timedelta(ms, unit="ms")
    frame = pd.DataFrame({
        "count": ms % 1000, "date": date, "clock": date.strftime("%H:%M:%S.%f"),
        "s": 1_700_000_000 + ms // 1000, "ns": ms % 1000 * 1_000_000, "x_m": 0.1 * np.sin(ms / 300),
    })  # fmt: skip
    monkeypatch.setattr(log_format, "ROWS", 450)
    rules = {"time": time, "columns": [{"source": "x_m", "target": "x_m"}]}
    made = swimid.import_log(write(frame, tmp_path / "run.parquet", 450), map_path=rules, clean=False)
    t = made.frame["t_s"].to_numpy()
    assert np.allclose(t - t[0], ms / 1000, atol=1e-9)


def test_every_row_is_the_mean_of_successive_rows(tmp_path):
    frame = recording(5030)
    made = swimid.import_log(write(frame, tmp_path / "run.parquet", 800), map_path=MAP, every=100)
    t = np.arange(5030) / RATE_HZ
    assert np.allclose(made.frame["t_s"], means(t, 100), atol=1e-12)
    assert np.allclose(made.frame["force_N"], means(frame["force"].to_numpy() / 1000, 100), atol=1e-12)
    true = means(np.radians(175 + 20 * np.sin(2 * np.pi * 1.3 * t)), 100)
    off = made.frame["yaw_rad"] - true
    assert np.allclose(off - 2 * np.pi * np.round(off / (2 * np.pi)), 0, atol=1e-12)
    assert made.log.metadata["mean_of_rows"] == 100


def test_statistics_are_those_of_all_rows(tmp_path, monkeypatch):
    frame = recording(5030)
    frame.loc[2000:2041, "force"] = frame.loc[2000, "force"] = 77.0
    frame.loc[3000, "us"] = frame.loc[2999, "us"]
    frame.loc[3500, "us"] = frame.loc[3498, "us"]
    monkeypatch.setattr(log_format, "ROWS", 333)
    made = swimid.import_log(write(frame, tmp_path / "run.parquet", 400), map_path=MAP, every=50)
    told, force = made.data["all_rows"], frame["force"].to_numpy() * 0.001
    one = told["channels"]["force_N"]
    assert (told["rows"], told["repeated"], told["backwards"]) == (5030, 1, 1)
    assert (one["missing"], one["samples"]) == (np.isnan(force).sum(), np.isfinite(force).sum())
    assert (one["low"], one["high"]) == (np.nanmin(force), np.nanmax(force))
    assert np.allclose([one["mean"], one["sd"]], [np.nanmean(force), np.nanstd(force)], rtol=1e-9)
    assert one["longest_hold"] == 42
    assert any("5030 time stamps" in check.reason for check in made.evidence.checks)


def test_a_pause_ends_a_mean(tmp_path):
    frame = recording(1000)
    frame.loc[455:, "us"] += 2_000_000
    made = swimid.import_log(write(frame, tmp_path / "run.parquet", 1000), map_path=MAP, every=100)
    t = made.frame["t_s"].to_numpy()
    # four means of 100 rows, one of 55, and then again from the first row after the pause
    assert np.allclose(t[3:6], [0.3495, 0.427, 2.455 + 0.0495], atol=1e-9)
    assert made.data["all_rows"]["pauses"] == 1


@pytest.mark.parametrize("fault", ["code", "clipped"])
def test_faults_that_a_mean_hides_are_found_in_all_rows(tmp_path, fault):
    frame = recording(6000)
    if fault == "code":
        frame.loc[4321, "force"] = -99_999.0
    else:
        frame["force"] = frame["force"].clip(upper=480.0)
    made = swimid.import_log(write(frame, tmp_path / "run.parquet", 1000), map_path=MAP, every=20)
    checks = {check.name: check for check in made.evidence.checks}
    assert checks["Values of all rows"].verdict == "warn"
    assert {"code": "-99.999", "clipped": "0.48"}[fault] in checks["Values of all rows"].reason


def test_quaternions_of_either_sign_have_a_mean_of_unit_length():
    t = np.arange(4000) / RATE_HZ
    sign = np.where(np.arange(4000) % 7 < 3, -1.0, 1.0)
    half = 0.2 * np.sin(2 * np.pi * t)
    frame = pd.DataFrame(
        {"t_s": t, "qw": sign * np.cos(half), "qx": 0 * t, "qy": 0 * t, "qz": sign * np.sin(half)}
    )
    made = swimid.import_log(frame, every=10).frame
    turned = np.arctan2(made["qz"], made["qw"])
    off = turned - means(half, 10)
    assert np.allclose(off - np.pi * np.round(off / np.pi), 0, atol=1e-6)
    assert np.allclose(np.hypot(made["qw"], made["qz"]), 1)


def test_memory_does_not_grow_with_the_rows_or_with_other_columns(tmp_path, monkeypatch):
    monkeypatch.setattr(log_format, "ROWS", 5000)
    peaks = []
    for rows in (50_000, 200_000):
        path = write(recording(rows, spare=6), tmp_path / f"{rows}.parquet", 5000)
        tracemalloc.start()
        swimid.import_log(path, map_path=MAP, every=1000)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 150_000 < 1.0  # bytes a row; a row of the mapped columns has 24


def test_rows_that_do_not_fit_in_memory_are_refused_with_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr("swimid.files.memory.physical_bytes", lambda: 400_000)
    monkeypatch.setattr(log_format, "ROWS", 1000)
    path = write(recording(5000), tmp_path / "run.parquet", 1000)
    with pytest.raises(InputError, match="5000 rows of 3 columns do not fit in memory") as raised:
        swimid.import_log(path, map_path=MAP)
    assert "every" in raised.value.hint
    made = swimid.import_log(path, map_path=MAP, every=10, output=tmp_path / "short.parquet")
    assert (
        len(swimid.Log.read(tmp_path / "short.parquet") if hasattr(swimid.Log, "read") else made.log) == 500
    )
    frame = recording(5000).rename(columns={"us": "t_s"})
    with pytest.raises(InputError, match="do not fit in memory") as raised:
        log_format.read(write(frame, tmp_path / "log.parquet", 1000))
    assert "--every" in raised.value.hint
    assert len(log_format.read(tmp_path / "log.parquet", optional=["force"])) == 5000


def test_columns_of_another_clock_cannot_be_averaged(tmp_path):
    path = write(recording(2000), tmp_path / "run.parquet", 1000)
    rules = MAP | {
        "join": [
            {"file": "run.parquet", "time": MAP["time"], "columns": [{"source": "yaw", "target": "a_rad"}]}
        ]
    }
    with pytest.raises(InputError, match="join"):
        swimid.import_log(path, map_path=rules, every=10)
