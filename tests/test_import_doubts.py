"""Files that are easily misread: ``swimid import`` reads them right, asks, or names the fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import swimid
from swimid.logs import log
from tests.conftest import Ran

Run = Callable[..., Ran]
T = np.arange(750) / 50.0
HEAD = "format: swimid-mapping/1\n"


@pytest.fixture
def imported(swimid: Run, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Import ``a.csv`` through the text of a mapping, if there is one; return what the command found."""

    def run(rules: str = "", *options: str) -> dict[str, Any]:
        if rules:
            (tmp_path / "m.yaml").write_text(HEAD + rules)
            options = ("--map", str(tmp_path / "m.yaml"), *options)
        ran = swimid("import", tmp_path / "a.csv", *options, "-o", tmp_path / "o.csv", "--force", "--json")
        assert ran.status == 0, ran.err
        return ran.json["result"]

    return run


def _swim(beat_hz: float = 1.1) -> pd.DataFrame:
    """A swimmer in a bend whose velocities and rates fit its pose."""
    rng = np.random.default_rng(7)
    yaw = 0.15 * T + 0.12 * np.sin(2 * np.pi * beat_hz * T)
    rate = 0.15 + 0.12 * 2 * np.pi * beat_hz * np.cos(2 * np.pi * beat_hz * T)
    u, v = 0.25 + 0.03 * np.sin(4 * np.pi * beat_hz * T), 0.05 * np.sin(2 * np.pi * beat_hz * T + 1)
    velocity = (u + 1j * v) * np.exp(1j * yaw)
    place = np.concatenate(([0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 / 50)))
    noise = rng.normal(size=(6, len(T))) * np.array([[3e-4], [3e-4], [2e-3], [3e-3], [3e-3], [5e-3]])
    values = np.array([place.real, place.imag, yaw, u, v, rate]) + noise
    names = ["x_m", "y_m", "yaw_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s"]
    return pd.DataFrame({"t_s": T, **dict(zip(names, values, strict=True))})


STROKE = 0.3 * np.sin(2 * np.pi * 1.5 * T) + 1e-3 * np.random.default_rng(1).normal(size=len(T))
#: Columns of logs with too little to judge, or with a faulty channel, and words of the verdict.
UNJUDGED: dict[str, tuple[dict[str, Any], str]] = {
    "two samples": ({"t_s": T[:2], "yaw_rad": STROKE[:2]}, "2 samples are too few to judge a log"),
    "three samples": ({"t_s": T[:3], "x_m": T[:3], "y_m": STROKE[:3]}, "3 samples are too few"),
    "no value in one channel": (
        {"t_s": T, "yaw_rad": STROKE, "x_m": np.full(len(T), np.nan)},
        "too few values to judge x_m (0 of 750)",
    ),
    "five values in one channel": (
        {"t_s": T, "u_m_s": STROKE, "yaw_rad": np.where(np.arange(len(T)) % 150 == 0, STROKE, np.nan)},
        "too few values to judge yaw_rad (5 of 750)",
    ),
    "constant channel": ({"t_s": T, "yaw_rad": STROKE, "depth_m": 0 * T + 1.2}, "depth_m holds one value"),
    "copied channel": ({"t_s": T, "roll_rad": STROKE, "pitch_rad": STROKE}, "pitch_rad equals roll_rad"),
    "time as a channel": ({"t_s": T, "force_N": T}, "force_N equals t_s"),
    "count of the rows": ({"t_s": T, "depth_m": np.arange(len(T))}, "depth_m counts the rows"),
    "mark of missing samples": (
        {"t_s": T, "force_N": np.where(np.arange(len(T)) % 50 == 0, -9999.0, STROKE)},
        "force_N holds -9999 in 1 samples",
    ),
    "one error far away": (
        {"t_s": T, "depth_m": np.where(np.arange(len(T)) == 70, 80.0, STROKE)},
        "depth_m: 1 samples in 1 jumps left out (lines 71)",
    ),
    "saturated sensor": ({"t_s": T, "force_N": np.clip(20 * STROKE, -3.0, 3.0)}, "force_N is cut off at -3"),
    "two origins of the time": (
        {"t_s": np.where(np.arange(len(T)) < 400, T, T + 1.7e9), "yaw_rad": STROKE},
        "no sample lies between 7.98 s and 1.7e+09 s",
    ),
}


