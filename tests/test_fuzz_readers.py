"""Every reader against garbage: it succeeds or raises a SwimidError, and never hangs.

Files are arbitrary bytes, arbitrary text, valid files with bytes flipped, removed, put in or
cut off, and valid documents with one value replaced by a strange one. Derandomised: every run
tries the same files. ``SWIMID_FUZZ`` multiplies the number of examples for a long search.
"""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from swimid.errors import SwimidError
from swimid.logs import log, trials
from swimid.notices import SwimidWarning
from swimid.propulsion import trials as cruise
from swimid.results import evidence, parameters
from swimid.robots import file as robot
from swimid.tracking import setup
from tests.conftest import SAMPLES, Ran

#: A spawned compiler or a loaded runner may stall one example; a hang is longer.
DEADLINE = timedelta(seconds=20)
FACTOR = int(os.environ.get("SWIMID_FUZZ", "1"))


def examples(count: int) -> Callable[[Any], Any]:
    """Settings that make a search the same on every machine."""
    return settings(
        max_examples=count * FACTOR,
        deadline=DEADLINE,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


# ------------------------------------------------------------ a valid file of each format

LOG = b"# robot: boxfish\n# mass_kg: 0.01\nt_s,x_m,status\n0,0.0,ok\n0.1,0.01,ok\n0.2,,lost\n0.3,0.05,ok\n"
CRUISE = (
    b"fin,frequency_hz,amplitude_deg,distance_m,time_s\n2025Rect,2,16,1.15,36.7\n3825Rect,2.5,16,1.15,29.2\n"
)
TRIALS = b"""\
# seven weights
format: swimid-trials/1
experiment: falling-weight
robot: boxfish
trials:
  - {log: w10.csv, id: w10, pulling_mass_kg: 0.010}
  - log: w15.csv
    driving_force_N: 0.2
    role: validate
    start_s: 0.5
    inertial_mass_kg: 1.2
"""
FREE_SWIM = b"""\
format: swimid-trials/1
experiment: free-swim
robot: boxfish
trials:
  - log: a.csv
    drive: {waveform: a-cpg, frequency_hz: 2.0, amplitude_deg: 16, bias_deg: 0, asymmetry: 0.1, ramp_s: 1}
"""
ROBOT = b"""\
format: swimid-robot/1
name: fish
sources: ["a paper"]
fluid: {density_kg_m3: 997, gravity_m_s2: 9.80}
body: {inertial_mass_kg: 1.196, frontal_area_m2: 0.00698}
fins:
  2025Rect: {shape: rectangle, height_m: 0.0636, length_m: 0.0318, axle_gap_m: 0.007}
theory:
  - {parameter: added_mass, value: 0.764, unit: kg, basis: box}
"""
PARAMETERS = b"""\
format: swimid-parameters/1
model: falling-weight
robot: boxfish
parameters:
  drag_coefficient: {value: 0.7, stderr: 0.01, unit: "1", bounds: [0, 5], status: estimated}
  added_mass: {value: 0.68, stderr: null, unit: kg, bounds: [null, null], status: fixed}
correlation: {names: [drag_coefficient], matrix: [[1.0]]}
poles:
  - {real: 0.9, imag: 0.1, magnitude: 0.905}
fit: {trials: [w10], channels: {x_m: {rmse: 0.001}}, converged: true}
provenance: {command: swimid fit-drag, inputs: {a.csv: 00ff}}
"""
SETUP = b"""\
format: swimid-setup/1
markers:
  - name: red
    hsv: {hue_deg: [345, 15], saturation: [0.45, 1], value: [0.3, 1]}
  - name: blue
    hsv: {hue_deg: [200, 250]}
head: red
tail: blue
scale: {points_px: [[0, 0], [100, 0]], distance_m: 0.5}
camera: {matrix: [[800, 0, 320], [0, 800, 240], [0, 0, 1]], distortion: [0, 0, 0, 0], size_px: [640, 480]}
frame_rate_hz: 30
"""
EVIDENCE = json.dumps(
    {
        "format": "swimid-evidence/1",
        "command": "fit-drag",
        "title": "Rig",
        "verdict": {"level": "good", "text": "It holds."},
        "checks": [{"name": "converged", "value": "yes", "verdict": "pass"}],
        "tables": [{"id": "t", "title": "T", "columns": ["a"], "rows": [[1.0], [None], ["x"]]}],
        "figures": [
            {
                "id": "f",
                "title": "F",
                "caption": "c",
                "panels": [
                    {
                        "x_label": "x",
                        "y_label": "y",
                        "traces": [{"x": [0, 1], "y": [None, 2.5], "style": "points", "y_error": [0.1, 0.2]}],
                        "marks": [{"at": 0.0}],
                        "spans": [{"start": 0.0, "end": 1.0}],
                    }
                ],
            }
        ],
        "images": [{"id": "i", "title": "I", "caption": "c", "media_type": "image/png", "base64": "AAAA"}],
        "provenance": {"command": "swimid"},
    }
).encode()


def _parquet() -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"t_s": np.arange(20) * 0.1, "x_m": np.linspace(0, 1, 20), "n": np.arange(20)})
    stream = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({b"swimid": b"robot: boxfish"}), stream)
    return stream.getvalue()


