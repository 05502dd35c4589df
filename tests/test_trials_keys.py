"""Every key of a trials file is used by whoever reads it, or refused: none is passed over in silence."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any, Literal, get_args

import numpy as np
import pytest
import yaml
from pydantic import BaseModel

from swimid.blackbox import model as arma
from swimid.blackbox.options import RwlsOptions
from swimid.errors import InputError, SwimidError
from swimid.experiments.free_swim import FreeSwim
from swimid.fitting.fit_common import load_experiment
from swimid.logs.experiments import FreeSwimTrial, find_experiments
from swimid.logs.trials import TrialSet
from swimid.notices import record_warnings
from swimid.results.parameters import ParameterFile
from swimid.simulators.model import SimulatorModel

RATE_HZ = 20.0
TIME = np.arange(0.0, 14.0, 1.0 / RATE_HZ)
DRIVE = {"frequency_hz": 1.0, "amplitude_deg": 20}
ROBOT = """
format: swimid-robot/1
name: bob
sources: [made up]
fluid: {density_kg_m3: 1000, gravity_m_s2: 9.81}
body: {inertial_mass_kg: 1.0, frontal_area_m2: 0.01, roll_inertia_kg_m2: 0.002}
rig: {stiffness_N_m: 5.0, roll_stiffness_N_m_rad: 0.3}
"""


def write_logs(folder: Path) -> None:
    """Logs that hold every column that any experiment reads."""
    ease = np.clip(TIME / 2.0, 0.0, 1.0)
    columns = {
        "t_s": TIME,
        "x_m": 0.2 * TIME,
        "y_m": 0.01 * np.sin(2 * np.pi * TIME),
        "yaw_rad": 0.1 * ease * np.sin(2 * np.pi * TIME),
        "force_N": 1.0 + 0.1 * np.sin(TIME),
        "u_m_s": 0.2 + 0.01 * np.sin(3.0 * TIME),
        "cmd1_rad": np.sign(np.sin(2.0 * TIME)),
        "heading_rate_rad_s": 0.3 * np.sin(2.0 * TIME - 0.4),
    }
    decay = {"t_s": TIME, "x_m": 0.1 * np.exp(-0.1 * TIME) * np.cos(2.0 * TIME)}
    for name, table in {"one.csv": columns, "two.csv": columns, "decay.csv": decay}.items():
        rows = np.column_stack(list(table.values()))
        np.savetxt(folder / name, rows, delimiter=",", header=",".join(table), comments="", fmt="%.9g")
    # another log, not the same again
    text = (folder / "two.csv").read_text().splitlines()
    (folder / "two.csv").write_text("\n".join(text[:-20]) + "\n")
    (folder / "bob.yaml").write_text(ROBOT)
    (folder / "bill.yaml").write_text(ROBOT.replace("bob", "bill"))
    (folder / "speeds.csv").write_text(
        "fin,frequency_hz,amplitude_deg,distance_m,time_s\n"
        + "".join(f"2025Rect,{f},16,1.15,{48.88 / f:.2f}\n" for f in (1.5, 2.0, 2.5))
    )
    (folder / "slow.csv").write_text((folder / "speeds.csv").read_text().replace("1.15", "1.10"))
    for name, value in (("drag.yaml", 0.7), ("other.yaml", 0.8)):
        (folder / name).write_text(
            "format: swimid-parameters/1\nmodel: falling-weight\nrobot: boxfish\nparameters:\n"
            f"  drag_coefficient: {{value: {value}, stderr: 0.01, unit: '1', status: estimated}}\n"
            "  added_mass: {value: 0.3, stderr: 0.01, unit: kg, status: estimated}\n"
        )


def _arma_file() -> ParameterFile:
    estimate = {"stderr": 0.1, "unit": "1", "bounds": [None, None], "status": "estimated"}
    return ParameterFile.model_validate(
        {
            "format": "swimid-parameters/1",
            "model": "arma",
            "robot": "bob",
            "parameters": {"a1": {"value": -0.5, **estimate}, "b1": {"value": 0.5, **estimate}},
            "delay": 1,
            "sample_time_s": 1.0 / RATE_HZ,
            "settings": {
                "input": "cmd1_rad",
                "output": "u_m_s",
                "orders": {"na": 1, "nb": 1, "nk": 1, "nc": 0},
                "input_level": 0.0,
                "output_level": 0.0,
            },
        }
    )


@dataclass(frozen=True)
class Reader:
    """Who reads a trials file: the function, a document it reads, and the keys at which another value than
    that of the document must make a difference or be refused.

    ``values`` has one other value for each key; ``refused`` what is said of those that have no effect, and
    ``same`` the keys that rightly make no difference, and why.
    """

    load: Callable[[Path], Any]
    document: dict[str, Any]
    values: dict[str, Any]
    refused: dict[str, str] = field(default_factory=dict)
    same: dict[str, str] = field(default_factory=dict)


def _trials(*, log: str = "one.csv", robot: str = "bob.yaml", experiment: str, **keys: Any) -> dict[str, Any]:
    return {
        "format": "swimid-trials/1",
        "experiment": experiment,
        "robot": robot,
        "trials": [
            {"id": "a", "log": log, **copy.deepcopy(keys)},
            {
                "id": "b",
                "log": log.replace("one", "two").replace("decay", "./other/decay"),
                **copy.deepcopy(keys),
            },
        ],
    }


OF_TRIAL = {
    "trials.id": "renamed",
    "trials.role": "validate",
    "trials.start_s": 2.0,
    "trials.end_s": 11.0,
    "robot": "bill.yaml",
}
WATER = {"trials.inertial_mass_kg": 1.3, "trials.frontal_area_m2": 0.02, "trials.fluid_density_kg_m3": 1025.0}
BEAT = {
    "trials.drive.waveform": "a-cpg",
    "trials.drive.frequency_hz": 1.2,
    "trials.drive.amplitude_deg": 25.0,
    "trials.drive.bias_deg": 5.0,
    "trials.drive.asymmetry": 0.3,
    "trials.drive.ramp_s": 3.0,
    "trials.drive.phase_deg": 40.0,
}
STROKE = {
    "trials.drive.stroke": "characteristic-pelvis",
    "trials.drive.frequency_hz": 0.4,
    "trials.drive.scale": 0.5,
    "trials.drive.ramp_s": 0.5,
    "trials.drive.cycles": 1.0,
    "trials.drive.phase_deg": 40.0,
}
LOG = {"trials.log": "one-late.csv"}
READERS = {
    "falling weight": Reader(
        load_experiment,
        _trials(experiment="falling-weight", pulling_mass_kg=0.05),
        {**OF_TRIAL, **LOG, **WATER, "trials.pulling_mass_kg": 0.07, "trials.driving_force_N": 1.0},
    ),
    "towed": Reader(load_experiment, _trials(experiment="towed"), {**OF_TRIAL, **LOG, **WATER}, {}),
    "free decay": Reader(
        load_experiment,
        _trials(experiment="free-decay", log="decay.csv"),
        {**OF_TRIAL, **WATER, "trials.log": "decay-late.csv"},
        refused={
            name: f"'{name.removeprefix('trials.')}', which has no effect here"
            for name in ("trials.frontal_area_m2", "trials.fluid_density_kg_m3")
        },
    ),
    "cruise": Reader(
        load_experiment,
        {
            "format": "swimid-trials/1",
            "experiment": "cruise",
            "robot": "boxfish",
            "table": "speeds.csv",
            "drag": "drag.yaml",
        },
        {"robot": "bill.yaml", "table": "slow.csv", "drag": "other.yaml"},
        refused={"robot": "no fin"},
    ),
    "surge": Reader(
        partial(load_experiment, command="fit-propulsion"),
        _trials(experiment="free-swim", drive=DRIVE),
        {**OF_TRIAL, **LOG, **BEAT, "trials.coefficients": {"d_p": 0.02}, "trials.start_state": "steady"},
        refused={
            "trials.coefficients": "'coefficients', which has no effect here",
            "trials.start_state": "'start_state', which has no effect here",
            "trials.drive.asymmetry": "of 'a', a-cpg \\(asymmetry 0.3\\), and of 'b', sine",
        },
        same={
            "trials.drive.phase_deg": "an average over beats has no phase",
            "trials.drive.waveform": "without asymmetry it is the sine",
        },
    ),
    "swimmer, beat": Reader(
        partial(load_experiment, command="fit-graybox"),
        _trials(experiment="free-swim", robot="tfish", drive=DRIVE),
        {
            **OF_TRIAL,
            **LOG,
            **BEAT,
            "robot": "dolphin",
            "trials.coefficients": {"d_p": 0.02},
            "trials.start_state": "steady",
        },
    ),
    "swimmer, stroke": Reader(
        partial(load_experiment, command="fit-graybox"),
        _trials(experiment="multibody", robot="sealion", drive={"stroke": "characteristic"}),
        {**OF_TRIAL, **LOG, **STROKE, "robot": "tfish", "trials.start_state": "steady"},
        refused={"robot": "no stroke"},
    ),
    "rwls": Reader(
        lambda path: arma.read([path], RwlsOptions()),
        {**_trials(experiment="arma"), "input": "cmd1_rad", "output": "u_m_s"},
        {**OF_TRIAL, **LOG, "input": "force_N", "output": "heading_rate_rad_s"},
    ),
    "black box": Reader(
        lambda path: load_experiment(path, params=(path, _arma_file())),
        {**_trials(experiment="arma"), "input": "cmd1_rad", "output": "u_m_s"},
        {**OF_TRIAL, **LOG, "input": "force_N", "output": "heading_rate_rad_s"},
        refused={
            "input": "name the input 'force_N', the parameters are of 'cmd1_rad'",
            "output": "name the output 'heading_rate_rad_s', the parameters are of 'u_m_s'",
        },
    ),
}
SIMULATED = {
    "model.parameters.bounds": [0.0, 3.0],
    "model.parameters.start": 0.5,
    "model.parameters.unit": "N",
    "model.parameters.scale": 0.7,
    "model.parameters.per_trial": True,
    "model.parameters.fixed": True,
    "model.parameters.meaning": "a spring",
    "model.parameters": {"k": {"path": "joint/x/damping", "bounds": [0.0, 2.0]}},
}
READERS |= {
    "mjcf": Reader(
        load_experiment,
        {
            **_trials(experiment="mjcf", robot=""),
            "model": {
                "mjcf": "slide.xml",
                "parameters": {"k": {"path": "joint/x/stiffness", "bounds": [0.0, 2.0]}},
                "inputs": {"push": "force_N"},
                "outputs": {"x_m": "joint/x"},
            },
        },
        {
            **OF_TRIAL,
            **LOG,
            **SIMULATED,
            "robot": "sled",
            "trials.start_state": "rest",
            "model.mjcf": "other.xml",
            "model.keyframe": "away",
            "model.parameters.path": "joint/x/damping",
            "model.parameters.scale_inertia": True,
            "model.inputs": {"push": "cmd1_rad"},
            "model.outputs": {"x_m": "body/sled/x"},
        },
        same={"model.parameters.scale_inertia": "the parameter is no mass"},
    ),
    "python": Reader(
        load_experiment,
        {
            **_trials(experiment="python", robot=""),
            "model": {
                "python": "sim.py:simulate",
                "parameters": {"k": {"start": 1.0, "bounds": [0.0, 2.0]}},
                "inputs": ["force_N"],
                "outputs": ["x_m"],
            },
        },
        {
            **OF_TRIAL,
            **LOG,
            **SIMULATED,
            "robot": "sled",
            "model.parameters": {"other": {"start": 1.0}},
            "model.python": "sim.py:other",
            "model.inputs": ["cmd1_rad"],
            "model.outputs": ["u_m_s"],
        },
    ),
}
SLIDE = """<mujoco><option gravity="0 0 0"/><worldbody><body name="sled">
<joint name="x" type="slide" axis="1 0 0" stiffness="1" damping="0.3"/><geom size="0.1" mass="{}"/></body>
</worldbody><actuator><motor name="push" joint="x"/></actuator>
<keyframe><key name="away" qpos="1"/></keyframe></mujoco>
"""
#: Keys that say what the file is, and what every test here changes the inside of.
FRAME = {"format", "experiment", "trials", "trials.drive", "model"}


def keys_of(model: type[BaseModel], prefix: str = "") -> set[str]:
    """Every key a format has, with its path."""
    found = set()
    for name, info in model.model_fields.items():
        found.add(prefix + name)
        for part in documents_in(info.annotation):
            found |= keys_of(part, f"{prefix}{name}.")
    return found


def documents_in(annotation: Any) -> list[type[BaseModel]]:
    """The formats within a type: list[A], A | B, Annotated[A, ...]."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in documents_in(part)]