@pytest.mark.parametrize("case", UNJUDGED)
def test_a_log_is_not_good_without_evidence(case: str) -> None:
    columns, words = UNJUDGED[case]
    found = swimid.import_log(pd.DataFrame(columns)).data
    assert found["verdict"]["level"] == "caution"
    assert words in found["verdict"]["text"]


def test_a_log_without_any_value_is_bad() -> None:
    found = swimid.import_log(pd.DataFrame({"t_s": T, "yaw_rad": np.full(len(T), np.nan)})).data
    assert found["verdict"]["level"] == "bad"
    assert "too few values to judge yaw_rad (0 of 750)" in found["verdict"]["text"]


def test_a_check_that_the_samples_do_not_allow_does_not_pass() -> None:
    checks = swimid.import_log(pd.DataFrame({"t_s": T[:2], "yaw_rad": STROKE[:2]})).data["checks"]
    verdicts = {check["name"]: check["verdict"] for check in checks}
    names = ("Columns agree", "Sampling", "Frozen channels", "Faulty channels", "Values a swimmer reaches")
    assert {verdicts[name] for name in names} == {"info"}
    whole = {check["name"]: check["verdict"] for check in swimid.import_log(_swim()).data["checks"]}
    assert {whole[name] for name in names} == {"pass"}


def test_commands_and_synonyms_may_be_constant_or_equal() -> None:
    rate = 3.0 * np.cos(2 * np.pi * 1.5 * T) + 1e-3 * STROKE
    columns = {"t_s": T, "cmd1_rad": 0 * T, "cmd2_rad": 0 * T, "wz_rad_s": rate, "yaw_rate_rad_s": rate}
    assert swimid.import_log(pd.DataFrame(columns)).data["verdict"]["level"] == "good"


def test_columns_that_agree_are_good(imported: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    _swim().to_csv(tmp_path / "a.csv", index=False)
    result = imported()
    assert result["contradictions"] == []
    assert result["verdict"]["level"] == "good"


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("u_m_s", 1000.0, "1000 times too large"),
        ("v_m_s", -1.0, "opposite sign"),
        ("yaw_rate_rad_s", 180 / np.pi, "degrees"),
    ],
)
def test_a_rate_in_another_unit_is_named(
    column: str, factor: float, words: str, imported: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    table = _swim()
    table[column] *= factor
    table.to_csv(tmp_path / "a.csv", index=False)
    result = imported()
    (found,) = result["contradictions"]
    assert found["column"] == column
    assert words in found["text"]
    assert result["verdict"]["level"] == "bad"


def test_a_mirrored_track_contradicts_its_heading(
    imported: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    table = _swim()[["t_s", "x_m", "y_m", "yaw_rad"]]
    table["y_m"] *= -1
    table.to_csv(tmp_path / "a.csv", index=False)
    result = imported()
    assert [one["against"] for one in result["contradictions"]] == ["the course of the track"]
    assert result["verdict"]["level"] == "bad"


@pytest.mark.parametrize("direction", ["body-to-world", "world-to-body"])
def test_the_direction_of_a_quaternion(
    direction: str, imported: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    roll, yaw = 0.2 * np.sin(2 * np.pi * 0.9 * T), 0.3 * np.sin(2 * np.pi * 0.4 * T)
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw, 0 * T, roll]))
    steps = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * 50
    rates = np.vstack((steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]))
    q = attitude if direction == "body-to-world" else attitude.inv()
    columns = dict(zip(["q1", "q2", "q3", "q0"], q.as_quat().T, strict=True))
    rates = rates + 0.01 * np.random.default_rng(3).normal(size=rates.shape)
    columns |= dict(zip(["wx_rad_s", "wy_rad_s", "wz_rad_s"], rates.T, strict=True))
    pd.DataFrame({"t_s": T, **columns}).to_csv(tmp_path / "a.csv", index=False)
    names = zip(["q0", "q1", "q2", "q3"], ["qw", "qx", "qy", "qz"], strict=True)
    listed = [*names, *((name, name) for name in ("wx_rad_s", "wy_rad_s", "wz_rad_s"))]
    columns = ", ".join(f"{{source: {a}, target: {b}}}" for a, b in listed)
    rules = f"time: {{source: t_s}}\ncolumns: [{columns}]\n"
    plain = imported(rules)
    assert (plain["verdict"]["level"] == "bad") == (direction == "world-to-body")
    if direction == "world-to-body":
        assert "world-to-body" in plain["contradictions"][0]["text"]
    turned = imported(rules + f"quaternion: {{direction: {direction}}}\n")
    assert turned["contradictions"] == []
    q = log.read(tmp_path / "o.csv")
    found = Rotation.from_quat(np.column_stack([q[f"q{axis}"] for axis in "xyzw"]))
    assert (found.inv() * attitude).magnitude().max() < 1e-6


