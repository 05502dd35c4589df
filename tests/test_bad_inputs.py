"""Bad inputs through whole commands: the exit status, and a message that says where and what to do.

What each reader says of each fault is in ``test_formats.py``; here a fault lies deep in the
inputs of a verb, and is found, named and survived.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid.results import parameters
from tests.conftest import SAMPLES, Ran

Run = Callable[..., Ran]
HEAD = "format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\ntrials:\n"
#: Modes of files hinder neither root nor Windows.
UNHINDERED = os.name == "nt" or os.geteuid() == 0
ARX = ["--input", "cmd1_rad", "--output", "u_m_s", "--na", "1", "--nb", "1"]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A copy of the sample rig that a test may spoil."""
    return Path(shutil.copytree(SAMPLES / "rig", tmp_path / "rig"))


@pytest.fixture
def cruise(tmp_path: Path) -> Path:
    """A copy of the sample cruise with a drag file beside it."""
    folder = Path(shutil.copytree(SAMPLES / "cruise", tmp_path / "cruise"))
    known = {
        name: parameters.Estimate(value=value, stderr=0.0, unit=unit, status="estimated")
        for name, value, unit in (("drag_coefficient", 0.705, "1"), ("added_mass", 0.685, "kg"))
    }
    file = parameters.ParameterFile(model="falling-weight", robot="boxfish", parameters=known)
    file.write(folder / "drag.yaml")
    return folder


def arx_log(rows: int = 200) -> list[str]:
    """Lines of a log of a first-order model; the header first."""
    rng = np.random.default_rng(4)
    u, y = rng.normal(size=rows), np.zeros(rows)
    for k in range(1, rows):
        y[k] = 0.8 * y[k - 1] + 0.05 * u[k - 1] + rng.normal(0, 0.001)
    return ["t_s,cmd1_rad,u_m_s", *(f"{0.1 * k:.1f},{u[k]:.5f},{y[k]:.5f}" for k in range(rows))]


def edited(path: Path, change: Callable[[list[list[str]]], None]) -> None:
    """Change the cells of a CSV file; row 0 is the header."""
    lines = path.read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    cells = [line.split(",") for line in lines if not line.startswith("#")]
    change(cells)
    path.write_text("\n".join([*comments, *(",".join(row) for row in cells)]) + "\n")


def refused(ran: Ran, status: int, words: list[str]) -> None:
    assert ran.status == status, ran.err + ran.out
    for word in words:
        assert word in ran.err
    assert "Traceback" not in ran.err
    assert ran.out == ""


# ------------------------------------------------------------ logs of a rig

LOG_FAULTS: dict[str, tuple[Callable[[list[list[str]]], None], list[str]]] = {
    "non-numeric cell": (
        lambda c: c[7].__setitem__(1, "0.0x5"),
        ["w20.csv, line 12, 'x_m': '0.0x5' is not a number"],
    ),
    "too few samples": (lambda c: c.__delitem__(slice(4, None)), ["w20.csv", "at least 5"]),
    "constant column": (
        lambda c: [row.__setitem__(1, "0.1") for row in c[1:]] and None,
        ["w20.csv", "the displacement goes from 0.1 to 0.1 m"],
    ),
    "falling displacement": (
        lambda c: [row.__setitem__(1, f"-{row[1]}") for row in c[1:]] and None,
        ["w20.csv", "'x_m'", "must grow along the pull"],
    ),
}


@pytest.mark.parametrize("fault", LOG_FAULTS)
def test_one_bad_log_among_seven(swimid: Run, rig: Path, tmp_path: Path, fault: str) -> None:
    change, words = LOG_FAULTS[fault]
    edited(rig / "w20.csv", change)
    out = tmp_path / "drag.yaml"
    refused(swimid("fit-drag", rig / "trials.yaml", "-o", out), 3, words)
    assert not out.exists()


# ------------------------------------------------------------ trials files

TRIALS_FAULTS: dict[str, tuple[str, list[str]]] = {
    "no such log": (
        HEAD + "  - {log: w11.csv, pulling_mass_kg: 0.01}\n",
        ["w11.csv: cannot be read: No such file"],
    ),
    "no mass anywhere": (
        HEAD.replace("boxfish", "light.yaml") + "  - {log: w10.csv, pulling_mass_kg: 0.01}\n",
        [
            "'inertial_mass_kg': the trial 'w10.csv' has no inertial mass",
            "body.inertial_mass_kg of the robot",
        ],
    ),
    "one log twice without ids": (
        HEAD + "  - {log: w10.csv, pulling_mass_kg: 0.01}\n  - {log: w10.csv, pulling_mass_kg: 0.015}\n",
        ["two trials have the id 'w10.csv'"],
    ),
    "stretch outside the log": (
        HEAD + "  - {log: w10.csv, pulling_mass_kg: 0.01, start_s: 900}\n",
        ["w10.csv: has fewer than 2 samples between start_s 900", "the log runs from"],
    ),
    "area of some trials only": (
        HEAD.replace("boxfish", "light.yaml")
        + "  - {log: w10.csv, pulling_mass_kg: 0.01, inertial_mass_kg: 1.2, frontal_area_m2: 0.007}\n"
        + "  - {log: w15.csv, pulling_mass_kg: 0.01, inertial_mass_kg: 1.2}\n",
        ["'frontal_area_m2'", "the trial 'w15.csv' has no frontal area"],
    ),
    "force against the motion": (
        HEAD + "  - {log: w10.csv, driving_force_N: -0.1}\n",
        ["'driving_force_N'", "must be positive"],
    ),
}


