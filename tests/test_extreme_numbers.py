"""Numbers at the ends of the range, large YAML files, and result files whose parts contradict each other."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.logs import log
from swimid.results.parameters import ParameterFile
from tests.conftest import Ran

Run = Callable[..., Ran]

SAMPLES = Path(__file__).parents[1] / "sample_logs"
PARAMETERS = """\
format: swimid-parameters/1
model: falling-weight
robot: boxfish
parameters:
  drag_coefficient: {value: 0.7, stderr: 0.003, unit: '1', status: estimated}
  added_mass: {value: 0.68, stderr: 0.001, unit: kg, status: estimated}
  pulley_friction: {value: 0.03, stderr: null, unit: N, status: fixed}
correlation:
  names: [drag_coefficient, added_mass]
  matrix:
  - [1.0, -0.5]
  - [-0.5, 1.0]
fit:
  trials: [w10]
  channels:
    x_m: {rmse: 0.001, nrmse: 0.002, samples: 10, unit: m}
  validation: {trials: [w25], channels: {x_m: {rmse: 0.001, nrmse: 0.002, samples: 10, unit: m}}}
  noise:
    x_m: {value_sd: 0.001, time_sd_s: null}
  converged: true
provenance:
  inputs: {w10.csv: abc}
"""


def refused(ran: Ran, *words: str) -> None:
    """The command refused its input, and the message has all words."""
    assert ran.status == 3, (ran.status, ran.err)
    for word in words:
        assert word in ran.err, ran.err


#: Changes that make the parts of a parameter file contradict each other, and words of the refusal.
CONTRADICTIONS = {
    "a short row": ("- [-0.5, 1.0]", "- [-0.5]", ["rows of 2, 1 numbers"]),
    "a row too many": ("- [-0.5, 1.0]", "- [-0.5, 1.0]\n  - [0.0, 0.0]", ["rows of 2, 2, 2 numbers"]),
    "must be symmetric": ("- [-0.5, 1.0]", "- [0.4, 1.0]", ["must be symmetric", "added_mass"]),
    "a diagonal of 0": ("- [-0.5, 1.0]", "- [-0.5, 0.0]", ["diagonal of 1"]),
    "above 1": ("[1.0, -0.5]", "[1.0, -1.5]", ["matrix"]),
    "another name": ("names: [drag_coefficient, ", "names: [drag, ", ["'drag'", "drag_coefficient"]),
    "one name twice": ("names: [drag_coefficient, ", "names: [added_mass, ", ["added_mass, added_mass"]),
    "inputs that are no mapping": ("inputs: {w10.csv: abc}", "inputs: true", ["provenance.inputs"]),
    "an error that is text": ("x_m: {rmse: 0.001, nrmse: 0.002, samples: 10, unit: m}\n  val",
                              "x_m: {rmse: abc, unit: m}\n  val", ["fit.channels.x_m.rmse"]),
    "channels that are no mapping": ("validation: {trials: [w25], channels: {x_m",
                                     "validation: {channels: [x]}\n  more: {x: {x_m", ["validation"]),
    "a negative standard error": ("stderr: 0.003", "stderr: -0.003", ["at least 0"]),
}  # fmt: skip


@pytest.mark.parametrize("change", CONTRADICTIONS)
def test_parameter_files_that_contradict_themselves(change: str, swimid: Run, tmp_path: Path) -> None:
    before, after, words = CONTRADICTIONS[change]
    assert before in PARAMETERS
    path = tmp_path / "drag.yaml"
    path.write_text(PARAMETERS.replace(before, after))
    refused(swimid("report", path, "-o", tmp_path / "page.html"), "drag.yaml, line", *words)
    refused(
        swimid("simulate", "--params", path, "--pulling-mass-kg", "0.02", "-o", tmp_path / "o.csv"),
        "drag.yaml, line",
        *words,
    )


def test_a_correlation_that_no_data_have(tmp_path: Path) -> None:
    path = tmp_path / "drag.yaml"
    text = PARAMETERS.replace("names: [drag_coefficient, added_mass]", "names: [a, b, c]")
    rows = "- [1, 0.9, -0.9]\n  - [0.9, 1, 0.9]\n  - [-0.9, 0.9, 1]"
    text = text.replace("- [1.0, -0.5]\n  - [-0.5, 1.0]", rows)
    path.write_text(text)
    with pytest.raises(InputError, match="negative eigenvalue"):
        ParameterFile.read(path)


def test_a_correlation_may_name_a_value_that_parameters_share(tmp_path: Path) -> None:
    """The parameters c_f0 and c_f4 share the value c_f, which has one row of the correlation matrix."""
    path = tmp_path / "drag.yaml"
    text = PARAMETERS.replace("names: [drag_coefficient, added_mass]", "names: [drag_coefficient, c_f]")
    path.write_text(text)
    with pytest.raises(InputError, match="the correlation names 'c_f', not a parameter"):
        ParameterFile.read(path)
    path.write_text(f"{text}settings:\n  shared: {{c_f: [drag_coefficient, added_mass]}}\n")
    assert ParameterFile.read(path).settings["shared"] == {"c_f": ["drag_coefficient", "added_mass"]}


def test_a_parameter_file_is_read_and_written_unchanged(tmp_path: Path) -> None:
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    first.write_text(PARAMETERS)
    ParameterFile.read(first).write(second)
    ParameterFile.read(second).write(first)
    assert first.read_bytes() == second.read_bytes()
    assert list(ParameterFile.read(first).fit.channels["x_m"]) == ["rmse", "nrmse", "samples", "unit"]


EVIDENCE = {
    "a cell more": lambda e: e["tables"][0]["rows"][0].append("x"),
    "a cell less": lambda e: e["tables"][0]["rows"][0].pop(),
    "a result in another folder": lambda e: e.__setitem__("result", "../drag.yaml"),
    "no result": lambda e: e.__setitem__("result", ""),
    "inputs that are no mapping": lambda e: e["provenance"].__setitem__("inputs", True),
}


@pytest.mark.parametrize("change", EVIDENCE)
def test_evidence_that_contradicts_itself(change: str, swimid: Run, tmp_path: Path) -> None:
    content = {
        "format": "swimid-evidence/1",
        "result": "drag.yaml",
        "command": "fit-drag",
        "title": "t",
        "verdict": {"level": "good", "text": "t"},
        "tables": [{"id": "a", "title": "t", "columns": ["a", "b"], "rows": [["x", 1], ["y", 2]]}],
        "provenance": {"inputs": {}},
    }
    EVIDENCE[change](content)
    (tmp_path / "drag.yaml").write_text(PARAMETERS)
    (tmp_path / "drag.evidence.json").write_text(json.dumps(content))
    named = [tmp_path] + [tmp_path / "drag.yaml"] * (change != "no result")
    for given in named:
        refused(swimid("report", given, "-o", tmp_path / "page.html"), "drag.evidence.json")


#: Factors on the time and the values of a log that leave the range of numbers, and words of the refusal.
FACTORS = {
    "huge values": (1.0, 1e300, ["x_m", "beyond"]),
    "tiny values": (1.0, 1e-300, ["x_m", "at least 1e-30"]),
    "huge times": (1e300, 1.0, ["t_s", "beyond"]),
    "tiny times": (1e-300, 1.0, ["t_s", "mean step"]),
    "a step of 1e-20 s": (1e-18, 1.0, ["t_s", "mean step"]),
}


@pytest.mark.parametrize("kind", FACTORS)
@pytest.mark.parametrize("command", ["plot", "rwls"])
def test_a_log_beyond_the_range(kind: str, command: str, swimid: Run, tmp_path: Path) -> None:
    on_time, on_values, words = FACTORS[kind]
    path, time_s = tmp_path / "run.csv", np.arange(50) * 0.02
    values = np.column_stack([time_s * on_time, np.sin(time_s) * on_values, np.cos(time_s) * on_values])
    np.savetxt(path, values, delimiter=",", header="t_s,x_m,y_m", comments="", fmt="%.17g")
    options = ["--input", "y_m", "--output", "x_m", "--na", "1", "--nb", "1"] * (command == "rwls")
    out = {"plot": "p.svg", "rwls": "p.yaml"}[command]
    refused(swimid(command, path, *options, "-o", tmp_path / out), "run.csv", *words)


def test_small_values_among_others_are_no_error(swimid: Run, tmp_path: Path) -> None:
    path, time_s = tmp_path / "decay.csv", np.arange(100) * 0.02
    table = np.column_stack([time_s, np.exp(-200 * time_s)])
    np.savetxt(path, table, delimiter=",", header="t_s,x_m", comments="", fmt="%.17g")
    assert swimid("plot", path, "-o", tmp_path / "p.svg").status == 0


@pytest.mark.parametrize("value", ["1e300", "1e-300", "-1e300", "1" + 400 * "0"])
@pytest.mark.parametrize("file", ["robot", "trials"])
def test_a_number_of_a_file_beyond_the_range(file: str, value: str, swimid: Run, tmp_path: Path) -> None:
    mass, density = ("0.01", value) if file == "robot" else (value, "1000")
    (tmp_path / "robot.yaml").write_text(
        f"format: swimid-robot/1\nname: box\nfluid: {{density_kg_m3: {density}}}\n"
        "body: {inertial_mass_kg: 1.0, frontal_area_m2: 0.01}\n"
    )
    (tmp_path / "trials.yaml").write_text(
        "format: swimid-trials/1\nexperiment: falling-weight\nrobot: robot.yaml\ntrials:\n"
        f"  - {{log: w.csv, pulling_mass_kg: {mass}}}\n"
    )
    (tmp_path / "w.csv").write_text("t_s,x_m\n0,0\n1,1\n2,3\n")
    refused(swimid("fit-drag", tmp_path / "trials.yaml"), f"{file}.yaml", "line", "not usable")


DROP = ("simulate", "--pulling-mass-kg", "0.02", "--duration-s", "2")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--sample-rate-hz", "2e-5"), ["less than one sampling interval", "0.5 or more"]),
        (("--sample-rate-hz", "1e9"), ["2e+09 samples", "20,000,000"]),
        (("--dt", "1e-12"), ["samples", "--dt"]),
        (("--dt", "inf"), ["--dt", "not usable"]),
        (("--ramp-s", "inf"), ["--ramp-s", "not usable"]),
        (("--set", "added_mass=1e300"), ["--set", "1e300"]),
    ],
)
def test_options_beyond_the_range(
    options: tuple[str, ...], words: list[str], swimid: Run, tmp_path: Path
) -> None:
    (tmp_path / "drag.yaml").write_text(PARAMETERS)
    ran = swimid(*DROP, "--params", tmp_path / "drag.yaml", *options, "-o", tmp_path / "o.csv")
    assert ran.status == 2, ran.err
    for word in words:
        assert word in ran.err


def test_a_simulation_ends_with_its_duration(swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "drag.yaml").write_text(PARAMETERS)
    out = tmp_path / "o.csv"
    ran = swimid(*DROP, "--params", tmp_path / "drag.yaml", "--sample-rate-hz", "0.75", "-o", out)
    assert ran.status == 0, ran.err
    assert log.read(out).time_s[-1] <= 2.0


@pytest.mark.parametrize(
    "text",
    [
        "values: [" + ", ".join(["a"] * 250_000) + "]\n",
        "values:\n" + "- 1.5\n" * 250_000,
        "values: {" + ", ".join(f"k{k}: 1" for k in range(120_000)) + "}\n",
        "values: " + "x " * 2_000_000 + "\n",
    ],
    ids=["words", "lines", "keys", "text"],
)
def test_a_long_yaml_file_is_refused_before_it_is_parsed(text: str, tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    path.write_text(text)
    began = time.process_time()
    with pytest.raises(InputError, match="nodes"):
        yamlio.load(path)
    assert time.process_time() - began < 2.0


def test_long_lists_of_numbers_are_read_fast_and_exactly(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=30_000)
    path = tmp_path / "map.yaml"
    path.write_text("values: [" + ", ".join(map(repr, values.tolist())) + "]\nlast: 1\n")
    began = time.process_time()
    data = yamlio.load(path)
    assert time.process_time() - began < 3.0
    assert yamlio.plain(data)["values"] == values.tolist()
    assert yamlio.line_of(data, ("last",)) == 2


def test_aliases_of_a_long_list_count_as_copies(tmp_path: Path) -> None:
    path = tmp_path / "bomb.yaml"
    row = ", ".join(["1.5"] * 100_000)
    path.write_text(f"a: &a [{row}]\nb: [{', '.join(['*a'] * 1000)}]\n")
    with pytest.raises(InputError, match="nodes"):
        yamlio.load(path)


def test_every_sample_says_that_its_data_are_simulated() -> None:
    from swimid.files.provenance import says_simulated

    logs = [path for path in SAMPLES.glob("*/*.csv") if path.parent.name != "tutorial"]
    assert len(logs) > 20
    assert [path for path in logs if not says_simulated(path)] == []
