"""No command loses work: inputs, files of others, results of other runs, and what a stopped run computed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import swimid as package
from swimid.errors import InputError, UsageError
from swimid.files import atomic, provenance
from swimid.files.atomic import Checkpoint, checkpoint_path, file_names
from swimid.files.video import open_writer
from swimid.notices import SwimidWarning, record_warnings
from tests.conftest import SAMPLES, Ran

Run = Callable[..., Ran]

PARAMETERS = """format: swimid-parameters/1
model: falling-weight
robot: boxfish
parameters:
  drag_coefficient: {value: 0.7, stderr: 0.01, unit: '1', bounds: [0.0, 5.0], status: estimated}
  added_mass: {value: 0.7, stderr: 0.02, unit: kg, bounds: [0.0, null], status: estimated}
  pulley_friction: {value: 0.03, stderr: 0.001, unit: N, bounds: [0.0, null], status: estimated}
"""
#: Parameters of a robot with links.
LINKS = SAMPLES / "gap" / "params.yaml"


def drops(folder: Path, *ids: str, header: str = "# made_by: encoder box for swimid\n") -> Path:
    """Write one measured drop for each id and the parameters of the rig; returns the trials file."""
    folder.mkdir(exist_ok=True)
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: boxfish", "trials:"]
    for number, name in enumerate(ids):
        t = np.arange(0.0, 4.0, 0.1)
        rows = "".join(f"{a:.2f},{(0.05 + 0.01 * number) * a * a:.5f}\n" for a in t)
        log = f"{number}.csv" if "/" in name else f"{name}.csv"
        (folder / log).write_text(f"{header}t_s,x_m\n{rows}")
        lines.append(f"  - {{id: {name}, log: '{log}', pulling_mass_kg: 0.0{number + 1}}}")
    (folder / "params.yaml").write_text(PARAMETERS)
    (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
    return folder / "trials.yaml"


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder with its content, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def piece(path: Path, number: int) -> dict[str, Any]:
    """One line of a checkpoint."""
    return json.loads(path.read_text().splitlines()[number])


class TestCheckpoints:
    """Two runs on one output, and files that are damaged."""

    def test_a_file_of_another_program_is_left_as_it_is(self, tmp_path: Path) -> None:
        out = tmp_path / "map.yaml"
        checkpoint_path(out).write_text("half of my download\n")
        with pytest.raises(UsageError, match="is not a checkpoint"):
            Checkpoint.of_output(out, "it")
        assert contents(tmp_path) == {"map.yaml.partial": b"half of my download\n"}

    def test_runs_with_other_options_do_not_mix(self, tmp_path: Path) -> None:
        out = tmp_path / "map.yaml"
        first = Checkpoint.of_output(out, {"amplitude_deg": 27})
        first.put("points 0", np.array([1.0]))
        second = Checkpoint.of_output(out, {"amplitude_deg": 10})
        first.put("points 1", np.array([2.0]))
        with record_warnings() as notices:
            again = Checkpoint.of_output(out, {"amplitude_deg": 10})
        assert second.get("points 0") is None
        assert again.get("points 0") is None
        assert again.get("points 1") is None
        assert [n.code for n in notices] == ["SWM150"]
        assert "2 of 2 lines were ignored: 2 of runs with other inputs or options" in notices[0].text
        again.put("points 0", np.array([3.0]))
        again.finish()
        # what the first run computed outlives the second one
        kept = Checkpoint.of_output(out, {"amplitude_deg": 27})
        assert kept.get("points 0") == 1.0
        assert kept.get("points 1") == 2.0
        del first, second
        kept.finish()
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "damage",
        {
            "the end is missing": lambda raw: raw[:-9],
            "no line feed at the end": lambda raw: raw[:-1],
            "no text": lambda raw: raw.replace(b'"values": [2.5', b'"values": [\xff\x00'),
            "a line of another program": lambda raw: raw + b"5\n[1]\n{}\nhello\n",
            "zeros after a crash": lambda raw: raw + bytes(300),
        }.items(),
        ids=lambda item: item[0],
    )
    def test_damaged_lines_are_computed_again(self, tmp_path: Path, damage: Any) -> None:
        out = tmp_path / "map.yaml"
        keep = Checkpoint.of_output(out, "it")
        keep.put("one", np.array([1.5, np.nan]))
        keep.put("two", np.array([2.5, np.inf]))
        checkpoint_path(out).write_bytes(damage[1](checkpoint_path(out).read_bytes()))
        with record_warnings() as notices:
            again = Checkpoint.of_output(out, "it")
        assert all(n.code == "SWM150" and "damaged" in n.text for n in notices)
        np.testing.assert_array_equal(again.get("one"), [1.5, np.nan])
        found = again.get_or_compute("two", lambda: np.array([2.5, np.inf]))
        np.testing.assert_array_equal(found, [2.5, np.inf])
        third = Checkpoint.of_output(out, "it")
        np.testing.assert_array_equal(third.get("two"), [2.5, np.inf])
        third.finish()
        assert not checkpoint_path(out).exists()

    def test_a_line_is_not_taken_for_another_piece(self, tmp_path: Path) -> None:
        out = tmp_path / "map.yaml"
        keep = Checkpoint.of_output(out, "it")
        keep.put("points 1", np.array([1.0]))
        checkpoint_path(out).write_text(checkpoint_path(out).read_text().replace("points 1", "points 2"))
        assert {"key", "name", "values"} == set(piece(checkpoint_path(out), 0))
        with pytest.warns(SwimidWarning, match="SWM150"):
            assert Checkpoint.of_output(out, "it").get("points 2") is None

    def test_a_folder_in_its_place_is_said(self, tmp_path: Path) -> None:
        checkpoint_path(tmp_path / "map.yaml").mkdir()
        with pytest.raises(UsageError, match="is a folder"):
            Checkpoint.of_output(tmp_path / "map.yaml", "it")

    def test_a_full_disk_does_not_stop_the_run(self, tmp_path: Path) -> None:
        keep = Checkpoint.of_output(tmp_path / "map.yaml", "it")
        checkpoint_path(tmp_path / "map.yaml").unlink(missing_ok=True)
        checkpoint_path(tmp_path / "map.yaml").symlink_to("/dev/full")
        with pytest.warns(SwimidWarning, match="SWM151"):
            assert keep.get_or_compute("one", lambda: np.ones(1)) == 1.0

    def test_one_output_has_one_run(self, tmp_path: Path) -> None:
        """Another thread of one process stands for another process here."""
        keep = Checkpoint.of_output(tmp_path / "map.yaml", "it")
        refused: list[UsageError] = []

        def second() -> None:
            try:
                Checkpoint.of_output(tmp_path / "map.yaml", "another")
            except UsageError as error:
                refused.append(error)

        for expected in (1, 1):
            thread = threading.Thread(target=second)
            thread.start()
            thread.join()
            assert len(refused) == expected
            keep.finish()
        assert f"is being written by another run of swimid (process {os.getpid()} on " in str(refused[0])
        assert "map.yaml.lock" in str(refused[0])


HOLDER = """
import sys, time
from pathlib import Path
from swimid.files import atomic
atomic.lock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def test_a_command_on_a_locked_output_names_the_process(swimid: Run, tmp_path: Path) -> None:
    """The lock of a killed process does not hold anybody up."""
    trials = drops(tmp_path / "rig", "a", "b")
    out = tmp_path / "sim"
    command = ("simulate", "--params", tmp_path / "rig" / "params.yaml", "--trials", trials, "-o", out)
    with subprocess.Popen([sys.executable, "-c", HOLDER, out], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        ran = swimid(*command)
        assert ran.status == 2
        assert f"is being written by another run of swimid (process {holder.pid} on " in ran.err
        assert "wait for it" in ran.err
        assert not out.exists()
        holder.kill()
    assert swimid(*command).status == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig", "sim"]


class TestFilesOfOthers:
    """A file is replaced only where it has the mark in its place."""

    OTHERS = {
        "log.csv": "# recorded with swimid in mind\nt_s,swimid\n0,1\n1,2\n",
        "made.csv": "# made_by: the swimid team\nt_s,x_m\n0,1\n1,2\n",
        "late.csv": "t_s,x_m\n0,1\n# made_by: swimid simulate\n1,2\n",
        "notes.md": "# Notes\nswimid gave 0.7. Made by swimid, they say.\n",
        "mine.yaml": "format: swimid-parameters/1\nmodel: falling-weight\nparameters: {}\n",
        "trials.yaml": "format: swimid-trials/1\nexperiment: arma\nprovenance:\n  version: 0.1.0\n",
        "list.yaml": "- format: swimid-map/1\n- provenance\n",
        "setup.yaml": "format: swimid-setup/1\nmarkers: []\n",
        "page.html": "<!DOCTYPE html><html><head><title>swimid</title></head>"
        '<body><meta name="generator" content="swimid 1"></body></html>',
        "data.json": '{"note": "swimid-evidence/1", "format": "mine"}',
        "trials.json": '{"format": "swimid-trials/1"}',
        "robot.xml": '<?xml version="1.0"?>\n<!-- based on swimid -->\n<mujoco model="swimid"/>\n',
        "fig.svg": '<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg"><title>swimid</title></svg>',
        "rule.h": "/* for swimid */\n#include <swimid.h>\n",
        "binary.bin": "\x00swimid\x01",
    }

    @pytest.mark.parametrize("name", OTHERS)
    def test_the_word_alone_is_no_mark(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / name
        path.write_text(self.OTHERS[name])
        assert not provenance.is_own(path)

    def test_pictures_and_tables_of_others(self, tmp_path: Path) -> None:
        Image.new("RGB", (8, 8)).save(tmp_path / "swimid.png")
        Image.new("RGB", (8, 8)).save(tmp_path / "swimid.gif", comment=b"swimid")
        table = pa.table({"t_s": [0.0, 1.0], "swimid": [1.0, 2.0]})
        pq.write_table(table.replace_schema_metadata({b"swimid": b"robot: boxfish"}), tmp_path / "a.parquet")
        (tmp_path / "b.parquet").write_bytes(b"PAR1 swimid")
        (tmp_path / "a.mp4").write_bytes(b"\x00\x00\x00\x18ftypisom made by swimid, and more")
        assert [p.name for p in tmp_path.iterdir() if provenance.is_own(p)] == []

    def test_what_swimid_writes_has_the_mark(self, swimid: Run, tmp_path: Path, samples: Path) -> None:
        trials, params = drops(tmp_path / "rig", "a"), tmp_path / "rig" / "params.yaml"
        out = tmp_path / "out"
        out.mkdir()
        (out / "track.csv").write_text("# made_by: swimid track video\nt_s,x_m,y_m\n0,0,0\n1,1,0\n")
        for words in (
            ("compare", trials, "--params", params, "-o", out / "c.yaml"),
            ("simulate", "--params", params, "--trials", trials, "--trial", "a", "-o", out / "a.csv"),
            ("simulate", "--params", params, "--trials", trials, "--trial", "a", "-o", out / "a.parquet"),
            ("import", samples / "rig" / "w10.csv", "-o", out / "w.csv"),
            ("plot", out / "a.csv", "-o", out / "a.svg"),
            ("plot", out / "a.csv", "-o", out / "a.png"),
            ("report", out / "c.yaml", "-o", out / "c.html"),
            ("report", out / "c.yaml", "-o", out / "c.md"),
            ("export", LINKS, "--to", "gazebo", "-o", out / "p.sdf"),
            ("export", LINKS, "--to", "json", "-o", out / "p.json"),
            ("schema", "map", "-o", out / "s.json"),
            ("doctor", "-o", out / "d.json"),
        ):
            ran = swimid(*words)
            assert ran.status == 0, ran.err
        for ending in (".mp4", ".gif"):
            writer = open_writer(out / f"film{ending}", 25.0, 64, 64)
            for k in range(5):
                writer.write(0.04 * k, np.full((64, 64, 3), 20 * k, dtype=np.uint8))
            writer.close()
        assert [p.name for p in sorted(out.iterdir()) if not provenance.is_own(p)] == []
        assert len(list(out.iterdir())) == 17

    def test_a_draft_is_not_replaced(self, swimid: Run, tmp_path: Path, samples: Path) -> None:
        draft = tmp_path / "map.yaml"
        command = ("import", samples / "rig" / "w10.csv", "--guess", "-o", draft)
        assert swimid(*command).status == 0
        assert swimid(*command).status == 2
        assert swimid(*command, "--force").status == 0

    def test_files_beside_the_output_are_those_of_others_too(self, swimid: Run, tmp_path: Path) -> None:
        trials, params = drops(tmp_path / "rig", "a"), tmp_path / "rig" / "params.yaml"
        notes = tmp_path / "c.evidence.json"
        notes.write_text('{"notes": "why swimid is right"}')
        ran = swimid("compare", trials, "--params", params, "-o", tmp_path / "c.yaml")
        assert ran.status == 2
        assert "c.evidence.json exists and was not written by swimid" in ran.err
        assert not (tmp_path / "c.yaml").exists()


class TestInputs:
    """No command writes over what it reads."""

    def test_a_simulation_keeps_measured_logs(self, swimid: Run, tmp_path: Path) -> None:
        """Also logs that swimid itself has made, and also with --force."""
        for header in ("# made_by: swimid track video\n", "# imported_by: swimid import\n", "# plain\n"):
            trials = drops(tmp_path / "rig", "a", "b", header=header)
            before = contents(tmp_path)
            for more in ((), ("--force",)):
                params = tmp_path / "rig" / "params.yaml"
                ran = swimid(
                    "simulate", "--params", params, "--trials", trials, "-o", tmp_path / "rig", *more
                )
                assert ran.status == 2
                assert "a.csv is also an input" in ran.err
            ran = swimid(
                "simulate", "--params", params, "--trials", trials, "--trial", "a",
                "-o", tmp_path / "rig" / "b.csv", "--force",
            )  # fmt: skip
            assert ran.status == 2, ran.err
            assert contents(tmp_path) == before

    def test_a_simulation_keeps_other_logs_of_the_folder(self, swimid: Run, tmp_path: Path) -> None:
        trials = drops(tmp_path / "rig", "a", "b")
        out = tmp_path / "out"
        out.mkdir()
        (out / "b.csv").write_text("# a log that swimid shall read\nt_s,x_m\n0,0\n1,1\n")
        before = contents(tmp_path)
        ran = swimid("simulate", "--params", tmp_path / "rig" / "params.yaml", "--trials", trials, "-o", out)
        assert ran.status == 2
        assert "b.csv exists and was not written by swimid" in ran.err
        assert contents(tmp_path) == before

    @pytest.mark.parametrize("target", ["a.csv", "trials.yaml", "params.yaml"])
    @pytest.mark.parametrize(
        "words",
        [
            ("fit-drag", "trials.yaml"),
            ("compare", "trials.yaml", "--params", "params.yaml"),
            ("diagnose", "trials.yaml", "--params", "params.yaml"),
            ("simulate", "--params", "params.yaml", "--trials", "trials.yaml", "--trial", "b"),
            ("rwls", "a.csv", "--input", "t_s", "--output", "x_m", "--na", "1", "--nb", "1"),
            ("import", "a.csv"),
            ("plot", "a.csv"),
            ("report", "a.csv", "--format", "md"),
            ("export", "params.yaml", "--to", "json"),
        ],
        ids=lambda words: words[0],
    )
    def test_no_input_is_replaced(
        self, swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: Any, target: str
    ) -> None:
        drops(tmp_path, "a", "b", header="# made_by: swimid simulate\n")
        monkeypatch.chdir(tmp_path)
        if words[0] == "export":
            shutil.copy(LINKS, "params.yaml")
        before = contents(tmp_path)
        ran = swimid(*words, "-o", target)
        if target in before and any(target in str(word) for word in words):
            assert ran.status == 2, ran.err
        if ran.status == 2:
            assert contents(tmp_path) == before
        else:  # a log made by swimid that this command does not read
            assert target == "a.csv"
            assert words[0] in ("export",)

    def test_saving_from_python_keeps_them_too(self, tmp_path: Path) -> None:
        trials, params = drops(tmp_path / "rig", "a", "b"), tmp_path / "rig" / "params.yaml"
        before = contents(tmp_path)
        with pytest.raises(UsageError, match="is also an input"):
            package.simulate(params=params, trials=trials).save(tmp_path / "rig")
        with pytest.raises(UsageError, match="is also an input"):
            package.compare(trials, params=params).save(tmp_path / "rig" / "a.csv")
        assert contents(tmp_path) == before

    def test_a_report_keeps_the_evidence_it_is_made_of(self, swimid: Run, tmp_path: Path) -> None:
        trials, params = drops(tmp_path, "a"), tmp_path / "params.yaml"
        assert swimid("compare", trials, "--params", params, "-o", tmp_path / "c.yaml").status == 0
        before = contents(tmp_path)
        ran = swimid("report", tmp_path / "c.yaml", "-o", tmp_path / "c.evidence.json")
        assert ran.status == 2
        assert contents(tmp_path) == before

    def test_a_link_stays_a_link(self, tmp_path: Path) -> None:
        (tmp_path / "far").mkdir()
        link = tmp_path / "out.txt"
        link.symlink_to(tmp_path / "far" / "real.txt")
        atomic.write_text(link, "one")
        assert link.is_symlink()
        assert (tmp_path / "far" / "real.txt").read_text() == "one"

    def test_two_outputs_are_two_files(self, swimid: Run, tmp_path: Path) -> None:
        out = tmp_path / "run.gif"
        ran = swimid(
            "simulate", "--robot", "dolphin", "--frequency-hz", "2", "--amplitude-deg", "20", "-o", out,
            "--animate", out,
        )  # fmt: skip
        assert ran.status == 2
        assert "two outputs would be written to" in ran.err


class TestNames:
    """Ids become file names without loss."""

    @pytest.mark.parametrize(
        "ids", [("run/1", "run_1"), ("A", "a"), ("run 1", "run:1"), ("w1.csv", "w1"), ("é", "e\u0301")]
    )
    def test_ids_with_one_file_name_are_both_named(self, swimid: Run, tmp_path: Path, ids: Any) -> None:
        with pytest.raises(UsageError) as raised:
            file_names(ids, [".csv"])
        assert all(f"'{name}'" in str(raised.value) for name in ids)

    def test_a_simulation_says_so_before_it_writes(self, swimid: Run, tmp_path: Path) -> None:
        trials = drops(tmp_path / "rig", "run/1", "run_1")
        ran = swimid(
            "simulate", "--params", tmp_path / "rig" / "params.yaml", "--trials", trials,
            "-o", tmp_path / "sim",
        )  # fmt: skip
        assert ran.status == 2
        assert "'run/1' and 'run_1' would both be written to the file run_1.csv" in ran.err
        assert not (tmp_path / "sim").exists()

    def test_names_are_no_devices_and_leave_no_folder(self) -> None:
        assert file_names(["../up", "a"], [".csv"]) == [".._up.csv", "a.csv"]


BEAT = ("--frequency-hz", "1", "--amplitude-deg", "20", "--duration-s", "60")
POOL = SAMPLES / "pool"
#: The command line with bars that say on stdout when they are opened and advance slowly.
TELLING = """
import time
from contextlib import contextmanager
from swimid.cli.main import Run

@contextmanager
def progress(description, total=None):
    print(description, flush=True)
    yield lambda amount=1: time.sleep(0.02)

Run.progress = property(lambda self: progress)
from swimid.cli.main import entry
entry()
"""


class TestTogether:
    """Files that belong together appear together."""

    @staticmethod
    def write(folder: Path, *names: str, last: Callable[[], object] = lambda: None) -> None:
        """Write a group of files, and do something before it ends."""
        with atomic.write_together():
            for name in names:
                atomic.make_folder((folder / name).parent)
                atomic.write_text(folder / name, "new")
            last()

    @staticmethod
    def press() -> None:
        raise KeyboardInterrupt

    @pytest.mark.parametrize("names", [(), ("a",), ("a", "made/b")])
    def test_all_or_none(self, tmp_path: Path, names: tuple[str, ...]) -> None:
        (tmp_path / "a").write_text("old")
        with atomic.record_writes() as written:
            with pytest.raises(KeyboardInterrupt):
                self.write(tmp_path, *names, last=self.press)
            assert written == []
            assert contents(tmp_path) == {"a": b"old"}
            assert not (tmp_path / "made").exists()
            self.write(tmp_path, *names, last=lambda: written.append(tmp_path / "last"))
        assert written == [tmp_path / name for name in ("last", *names)]
        assert dict.fromkeys(names, b"new").items() <= contents(tmp_path).items()

    def test_a_file_that_cannot_be_renamed_undoes_the_others(self, tmp_path: Path) -> None:
        (tmp_path / "a").write_text("old")
        with pytest.raises(InputError, match="cannot be written"):
            self.write(tmp_path, "a", "b", "c", last=(tmp_path / "c").mkdir)
        assert contents(tmp_path) == {"a": b"old"}

    def test_ctrl_c_during_the_renaming_waits(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        rename = Path.replace

        def disturbed(self: Path, target: Path) -> Path:
            signal.raise_signal(signal.SIGINT)
            return rename(self, target)

        monkeypatch.setattr(Path, "replace", disturbed)
        with atomic.record_writes() as written:
            with pytest.raises(KeyboardInterrupt):
                self.write(tmp_path, "a", "b")
            assert written == [tmp_path / "a", tmp_path / "b"]
        assert contents(tmp_path) == {"a": b"new", "b": b"new"}

    @pytest.mark.parametrize("stage", range(1, 8))
    def test_an_interrupted_simulation_leaves_all_or_nothing(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: int
    ) -> None:
        """Logs of a folder and the film of a run; Ctrl-C at the n-th step of any bar."""
        left = stage

        @contextmanager
        def stopping(description: str, total: int | None = None) -> Iterator[Callable[..., None]]:
            def step(amount: int = 1) -> None:
                nonlocal left
                left -= 1
                if left == 0:
                    raise KeyboardInterrupt

            yield step

        with pytest.raises(KeyboardInterrupt):
            package.simulate(
                robot="tfish", frequency_hz=1.0, amplitude_deg=20.0, duration_s=1.0, sample_rate_hz=20,
                output=tmp_path / "run.csv", animate=tmp_path / "run.gif", progress=stopping,
            )  # fmt: skip
        assert contents(tmp_path) == {}

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("words", "stage"),
        [
            (("simulate", "--robot", "tfish", *BEAT, "-o", "run.csv", "--animate", "run.mp4"), "simulating"),
            (("simulate", "--robot", "tfish", *BEAT, "-o", "run.csv", "--animate", "run.mp4"), "animation"),
            (("track", "video", POOL / "pool.mp4", "--setup", POOL / "pool_setup.yaml", "-o", "run.csv",
              "--overlay", "run.mp4"), "overlay"),
        ],
        ids=["simulating", "animation", "overlay"],
    )  # fmt: skip
    def test_the_message_after_a_real_ctrl_c_is_true(self, tmp_path: Path, words: Any, stage: str) -> None:
        with subprocess.Popen(
            [sys.executable, "-c", TELLING, *words],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith(stage):
                    process.send_signal(signal.SIGINT)
                    break
            _, err = process.communicate(timeout=120)
        assert process.returncode == 130, err
        # warnings that were raised before are printed as well
        assert err.endswith("Error: interrupted; nothing was written\n")
        assert err.count("Error") == 1
        assert contents(tmp_path) == {}

    def test_a_full_disk_leaves_the_old_files(self, swimid: Run, tmp_path: Path) -> None:
        """A limit on the size of files stands for the disk."""
        resource = pytest.importorskip("resource")
        trials, out = drops(tmp_path / "rig", "a", "b"), tmp_path / "sim"
        out.mkdir()
        for name in ("a.csv", "b.csv"):
            (out / name).write_text("# made_by: swimid simulate\nt_s,x_m\n0,0\n1,1\n")
        before = contents(tmp_path)
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        try:
            params = tmp_path / "rig" / "params.yaml"
            ran = swimid("simulate", "--params", params, "--trials", trials, "-o", out)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert ran.status == 3, ran.err
        assert "cannot be written: File too large" in ran.err
        assert contents(tmp_path) == before


class TestEvidence:
    """Evidence stays with its result."""

    def test_of_another_result_is_not_replaced(self, swimid: Run, tmp_path: Path) -> None:
        trials, params = drops(tmp_path / "rig", "a"), tmp_path / "rig" / "params.yaml"
        assert swimid("import", tmp_path / "rig" / "a.csv", "-o", tmp_path / "run.csv").status == 0
        before = contents(tmp_path)
        command = ("compare", trials, "--params", params, "-o", tmp_path / "run.yaml")
        ran = swimid(*command)
        assert ran.status == 2
        assert "run.yaml and run.csv would both have the evidence file" in ran.err
        assert contents(tmp_path) == before
        (tmp_path / "run.csv").unlink()
        assert swimid(*command).status == 0

    def test_of_a_replaced_log_goes_with_it(self, swimid: Run, tmp_path: Path) -> None:
        trials, params = drops(tmp_path / "rig", "a"), tmp_path / "rig" / "params.yaml"
        out = tmp_path / "run.csv"
        assert swimid("import", tmp_path / "rig" / "a.csv", "-o", out).status == 0
        ran = swimid("simulate", "--params", params, "--trials", trials, "--trial", "a", "-o", out)
        assert ran.status == 0, ran.err
        assert not (tmp_path / "run.evidence.json").exists()
        # evidence of a result that has another name stays
        assert swimid("compare", trials, "--params", params, "-o", tmp_path / "c.yaml").status == 0
        assert swimid("simulate", "--params", params, "--trials", trials, "--trial", "a",
                      "-o", tmp_path / "c.csv").status == 0  # fmt: skip
        assert (tmp_path / "c.evidence.json").exists()


@pytest.mark.parametrize("words", [
    ("compare", "trials.yaml", "--params", "params.yaml"),
    ("plot", "a.csv"),
    ("export", "params.yaml", "--to", "json"),
])  # fmt: skip
def test_outputs_that_cannot_be_are_refused_before_the_work(
    swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    drops(tmp_path, "a")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "folder.png").mkdir()
    if words[0] == "export":
        shutil.copy(LINKS, "params.yaml")
    before = contents(tmp_path)
    ending = "png" if words[0] == "plot" else "csv"
    assert swimid(*words, "-o", f"folder.{ending}").status == 2
    assert swimid(*words, "-o", f"nowhere/out.{ending}").status == 3
    assert contents(tmp_path) == before
    assert pd.read_csv(tmp_path / "a.csv", comment="#").shape[1] == 2
    assert atomic.lock(tmp_path / "out.csv").release() is None


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="only Linux tells that a process has ended")
def test_the_lock_of_a_killed_process_that_nobody_waits_for_is_replaced(tmp_path: Path) -> None:
    output = tmp_path / "out.yaml"
    code = (
        "import time; from swimid.files import atomic; from pathlib import Path\n"
        f"with atomic.hold_lock(Path({str(output)!r})):\n"
        "    print('locked', flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    process.kill()
    deadline = 100
    while "Z" not in Path(f"/proc/{process.pid}/stat").read_text().split() and deadline:
        deadline -= 1
        time.sleep(0.05)
    with atomic.hold_lock(output):
        assert (tmp_path / "out.yaml.lock").exists()
    process.wait()
