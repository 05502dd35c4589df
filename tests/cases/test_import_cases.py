"""Recorded inputs of ``swimid import`` that once ended with a wrong number and a good verdict."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.imports import mapping
from swimid.logs import log
from tests.conftest import Ran

Run = Callable[..., Ran]
Case = Callable[..., Path]
HEAD = "format: swimid-mapping/1\n"


@pytest.fixture
def imported(swimid: Run) -> Callable[..., dict[str, Any]]:
    """Import a file; return what the command found."""

    def run(file: str, *options: str) -> dict[str, Any]:
        ran = swimid("import", file, *options, "-o", "out.csv", "--force", "--json")
        assert ran.status == 0, ran.err
        return ran.json["result"]

    return run


@pytest.fixture
def drafted(swimid: Run) -> Callable[[str], str]:
    """Draft the mapping of a file as ``map.yaml``; return its text."""

    def draft(file: str) -> str:
        assert swimid("import", file, "--guess", "-o", "map.yaml", "--force").status == 0
        return Path("map.yaml").read_text()

    return draft


def _mapped(file: str) -> mapping.MappedLog:
    """Read a file with the mapping in ``map.yaml``."""
    return mapping.apply(mapping.read_mapping("map.yaml"), file)


def _answer(text: str, **answers: str) -> None:
    """Write the draft with its questions answered, and without the lines that stay open."""
    for key, value in answers.items():
        text = text.replace(f"{key}: ASK", f"{key}: {value}")
    lines = [line for line in text.splitlines() if "ASK" not in line.partition("#")[0]]
    Path("map.yaml").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("file", ["imu_near.csv", "imu_same.csv"])
def test_instances_are_never_mixed(
    file: str, case: Case, imported: Callable[..., dict[str, Any]], swimid: Run
) -> None:
    case("c-01-interleaved-instances")
    result = imported(file)
    assert result["samples"] == 1000
    assert result["median_rate_hz"] == pytest.approx(50, rel=1e-3)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=1e-3)
    assert result["verdict"]["level"] == "caution"
    columns = "columns: [{source: GyrZ, target: wz_rad_s}]\n"
    Path("map.yaml").write_text(HEAD + "time: {source: TimeUS, unit: us}\n" + columns)
    ran = swimid("import", file, "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "2 instances" in ran.err
    assert "where: {I: 0}" in ran.err
    Path("map.yaml").write_text(HEAD + "time: {source: TimeUS, unit: us}\nwhere: {I: 1}\n" + columns)
    assert imported(file, "--map", "map.yaml")["samples"] == 1000


def test_rows_of_two_tags(case: Case, drafted: Callable[[str], str], imported: Any, swimid: Run) -> None:
    case("c-01-interleaved-instances")
    text = drafted("tags.csv")
    assert "rate_hz: ASK" in text
    _answer(text, rate_hz="30")
    mixed = swimid("import", "tags.csv", "--map", "map.yaml", "-o", "out.csv")
    assert mixed.status == 3
    assert "where: {tag_id: " in mixed.err
    Path("map.yaml").write_text(Path("map.yaml").read_text() + "where: {tag_id: 3}\n")
    result = imported("tags.csv", "--map", "map.yaml")
    assert result["track"]["jumps"] == 0
    assert result["speed"]["line_m_s"] == pytest.approx(0.2, rel=0.01)


def test_frame_numbers_with_gaps_are_times(case: Case, imported: Any, drafted: Callable[[str], str]) -> None:
    case("c-02-frame-numbers-with-gaps")
    result = imported("frame_gaps.csv", "--map", "fr.yaml")
    assert result["duration_s"] == pytest.approx(19.93, abs=0.05)
    assert result["speed"]["path_m_s"] == pytest.approx(0.2018, rel=1e-3)
    assert result["speed"]["line_m_s"] == pytest.approx(0.2, rel=1e-3)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=2e-3)
    gaps = sorted(end - start for start, end in result["track"]["gaps_s"])
    assert gaps == pytest.approx([1.53, 2.03], abs=0.05)
    for file in ("frame_gaps.csv", "frame_only.csv"):
        text = drafted(file)
        assert 'time: {frame: "frame", rate_hz: ASK}' in text
        assert text.count("target: ASK") == 2


@pytest.mark.parametrize(("file", "emptied"), [("dlc2_soft.csv", 156), ("dlc_drift.csv", None)])
def test_unlikely_points_are_left_empty(file: str, emptied: int | None, case: Case, imported: Any) -> None:
    folder = case("c-05-dlc-low-likelihood")
    result = imported(file, "--rate-hz", "30")
    raw = np.genfromtxt(folder / file, delimiter=",", skip_header=3)
    unlikely = raw[:, 3] < 0.6
    record = log.read(folder / "out.csv")
    names = [name for name in record.columns if name.endswith("_x_px")]
    assert np.array_equal(np.isnan(record[names[0]]), unlikely)
    assert np.allclose(record[names[0]][~unlikely], raw[~unlikely, 1])
    assert emptied in (None, next(iter(result["unlikely"].values())))
    assert result["verdict"]["level"] == "caution"


def test_a_motion_in_degrees(case: Case, imported: Any) -> None:
    folder = case("c-06-opensim-indegrees")
    result = imported("small.mot")
    record = log.read(folder / "out.csv")
    assert np.ptp(record["joint1_rad"]) / 2 == pytest.approx(np.radians(1.2), rel=0.01)
    assert np.ptp(record["joint2_rad"]) / 2 == pytest.approx(np.radians(0.8), rel=0.01)
    assert result["verdict"]["level"] == "good"
    imported("swim.mot")
    assert np.ptp(log.read(folder / "out.csv")["joint1_rad"]) / 2 == pytest.approx(np.radians(20), rel=0.01)


def test_stamps_of_messages_survive_a_recorder_whose_clock_steps_back(
    case: Case, imported: Any, drafted: Callable[[str], str]
) -> None:
    rules = case("c-14-recorder-clock-steps-back") / "h.yaml"
    rules.write_text(rules.read_text().replace("reader: {topic: /pose}", "select: /pose"))
    result = imported("step.mcap", "--map", "h.yaml")
    assert result["samples"] == 600
    assert result["duration_s"] == pytest.approx(19.97, abs=0.01)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=1e-3)
    assert '{source: "header.stamp", origin: first}' in drafted("step.mcap")


@pytest.mark.parametrize(
    ("file", "time"),
    [
        ("d02_datetime.csv", "{source: [Date, Time], origin: first}"),
        ("d03b_tod.csv", "{source: Time, origin: first}"),
        ("d08_dayfirst.csv", "{source: time, format: '%d/%m/%Y %H:%M:%S.%f', origin: first}"),
        ("d09_comma.csv", "{source: time, origin: first}"),
        ("d11_secnsec.csv", "{source: [secs, nsecs], unit: [s, ns], origin: first}"),
    ],
)
def test_times_in_parts(
    file: str, time: str, case: Case, imported: Any, drafted: Callable[[str], str]
) -> None:
    case("c-15-split-and-other-time-columns")
    columns = "columns: [{source: x_m, target: x_m}, {source: yaw_rad, target: yaw_rad}]\n"
    Path("map.yaml").write_text(f"{HEAD}time: {time}\n{columns}")
    result = imported(file, "--map", "map.yaml")
    assert result["samples"] == 600
    assert result["duration_s"] == pytest.approx(59.9, abs=1e-6)
    assert result["median_rate_hz"] == pytest.approx(10, rel=1e-6)
    assert result["verdict"]["level"] == "good"
    _answer(re.sub("time: .*", f"time: {time}", drafted(file)))
    assert imported(file, "--map", "map.yaml")["duration_s"] == pytest.approx(59.9, abs=1e-6)


def test_a_time_that_lacks_a_part_is_not_trusted(case: Case, imported: Any, swimid: Run) -> None:
    case("c-15-split-and-other-time-columns")
    columns = "columns: [{source: x_m, target: x_m}]\n"
    Path("map.yaml").write_text(HEAD + "time: {source: secs}\n" + columns)
    assert imported("d11_secnsec.csv", "--map", "map.yaml")["verdict"]["level"] == "bad"
    Path("map.yaml").write_text(HEAD + "time: {source: Date}\n" + columns)
    ran = swimid("import", "d02_datetime.csv", "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "1 of 600 rows" in ran.err


@pytest.mark.parametrize(("file", "period"), [("d05_u16ms.csv", 65536), ("d05b_u32us.csv", 4294967296)])
def test_a_counter_that_wraps(
    file: str, period: int, case: Case, imported: Any, drafted: Callable[[str], str], swimid: Run
) -> None:
    case("c-28-counter-wraps-and-dst")
    text = drafted(file)
    ran = swimid("import", file, "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "wraps_at: " in ran.err
    Path("map.yaml").write_text(text.replace("time: {", f"time: {{wraps_at: {period}, "))
    result = imported(file, "--map", "map.yaml")
    assert result["samples"] == 600
    assert result["median_rate_hz"] == pytest.approx(10, rel=1e-6)


@pytest.mark.slow
def test_local_time_that_steps_by_an_hour(case: Case, imported: Any, drafted: Any, swimid: Run) -> None:
    case("c-28-counter-wraps-and-dst")
    drafted("d04_dst_back.csv")
    ran = swimid("import", "d04_dst_back.csv", "--map", "map.yaml", "-o", "o.csv")
    assert ran.status == 3
    assert "line 202" in ran.err
    assert imported("d04b_dst_fwd.csv", "--map", "map.yaml")["verdict"]["level"] == "caution"
    drafted("d01_wholesec.csv")
    assert imported("d01_wholesec.csv", "--map", "map.yaml")["median_rate_hz"] == pytest.approx(10)


def test_points_of_a_tracker_stay_points(case: Case, imported: Any, drafted: Callable[[str], str]) -> None:
    case("n-import")
    result = imported("sleap.analysis.h5", "--rate-hz", "60")
    assert {"nose_x_px", "hip_y_px", "tailtip_score"} < set(result["columns"])
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=0.01)
    text = drafted("plain.csv")
    assert 'time: {frame: "frame", rate_hz: ASK}' in text
    assert text.count("target: ASK") == 8


def test_a_table_of_points_in_a_mapping(case: Case, imported: Any) -> None:
    """The points have a constant stretch, where no window has a phase."""
    case("n-import")
    result = imported("dlc2.csv", "--map", "map_dlc.yaml")
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=0.01)
    assert result["verdict"]["level"] != "good"


def test_keypoints_of_coco_need_a_frame_rate(case: Case, swimid: Run) -> None:
    case("n-import")
    ran = swimid("import", "coco.json", "-o", "o.csv")
    assert ran.status == 3
    assert "--rate-hz" in ran.err


@pytest.mark.parametrize("name", ["sleap", "framenr", "frame", "index", "num"])
def test_a_count_is_no_time(name: str, case: Case, imported: Any, drafted: Callable[[str], str]) -> None:
    case("p-frame-index-as-ms")
    text = drafted(f"{name}.csv")
    assert "rate_hz: ASK" in text
    assert "unit: ms" not in text
    # the mapping that was drafted for the file before
    assert imported(f"{name}.csv", "--map", f"{name}.yaml")["verdict"]["level"] in ("caution", "bad")


def test_points_are_no_gravity(case: Case, drafted: Callable[[str], str]) -> None:
    case("p-pixels-as-gravity")
    for file in ("points.csv", "points2.csv"):
        text = drafted(file)
        assert "m_s2" not in text
        assert "time: ASK" in text


@pytest.mark.parametrize("name", ["row", "idx", "axis", "n", ""])
def test_a_counter_of_any_name(name: str, case: Case, drafted: Callable[[str], str], imported: Any) -> None:
    folder = case("r-guess-row-counter-as-time", "make.py")
    lines = (folder / "frames.csv").read_text().splitlines()
    lines[0] = ",".join([name, *lines[0].split(",")[1:]])
    (folder / "named.csv").write_text("\n".join(lines) + "\n")
    text = drafted("named.csv").replace("time: ASK", "time: {frame: 1, rate_hz: ASK}")
    assert "rate_hz: ASK" in text
    _answer(text, rate_hz="25")
    result = imported("named.csv", "--map", "map.yaml")
    assert result["speed"]["path_m_s"] == pytest.approx(0.2069, rel=0.01)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.2, abs=0.01)


@pytest.mark.parametrize(
    ("file", "column"), [("right", None), ("mirrored", "v_m_s"), ("rate", "yaw_rate_rad_s")]
)
def test_a_mirrored_velocity_is_named(file: str, column: str | None, case: Case, imported: Any) -> None:
    case("r-import-sway-mirrored", "make.py")
    result = imported(f"{file}.csv")
    if column is None:
        assert result["contradictions"] == []
        assert result["verdict"]["level"] == "good"
        return
    (found,) = result["contradictions"]
    assert found["column"] == column
    assert found["gain"] == pytest.approx(-1.0, abs=0.1)
    assert "opposite sign" in found["text"]
    assert result["verdict"]["level"] == "bad"


# ---------------------------------------------------------------- clocks, formats and units of other programs


def test_a_mapping_keeps_the_clock_of_the_file(case: Case, imported: Any, swimid: Run) -> None:
    case("t4-as-with-columns")
    result = imported("tracker.csv", "--map", "map.yaml")
    assert result["median_rate_hz"] == pytest.approx(100.0)
    assert result["speed"]["line_m_s"] == pytest.approx(0.2137, abs=5e-4)
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.27, abs=0.005)
    refused = swimid(
        "import", "tracker.csv", "--map", "map.yaml", "--rate-hz", "50", "-o", "out.csv", "--force"
    )
    assert refused.status == 3
    assert "100 Hz: a rate of 50.0 Hz contradicts" in refused.err


@pytest.mark.parametrize(("file", "select"), [("swim.bin", "ATT"), ("swim.tlog", "ATTITUDE")])
def test_binary_logs(file: str, select: str, case: Case, imported: Any, swimid: Run) -> None:
    """The first 20 kB of logs; the end of a bag is needed to read it."""
    pytest.importorskip("pymavlink")
    case("t4-binary-hint")
    assert f"{select}" in swimid("import", file, "-o", "none.csv").err
    assert imported(file, "--select", select)["samples"] > 50
    damaged = swimid("import", "swim.bag", "-o", "none.csv")
    assert damaged.status == 3
    assert "bag of ROS" in damaged.err


def test_two_servos_in_one_table(case: Case, imported: Any, swimid: Run) -> None:
    case("t4-dynamixel-ids")
    refused = swimid("import", "two_ids.csv", "-o", "none.csv")
    assert refused.status == 3
    assert "'ID'" in refused.err
    for number, amplitude in ((1, 0.42), (2, 0.55)):
        rules = f"format: swimid-mapping/1\nas: dynamixel\nwhere: {{ID: {number}}}\n"
        Path("map.yaml").write_text(rules)
        assert imported("two_ids.csv", "--map", "map.yaml")["samples"] == 1200
        assert np.max(log.read(Path("out.csv"))["joint1_rad"]) == pytest.approx(amplitude, abs=0.01)


@pytest.mark.parametrize("file", ["position_unsigned", "velocity_unsigned", "velocity_signed"])
def test_negative_numbers_of_a_servo_without_a_sign(file: str, case: Case, imported: Any) -> None:
    case("t4-o01-dynamixel-unsigned")
    result = imported(f"{file}.csv")
    assert result["verdict"]["level"] == "good"
    joint = log.read(Path("out.csv"))["joint1_rad"]
    assert np.ptp(joint) == pytest.approx(2 * np.radians(30), abs=0.01)


@pytest.mark.parametrize("file", ["late", "same"])
def test_channels_of_tdms_with_start_times(file: str, case: Case, imported: Any) -> None:
    """The true motion is in csv1.csv to csv4.csv."""
    pytest.importorskip("nptdms")
    case("t4-o04-tdms-start-times")
    for k in (1, 4):
        imported(f"{file}{k}.tdms")
        found, true = log.read(Path("out.csv")), log.read(Path(f"csv{k}.csv"))
        for name in ("x_m", "force_N"):
            wanted = np.interp(found.time_s, true.time_s, true[name])
            assert np.allclose(found[name], wanted, atol=1e-3), name


def test_units_that_a_netcdf_file_states(
    case: Case, imported: Any, drafted: Callable[[str], str], swimid: Run
) -> None:
    pytest.importorskip("h5netcdf")
    case("t4-speed-of-213700")
    refused = swimid("import", "plain.nc", "--map", "map.yaml", "-o", "none.csv")
    assert refused.status == 3
    assert "states ms for the times, the mapping states ns" in refused.err
    text = drafted("plain.nc")
    Path("map.yaml").write_text(text.replace("target: ASK", "target: yaw_rad"))
    result = imported("plain.nc", "--map", "map.yaml")
    assert result["speed"]["line_m_s"] == pytest.approx(0.2137, abs=5e-4)


@pytest.mark.parametrize(
    ("file", "cells"),
    [("err", "'ERR' in line 152"), ("hash", "'####' in line 152, '####' in line 153"),
     ("plus", "'>1000' in line 301"), ("tail", "'end of test' in line 301")],
)  # fmt: skip
def test_a_cell_of_text_is_named(
    file: str, cells: str, case: Case, imported: Any, drafted: Callable[[str], str]
) -> None:
    case("t4-one-text-cell")
    assert cells in drafted(f"{file}.csv")
    result = imported(f"{file}.csv", "--map", "map.yaml")
    assert cells in result["notes"][0]
    assert result["columns"] == ["t_s", "x_m", "y_m"]
    assert result["missing"]["x_m"] == cells.count("in line")
    assert result["verdict"]["level"] == "caution"


def test_dashes_for_missing_values(case: Case, imported: Any, drafted: Callable[[str], str]) -> None:
    case("t4-missing-dash")
    _answer(drafted("ethovision.txt").replace("x_center_m", "x_m").replace("y_center_m", "y_m"))
    result = imported("ethovision.txt", "--map", "map.yaml")
    assert result["speed"]["line_m_s"] == pytest.approx(0.2, rel=0.1)
    assert result["missing"]["x_m"] == 10
    assert "'-' in line 439" in " ".join(result["notes"])


def test_tables_that_are_drafted_with_their_columns(case: Case, drafted: Callable[[str], str]) -> None:
    case("t4-list-cells")
    assert 'source: "p[3]"' in drafted("l.csv")
    case("t4-sheet-with-blank-columns")
    assert "no numbers" not in drafted("s.xlsx")
    case("t4-gyro-name")
    text = drafted("swim1_imu.csv")
    assert {"ax_m_s2", "az_m_s2", "wx_rad_s", "wz_rad_s"} < set(re.findall(r"target: (\w+)", text))
    assert "ASK" not in text.partition("columns:")[2]
    case("t4-pwm-as-time")
    assert "\ntime: ASK" in drafted("bench.csv")


@pytest.mark.parametrize("file", ["serial.txt", "csvlines.txt"])
def test_a_serial_log_after_boot_lines(
    file: str, case: Case, imported: Any, drafted: Callable[[str], str]
) -> None:
    case("t4-serial-boot-lines")
    text = (
        drafted(file)
        .replace("unit: ASK", 'unit: "deg"')
        .replace('{source: "t", unit: "deg"', "{source: t, unit: ms")
    )
    _answer(text)
    result = imported(file, "--map", "map.yaml")
    assert result["samples"] == 480
    assert result["columns"] == ["t_s", "yaw_rad", "joint1_rad", "joint2_rad"]
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.27, abs=0.01)
    assert "7 of 487" in result["notes"][0] or "8 lines above" in result["notes"][0]


@pytest.mark.parametrize(
    "file", ["t4-json-log/a.json", "t4-json-columns/columns.json", "t4-json-columns/flat.jsonl"]
)
def test_tables_in_json(file: str, case: Case, drafted: Callable[[str], str]) -> None:
    folder, name = file.split("/")
    case(folder)
    text = drafted(name).replace(
        '"position", target: ASK, unit: ASK', '"position", target: joint1_rad, unit: rad'
    )
    _answer(text.replace("unit: ASK", "unit: s"))
    found = _mapped(name)
    assert len(found) == {"a.json": 3000}.get(name, 480)
    assert found.notes == []


def test_a_torque_about_the_yaw_axis(case: Case) -> None:
    case("t4-torque-column")
    assert "torque_yaw_N_m" in _mapped("ft.csv").columns


@pytest.mark.parametrize("file", ["joined.csv", "joined_int.csv"])
def test_lost_line_ends(file: str, case: Case, drafted: Any, swimid: Run) -> None:
    case("t4-o03-lost-newline")
    ran = swimid("import", file, "-o", "o.csv")
    assert ran.status == 3
    assert "bad_lines: skip" in ran.err
    _answer(drafted(file), bad_lines="skip")
    found = _mapped(file)
    assert len(found) == 960
    assert "20 of 980 lines" in found.notes[0]
    assert "mend lost line ends" in swimid("import", "one_line.csv", "--guess").err


@pytest.mark.parametrize(
    ("file", "form"),
    [("dmy", "%d/%m"), ("dmy_twice", None), ("dmy_ambiguous", None), ("dots", "%d.%m"), ("iso", "")],
)
def test_the_order_of_day_and_month(
    file: str, form: str | None, case: Case, drafted: Callable[[str], str], swimid: Run
) -> None:
    case("t4-o05-day-month")
    text = drafted(f"{file}.csv")
    if form is None:
        assert "format: ASK" in text
        _answer(text.replace("format: ASK", 'format: "%d/%m/%Y %H:%M:%S.%f"'))
    elif form:
        assert f'format: "{form}' in text
    assert np.ptp(_mapped(f"{file}.csv").time_s) == pytest.approx(39.96)
    if form != "":
        ran = swimid("import", f"{file}.csv", "--map", f"map_{file}.yaml", "-o", "o.csv")
        assert ".%f'" in ran.err


def test_a_header_with_more_names_than_values(case: Case, swimid: Run) -> None:
    case("t4-o07-header-longer")
    for file, names, values in (("shifted", 8, 6), ("shifted1", 5, 4), ("shorter", 3, 4)):
        ran = swimid("import", f"{file}.csv", "-o", "o.csv")
        assert ran.status == 3
        assert f"{names} names, the lines below {values} values" in ran.err
