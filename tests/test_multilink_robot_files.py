"""Wrong files of multi-link robots: one clear error each, with file, line and what to do."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from swimid.errors import InputError, SwimidError, UsageError
from swimid.fitting import drives
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import SwimInput, Trial
from swimid.notices import SwimidWarning
from swimid.robots import file as robot_format
from swimid.swimmer import trials as experiment
from tests.conftest import Ran
from tests.generators.files import write_trials
from tests.test_fuzz_readers import examples, mutated, rewritten

ROBOT = """\
format: swimid-robot/1
name: eel
fluid: {density_kg_m3: 1000}
readings:
  lift:
    question: Does the fin lift?
    chosen: some
    options:
      some: {says: A little.}
      none: {says: No., set: {multilink.elements.plate.lift_coefficient: 0}}
multilink:
  plane: vertical
  coefficients:
    c_m: {value: 0.5, bounds: [0, 2]}
    c_d: {value: 1.5, bounds: [0, 9], start: 2}
    stiff: {value: 0.3, unit: N m/rad, bounds: [0, null], scale: 0.1}
  links:
    - {name: head, length_m: 0.25, mass_kg: 1.2, com_m: 0.1, inertia_kg_m2: 0.019, inertia_about: front}
    - {name: trunk, length_m: 0.2, mass_kg: 0.8, com_m: 0.1, inertia_kg_m2: 0.003, inertia_about: com}
    - {name: tail, length_m: 0.1, mass_kg: 0.1, com_m: 0.04, inertia_kg_m2: 1.0e-4, inertia_about: com}
  joints:
    - {name: neck, parent: head, child: trunk, driven: {gain: 1, servo: {natural_frequency_hz: 5}}}
    - name: peduncle
      parent: trunk
      child: tail
      passive: {stiffness_N_m_rad: stiff, damping_N_m_s_rad: 0.001}
  elements:
    - {kind: added-mass, name: water, link: head, surge_kg: 0.1, sway_kg: 1.2 * c_m, inertia_kg_m2: 0.002}
    - {kind: drag, name: hull, link: trunk, normal_coefficient: c_d,
       normal_area_m2: 0.02, from_m: 0.05, to_m: 0.2}
    - {kind: damping, link: head, linear_N_m_s_rad: 0.001}
    - kind: slender-body
      link: trunk
      drag_coefficient: c_d
      sections:
        - {station_m: 0, height_m: 0.1, perimeter_m: 0.3}
        - {station_m: 0.2, height_m: 0.04, perimeter_m: 0.1}
    - {kind: foil, name: plate, link: tail, area_m2: 0.008, at_m: 0.04, lift_coefficient: 1.2}
    - {kind: hydrostatics, link: head, volume_m3: 0.0012}
    - {kind: force, link: tail, forward_N: 0.01, frame: world}
