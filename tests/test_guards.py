"""Guards at the edges: kernel cache, names of files, links, cells of tables, costs of large inputs."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError
from swimid.files import kernels
from swimid.logs import log, trials
from tests.conftest import Ran

posix = pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")


@posix
@pytest.mark.parametrize(
    ("mode", "words"), [(0o700, ""), (0o757, "other users"), (0o755, ""), (0o1777, "other users")]
)
def test_a_folder_of_kernels_that_others_write_is_not_used(mode: int, words: str, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    assert words in kernels.find_fault(folder)
    assert bool(words) == bool(kernels.find_fault(folder / "inner"))


@posix
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_folder_of_another_user_holds_no_kernels(tmp_path: Path) -> None:
    os.chown(tmp_path, 65534, 65534)
    assert kernels.find_fault(tmp_path) == "belongs to another user"


@posix
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize(("mode", "allowed"), [(0o750, True), (0o770, False), (0o1770, False)])
def test_a_group_of_several_users_writes_no_kernels(mode: int, allowed: bool, tmp_path: Path) -> None:
    os.chown(tmp_path, -1, 54321)  # a group that has no name, and not that of root
    tmp_path.chmod(mode)
    assert (kernels.find_fault(tmp_path) == "") == allowed
    assert ("users of its group" in kernels.find_fault(tmp_path)) != allowed


@posix
@pytest.mark.parametrize(("mode", "words"), [(0o777, "other users"), (0o1777, "")])
def test_a_folder_that_others_can_rename_holds_no_kernels(mode: int, words: str, tmp_path: Path) -> None:
    (tmp_path / "shared" / "mine").mkdir(parents=True, mode=0o700)
    (tmp_path / "shared").chmod(mode)
    assert words in kernels.find_fault(tmp_path / "shared" / "mine")
    assert bool(words) == bool(kernels.find_fault(tmp_path / "shared" / "mine"))


@posix
def test_an_unsafe_folder_is_replaced_by_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with pytest.warns(UserWarning, match="SWM152"):
        kernels.choose_cache()
    chosen = Path(os.environ["NUMBA_CACHE_DIR"])
    assert chosen != tmp_path
    assert not kernels.find_fault(chosen)


@pytest.mark.parametrize("length", [247, 251, 300])
def test_long_names_are_an_error_of_the_user(
    length: int, swimid: Callable[..., Ran], tmp_path: Path, samples: Path
) -> None:
    ran = swimid("plot", samples / "rig" / "w10.csv", "-o", tmp_path / f"{'x' * length}.svg")
    assert ran.status == 3, ran.err
    assert swimid("plot", tmp_path / f"{'x' * length}.csv", "-o", tmp_path / "a.svg").status == 3


@posix
def test_paths_that_are_not_utf8_are_refused(swimid: Callable[..., Ran], tmp_path: Path) -> None:
    ran = swimid("plot", os.fsdecode(b"\xff.csv"), "-o", tmp_path / "a.svg")
    assert ran.status == 2
    assert "not UTF-8" in ran.err


@pytest.mark.parametrize(
    "text",
    [
        "format: [1, 2]\n",
        "format: swimid-parameters/1\nmodel: m\nparameters: {}\n"
        "correlation: {names: [a, b], matrix: [[1, 1.0e+308], [1.0e+308, 1]]}\n"
        "fit: {trials: [], converged: true}\nprovenance: {}\n",
    ],
)
def test_odd_results_are_refused(text: str, swimid: Callable[..., Ran], tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text)
    ran = swimid("report", tmp_path / "a.yaml", "-o", tmp_path / "a.html")
    assert ran.status == 3, ran.err


@posix
def test_a_dangling_link_gets_its_target(swimid: Callable[..., Ran], tmp_path: Path, samples: Path) -> None:
    link = tmp_path / "link.svg"
    link.symlink_to(tmp_path / "target.svg")
    assert swimid("plot", samples / "rig" / "w10.csv", "-o", link).status == 0
    assert link.is_symlink()
    assert (tmp_path / "target.svg").is_file()


def test_text_in_a_table_is_no_formula(tmp_path: Path) -> None:
    cells = ["=1+1", "-x", "@x", "-0.5"]
    table = pd.DataFrame({"t_s": np.arange(4.0), "x_m": -np.arange(4.0), "note": cells, "=head": cells})
    log.write(tmp_path / "a.csv", dict(table))
    rows = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    assert rows[0] == ["t_s", "x_m", "note", "'=head"]
    assert [row[2] for row in rows[1:]] == ["'=1+1", "'-x", "'@x", "-0.5"]
    assert [float(row[1]) for row in rows[1:]] == [0.0, -1.0, -2.0, -3.0]


@pytest.mark.parametrize("first", ["root:x:0:0:root:/root:/bin/sh", "secret", "a,b;c=d"])
def test_a_foreign_file_is_not_quoted(first: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{first}\n1,2\n")
    with pytest.raises(InputError) as caught:
        log.read(path)
    assert first not in str(caught.value)


@pytest.mark.slow
def test_the_cost_of_many_trials_and_columns_is_linear(tmp_path: Path) -> None:
    rows = "".join(f"  - {{log: w{k}.csv, pulling_mass_kg: 0.04}}\n" for k in range(1000))
    head = "format: swimid-trials/1\nexperiment: falling-weight\nrobot: boxfish\ntrials:\n"
    (tmp_path / "trials.yaml").write_text(head + rows)
    for k in range(1000):
        (tmp_path / f"w{k}.csv").write_text(f"t_s,x_m\n0,0\n1,{k:04d}\n")
    (tmp_path / "wide.csv").write_text(
        f"t_s,{','.join(f'c{k}_m' for k in range(5000))}\n" + f"0{',1' * 5000}\n1{',2' * 5000}\n"
    )
    began = time.perf_counter()
    assert len(trials.read(tmp_path / "trials.yaml").trials) == 1000
    assert len(log.read(tmp_path / "wide.csv").columns) == 5001
    assert time.perf_counter() - began < 20.0


def test_every_module_takes_numba_with_its_cache_checked() -> None:
    package = Path(kernels.__file__).parents[1]
    direct = re.compile(r"^(import numba|from numba import)", re.M)
    modules = [path for path in package.rglob("*.py") if "__pycache__" not in path.parts]
    found = {path.name for path in modules if direct.search(path.read_text(encoding="utf-8"))}
    assert found == {"kernels.py", "lanes.py"}  # lanes.py imports types, and writes modules that import numba
