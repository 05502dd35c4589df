"""The command line: help, streams, exit statuses, what it refuses to overwrite."""

from __future__ import annotations

import inspect
import json
import re
import shlex
import signal
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner

import swimid as package
from swimid.cli.main import CommandRun as Running
from swimid.cli.main import main
from swimid.commands import COMMAND_SPECS, TABLE
from swimid.files.atomic import Checkpoint
from swimid.notices import warn
from swimid.results.result import Result, list_result_formats
from tests.conftest import ROOT, Ran

Run = Callable[..., Ran]


def test_every_command_is_in_a_section_and_explains_itself(swimid: Run) -> None:
    shown = swimid("--help").out
    assert re.findall(r"^(\w[\w ]+):$", shown, re.M) == ["Options", *TABLE]
    for name in main.commands:
        assert re.search(rf"^  {name} ", shown, re.M), name
    for spec in COMMAND_SPECS.values():
        assert inspect.getdoc(spec.model()).splitlines()[0] == spec.help, spec.command
        assert "Example" in swimid(*spec.command.split(), "--help").out, spec.command


def test_every_verb_takes_the_shared_options() -> None:
    def leaves(group: click.Group) -> list[click.Command]:
        found = []
        for command in group.commands.values():
            found += leaves(command) if isinstance(command, click.Group) else [command]
        return found

    for command in leaves(main):
        flags = {
            flag
            for p in command.get_params(click.Context(command))
            if isinstance(p, click.Option)
            for flag in p.opts
        }
        assert {"-o", "--json", "-q", "-v", "--no-progress", "--debug", "--force"} <= flags, command.name


def test_version(swimid: Run) -> None:
    assert package.__version__ in swimid("--version").out


@pytest.mark.parametrize(
    "words, status, text",
    [
        (["no-such-verb"], 2, "No such command"),
        (["fit-drag"], 2, "Missing argument"),
        (["fit-drag", "x.yaml", "--method", "magic"], 2, "magic"),
        (["fit-drag", "absent.yaml"], 3, "absent.yaml: cannot be read: No such file"),
        (["fit-drag", "{samples}/rig/trials.yaml", "--fix", "drag=1"], 2, "did you mean 'drag_coefficient'"),
        (["fit-drag", "{samples}/rig/trials.yaml", "--fix", "drag_coefficient"], 2, "NAME=VALUE"),
        (
            ["fit-drag", "{samples}/rig/trials.yaml", "--fix", "drag_coefficient=high"],
            2,
            "'high' is not a number",
        ),
        (
            ["fit-drag", "{samples}/rig/trials.yaml", "--bounds", "added_mass=2,1"],
            2,
            "the lower bound 2.0 must be below 1.0",
        ),
        (["fit-drag", "{samples}/rig/trials.yaml", "-o", "no/such/folder/d.yaml"], 3, "does not exist"),
        (["fit-drag", "{samples}/rig/trials.yaml", "-o", "{samples}/rig/w10.csv/d.yaml"], 3, "is a file"),
        (["fit-drag", "{samples}/rig/trials.yaml", "-o", "{samples}/rig/trials.yaml"], 2, "also an input"),
        (["fit-drag", "{samples}/cruise/trials.yaml"], 3, "'cruise' is not allowed"),
        (
            ["fit-drag", "{samples}/rig/trials.yaml", "--method", "two-point", "--points", "3,6"],
            4,
            "samples lie within",
        ),
        (["schema", "trails"], 2, "did you mean 'trials'"),
    ],
)
def test_statuses(swimid: Run, samples: Path, words: list[str], status: int, text: str) -> None:
    ran = swimid(*[w.format(samples=samples) for w in words])
    assert ran.status == status, ran.err
    assert text in ran.err
    assert "Traceback" not in ran.err
    assert ran.out == ""


def test_json_is_one_document_on_failure_too(swimid: Run) -> None:
    ran = swimid("fit-drag", "absent.yaml", "--json")
    assert ran.status == 3
    document = json.loads(ran.out)
    assert document["ok"] is False
    assert document["error"]["file"] == "absent.yaml"
    assert document["error"]["exit_status"] == 3


def test_quiet_prints_nothing(swimid: Run, samples: Path) -> None:
    ran = swimid("fit-drag", samples / "rig" / "trials.yaml", "-q")
    assert (ran.status, ran.out, ran.err) == (0, "", "")


