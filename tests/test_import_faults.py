"""Faults of recordings that must not change the values of a log, and files of widespread formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from swimid import guess_mapping, import_log

from .conftest import Ran

SPEED, COURSE = 0.2137, np.radians(20.0)


def swim(rate_hz: float = 50.0, seconds: float = 12.0) -> pd.DataFrame:
    """Return a swim along a line with a yawing head, as columns of a log."""
    rng = np.random.default_rng(3)
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    x, y = (SPEED * t * part + rng.normal(0, 3e-4, t.size) for part in (np.cos(COURSE), np.sin(COURSE)))
    yaw = COURSE + 0.14 * np.sin(8.0 * t) + rng.normal(0, 0.004, t.size)
    return pd.DataFrame({"t_s": t, "x_m": x, "y_m": y, "yaw_rad": yaw})


def test_a_heading_that_crosses_the_full_turn_leaves_the_track(tmp_path: Path, swimid: Any) -> None:
    table = swim()
    table["yaw_rad"] = np.mod(table["yaw_rad"] - COURSE, 2 * np.pi)
    table.to_csv(tmp_path / "a.csv", index=False)
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "o.csv", "--json")
    log = pd.read_csv(tmp_path / "o.csv", comment="#")
    assert log["x_m"].notna().all()
    assert ran.json["verdict"]["level"] == "good"
    assert ran.json["result"]["speed"]["line_m_s"] == pytest.approx(SPEED, rel=5e-3)


def test_flips_of_an_attitude_leave_no_full_turn(tmp_path: Path) -> None:
    """A reader of quaternions unwraps the heading, and counts a full turn for two flips by half a turn."""
    table = swim(100.0)
    yaw = table["yaw_rad"].to_numpy() + np.isin(np.arange(len(table)), [300, 301, 302, 700, 900]) * np.pi
    names = ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position"
    head = (
        "Format Version,1.23,Take Name,a,Capture Frame Rate,100,Rotation Type,Quaternion,Length Units,Meters"
    )
    rows = [head, "", ",," + ",".join(["Rigid Body"] * 7), ",," + ",".join(["fish"] * 7)]
    rows += [",," + ",".join(["A1"] * 7), names, "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z"]
    for k, (t, x, y, _) in enumerate(table.to_numpy()):
        turn = f"0,{np.sin(yaw[k] / 2):.7f},0,{np.cos(yaw[k] / 2):.7f}"
        rows.append(f"{k},{t:.4f},{turn},{x:.6f},0.1,{-y:.6f}")
    path = tmp_path / "take.csv"
    path.write_text("\n".join(rows) + "\n")
    log = import_log(path).log
    left = np.isfinite(log.columns["yaw_rad"])
    assert left.sum() == len(table) - 5
    assert np.abs(log.columns["yaw_rad"] - table["yaw_rad"])[left].max() < 1e-5


@pytest.mark.parametrize("wrong", [-5.0, 1e6])
def test_one_wrong_time_is_left_out_and_named(wrong: float, swimid: Any, tmp_path: Path) -> None:
    table = swim()
    table.loc[200, "t_s"] = wrong
    table.to_csv(tmp_path / "a.csv", index=False)
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "o.csv", "--json")
    result = ran.json["result"]
    assert result["duration_s"] == pytest.approx(12.0)
    assert result["rows"]["misdated"] == 1
    assert result["speed"]["line_m_s"] == pytest.approx(SPEED, rel=5e-3)
    assert "far from all other times" in " ".join(ran.err.split())


@pytest.mark.parametrize("lost", [0, 17])
@pytest.mark.parametrize("rate_hz", [30.0, 60.0])
def test_the_text_of_kinovea_0_8(
    rate_hz: float, lost: int, imported: Callable[..., tuple[Any, Ran]], tmp_path: Path
) -> None:
    """Kinovea 0.8 writes no name of a track, and cuts its times to hundredths of a second."""
    table = swim(rate_hz)
    kept = np.delete(np.arange(len(table)), np.arange(100, 100 + lost))
    rows = ["#Kinovea Trajectory data export", "#T X Y"]
    for k in kept:
        hundredths = int(100 * k / rate_hz + 1e-9)
        clock = f"0:00:{hundredths // 100:02d}:{hundredths % 100:02d}"
        rows.append(f"{clock} {100 * table['x_m'][k]:.2f} {100 * table['y_m'][k]:.2f} ".replace(".", ","))
    path = tmp_path / "a.txt"
    path.write_text("\n".join(rows) + "\n\n\n")
    log, _ = imported(path, "--rate-hz", f"{rate_hz:g}", "--length-unit", "cm")
    assert log.columns["t_s"] == pytest.approx(kept / rate_hz)
    assert log.columns["track_1_x_m"] == pytest.approx(table["x_m"][kept].to_numpy(), abs=6e-5)


@pytest.mark.parametrize("mark", [",", "\t", ";", " "])
def test_stamps_of_a_serial_monitor_are_a_column(mark: str, tmp_path: Path) -> None:
    rows = [["millis", "yaw_deg", "force_N"]]
    rows += [[str(20 * k), f"{10 * np.sin(0.2 * k):.3f}", f"{0.1 * k:.2f}"] for k in range(100)]
    lines = [f"10:00:{k // 50:02d}.{20 * (k % 50):03d} -> {mark.join(cells)}" for k, cells in enumerate(rows)]
    (tmp_path / "a.txt").write_text("\n".join(lines) + "\n")
    draft = guess_mapping(tmp_path / "a.txt", output=tmp_path / "map.yaml")
    assert [column.target for column in draft.mapping.columns if column.target != "millis"][:1] == ["yaw_rad"]
    log = import_log(tmp_path / "a.txt", map_path=tmp_path / "map.yaml").log
    assert np.degrees(log.columns["yaw_rad"]) == pytest.approx([float(cells[1]) for cells in rows[1:]])


def test_a_draft_takes_what_the_user_states(swimid: Any, tmp_path: Path) -> None:
    """The hint of a refused draft is an option; with it, the draft must be written and be complete."""
    table = swim()
    points = pd.DataFrame({f"nose_{axis}": 1000 * table[f"{axis}_m"] for axis in "xy"})
    points["nose_z"], points["nose_error"], points["nose_ncams"], points["nose_score"] = 0.0, 1.0, 3, 0.9
    for name in [f"M_{row}{column}" for row in range(3) for column in range(3)]:
        points[name] = float(name[2] == name[3])
    points[["center_0", "center_1", "center_2"]] = 0.0
    points["fnum"] = np.arange(len(points))
    path, draft = tmp_path / "a.csv", tmp_path / "map.yaml"
    points.to_csv(path, index=False)
    asked = swimid("import", path, "--guess", "-o", draft)
    assert asked.status == 3
    assert "--length-unit" in asked.err
    assert (
        swimid("import", path, "--guess", "--length-unit", "mm", "--rate-hz", "50", "-o", draft).status == 0
    )
    assert "ASK;" not in draft.read_text().replace("ASK;", "", 1)
    log = import_log(path, map_path=draft).log
    assert log.columns["nose_x_m"] == pytest.approx(table["x_m"].to_numpy())
    assert log.columns["t_s"] == pytest.approx(table["t_s"].to_numpy())


def inertial() -> pd.DataFrame:
    """Return an inertial recording at 100 Hz with rests at both ends."""
    rng = np.random.default_rng(7)
    t = np.arange(1500) / 100.0
    swims = (t > 3) & (t < 12)
    signals = {name: rng.normal(0, 0.02, t.size) for name in ("ax_m_s2", "ay_m_s2", "az_m_s2")}
    signals["az_m_s2"] += 9.81
    signals |= {name: rng.normal(0, 0.002, t.size) for name in ("wx_rad_s", "wy_rad_s", "wz_rad_s")}
    signals["wz_rad_s"] += 1.1 * np.sin(8.0 * (t - 3)) * swims
    return pd.DataFrame({"t_s": t, **signals})


@pytest.mark.parametrize("fault", ["spike", pytest.param("zeros", marks=pytest.mark.slow)])
def test_single_faults_of_a_gyroscope_do_not_turn_the_heading(
    fault: str, swimid: Any, tmp_path: Path
) -> None:
    table = inertial()
    if fault == "spike":
        table.loc[700, "wz_rad_s"] = -34.9
    else:
        table.loc[[600, 601, 602, 603], table.columns[1:]] = 0.0
    table.to_csv(tmp_path / "a.csv", index=False)
    ran = swimid("track", "imu", tmp_path / "a.csv", "-o", tmp_path / "o.csv")
    assert ran.status == 0, ran.err
    turned = 1.1 / 8.0 * (1.0 - np.cos(8.0 * 9.0))
    log = pd.read_csv(tmp_path / "o.csv", comment="#")
    assert log["yaw_rad"].iloc[-1] == pytest.approx(turned, abs=0.02)
    assert {"spike": "corrupt readings", "zeros": "empty samples"}[fault] in ran.err