"""
#: What is replaced, by what, the key named, words of the reason, and words of the hint.
WRONG = {
    "negative mass": ("mass_kg: 0.8", "mass_kg: -0.8", "trunk.mass_kg", "must be positive", ""),
    "no mass": ("mass_kg: 0.8", "mass_kg: 0", "trunk.mass_kg", "must be positive", ""),
    "mass by a coefficient": ("mass_kg: 0.8", "mass_kg: -1 * c_m", "trunk.mass_kg", "-0.5 kg", ""),
    "inertia about the front below m l^2": ("0.019", "0.011", "head.inertia_kg_m2", "is -0.001", "0.012"),
    "negative inertia": ("1.0e-4", "-1.0e-4", "tail.inertia_kg_m2", "must be positive", ""),
    "no inertia": ("1.0e-4", "0", "tail.inertia_kg_m2", "must be positive", ""),
    "added mass below zero": (
        "0.1, sway_kg", "-1.5, sway_kg", "links.head", "not positive definite", "negative",
    ),
    "negative added coefficient": (
        "c_m: {value: 0.5, bounds: [0, 2]}", "c_m: {value: -2}", "links.head", "not positive definite",
        "negative",
    ),
    "grams": ("mass_kg: 1.2", "mass_kg: 1200", "head.mass_kg", "1200 kg", "in g"),
    "grams in a small link": ("mass_kg: 0.1,", "mass_kg: 100,", "tail", "100 kg", "g"),
    "millimetres of a link": ("length_m: 0.2,", "length_m: 200,", "trunk.inertia_kg_m2", "gyration", "mm"),
    "millimetres of a centre of mass": ("com_m: 0.04", "com_m: 40", "tail.com_m", "40 m is out", "mm"),
    "millimetres of a joint": (
        "child: tail\n", "child: tail\n      at_m: 200\n", "peduncle.at_m", "out of proportion", "mm",
    ),
    "millimetres of a station": ("at_m: 0.04", "at_m: 40", "plate.at_m", "out of proportion", "mm"),
    "millimetres of a section": ("station_m: 0.2", "station_m: 200", "sections.1.station_m", "out of", "mm"),
    "square centimetres": (
        "normal_area_m2: 0.02", "normal_area_m2: 200", "hull.normal_area_m2", "200 m2", "cm2",
    ),
    "g m2": ("inertia_kg_m2: 0.003", "inertia_kg_m2: 3", "trunk.inertia_kg_m2", "gyration", "g m2"),
    "kg mm2": ("inertia_kg_m2: 0.003", "inertia_kg_m2: 3000", "trunk.inertia_kg_m2", "gyration", "g m2"),
    "joint without its link": (
        "parent: trunk", "parent: trnk", "peduncle.parent", "no link 'trnk'", "'trunk'",
    ),
    "element without its link": (
        "link: tail, area", "link: tall, area", "elements.4.link", "'tall'", "'tail'",
    ),
    "circle": ("parent: head", "parent: tail", "links.trunk", "no joints connect", ""),
    "link on itself": ("parent: trunk", "parent: tail", "links.tail", "no joints connect", ""),
    "two joints on a link": (
        "  elements:\n", "    - {name: rod, parent: head, child: tail}\n  elements:\n", "joints.rod",
        "two joints", "",
    ),
    "base hung on a link": (
        "  elements:\n", "    - {name: rod, parent: tail, child: head}\n  elements:\n",
        "joints.rod.child", "is the base",
        "closes on itself",
    ),
    "loose link": (
        "    - {name: neck", "    # - {name: neck", "links.trunk", "no joints connect the link 'trunk'", "",
    ),
    "link name twice": ("name: tail,", "name: trunk,", "links.2", "two links have the name", ""),
    "joint name twice": ("name: peduncle", "name: neck", "joints.1", "two joints have the name", ""),
    "driven and passive": (
        "driven: {gain: 1", "passive: {}, driven: {gain: 1", "joints.0", "both driven and", "",
    ),
    "unknown coefficient": ("1.2 * c_m", "1.2 * c_n", "water.sway_kg", "no coefficient 'c_n'", "'c_m'"),
    "unknown coefficient deep down": (
        "frequency_hz: 5", "frequency_hz: stif", "neck.driven.servo.natural_frequency_hz", "'stif'",
        "'stiff'",
    ),
    "word for a mass": (
        "mass_kg: 0.8", "mass_kg: heavy", "trunk.mass_kg", "no coefficient 'heavy'", "it has",
    ),
    "sum of quantities": ("1.2 * c_m", "1.2 + c_m", "sway_kg", "neither a number nor a product", ""),
    "power of quantities": ("1.2 * c_m", "1.2 ** c_m", "sway_kg", "neither a number nor a product", ""),
    "name that is none": ("c_m: {value", "c-m: {value", "multilink", "'c-m'", ""),
    "true for a number": ("mass_kg: 0.8", "mass_kg: true", "mass_kg", "'true' is not a number", ""),
    "not a number": ("mass_kg: 0.8", "mass_kg: .nan", "mass_kg", "finite", ""),
    "infinite": ("mass_kg: 0.8", "mass_kg: .inf", "mass_kg", "finite", ""),
    "infinite product": ("1.2 * c_m", "1e200 * 1e200 * c_m", "sway_kg", "not finite", ""),
    "beyond reason": ("mass_kg: 0.8", "mass_kg: 8.0e+300", "mass_kg", "from 1e-30 to 1e+30", ""),
    "bounds exchanged": ("bounds: [0, 9]", "bounds: [9, 0]", "c_d", "must be below the upper bound, 0", ""),
    "value out of bounds": ("value: 1.5", "value: 15", "c_d", "15 lies outside the bounds, 0 to 9", ""),
    "start out of bounds": ("start: 2", "start: 20", "c_d", "20 lies outside the bounds, 0 to 9", ""),
    "crank longer than its arm": (
        "stiffness_N_m_rad: stiff",
        "tendon: {spring_N_m: 80, pretension_m: 0.01, arm_m: 0.02, crank_m: 0.03}",
        "tendon", "crank_m must be shorter", "",
    ),
    "spring that pushes": (
        "stiffness_N_m_rad: stiff", "stiffness_N_m_rad: -2", "peduncle.passive", "negative", "",
    ),
    "tendon that pushes": (
        "stiffness_N_m_rad: stiff",
        "tendon: {spring_N_m: -80, pretension_m: 0.01, arm_m: 0.03, crank_m: 0.02}",
        "peduncle.passive", "negative", "",
    ),
    "damper that drives": (
        "damping_N_m_s_rad: 0.001}", "damping_N_m_s_rad: -0.1}", "peduncle.passive", "negative", "",
    ),
    "drag that drives": ("normal_area_m2: 0.02", "normal_area_m2: -0.02", "normal_area_m2", "negative", ""),
    "stations exchanged": (
        "from_m: 0.05, to_m: 0.2", "from_m: 0.2, to_m: 0.05", "elements.1", "greater than from_m", "",
    ),
    "sections out of order": ("station_m: 0,", "station_m: 0.3,", "elements.3", "must increase", ""),
    "point on strips": ("from_m: 0.05, to_m: 0.2", "at_m: 0.1", "elements.1", "strips: 1", ""),
    "no strips": ("from_m: 0.05", "strips: 0, from_m: 0.05", "strips", "at least 1", ""),
    "unknown kind": ("kind: foil", "kind: fol", "elements.4", "'fol'", ""),
    "unknown key": (
        "normal_coefficient", "normal_coeficient", "normal_coeficient", "unknown key", "normal_coef",
    ),
    "missing key": (", com_m: 0.04", "", "com_m", "missing", ""),
    "unknown plane": ("plane: vertical", "plane: upright", "plane", "'upright'", ""),
    "reading not there": ("chosen: some", "chosen: sum", "readings.lift", "the options are", ""),
    "reading of a key not there": (
        "chosen: some", "chosen: none", "readings.lift.options.none", "the robot file has no 'plate'", "",
    ),
    "no links": (
        ROBOT[ROBOT.index("    - {name: head") : ROBOT.index("  joints:")], "    []\n", "links",
        "at least 1", "",
    ),
}  # fmt: skip


def wrong(name: str) -> tuple[str, int | None]:
    """The file with its fault, and the line of the fault."""
    old, new, *_ = WRONG[name]
    text = ROBOT
    if name == "reading of a key not there":
        text = text.replace("name: plate, ", "")
    assert text.count(old) >= 1
    text = text.replace(old, new, 1)
    changed = [
        n for n, (a, b) in enumerate(zip(text.split("\n"), ROBOT.split("\n"), strict=False), 1) if a != b
    ]
    return text, changed[0] if changed else None


#: Faults whose error rightly points to another line than the one that was changed.
ELSEWHERE = {
    "added mass below zero",
    "negative added coefficient",
    "loose link",
    "link on itself",
    "circle",
    "name that is none",
    "no links",
    "point on strips",
    "reading not there",
    "reading of a key not there",
    "sections out of order",
    "stations exchanged",
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / "eel.yaml"
    text, line = wrong(name)
    path.write_text(text)
    _, _, key, reason, hint = WRONG[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError) as caught:
            experiment.robot_model(str(path))
    error = caught.value
    assert error.exit_status == 3
    assert error.file == str(path)
    assert error.line is not None
    assert key in (error.column or "")
    assert reason in error.reason
    assert hint in (error.hint or "")
    if name not in ELSEWHERE:
        assert error.line == line


@pytest.mark.parametrize(
    "name", ["negative mass", "circle", "grams", "unknown coefficient", "crank longer than its arm"]
)
def test_through_the_command_line(name: str, tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = tmp_path / "eel.yaml"
    path.write_text(wrong(name)[0])
    beat = ("--frequency-hz", 1, "--amplitude-deg", 20, "--duration-s", 1)
    ran = swimid("simulate", "--robot", path, *beat, "-o", tmp_path / "out.csv")
    assert ran.status == 3
    assert "Traceback" not in ran.err
    assert "eel.yaml, line " in ran.err
    assert not (tmp_path / "out.csv").exists()


def test_the_unchanged_file_is_valid(tmp_path: Path) -> None:
    path = tmp_path / "eel.yaml"
    path.write_text(ROBOT)
    _, model = experiment.robot_model(str(path))
    assert [p.name for p in model.parameters][:3] == ["c_m", "c_d", "stiff"]
    assert np.isfinite(_swim(model)).all()


def test_readings(tmp_path: Path) -> None:
    path = tmp_path / "eel.yaml"
    path.write_text(ROBOT)
    robot, _ = experiment.robot_model(str(path), readings={"lift": "none"})
    assert robot.readings["lift"].chosen == "none"
    assert robot.multilink is not None
    assert robot.multilink.elements[4].lift_coefficient == 0
    for given_readings in ({"lift": "maybe"}, {"list": "none"}):
        with pytest.raises(UsageError) as caught:
            robot_format.read(str(path), readings=given_readings)
        assert caught.value.exit_status == 2
        assert "there are" in (caught.value.hint or "")


def test_nothing_to_simulate(tmp_path: Path) -> None:
    path = tmp_path / "eel.yaml"
    fixed = ROBOT.replace("plane: vertical", "plane: vertical\n  base: fixed")
    fixed = fixed.replace(", driven: {gain: 1, servo: {natural_frequency_hz: 5}}", "")
    fixed = fixed.replace("passive: {", "# {")
    path.write_text(fixed)
    with pytest.raises(InputError, match="needs a driven or passive joint") as caught:
        experiment.robot_model(str(path))
    assert caught.value.line == 1 + fixed[: fixed.index("base: fixed")].count("\n")


def test_robot_without_links() -> None:
    with pytest.raises(InputError, match="no 'multilink' or 'multibody' part"):
        experiment.robot_model("boxfish")


def test_driven_joint_without_its_column(tmp_path: Path) -> None:
    """Neither a drive nor a logged angle: the error names the log and both columns."""
    (tmp_path / "eel.yaml").write_text(ROBOT)
    rows = [f"{0.02 * k:.2f},{0.001 * k:.4f},0,0" for k in range(50)]
    (tmp_path / "run.csv").write_text("\n".join(["t_s,x_m,z_m,pitch_rad", *rows]) + "\n")
    trials = tmp_path / "trials.yaml"
    write_trials(trials, "free-swim", "eel.yaml", ["log: run.csv"])
    with pytest.raises(InputError) as caught:
        load_experiment(trials)
    assert caught.value.file == str(tmp_path / "run.csv")
    assert "'neck'" in caught.value.reason
    assert "joint1_rad" in str(caught.value)
    assert "cmd1_rad" in str(caught.value)
    assert "drive" in (caught.value.hint or "")


# ------------------------------------------------------------ anything at all


def _swim(model: experiment.MultilinkModel) -> np.ndarray:
    time = np.linspace(0.0, 0.2, 11)
    values = np.array([p.start for p in model.parameters])
    trial = Trial("run", "fit", time, {}, swim=SwimInput(drives.TailBeat("sine", 1.0, 0.3)))
    return np.column_stack(list(model.simulate(values, trial).values()))


def _survives(path: Path, content: bytes) -> None:
    """A model that simulates (to NaN at worst), or an error made for the user."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SwimidWarning)
        refusal, model = None, None
        try:
            _, model = experiment.robot_model(str(path))
        except SwimidError as error:
            refusal = error
        if model is not None:
            _swim(model)
    if refusal is not None:
        assert refusal.exit_status in (2, 3)
        assert refusal.message


@pytest.mark.kernels
class TestFuzz:
    def test_mutated(self, tmp_path: Path) -> None:
        @examples(150)
        @given(content=mutated(ROBOT.encode()))
        def run(content: bytes) -> None:
            _survives(tmp_path / "x.yaml", content)

        run()

    @pytest.mark.slow
    def test_rewritten(self, tmp_path: Path) -> None:
        @examples(60)
        @given(content=rewritten(ROBOT.encode()))
        def run(content: bytes) -> None:
            _survives(tmp_path / "x.yaml", content)

        run()