@pytest.mark.parametrize("fault", TRIALS_FAULTS)
def test_bad_trials_file(swimid: Run, rig: Path, fault: str) -> None:
    text, words = TRIALS_FAULTS[fault]
    (rig / "light.yaml").write_text("format: swimid-robot/1\nname: light\n")
    (rig / "t.yaml").write_text(text)
    refused(swimid("fit-drag", rig / "t.yaml"), 3, words)


def test_bad_robot_file_names_its_own_line(swimid: Run, rig: Path) -> None:
    (rig / "own.yaml").write_text("format: swimid-robot/1\nname: own\nbody:\n  inertial_mas_kg: 1\n")
    (rig / "t.yaml").write_text(
        HEAD.replace("boxfish", "own.yaml") + "  - {log: w10.csv, pulling_mass_kg: 0.01}\n"
    )
    ran = swimid("fit-drag", rig / "t.yaml")
    refused(ran, 3, ["own.yaml, line 4", "did you mean 'inertial_mass_kg'"])


@pytest.mark.skipif(UNHINDERED, reason="root may read every file; Windows has no such modes")
def test_unreadable_log(swimid: Run, rig: Path) -> None:
    (rig / "w20.csv").chmod(0)
    refused(swimid("fit-drag", rig / "trials.yaml"), 3, ["w20.csv: cannot be read: Permission denied"])