def test_debug_shows_where(swimid: Run) -> None:
    assert "Traceback" in swimid("fit-drag", "absent.yaml", "--debug").err


def test_a_bug_is_reported_as_one(swimid: Run, samples: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a / b")

    monkeypatch.setattr("swimid.rig.fit_drag.fit_drag", broken)
    ran = swimid("fit-drag", samples / "rig" / "trials.yaml")
    assert ran.status == 1
    assert "bug in swimid" in ran.err
    assert "--debug" in ran.err


@pytest.mark.parametrize(
    "name", ["trials", "robot", "parameters", "setup", "comparison", "gap", "sensitivity", "evidence"]
)
def test_schemas_are_json_schema(swimid: Run, name: str) -> None:
    document = json.loads(swimid("schema", name).out)
    assert document["$schema"].startswith("https://json-schema.org/")
    assert "properties" in document or "oneOf" in document


@pytest.mark.parametrize(
    "words",
    [
        ("fit-drag", "rig/trials.yaml"),
        ("rwls", "longfin/longfin_marching.csv", "--input=cmd1_rad", "--output=u_m_s", "--na=2", "--nb=1"),
        ("import", "camera/polled.csv", "--guess"),
        pytest.param(("compare", "gap/trials.yaml", "--params=gap/params.yaml"), marks=pytest.mark.slow),
        ("simulate", "--params=gap/params.yaml", "--frequency-hz=1", "--amplitude-deg=20", "--duration-s=2"),
        ("export", "gap/params.yaml", "--to=mjcf"),
        ("report", "gap/params.yaml"),
        ("init", "rig"),
        ("sample",),
        ("doctor",),
        ("schema",),
        ("fit-drag", "nowhere.yaml"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_answers_fit_their_schema(
    swimid: Run, samples: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(samples)
    answer = swimid(*words, "--json").json
    jsonschema.validate(answer, swimid("schema", "answer").json)


def test_a_fit_without_held_out_trials_is_not_good(swimid: Run, samples: Path, tmp_path: Path) -> None:
    text = (samples / "rig/trials.yaml").read_text()
    assert swimid("fit-drag", samples / "rig/trials.yaml", "--json").json["verdict"]["level"] == "good"
    text = text.replace("log: ", f"log: {samples}/rig/").replace(", role: validate", "")
    (tmp_path / "trials.yaml").write_text(text)
    verdict = swimid("fit-drag", tmp_path / "trials.yaml", "--json").json["verdict"]
    assert verdict["level"] == "caution"
    assert verdict["reasons"] == ["no trial was held out (role: validate)"]


@pytest.mark.parametrize("words", [("schema", "trials"), ("doctor",)])
def test_schema_and_doctor_write_over_nothing_of_others(
    swimid: Run, tmp_path: Path, words: tuple[str, ...]
) -> None:
    out = tmp_path / "mine.json"
    out.write_text("my own notes\n")
    assert swimid(*words, "-o", out).status == 2
    assert out.read_text() == "my own notes\n"
    assert swimid(*words, "-o", out, "--force").status == 0
    assert swimid(*words, "-o", out).status == 0  # its own may be replaced


def test_schema_lists_every_format(swimid: Run) -> None:
    listed = swimid("schema").out.split()
    assert listed[:7] == ["trials", "robot", "setup", "mapping", "points", "evidence", "answer"]
    assert listed[7:] == list_result_formats()


@pytest.mark.slow
def test_doctor(swimid: Run, tmp_path: Path) -> None:
    ran = swimid("doctor", "--json", "-o", tmp_path / "d.json", "--warm-up")
    assert ran.status == 0
    assert ran.json["result"]["healthy"] is True
    assert json.loads((tmp_path / "d.json").read_text())["swimid"] == package.__version__
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    # names as the index spells them
    plain = [re.sub(r"[._]", "-", re.split("[<>=]", text)[0]).lower() for text in stated]
    assert list(ran.json["result"]["packages"]) == plain


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_full_disk(swimid: Run, samples: Path) -> None:
    ran = swimid("fit-drag", samples / "rig" / "trials.yaml", "-o", "/dev/full")
    assert ran.status == 3
    assert "No space left" in ran.err


def test_a_fit_does_not_write_a_file_called_dash(
    swimid: Run, samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = swimid("fit-drag", str(samples / "rig" / "trials.yaml"), "-o", "-")
    assert ran.status == 2
    assert "--json" in ran.err
    assert not (tmp_path / "-").exists()


class TestTerminal:
    """What a command prints beside its result."""

    def run(self, *warnings: tuple[str, str], **shared: int) -> Any:
        def command() -> None:
            def work() -> Result:
                for code, text in warnings:
                    warn(code, text)
                return Result("verb", "done")

            Running("verb", **shared)(work)  # type: ignore[arg-type]

        return CliRunner().invoke(click.Command("verb", callback=command))

    def test_a_warning_is_printed_once_and_wrapped(self) -> None:
        text = "a parameter was not found " * 8 + "in one_very_long_word" + "_" * 100
        ran = self.run(("SWM010", text), ("SWM011", "other"), ("SWM010", text))
        first, *rest = ran.stderr.splitlines()
        assert first.startswith("warning SWM010: a parameter")
        assert rest[-1] == "warning SWM011: other"
        assert all(line.startswith("    ") and line[4] != " " for line in rest[:-1])
        assert [line for line in (first, *rest) if len(line) > 100] == [rest[-2]]
        assert rest[-2].strip() == "one_very_long_word" + "_" * 100

    @pytest.mark.parametrize("count, shown", [(5, 5), (6, 3)])
    def test_many_warnings_of_one_code_are_counted(self, count: int, shown: int) -> None:
        ran = self.run(*(("SWM012", f"parameter {k}") for k in range(count)), ("SWM013", "white"))
        lines = ran.stderr.splitlines()
        assert lines[:shown] == [f"warning SWM012: parameter {k}" for k in range(shown)]
        rest = ["warning SWM012: 3 more like these; -v prints them"] if shown < count else []
        assert lines[shown:] == [*rest, "warning SWM013: white"]

    def test_verbose_prints_every_warning(self) -> None:
        ran = self.run(*(("SWM012", f"parameter {k}") for k in range(9)), verbose=1)
        assert len(ran.stderr.splitlines()) == 9

    def test_json_holds_every_warning(self) -> None:
        ran = self.run(*(("SWM012", f"parameter {k}") for k in range(9)), as_json=True)
        assert len(json.loads(ran.stdout)["warnings"]) == 9

    def test_the_next_command_can_be_typed(self, swimid: Run, samples: Path, tmp_path: Path) -> None:
        trials, out = samples / "rig" / "trials.yaml", tmp_path / "my drag.yaml"
        lines = swimid("fit-drag", trials, "-o", out).stderr.splitlines()
        assert lines[-3:-1] == [f"wrote {out}", f"wrote {tmp_path / 'my drag.evidence.json'}"]
        words = shlex.split(lines[-1].removeprefix("next: "))
        assert words[:2] == ["swimid", "compare"]
        assert str(out) in words
        assert swimid(*words[1:-2], "-o", tmp_path / "comparison.yaml").status == 0
        drop = ("simulate", "--params", out, "--pulling-mass-kg", "0.02", "-o", tmp_path / "drop.csv")
        assert f"next: swimid plot {tmp_path / 'drop.csv'} -o log.svg" in swimid(*drop).stderr
        for quiet in (["-q"], ["--json"], []):
            words = [*quiet, "-o", str(out)] if quiet else []
            assert "next:" not in swimid("fit-drag", trials, *words).stderr


class TestInterrupts:
    """Ctrl-C ends a verb with status 130 and one line that says what was written."""

    def verb(self, work: Callable[[], None], outputs: list[Path], output: Path | None = None) -> Any:
        def command() -> None:
            def result() -> Result:
                work()
                return Result("verb", "done", {}, outputs)

            Running("verb", output)(result)

        return CliRunner().invoke(click.Command("verb", callback=command))

    def test_nothing_was_written(self, tmp_path: Path) -> None:
        ran = self.verb(lambda: signal.raise_signal(signal.SIGINT), [], tmp_path / "out.yaml")
        assert ran.exit_code == 130
        assert ran.stderr == "Error: interrupted; nothing was written\n"
        assert ran.stdout == ""

    def test_what_is_kept_is_named(self, tmp_path: Path) -> None:
        keep = Checkpoint.of_output(tmp_path / "out.yaml", "it")

        def work() -> None:
            keep.put("one", np.ones(1))
            raise KeyboardInterrupt

        ran = self.verb(work, [], tmp_path / "out.yaml")
        assert ran.exit_code == 130
        assert "out.yaml.partial keeps the computed part: the same command continues from there" in ran.stderr

    def test_a_search_that_goes_on_with_what_it_has_is_told(self, tmp_path: Path) -> None:
        def work() -> None:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

        ran = self.verb(work, [tmp_path / "out.yaml"])
        assert ran.exit_code == 130
        assert f"the result so far is written: {tmp_path / 'out.yaml'}" in ran.stderr
        assert ran.stdout == ""


class TestFolders:
    """A folder in place of a file is one clear message for every command."""

    @pytest.mark.parametrize(
        "words",
        [
            "fit-drag F", "fit-graybox F", "fit-propulsion F", "diagnose F", "sensitivity F",
            "plot F -o x.svg", "compare F --params F", "rwls F --input a --output b", "import F -o x.csv",
            "batch F -o run", "import log.csv --map F -o x.csv", "track imu F -o x.csv",
            "track video log.csv --setup F -o x.csv", "export F --to json",
            "simulate --params F", "simulate --robot F",
            "map --params F --over frequency_hz=1:2:3", "import F.parquet -o x.csv",
            "plot F.parquet -o x.svg", "import F.mat -o x.csv", "import F.h5 -o x.csv",
            "import F.xlsx -o x.csv", "import F.tdms -o x.csv",
        ],
    )  # fmt: skip
    def test_is_named(self, swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str) -> None:
        monkeypatch.chdir(tmp_path)
        for ending in ("", ".parquet", ".mat", ".h5", ".xlsx", ".tdms"):
            Path(f"F{ending}").mkdir()
            Path(f"F{ending}", "inside.yaml").touch()
        Path("log.csv").write_text("t_s,x_m\n0,0\n1,1\n")
        ran = swimid(*words.split())
        assert ran.status == 3
        assert re.search(r"F(\.\w+)?: is a folder; a file is needed here", ran.err), ran.err
        assert "name one of its files: inside.yaml" in ran.err


@pytest.mark.parametrize(
    "line, value",
    [
        ("{id: a, log: w10.csv, pulling_mass_kg: 0,010}", "0.010"),
        ("{pulling_mass_kg: 1,5e-2, id: a, log: w10.csv}", "1.5e-2"),
        ("{id: a, log: w10.csv, start_s: -0,5, pulling_mass_kg: 0.01}", "-0.5"),
    ],
)
def test_a_decimal_comma_in_a_flow_mapping_is_named(
    swimid: Run, tmp_path: Path, line: str, value: str
) -> None:
    path = tmp_path / "trials.yaml"
    path.write_text(
        f"format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\ntrials:\n  - {line}\n"
    )
    ran = swimid("fit-drag", path)
    assert ran.status == 3
    typed = value.replace(".", ",")
    assert f"trials.yaml, line 5: '{typed}' is read as two values; write {value}" in ran.err


def test_a_decimal_comma_elsewhere_is_named_too(swimid: Run, tmp_path: Path) -> None:
    path = tmp_path / "trials.yaml"
    head = "format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\ntrials:\n"
    path.write_text(f"{head}  - log: w10.csv\n    pulling_mass_kg: 0,010\n")
    assert "write the decimal point as a dot: 0.010" in swimid("fit-drag", path).err
    log = tmp_path / "run.csv"
    log.write_text("# drive: {frequency_hz: 1,5, amplitude_deg: 20}\nt_s,x_m\n0,0\n1,1\n")
    assert "'1,5' is read as two values; write 1.5" in swimid("plot", log, "-o", tmp_path / "x.svg").err
    robot = tmp_path / "robot.yaml"
    robot.write_text("format: swimid-robot/1\nname: a\nbody: {inertial_mass_kg: 1,2}\n")
    ran = swimid("simulate", "--robot", robot, "--frequency-hz", "1", "--amplitude-deg", "2")
    assert "robot.yaml, line 3: '1,2' is read as two values; write 1.2" in ran.err
