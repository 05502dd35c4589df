"""Text tables, workbooks and JSON as people write them: cells of text, second tables, boot lines, dates."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError
from swimid.imports import mapping
from swimid.imports.formats import open_table
from swimid.imports.mapping import guess_mapping
from swimid.imports.table import ForeignTable
from tests.conftest import Ran

Run = Callable[..., Ran]
N = 240
T = np.arange(N) / 30
X = 6.4 * np.arange(N)
Y = 5 * np.sin(2 * np.pi * 1.2 * T)
NAMES = ["t_s", "X (mm)", "Y (mm)"]


def _rows(mark: str = ",") -> list[list[str]]:
    return [[f"{t:.4f}", f"{x:.2f}", f"{y:.3f}"] for t, x, y in zip(T, X, Y, strict=True)]


def _write(path: Path, rows: list[list[str]], mark: str = ",", names: list[str] = NAMES) -> Path:
    path.write_text("\n".join([mark.join(names), *map(mark.join, rows)]) + "\n")
    return path


def _draft(path: Path) -> str:
    return guess_mapping(path).document


def _mapped(path: Path, **answers: str) -> mapping.MappedLog:
    """Read a file with its drafted mapping, whose questions are answered."""
    text = _draft(path)
    for key, answer in answers.items():
        assert f"{key}: ASK" in text, text
        text = text.replace(f"{key}: ASK", f"{key}: {answer}")
    (path.parent / "map.yaml").write_text(text)
    return mapping.apply(mapping.read_mapping(path.parent / "map.yaml"), path)


def _other(values: np.ndarray, *rows: int) -> np.ndarray:
    return np.delete(values, rows)


# ---------------------------------------------------------------- cells of text


@pytest.mark.parametrize(
    ("text", "row"),
    [
        ("ERR", 100),
        ("####", 0),
        (">1000", N - 1),
        ("-", 9),
        ("n/a", 1),
        ("end of test", N - 1),
        ("1,2,3", 50),
    ],
)
def test_one_cell_of_text_is_empty_and_named(text: str, row: int, tmp_path: Path) -> None:
    rows = _rows()
    rows[row][1] = f'"{text}"'
    found = _mapped(_write(tmp_path / "a.csv", rows))
    assert list(found.columns) == ["t_s", "x_m", "y_m"]
    assert np.flatnonzero(np.isnan(found.columns["x_m"])).tolist() == [row]
    assert np.allclose(_other(found.columns["x_m"], row), _other(X, row) / 1000)
    assert np.isfinite(found.columns["y_m"]).all()
    (note,) = found.notes
    assert f"1 of {N} in X (mm)" in note
    assert f"'{text}' in line {row + 2}" in note
    assert note in _draft(tmp_path / "a.csv")


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_one_cell_of_text_beside_decimal_commas(mark: str, tmp_path: Path) -> None:
    rows = [[cell.replace(".", ",") for cell in row] for row in _rows()]
    rows[7][2] = "ERR"
    found = _mapped(_write(tmp_path / "a.csv", rows, mark, ["t_s", "x_mm", "y_mm"]))
    assert np.allclose(_other(found.columns["y_m"], 7), _other(Y, 7) / 1000, atol=1e-6)
    assert "'ERR' in line 9" in found.notes[0]


def test_one_cell_of_text_in_other_sources(tmp_path: Path) -> None:
    """A table in memory, Parquet and JSON hold columns of text, too."""
    table = pd.DataFrame({"t_s": T, "x_m": X / 1000})
    table["x_m"] = [str(x) for x in table["x_m"]]
    table.loc[5, "x_m"] = "lost"
    table.to_parquet(tmp_path / "a.parquet")
    table.to_json(tmp_path / "a.json", orient="records")
    assert "'lost' in row" in _draft(tmp_path / "a.parquet")
    assert "'lost' in row" in _draft(tmp_path / "a.json")
    assert "'lost' in row" in guess_mapping(table).document
    found = mapping.apply(None, tmp_path / "a.parquet")
    assert np.allclose(_other(found.columns["x_m"], 5), _other(X, 5) / 1000)


def test_a_log_with_a_cell_of_text_gives_caution(swimid: Run, tmp_path: Path) -> None:
    rows = _rows()
    rows[50][1] = "ERR"
    _write(tmp_path / "a.csv", rows, names=["t_s", "x_m", "y_m"])
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0, ran.err
    assert "'ERR' in line 52" in ran.err
    assert ran.json["result"]["verdict"]["level"] != "good"
    assert ran.json["result"]["missing"] == {"x_m": 1, "y_m": 0}


def test_many_cells_of_text_are_a_question(tmp_path: Path) -> None:
    rows = [row if k % 5 else [row[0], "-", "-"] for k, row in enumerate(_rows())]
    path = _write(tmp_path / "a.csv", rows)
    assert "reader: {missing: ASK}" in _draft(path)
    assert "'-'" in _draft(path)
    found = _mapped(path, missing='["-"]')
    assert np.isnan(found.columns["x_m"]).sum() == N // 5
    assert found.notes == []
    with pytest.raises(InputError, match="'-' is not a number"):
        mapping.apply(
            mapping.read_mapping({"time": {"source": 1}, "columns": [{"source": 2, "target": "x_m"}]}), path
        )


def test_units_below_the_names_hold_with_dashes_in_the_samples(tmp_path: Path) -> None:
    """The layout of EthoVision: cells and names in quotes, and a line of units."""
    rows = _rows()
    rows[40] = [rows[40][0], '"-"', '"-"']
    rows.insert(0, ['"s"', '"cm"', '"cm"'])
    found = _mapped(_write(tmp_path / "a.txt", rows, ";", ['"Trial time"', '"X center"', '"Y center"']))
    assert np.allclose(_other(found.columns["x_center_m"], 40), _other(X, 40) / 100)
    assert "X center, Y center: '-' in line 43" in found.notes[0]


def test_thousands_separators(tmp_path: Path) -> None:
    rows = [[t, f'"{float(x):,.2f}"', y] for t, x, y in _rows()]
    found = _mapped(_write(tmp_path / "a.csv", rows))
    assert np.allclose(found.columns["x_m"], X / 1000)
    swapped = str.maketrans(",.", ".,")
    rows = [[cell.translate(swapped) for cell in row] for row in rows]
    found = _mapped(_write(tmp_path / "b.csv", rows, ";"))
    assert np.allclose(found.columns["x_m"], X / 1000)


@pytest.mark.parametrize(("decimal", "factor"), [(".", 1.0), (",", 1e-3)])
def test_a_comma_that_may_be_either_mark_is_a_question(decimal: str, factor: float, tmp_path: Path) -> None:
    speeds = [1200 + 3 * k for k in range(N)]
    rows = [[str(20 * k), f"{speed:,d}"] for k, speed in enumerate(speeds)]
    path = _write(tmp_path / "a.txt", rows, "\t", ["t_ms", "turns (mm)"])
    assert "'1,200'" in _draft(path)
    found = _mapped(path, decimal=f"'{decimal}'")
    assert np.allclose(found.columns["turns_m"], factor * np.array(speeds) / 1000)


def test_a_unit_in_each_cell(tmp_path: Path) -> None:
    rows = [[t, f"{x} mm", f"{y}%", "3 fish"] for t, x, y in _rows()]
    rows[1][3] = "4 birds"
    path = _write(tmp_path / "a.csv", rows, names=["t_s", "x", "duty", "seen"])
    found = open_table(path)
    assert np.allclose(found.columns["x"], X)
    assert found.units == {"x": "mm", "duty": "%"}
    assert np.allclose(found.columns["duty"], Y, atol=1e-3)
    assert found.columns["seen"][1] == "4 birds"
    assert '{source: "x", target: x_m, unit: "mm"}' in _draft(path)


def test_one_cell_of_text_among_dates(tmp_path: Path) -> None:
    rows = [[f"2024-05-01 10:00:{t[:6]:0>7}", x, y] for t, x, y in _rows()]
    rows[30][0] = "ERR"
    found = _mapped(_write(tmp_path / "a.csv", rows, names=["Timestamp", "x_mm", "y_mm"]))
    assert np.flatnonzero(np.isnan(found.time_s)).tolist() == [30]
    assert found.notes == [f"cells that are no dates are left empty, 1 of {N} in Timestamp: 'ERR' in line 32"]


def test_lists_in_cells_are_columns(tmp_path: Path) -> None:
    rows = [[t, f'"[{x}, {y}, 1.0]"', f"({x} {y})"] for t, x, y in _rows()]
    table = open_table(_write(tmp_path / "a.csv", rows, names=["t", "p", "v"]))
    assert list(table.columns) == ["t", "p[1]", "p[2]", "p[3]", "v[1]", "v[2]"]
    assert np.allclose(table.columns["p[2]"], Y, atol=1e-3)
    assert np.allclose(table.columns["v[1]"], X)
    words = _write(tmp_path / "b.csv", [[t, "[left right]"] for t, *_ in _rows()], names=["t_s", "side"])
    assert list(open_table(words).columns) == ["t_s", "side"]


# ---------------------------------------------------------------- rows and columns that are no samples


@pytest.mark.parametrize("cell", ["", "nan"])
def test_padding_is_no_lost_sample(cell: str, swimid: Run, tmp_path: Path) -> None:
    _write(tmp_path / "a.csv", [*_rows(), *[[cell] * 3] * 200])
    guess_mapping(tmp_path / "a.csv", output=tmp_path / "m.yaml")
    ran = swimid(
        "import", tmp_path / "a.csv", "--map", tmp_path / "m.yaml", "-o", tmp_path / "o.csv", "--json"
    )
    assert ran.json["result"]["samples"] == N
    assert ran.json["result"]["verdict"]["level"] == "good"


def test_a_second_table_below_the_first_is_not_read(tmp_path: Path) -> None:
    below = [[""], ["Summary"], ["f (Hz)", "A (deg)", "v (mm/s)"], ["1", "20", "0.2"], ["2", "20", "0.3"]]
    found = _mapped(_write(tmp_path / "a.csv", [*_rows(), *below]))
    assert len(found) == N
    assert f"another table begins in line {N + 3}" in found.notes[0]
    # an empty line within the samples, and the same names again, begin no other table
    halves = [*_rows()[:100], [""], NAMES, *_rows()[100:]]
    found = _mapped(_write(tmp_path / "b.csv", halves))
    assert np.isfinite(found.columns["x_m"]).sum() == N


def _book(path: Path, rows: list[list[Any]]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.save(path)
    return path


def test_a_sheet_with_settings_blank_columns_and_a_second_table(tmp_path: Path) -> None:
    samples = [[float(t), None, float(x), *[None] * 30] for t, x in zip(T, X, strict=True)]
    above = [["Rate (Hz)", 30], ["Operator", "ann"], [], ["t_s", None, "x_mm", *[None] * 30]]
    below = [[], ["mean of", "runs"], ["f (Hz)", "v (m/s)"], [1, 0.2]]
    text = _draft(_book(tmp_path / "a.xlsx", [*above, *samples, *below]))
    assert text.count("  - {source") == 1
    found = _mapped(tmp_path / "a.xlsx")
    assert np.allclose(found.columns["x_m"], X / 1000)
    assert len(found) == N
    # a number of a column is its place in the file
    by_number = {"time": {"source": 1}, "columns": [{"source": 3, "target": "x_m", "unit": "mm"}]}
    assert np.allclose(
        mapping.apply(mapping.read_mapping(by_number), tmp_path / "a.xlsx").columns["x_m"], X / 1000
    )
    empty = {"time": {"source": 1}, "columns": [{"source": 2, "target": "x_m"}]}
    with pytest.raises(InputError, match="no such column"):
        mapping.apply(mapping.read_mapping(empty), tmp_path / "a.xlsx")


BOOT = [
    "ets Jul 29 2019 12:21:46",
    "",
    "rst:0x1 (POWERON)",
    "load:0x3fff0018,len:4",
    "Calib: 0,3,0,1",
    "n: 3",
]


@pytest.mark.parametrize(
    "form",
    [
        "t_ms:{}\tx_mm:{}\ty_mm:{}",
        "12:00:01.250 -> t_ms={}, x_mm={}, y_mm={}",
        "[12:00:01.250] t_ms: {} x_mm: {} y_mm: {}",
    ],
)
def test_labelled_lines_after_boot_lines(form: str, tmp_path: Path) -> None:
    lines = [form.format(f"{1000 * float(t):.0f}", x, y) for t, x, y in _rows()]
    lines.insert(90, "WARN: imu timeout 3")
    (tmp_path / "a.log").write_text("\r\n".join([*BOOT * 9, *lines]) + "\r\n")
    found = _mapped(tmp_path / "a.log")
    assert np.allclose(found.columns["x_m"], X / 1000)
    assert f"46 of {N + 46} lines" in found.notes[0]
    assert found.rows[0] == len(BOOT) * 9 + 1


def test_a_table_after_boot_lines(tmp_path: Path) -> None:
    """A boot line has as many cells as a sample."""
    lines = [*BOOT[:-1], "t_s,x_mm,a,b", *(",".join([*row, "1"]) for row in _rows())]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    found = open_table(tmp_path / "a.txt")
    assert list(found.columns) == ["t_s", "x_mm", "a", "b"]
    assert np.allclose(found.columns["x_mm"], X)


def test_a_column_of_text_keeps_the_first_sample(tmp_path: Path) -> None:
    """Text beside numbers in a sample is no setting above the names."""
    rows = [[*row, "swim" if k % 9 else "rest"] for k, row in enumerate(_rows())]
    rows.insert(60, [*NAMES, "mode"])  # the logger started again
    table = open_table(_write(tmp_path / "a.csv", rows, names=[*NAMES, "mode"]))
    assert table.columns["t_s"][0] == 0
    assert len(table.columns["t_s"]) == N + 1


def test_lines_with_a_wrong_number_of_cells(tmp_path: Path) -> None:
    """Line ends that a logger lost: the mapping says that these lines are left out."""
    lines = [",".join(row) for row in _rows()]
    joined = [
        a + b if k in range(20, 80, 3) else f"{a}\n{b}"
        for k, (a, b) in enumerate(zip(lines[::2], lines[1::2], strict=True))
    ]
    (tmp_path / "a.csv").write_text("\n".join(["t_s,x_mm,y_mm", *joined]) + "\n")
    with pytest.raises(InputError, match=r"line 42: has 5 cells where 3 .*\(20 of 220 such") as caught:
        mapping.apply(None, tmp_path / "a.csv")
    assert "bad_lines: skip" in str(caught.value.hint)
    found = _mapped(tmp_path / "a.csv", bad_lines="skip")
    assert len(found) == N - 40
    assert "20 of 220 lines" in found.notes[0]
    (tmp_path / "b.csv").write_text("t_s,x_mm,y_mm\n" + ",".join(lines))
    with pytest.raises(InputError, match="mend lost line ends"):
        open_table(tmp_path / "b.csv")


@pytest.mark.parametrize("names", [["t_s", "x_m", "x_m_filtered", "y_m"], ["t_s", "x_m"]])
def test_names_that_are_no_names_of_the_columns(names: list[str], swimid: Run, tmp_path: Path) -> None:
    _write(tmp_path / "a.csv", _rows(), names=names)
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert f"line 1 has {len(names)} names, but lines below have 3" in ran.err
    assert f"{len(names)} names" in _draft(tmp_path / "a.csv")


def test_a_delimiter_at_the_end_of_one_kind_of_line(tmp_path: Path) -> None:
    for names, rows in (([*NAMES, ""], _rows()), (NAMES, [[*row, ""] for row in _rows()])):
        assert list(open_table(_write(tmp_path / "a.csv", rows, names=names)).columns) == NAMES


# ---------------------------------------------------------------- JSON


def _frame() -> pd.DataFrame:
    return pd.DataFrame({"t_ms": 1000 * T, "x_mm": X, "yaw_deg": Y})


@pytest.mark.parametrize("orient", ["records", "columns", "index", "split", "table", "lines"])
def test_tables_in_json(orient: Any, tmp_path: Path) -> None:
    form: dict[str, Any] = {"orient": "records", "lines": True} if orient == "lines" else {"orient": orient}
    _frame().to_json(tmp_path / "a.json", **form)
    found = _mapped(tmp_path / "a.json") if orient != "table" else None
    if found is not None:
        assert np.allclose(found.time_s, T)
        assert np.allclose(found.columns["yaw_rad"], np.radians(Y))
    assert np.allclose(open_table(tmp_path / "a.json").columns["x_mm"], X)


def test_nested_json(tmp_path: Path) -> None:
    records = [
        {"stamp": {"s": t}, "p": [x, y, None], "mode": "swim"} for t, x, y in zip(T, X, Y, strict=True)
    ]
    (tmp_path / "a.txt").write_text("\n".join(json.dumps(one) for one in records)[:-9])
    table = open_table(tmp_path / "a.txt")
    assert list(table.columns) == ["stamp.s", "p[1]", "p[2]", "p[3]", "mode"]
    assert np.allclose(table.columns["p[2]"], Y[:-1])
    assert f"1 of {N} lines are no JSON and are left out (first: line {N})" in table.notes[0]
    whole = {"robot": "fish", "imu": records, "gps": {"lat": [1.0, 2.0], "lon": [3.0, 4.0]}}
    (tmp_path / "b.json").write_text(json.dumps(whole))
    assert list(open_table(tmp_path / "b.json", select="gps").columns) == ["lat", "lon"]
    assert len(open_table(tmp_path / "b.json", select="imu").columns["p[1]"]) == N


@pytest.mark.parametrize("text", ['{"a": [1, 2', '{"a": 1, "b": {"c": "x"}}', "[]", "[" * 9999, '{"a": "b"'])
def test_json_without_a_table_is_refused(text: str, swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    ran = swimid("import", tmp_path / "a.json", "--guess")
    assert ran.status == 3
    assert "JSON" in ran.err


# ---------------------------------------------------------------- names, units and times in a draft


@pytest.mark.parametrize(
    "name",
    ["PWM (us)", "pulse_us", "period (ms)", "latency_ms", "duty_us", "exposure_time_us", "RTT (ms)", "dt_s",
     "loop_time_ms", "responseTime_ms", "servo3_us", "Duration [s]"],
)  # fmt: skip
def test_a_unit_of_time_alone_is_no_clock(name: str, tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", _rows(), names=[name, "force_N", "RPM"])
    assert "\ntime: ASK" in _draft(path)
    assert f'source: "{name}", target' in _draft(path)
    rows = [[*row, str(k)] for k, row in enumerate(_rows())]
    path = _write(tmp_path / "b.csv", rows, names=[name, "force_N", "RPM", "Time (ms)"])
    assert '\ntime: {source: "Time (ms)", unit: "ms"}' in _draft(path)


@pytest.mark.parametrize(
    "name", ["t_ms", "Time [ms]", "millis", "timestamp_ms", "elapsed_ms", "ms", "Recording time (ms)"]
)
def test_names_of_a_clock(name: str, tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", _rows(), names=[name, "x_m", "y_m"])
    assert f'\ntime: {{source: "{name}", unit: ' in _draft(path)


@pytest.mark.parametrize(
    "name", ["heading_deg", "Compass (deg)", "course", "COG", "bearing_deg", "azimuth_deg"]
)
def test_a_heading_that_may_be_of_a_compass_is_a_question(name: str, tmp_path: Path) -> None:
    text = _draft(_write(tmp_path / "a.csv", _rows(), names=["t_s", name, "yaw_deg"]))
    (line,) = [line for line in text.splitlines() if name in line]
    assert "target: ASK" in line
    assert "factor: -1, offset: 1.5708" in line
    assert '"yaw_deg", target: yaw_rad' in text


@pytest.mark.parametrize(
    ("name", "target"),
    [("gx_dps", "wx_rad_s"), ("gyr_y (deg/s)", "wy_rad_s"), ("wz_deg_s", "wz_rad_s"), ("ax_g", "ax_m_s2"),
     ("az (mg)", "az_m_s2"), ("u_mm_s", "u_m_s"), ("yaw_dps", "yaw_rate_rad_s"),
     ("roll_rate_dps", "roll_rate_rad_s"), ("j2_deg", "joint2_rad"), ("Mz (N m)", "mz_Nm"),
     ("torque_yaw_N_m", "torque_yaw_N_m"), ("gx_g", "ASK"), ("k_N_m_rad", "ASK"), ("c_N_s_m", "ASK")],
)  # fmt: skip
def test_drafted_names_are_those_that_commands_read(name: str, target: str) -> None:
    assert mapping.name_target(name)[0] == target


def test_a_torque_in_a_mapping(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", _rows())
    columns = [{"source": 3, "target": "torque_yaw_N_m", "unit": "mNm"}]
    found = mapping.apply(mapping.read_mapping({"time": {"source": 1}, "columns": columns}), path)
    assert np.allclose(found.columns["torque_yaw_N_m"], Y / 1000, atol=1e-6)
    with pytest.raises(InputError, match="unit of length"):
        mapping.read_mapping({"time": {"source": 1}, "columns": [columns[0] | {"unit": "mm"}]})


@pytest.mark.parametrize(
    ("form", "start", "answers"),
    [
        ("%d/%m/%Y %H:%M:%S.%f", "2018-06-12 23:59:59", {}),  # into the 13th
        ("%m/%d/%Y %H:%M:%S.%f", "2018-06-12 23:59:59", {}),
        ("%d.%m.%y %H:%M:%S,%f", "2018-06-04 10:00:00", {"format": '"%d.%m.%y %H:%M:%S,%f"'}),
        ("%m/%d/%Y %I:%M:%S.%f %p", "2018-06-04 10:00:00", {"format": '"%m/%d/%Y %I:%M:%S.%f %p"'}),
        ("%d-%b-%Y %H:%M:%S.%f", "2018-06-04 10:00:00", {}),
        ("%Y-%m-%d %H:%M:%S.%f", "2018-06-04 10:00:00", {}),
    ],
)
def test_the_order_of_day_and_month(form: str, start: str, answers: dict[str, str], tmp_path: Path) -> None:
    """A draft states the order that the cells show, and asks for it where they do not."""
    stamps = pd.Timestamp(start) + pd.to_timedelta(T, unit="s")
    path = tmp_path / "a.csv"
    path.write_text(
        "Timestamp;x_m\n"
        + "".join(f"{stamp.strftime(form)};{x}\n" for stamp, x in zip(stamps, X, strict=True))
    )
    for answer in answers.values():
        assert answer.strip('"') in _draft(path)
    assert np.allclose(_mapped(path, **answers).time_s, T, atol=1e-6)


def test_the_hint_for_a_date_is_a_format_that_reads_it(tmp_path: Path) -> None:
    stamps = [f"04/06/2018 23:59:4{k % 10}.{k // 10 % 10}" for k in range(N)]
    _write(tmp_path / "a.csv", [[stamp, "1"] for stamp in stamps], names=["Timestamp", "x_m"])
    rules = {"time": {"source": 1}, "columns": [{"source": 2, "target": "x_m"}]}
    with pytest.raises(InputError) as caught:
        mapping.apply(mapping.read_mapping(rules), tmp_path / "a.csv")
    assert "'%d/%m/%Y %H:%M:%S.%f' or '%m/%d/%Y %H:%M:%S.%f'" in str(caught.value.hint)


def test_seconds_without_a_fraction_are_dates_too(tmp_path: Path) -> None:
    stamps = [f"13/06/2018 10:00:{k // 10:02d}" + f".{k % 10}" * (k % 10 > 0) for k in range(N)]
    found = _mapped(_write(tmp_path / "a.csv", [[s, "1"] for s in stamps], names=["Timestamp", "x_m"]))
    assert np.allclose(found.time_s, np.arange(N) / 10)


# ---------------------------------------------------------------- programs


@pytest.mark.parametrize("rate", [24.0, 25.0, 29.97, 30.0, 50.0, 59.94, 60.0, 120.0])
@pytest.mark.parametrize(("scale", "digits"), [(1, 2), (1, 3), (1000, 0), (1000, 2)])
def test_rounded_times_of_kinovea_are_frames(rate: float, scale: float, digits: int, tmp_path: Path) -> None:
    frames = np.delete(np.arange(400), [50, 51, 200])
    times = np.round(scale * frames / rate, digits)
    if (np.diff(times) <= 0).any():
        pytest.skip("several frames have one time")
    rows = [[f"{t:.{digits}f}", f"{f}", "1"] for t, f in zip(times, frames, strict=True)]
    path = _write(tmp_path / "a.csv", rows, names=["Time", "nose/0/X", "nose/0/Y"])
    found = mapping.apply(None, path, {"rate_hz": rate, "length_unit": "mm"})
    assert np.allclose(found.time_s, frames / rate)


def test_times_of_kinovea_that_are_no_frames(tmp_path: Path) -> None:
    times = np.cumsum(np.random.default_rng(1).uniform(20, 60, 200))
    rows = [[f"{t:.2f}", "1", "2"] for t in times]
    path = _write(tmp_path / "a.csv", rows, names=["Time", "nose/0/X", "nose/0/Y"])
    with pytest.raises(InputError, match="not multiples of a frame period"):
        mapping.apply(None, path, {"rate_hz": 30.0, "length_unit": "mm"})


@pytest.mark.parametrize(("mark", "decimal"), [(";", ","), (";", "."), ("\t", ","), (",", ".")])
@pytest.mark.parametrize("is_multi", [False, True])
def test_delimiters_of_tracker(mark: str, decimal: str, is_multi: bool, tmp_path: Path) -> None:
    head = [mark.join(["mass_A", "", ""]), mark.join(["t", "x", "y"])]
    if is_multi:
        head = ["#multi:", mark.join(["", "mass_A", ""]), head[1]]
    rows = [mark.join(row).replace(".", decimal) if mark != "," else ",".join(row) for row in _rows()]
    (tmp_path / "a.txt").write_text("\n".join([*head, *rows]) + "\n")
    found = mapping.apply(None, tmp_path / "a.txt")
    assert found.profile == "tracker"
    assert np.allclose(found.columns["x_m"], X)
    assert np.allclose(found.time_s, T, atol=1e-4)


# ---------------------------------------------------------------- files that are no tables


def test_a_folder_and_binary_content_are_refused(swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    ran = swimid("import", tmp_path / "a.csv", "--guess")
    assert ran.status == 3
    assert "is a folder; a file is needed here" in ran.err
    noise = np.random.default_rng(2).integers(1, 256, 4000, dtype=np.uint8)
    (tmp_path / "b.csv").write_bytes(noise.tobytes())
    ran = swimid("import", tmp_path / "b.csv", "--guess")
    assert ran.status == 3
    assert "is no text file" in ran.err
    # names in another code are text
    latin = "Zeit (ms);Höhe (mm)\n".encode("latin-1") + b"".join(b"%d;%d\n" % (20 * k, k) for k in range(50))
    (tmp_path / "c.csv").write_bytes(latin)
    assert isinstance(open_table(tmp_path / "c.csv"), ForeignTable)