Reader = Callable[[Path], Any]
#: Name of a format -> ending, reader, a valid file.
FORMATS: dict[str, tuple[str, Reader, bytes]] = {
    "log": (".csv", lambda p: log.read(p, required=("x_m",)), LOG),
    "log, chosen columns": (".csv", lambda p: log.read(p, required=("x_m",), optional=("y_m",)), LOG),
    "log, sample": (".csv", log.read, (SAMPLES / "rig" / "w10.csv").read_bytes()),
    "log, Parquet": (".parquet", lambda p: log.read(p, required=("x_m",)), _parquet()),
    "cruise table": (".csv", cruise.read_table, CRUISE),
    "cruise table, sample": (".csv", cruise.read_table, (SAMPLES / "cruise" / "speeds.csv").read_bytes()),
    "trials": (".yaml", trials.read, TRIALS),
    "trials, free swimming": (".yaml", trials.read, FREE_SWIM),
    "trials, sample": (".yaml", trials.read, (SAMPLES / "rig" / "trials.yaml").read_bytes()),
    "robot": (".yaml", lambda p: robot.read(str(p)), ROBOT),
    "parameters": (".yaml", parameters.read, PARAMETERS),
    "setup": (".yaml", setup.read, SETUP),
    "evidence": (".json", evidence.read, EVIDENCE),
}
YAML_FORMATS = [name for name, (ending, _, _) in FORMATS.items() if ending == ".yaml"]