def test_two_animals_at_even_times(swimid: Run, imported: Any, tmp_path: Path) -> None:
    """Their rows come at even times in turn, so that only the name tells them apart."""
    table = pd.DataFrame({"time (ms)": 20 * np.arange(len(T)), "animal": np.arange(len(T)) % 2})
    table["x (mm)"] = np.where(table.animal == 0, 100 + T, 400 - T)
    table.to_csv(tmp_path / "a.csv", index=False)
    rules = 'time: {source: "time (ms)", unit: ms}\ncolumns: [{source: "x (mm)", target: x_m, unit: mm}]\n'
    (tmp_path / "m.yaml").write_text(HEAD + rules)
    ran = swimid("import", tmp_path / "a.csv", "--map", tmp_path / "m.yaml", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert "where: {animal: 0}" in ran.err
    assert imported(rules + "where: {animal: 1}\n")["median_rate_hz"] == pytest.approx(25)


def test_frame_numbers_of_a_fast_camera(imported: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    frames = np.arange(1000, 3000)
    table = pd.DataFrame(
        {"Frame#": frames, "cx": 3.0 * frames, "cy": 20 * np.sin(2 * np.pi * 1.7 * frames / 240)}
    )
    table.drop(index=range(600, 700)).to_csv(tmp_path / "a.csv", index=False)
    columns = "[{source: cx, target: x_px}, {source: cy, target: y_px, factor: -1}]"
    result = imported(f'time: {{frame: "Frame#", rate_hz: 240}}\ncolumns: {columns}\n')
    assert result["speed"]["line_px_s"] == pytest.approx(720, rel=1e-3)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.7, abs=0.01)
    assert result["track"]["gaps_s"]


def test_a_confidence_under_another_name(imported: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    sure = np.where((T > 3) & (T < 4), 0.1, 0.9)
    table = pd.DataFrame({"t": T, "head_x": 5 * T, "head_y": np.sin(T), "head_confidence": sure})
    table.to_csv(tmp_path / "a.csv", index=False)
    columns = (
        "[{source: head_x, target: x_px}, {source: head_y, target: y_px}, "
        "{source: head_confidence, target: c, unit: '1'}]"
    )
    result = imported(f"time: {{source: t}}\ncolumns: {columns}\n")
    assert result["unlikely"] == {"c": int((sure < 0.5).sum())}
    assert result["verdict"]["level"] == "caution"
    assert not imported(f"time: {{source: t}}\nmin_likelihood: 0.05\ncolumns: {columns}\n")["unlikely"]


def test_dates_need_the_order_of_day_and_month(
    swimid: Run, imported: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    stamps = pd.Timestamp("2025-04-07 23:59:50") + pd.to_timedelta(T, unit="s")
    table = pd.DataFrame(
        {"Datum": stamps.strftime("%d.%m.%Y"), "Zeit": stamps.strftime("%H:%M:%S.%f"), "x_m": T}
    )
    table.to_csv(tmp_path / "a.csv", index=False)
    rules = "columns: [{source: x_m, target: x_m}]\n"
    (tmp_path / "m.yaml").write_text(f"{HEAD}time: {{source: [Datum, Zeit]}}\n{rules}")
    ran = swimid("import", tmp_path / "a.csv", "--map", tmp_path / "m.yaml", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert "format: " in ran.err
    # the time of day alone passes midnight
    assert imported("time: {source: Zeit, origin: first}\n" + rules)["duration_s"] == pytest.approx(T[-1])
    strptime = "time: {source: [Datum, Zeit], format: '%d.%m.%Y %H:%M:%S.%f', origin: first}\n"
    assert imported(strptime + rules)["duration_s"] == pytest.approx(T[-1])


def test_a_column_without_a_quantity_is_bad(imported: Callable[..., dict[str, Any]], tmp_path: Path) -> None:
    pd.DataFrame({"t_s": T, "x_m": 0.1 * T, "level": np.sin(T)}).to_csv(tmp_path / "a.csv", index=False)
    columns = "columns: [{source: x_m, target: x_m}, {source: level, target: level"
    rules = f"time: {{source: t_s}}\n{columns}"
    assert imported(rules + "}]\n")["verdict"]["level"] == "bad"
    assert imported(rules + ", unit: '1'}]\n")["verdict"]["level"] == "good"
    # without a mapping it is left out, with a note
    assert imported()["columns"] == ["t_s", "x_m"]


@pytest.mark.parametrize("decimals", [3, 4])
def test_rounding_of_a_steady_motion_is_no_stroke(decimals: int, imported: Any, tmp_path: Path) -> None:
    """A line of constant speed, rounded: the rounding error is periodic, and fits a sine without an error."""
    time = np.arange(600) / 30.0
    table = pd.DataFrame({"t_s": time, "x_m": np.round(0.2 * time, decimals)})
    table.to_csv(tmp_path / "a.csv", index=False)
    assert "unknown" in imported()["stroke"]
    table["x_m"] = np.round(0.2 * time + 0.01 * np.sin(2 * np.pi * 1.3 * time), decimals)
    table.to_csv(tmp_path / "a.csv", index=False)
    assert imported()["stroke"]["frequency_hz"] == pytest.approx(1.3, abs=2e-3)


@pytest.mark.parametrize(
    "header,unit", [("millis", "ms"), ("seconds", "s"), ("timestamp", "ASK"), ("Zeit (ms)", "ms")]
)
def test_a_draft_takes_the_unit_that_the_name_of_the_time_states(
    header: str, unit: str, swimid: Run, tmp_path: Path
) -> None:
    (tmp_path / "run.csv").write_text(f"{header},x (mm)\n" + "".join(f"{7 * k},{k}\n" for k in range(20)))
    assert swimid("import", tmp_path / "run.csv", "--guess", "-o", tmp_path / "m.yaml").status == 0
    assert f'time: {{source: "{header}", unit: {unit}}}' in (tmp_path / "m.yaml").read_text().replace(
        f'unit: "{unit}"', f"unit: {unit}"
    )


def test_a_group_above_empty_cells_stands_for_all_its_columns(swimid: Run, tmp_path: Path) -> None:
    # two markers with three coordinates each, their names above the first coordinate only
    rows = "".join(f"{k + 1},{k},{2 * k},0,{k - 9},{2 * k},0\n" for k in range(20))
    text = ",Head,,,Tail,,\nFrame,X,Y,Z,X,Y,Z\n,mm,mm,mm,mm,mm,mm\n" + rows
    (tmp_path / "run.csv").write_text(text)
    assert swimid("import", tmp_path / "run.csv", "--guess", "-o", tmp_path / "m.yaml").status == 0
    draft = (tmp_path / "m.yaml").read_text()
    for point in ("head", "tail"):
        for axis in "xyz":
            assert f"target: {point}_{axis}_m" in draft


def test_two_columns_of_one_name_are_refused(swimid: Run, tmp_path: Path) -> None:
    rows = "".join(f"{k / 50},{0.01 * k},{1 - 0.02 * k}\n" for k in range(100))
    (tmp_path / "run.csv").write_text("t_s,x_m,x_m\n" + rows)
    ran = swimid("import", tmp_path / "run.csv", "-o", tmp_path / "out.csv")
    assert ran.status == 3
    assert "'x_m': several columns have this name" in ran.err
    mapping = "format: swimid-mapping/1\ntime: {source: t_s, unit: s}\ncolumns: [{source: 3, target: x_m}]\n"
    (tmp_path / "m.yaml").write_text(mapping)
    args = ("--map", tmp_path / "m.yaml", "-o", tmp_path / "out.csv")
    assert swimid("import", tmp_path / "run.csv", *args).status == 0
    assert log.read(tmp_path / "out.csv")["x_m"][0] == 1.0