def fingerprint(found: Any) -> str:
    """Everything a reader made of its files, in words."""
    with np.printoptions(threshold=100_000, precision=12):
        if isinstance(found, arma.Data):
            return repr((found.columns, found.fit, found.held_out, found.logs, found.robot))
        parts = [found.robot, found.trials, found.facts]
        if isinstance(found.model, SimulatorModel):
            kept = float | int | str | tuple | dict | list | FunctionType
            parts += [(k, v) for k, v in sorted(vars(found.model).items()) if isinstance(v, kept)]
        return re.sub(r" at 0x[0-9a-f]+", "", repr(parts))


def write_case(folder: Path, document: dict[str, Any]) -> Path:
    write_logs(folder)
    (folder / "other").mkdir()
    for name in ("one", "decay"):
        head, *rows = (folder / f"{name}.csv").read_text().splitlines()
        (folder / f"{name}-late.csv").write_text("\n".join([head, *rows[7:]]) + "\n")
    for name, mass in (("slide.xml", 1.0), ("other.xml", 2.0)):
        (folder / name).write_text(SLIDE.format(mass).replace('stiffness="1"', f'stiffness="{mass}"'))
    code = "def simulate(parameters, inputs, times):\n    return {'x_m': times, 'u_m_s': times}\n"
    (folder / "sim.py").write_text(code + code.replace("simulate", "other"))
    # another recording, not a copy: copies are told
    (folder / "other" / "decay.csv").write_text((folder / "decay.csv").read_text() + "\n")
    path = folder / "trials.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def changed(document: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """The document with another value at a key of its first trial, or of itself."""
    found = copy.deepcopy(document)
    first, *rest = key.split(".")
    place = found["trials"][0] if first == "trials" else found.get(first) if rest else found
    if rest[:1] == ["parameters"] and len(rest) > 1:
        place, rest = place["parameters"]["k"], rest[1:]
    names = rest or [first]
    for name in names[:-1]:
        place = place[name]
    if names[-1] == "driving_force_N":
        del place["pulling_mass_kg"]
    if names[-1] == "asymmetry":
        place["waveform"] = "a-cpg"
    place[names[-1]] = value
    return found


def of_experiment(reader: Reader) -> set[str]:
    return keys_of(find_experiments()[reader.document["experiment"]])


CASES = [(name, key) for name, reader in READERS.items() for key in reader.values]


class TestEveryKey:
    def test_every_key_of_every_experiment_has_a_case(self):
        stroke, beat = set(STROKE), set(BEAT)
        seen = set()
        for name, reader in READERS.items():
            wanted = of_experiment(reader) - FRAME
            if "beat" in name or name == "surge":
                wanted -= stroke - beat
            if "stroke" in name:
                wanted -= (beat - stroke) | {"trials.coefficients"}
            assert wanted == set(reader.values), f"{name}: a key without a case here, or a case without a key"
            seen.add(reader.document["experiment"])
        assert seen == set(find_experiments())

    @pytest.mark.parametrize(("name", "key"), CASES)
    def test_is_used_or_refused(self, tmp_path, name, key):
        reader = READERS[name]
        path = write_case(tmp_path, changed(reader.document, key, reader.values[key]))
        with record_warnings():
            if key in reader.refused:
                with pytest.raises(SwimidError, match=reader.refused[key]):
                    reader.load(path)
                return
            after = fingerprint(reader.load(path))
            path.write_text(yaml.safe_dump(reader.document))
            before = fingerprint(reader.load(path))
        assert (after == before) == (key in reader.same)

    def test_a_key_that_nobody_declares_is_refused(self, tmp_path):
        class Newer(FreeSwimTrial):
            tide_m: float | None = None

        class Tidal(FreeSwim):
            experiment: Literal["tidal"]
            trials: list[Newer]

        document = changed(READERS["surge"].document, "trials.tide_m", 0.5)
        path = write_case(tmp_path, document | {"experiment": "tidal"})
        trials = TrialSet.read(path, [Tidal])
        with pytest.raises(InputError, match=r"line \d+.*'a' sets 'tide_m', which has no effect here"):
            load_experiment(trials, command="fit-propulsion")


class TestStretchesOfOneLog:
    def document(self, role: str, **keys: Any) -> dict[str, Any]:
        found = _trials(experiment="arma")
        found |= {"input": "cmd1_rad", "output": "u_m_s"}
        found["trials"][0] |= {"end_s": 8.0}
        found["trials"][1] |= {"log": "./one.csv", "role": role, **keys}
        return found

    def test_held_out_rows_must_not_be_fitted(self, tmp_path):
        path = write_case(tmp_path, self.document("validate", start_s=5.0))
        with pytest.raises(
            InputError,
            match=r"'a' and 'b' .* share its rows from 5 s to 8 s: held-out rows must not be fitted",
        ):
            arma.read([path], RwlsOptions())

    def test_rows_fitted_twice_are_told(self, tmp_path):
        path = write_case(tmp_path, self.document("fit"))
        with record_warnings() as notices:
            arma.read([path], RwlsOptions())
        assert [n.text for n in notices if n.code == "SWM074"] == [
            "trials.yaml: the trials 'a' and 'b' are of the same log and share its rows to 8 s, which count "
            "twice, so that standard errors are too small: separate the trials with start_s and end_s"
        ]

    def test_neighbours_stand_apart(self, tmp_path):
        path = write_case(tmp_path, self.document("validate", start_s=8.0))
        with record_warnings() as notices:
            found = arma.read([path], RwlsOptions())
        assert not [n for n in notices if n.code == "SWM074"]
        assert found.fit[0].time_s[-1] == 8.0 == found.held_out["b"][0].time_s[0]
        assert found.logs == ["a"]

    def test_the_command_line_is_held_against_itself(self, tmp_path):
        path = write_case(tmp_path, self.document("fit"))
        options = RwlsOptions(
            held_out=(tmp_path / "one.csv",), input_column="cmd1_rad", output_column="u_m_s"
        )
        for fitted in (path, tmp_path / "one.csv"):
            with record_warnings(), pytest.raises(InputError, match="held-out rows must not be fitted"):
                arma.read([fitted], options)