def survives(reader: Reader, path: Path, content: bytes) -> None:
    """The reader takes the content or refuses it in order; nothing else, no stray warning."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SwimidWarning)
        refusal = None
        try:
            reader(path)
        except SwimidError as error:
            refusal = error
    if refusal is not None:
        assert refusal.exit_status in (2, 3, 4)
        assert refusal.message


# ------------------------------------------------------------ what is thrown at them

ODD_CELLS = [
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1,5",
    "abc",
    '"',
    '"a',
    "\x00",
    "ü",
    "0x10",
    "1_0",
    " 1 ",
    "NA",
    "#",
    "\r",
]


@st.composite
def mutated(draw: st.DrawFn, valid: bytes) -> bytes:
    """The valid file with a few bytes changed, removed, put in, repeated or cut off."""
    data = bytearray(valid)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        kind = draw(st.integers(0, 5))
        if kind == 0 and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif kind == 1:
            del data[at : at + draw(st.integers(1, 20))]
        elif kind == 2:
            data[at:at] = draw(st.binary(min_size=1, max_size=8))
        elif kind == 3:
            data[at:at] = draw(st.sampled_from(ODD_CELLS + ODD_SCALARS)).encode()
        elif kind == 4:
            end = draw(st.integers(at, len(data)))
            data[at:at] = data[at:end]
        else:
            del data[at:]
    return bytes(data)


#: Text that YAML readers trip over: tags, anchors, merges, dates, numbers out of range.
ODD_SCALARS = [
    "~", "yes", "=", "<<", ".nan", ".inf", "-.inf", "1e999", "0x1F", "0o17", "0b1", "1_000", "9" * 400,
    "1e-400", "12:30:45", "190:20:30.15", "2020-01-01", "2020-13-45", "2020-01-01T25:61:61Z",
    "2001-12-14t21:59:43.10-05:00", "0001-01-01 00:00:00 +23:59", "!!int x", "!!float abc", "!!binary zz",
    "!!binary QUJD", "!!timestamp 1", "!!bool maybe", "!!null x", "!!set {a}", "!!omap [a: 1]",
    "!!pairs [a: 1]", "!!python/tuple [1]", "!!python/name:os.system", "!unknown {a: 1}", "!!str 1",
    "!!seq {a: 1}", "!!map [1]", "*a", "&a 1", "&a [*a]", "[1, [2, {a: [}]", "{? [1]: 2}", "{? {a: 1}: 2}",
    "{<<: 1}", "{<<: [1]}", "{<<: {a: 1}}", "{a: 1, a: 2}", '"\\ud800"', '"\\x00"', "'", "|", ">\n", "- ",
    "...", "---", "%YAML 9.9", "%TAG ! x", "\t", "? ", ": ", "\ufeff", "\u2028", "🐟", "[[[[[[[[[[",
    "[" * 70 + "]" * 70, "{}", "[]", "[null]", "-0.0", "+1", "1.", ".5", "1e3", "1.0e+3", "0_", "0x",
    "1__0", "-", "#",
]  # fmt: skip

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(ODD_SCALARS),
    st.dates(),
    st.datetimes(),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(
            st.one_of(st.text(max_size=6), st.integers(-5, 5), st.floats(), st.none()), inner, max_size=4
        ),
    ),
    max_leaves=8,
)


def _places(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = data.keys() if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()
    return [found for key in keys for found in [(*path, key), *_places(data[key], (*path, key))]]


@st.composite
def rewritten(draw: st.DrawFn, valid: bytes) -> bytes:
    """The valid document with values replaced, removed or added, written as YAML again."""
    data = YAML(typ="safe", pure=True).load(io.BytesIO(valid))
    raw: dict[str, str] = {}
    for _ in range(draw(st.integers(1, 3))):
        *parents, last = draw(st.sampled_from(_places(data)))
        holder = data
        for key in parents:
            holder = holder[key]
        kind = draw(st.integers(0, 3))
        if kind == 0:
            del holder[last]
        elif kind == 1 and isinstance(holder, dict):
            holder[draw(st.one_of(st.text(max_size=6), st.sampled_from(ODD_SCALARS)))] = draw(values)
        elif kind == 2:
            # bare text, so that tags and anchors are read as such
            name = f"RAW{len(raw)}RAW"
            raw[name] = draw(st.sampled_from(ODD_SCALARS))
            holder[last] = name
        else:
            holder[last] = draw(values)
        if not _places(data):
            break
    stream = io.StringIO()
    YAML(typ="safe", pure=True).dump(data, stream)
    text = stream.getvalue()
    for name, odd in raw.items():
        text = text.replace(name, odd)
    return text.encode("utf-8", "surrogatepass")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", FORMATS)
class TestReaders:
    def test_valid_file_is_read(self, name: str, folder: Path) -> None:
        ending, reader, valid = FORMATS[name]
        path = folder / f"valid{ending}"
        path.write_bytes(valid)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SwimidWarning)
            reader(path)

    def test_arbitrary_bytes(self, name: str, folder: Path) -> None:
        ending, reader, _ = FORMATS[name]

        @examples(25)
        @given(content=st.binary(max_size=200))
        def run(content: bytes) -> None:
            survives(reader, folder / f"x{ending}", content)

        run()

    def test_arbitrary_text(self, name: str, folder: Path) -> None:
        ending, reader, _ = FORMATS[name]

        @examples(25)
        @given(content=st.text(max_size=120))
        def run(content: str) -> None:
            survives(reader, folder / f"x{ending}", content.encode("utf-8", "surrogatepass"))

        run()

    def test_mutated_files(self, name: str, folder: Path) -> None:
        ending, reader, valid = FORMATS[name]

        @examples(60)
        @given(content=mutated(valid))
        def run(content: bytes) -> None:
            survives(reader, folder / f"x{ending}", content)

        run()


@pytest.mark.slow
@pytest.mark.parametrize("name", YAML_FORMATS)
def test_rewritten_documents(name: str, folder: Path) -> None:
    _, reader, valid = FORMATS[name]

    @examples(60)
    @given(content=rewritten(valid))
    def run(content: bytes) -> None:
        survives(reader, folder / "x.yaml", content)

    run()


def test_rewritten_evidence(folder: Path) -> None:
    """JSON with any value in any place; NaN and Infinity, which JSON does not know, among them."""
    places = _places(json.loads(EVIDENCE))

    @examples(80)
    @given(place=st.sampled_from(places), value=values)
    def run(place: tuple[Any, ...], value: Any) -> None:
        data = json.loads(EVIDENCE)
        holder = data
        for key in place[:-1]:
            holder = holder[key]
        holder[place[-1]] = value
        survives(evidence.read, folder / "x.json", json.dumps(data, default=str).encode())

    run()


@pytest.mark.parametrize("name", ["log", "cruise table"])
def test_tables_of_odd_cells(name: str, folder: Path) -> None:
    ending, reader, valid = FORMATS[name]
    header = next(line for line in valid.decode().splitlines() if not line.startswith("#"))
    cell = st.one_of(st.sampled_from(ODD_CELLS), st.floats().map(str), st.integers(0, 9).map(str))

    @examples(150)
    @given(
        names=st.permutations(header.split(",")),
        rows=st.lists(st.lists(cell, min_size=1, max_size=6), max_size=6),
        end=st.sampled_from(["\n", "\r\n", "\r", "\n\n"]),
    )
    def run(names: list[str], rows: list[list[str]], end: str) -> None:
        head = names if len(rows) % 2 else header.split(",")
        text = end.join([",".join(head), *(",".join(row) for row in rows)])
        survives(reader, folder / f"x{ending}", text.encode())

    run()


# ------------------------------------------------------------ the same through the command line


def _ends_in_order(ran: Ran) -> None:
    assert ran.status in (0, 2, 3, 4), ran.err
    assert "Traceback" not in ran.err
    assert "bug in swimid" not in ran.err
    assert "RuntimeWarning" not in ran.err
    if ran.status:
        assert "Error" in ran.err


class TestCommands:
    """Small inputs, so that a fit that comes about is a quick one."""

    def test_fit_drag(self, swimid: Callable[..., Ran], folder: Path) -> None:
        rows = (SAMPLES / "rig" / "w40.csv").read_text().splitlines()[4:41]
        valid = "\n".join(["t_s,x_m", *rows[1:]]).encode()
        text = "format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\n"
        (folder / "drag.yaml").write_text(text + "trials: [{log: drag.csv, pulling_mass_kg: 0.04}]\n")

        @examples(20)
        @given(content=mutated(valid))
        def run(content: bytes) -> None:
            (folder / "drag.csv").write_bytes(content)
            _ends_in_order(swimid("fit-drag", folder / "drag.yaml"))

        run()

    def test_fit_drag_trials(self, swimid: Callable[..., Ran], folder: Path) -> None:
        rows = (SAMPLES / "rig" / "w40.csv").read_text().splitlines()[4:31]
        (folder / "w10.csv").write_text("\n".join(rows))

        @examples(20)
        @given(content=rewritten(TRIALS.replace(b"w15.csv", b"w10.csv")))
        def run(content: bytes) -> None:
            (folder / "trials.yaml").write_bytes(content)
            _ends_in_order(swimid("fit-drag", folder / "trials.yaml"))

        run()

    def test_fit_propulsion(self, swimid: Callable[..., Ran], folder: Path) -> None:
        text = "format: swimid-trials/1\nexperiment: cruise\nrobot: boxfish\ntable: speeds.csv\n"
        (folder / "cruise.yaml").write_text(text)
        (folder / "known.yaml").write_bytes(PARAMETERS)

        @examples(15)
        @given(table=mutated(CRUISE), known=st.one_of(st.just(PARAMETERS), rewritten(PARAMETERS)))
        def run(table: bytes, known: bytes) -> None:
            (folder / "speeds.csv").write_bytes(table)
            (folder / "known.yaml").write_bytes(known)
            _ends_in_order(swimid("fit-propulsion", folder / "cruise.yaml", "--drag", folder / "known.yaml"))

        run()

    def test_rwls(self, swimid: Callable[..., Ran], folder: Path) -> None:
        rng = np.random.default_rng(3)
        u = rng.normal(size=60)
        y = np.zeros(60)
        for k in range(1, 60):
            y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1]
        lines = ["t_s,cmd1_rad,u_m_s", *(f"{0.1 * k:.1f},{u[k]:.4f},{y[k]:.4f}" for k in range(60))]
        valid = "\n".join(lines).encode()
        words = ["--input", "cmd1_rad", "--output", "u_m_s", "--na", "1", "--nb", "1"]

        @examples(15)
        @given(content=mutated(valid))
        def run(content: bytes) -> None:
            (folder / "run.csv").write_bytes(content)
            _ends_in_order(swimid("rwls", folder / "run.csv", *words))

        run()

    def test_report(self, swimid: Callable[..., Ran], folder: Path) -> None:
        path = folder / "result.yaml"

        @examples(15)
        @given(
            result=st.one_of(st.just(PARAMETERS), rewritten(PARAMETERS), mutated(PARAMETERS)),
            shown=st.one_of(st.just(EVIDENCE), mutated(EVIDENCE)),
        )
        def run(result: bytes, shown: bytes) -> None:
            path.write_bytes(result)
            evidence.sidecar(path).write_bytes(shown)
            _ends_in_order(swimid("report", path, "-o", folder / "r.html", "--force"))

        run()