@pytest.mark.skipif(UNHINDERED, reason="root may write everywhere; Windows has no such modes")
def test_unwritable_folder(swimid: Run, rig: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    refused(swimid("fit-drag", rig / "trials.yaml", "-o", folder / "d.yaml"), 3, ["you may not write"])


# ------------------------------------------------------------ what is suspicious, not wrong


def warned(ran: Ran, code: str, words: list[str]) -> None:
    lines = [line for line in ran.err.splitlines() if line.startswith(f"warning {code}")]
    assert lines, ran.err
    for word in words:
        assert any(word in line for line in lines), lines


def test_missing_samples_are_masked_and_the_result_stays(swimid: Run, rig: Path) -> None:
    """Two runs of missing samples in every log: each warned of, estimates within their errors."""
    whole = swimid("fit-drag", rig / "trials.yaml", "--json").json["result"]["parameters"]

    def lose(cells: list[list[str]]) -> None:
        for row in [*cells[20:28], *cells[40:50]]:
            row[1] = ""

    for path in rig.glob("w*.csv"):
        edited(path, lose)
    ran = swimid("fit-drag", rig / "trials.yaml", "--json", "-v")
    assert ran.status == 0
    warned(ran, "SWM001", ["w10.csv", "w40.csv", "longest run 10"])
    assert [w["code"] for w in ran.json["warnings"]].count("SWM001") == 7
    with_gaps = ran.json["result"]["parameters"]
    for name in ("drag_coefficient", "added_mass"):
        shift = abs(with_gaps[name]["value"] - whole[name]["value"])
        # fewer samples of the same noise: the estimates differ by less than their larger error
        assert shift < 2 * with_gaps[name]["stderr"], name


def test_displacement_in_millimetres(swimid: Run, rig: Path) -> None:
    """A factor of 1000: the fit may give up or go on, the unit is suspected either way."""
    for path in rig.glob("w*.csv"):
        edited(path, lambda c: [r.__setitem__(1, str(1000 * float(r[1]))) for r in c[1:]] and None)
    ran = swimid("fit-drag", rig / "trials.yaml")
    assert ran.status in (0, 4)
    warned(ran, "SWM002", ["w10.csv, 'x_m'", "millimetres", "factor of 1000"])


def test_masses_in_grams(swimid: Run, rig: Path) -> None:
    text = (rig / "trials.yaml").read_text()
    for grams in (10, 15, 20, 25, 30, 35, 40):
        text = text.replace(f"pulling_mass_kg: 0.0{grams}", f"pulling_mass_kg: {grams}")
    (rig / "trials.yaml").write_text(text)
    ran = swimid("fit-drag", rig / "trials.yaml")
    assert ran.status in (0, 4)
    warned(ran, "SWM002", ["'w10' has the pulling mass 10 kg", "grams"])


def test_command_in_degrees(swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("\n".join(arx_log()) + "\n")
    edited(
        tmp_path / "run.csv", lambda c: [r.__setitem__(1, str(57.3 * float(r[1]))) for r in c[1:]] and None
    )
    ran = swimid("rwls", tmp_path / "run.csv", *ARX)
    assert ran.status == 0
    warned(ran, "SWM002", ["'cmd1_rad'", "degrees", "57.3"])


def test_constant_input(swimid: Run, tmp_path: Path) -> None:
    """The output's own dynamics can still be told; the input's effect cannot, and that is said."""
    (tmp_path / "run.csv").write_text("\n".join(arx_log()) + "\n")
    edited(tmp_path / "run.csv", lambda c: [r.__setitem__(1, "0.5") for r in c[1:]] and None)
    ran = swimid("rwls", tmp_path / "run.csv", *ARX)
    assert ran.status == 0
    warned(ran, "SWM022", ["the input is constant"])


def test_option_without_effect(swimid: Run, rig: Path) -> None:
    ran = swimid("fit-drag", rig / "trials.yaml", "--coordinate", "roll_rad")
    assert ran.status == 0
    warned(ran, "SWM004", ["--coordinate"])


# ------------------------------------------------------------ cruise tables


@pytest.mark.parametrize(
    "column, factor, words",
    [("distance_m", 1000.0, ["mm/s"]), ("amplitude_deg", 1 / 57.3, ["'amplitude_deg'", "radians"])],
)
def test_units_of_a_cruise_table(
    swimid: Run, cruise: Path, column: str, factor: float, words: list[str]
) -> None:
    def scale(cells: list[list[str]]) -> None:
        at = cells[0].index(column)
        for row in cells[1:]:
            row[at] = f"{factor * float(row[at]):.6g}"

    edited(cruise / "speeds.csv", scale)
    ran = swimid("fit-propulsion", cruise / "trials.yaml", "--drag", cruise / "drag.yaml")
    assert ran.status in (0, 4), ran.err
    warned(ran, "SWM002", words)


@pytest.mark.parametrize(
    "text, words",
    [
        ("format: swimid-parameters/1\nmodel: arx\nparameters: {}\n", ["drag.yaml, 'model'", "'arx'"]),
        ("format: swimid-trials/1\n", ["drag.yaml, line 1, 'format': is no parameter file"]),
        (
            "format: swimid-parameters/1\nmodel: falling-weight\nparameters: {}\n",
            ["'parameters.drag_coefficient': this parameter is missing"],
        ),
    ],
)
def test_bad_drag_file(swimid: Run, cruise: Path, text: str, words: list[str]) -> None:
    (cruise / "drag.yaml").write_text(text)
    refused(swimid("fit-propulsion", cruise / "trials.yaml", "--drag", cruise / "drag.yaml"), 3, words)


# ------------------------------------------------------------ reports


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("verb", ["rwls", "report", "fit-propulsion"])
def test_full_disk(swimid: Run, cruise: Path, tmp_path: Path, verb: str) -> None:
    (tmp_path / "run.csv").write_text("\n".join(arx_log()) + "\n")
    words = {
        "rwls": ["rwls", tmp_path / "run.csv", *ARX],
        "report": ["report", cruise / "drag.yaml"],
        "fit-propulsion": ["fit-propulsion", cruise / "trials.yaml", "--drag", cruise / "drag.yaml"],
    }[verb]
    refused(swimid(*words, "-o", "/dev/full"), 3, ["/dev/full", "No space left"])


@pytest.mark.parametrize("verb", ["rwls", "report", "fit-propulsion"])
def test_missing_output_folder(swimid: Run, cruise: Path, tmp_path: Path, verb: str) -> None:
    """Said before the work, not after it."""
    words = {
        "rwls": ["rwls", tmp_path / "absent.csv", *ARX],
        "report": ["report", cruise / "drag.yaml"],
        "fit-propulsion": ["fit-propulsion", cruise / "absent.yaml"],
    }[verb]
    refused(swimid(*words, "-o", tmp_path / "no" / "x.yaml"), 3, ["the output folder", "mkdir -p"])


def test_a_copy_of_a_fitted_log_is_not_held_out(swimid: Run, rig: Path, tmp_path: Path) -> None:
    shutil.copy(rig / "w10.csv", rig / "another.csv")
    with (rig / "trials.yaml").open("a") as stream:
        stream.write("  - {log: another.csv, pulling_mass_kg: 0.010, role: validate}\n")
    ran = swimid("fit-drag", rig / "trials.yaml", "-o", tmp_path / "d.yaml")
    refused(ran, 3, ["'w10' and 'another", "held-out rows must not be fitted"])
