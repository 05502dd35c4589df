"""``swimid sample fishsim``: recordings of others, from their repository to a model of their fish."""

from __future__ import annotations

import hashlib
import http.server
import shutil
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.files.download import RemoteFiles, fetch
from swimid.notices import SwimidWarning
from tests.conftest import SAMPLES, Ran, interrupting

CONTENT = {"data/one/a.csv": b"1,2\r\n", "data/b.csv": b"3,4\n", "notes.txt": b"notes\n"}
LOCAL = ["one/a.csv", "b.csv", "notes.txt"]
COMMIT = "0123456789abcdef" * 2 + "01234567"


def make_dataset(**changed: object) -> RemoteFiles:
    """Return a list of three small files."""
    entries = {
        "format": "swimid-download/1", "repository": "owner/name", "commit": COMMIT, "licence": "MIT",
        "licence_text": "Permission is granted.\n", "citation": "A. Nonymous, 2026", "about": "Numbers.",
        "root": "data", "files": {path: hashlib.sha256(data).hexdigest() for path, data in CONTENT.items()},
    }  # fmt: skip
    return RemoteFiles.model_validate(entries | changed)


def lay_out(folder: Path, *, below: str = "") -> Path:
    """Write the files below a folder, under their paths in the repository."""
    for path, data in CONTENT.items():
        file = folder / below / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return folder


@pytest.fixture
def serve() -> Iterator[Callable[[Path], str]]:
    """Return a function that serves a folder, and returns the address of the server."""
    servers = []

    class Silent(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *words: object) -> None:
            pass

        def do_GET(self) -> None:
            if "cut" not in self.path:
                return super().do_GET()
            # a connection that ends in the middle of a file
            self.send_response(200)
            self.send_header("Content-Length", "1000")
            self.end_headers()
            self.wfile.write(b"1,")
            return None

    def start(folder: Path) -> str:
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=str(folder)))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        servers.append(server)
        return f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize("below", ["", f"owner/name/{COMMIT}"])
@pytest.mark.parametrize("served", [False, True])
def test_files_licence_and_citation_are_written(
    below: str, served: bool, serve: Callable[[Path], str], tmp_path: Path
) -> None:
    there = lay_out(tmp_path / "there", below=below)
    address = str(there)
    if served:
        address = serve(there)
    written = fetch(make_dataset(), tmp_path / "here", address=address)
    assert written == [tmp_path / "here" / name for name in [*LOCAL, "LICENSE", "CITATION.md"]]
    assert [path.read_bytes() for path in written[:3]] == list(CONTENT.values())
    assert written[3].read_text() == "Permission is granted.\n"
    page = written[4].read_text()
    for text in ("A. Nonymous, 2026", COMMIT, "MIT", "Numbers.", "https://github.com/owner/name"):
        assert text in page


def test_files_may_lie_flat_in_a_folder(tmp_path: Path) -> None:
    for path, data in CONTENT.items():
        (tmp_path / Path(path).name).write_bytes(data)
    written = fetch(make_dataset(), tmp_path / "here", address=str(tmp_path))
    assert (tmp_path / "here/one/a.csv").read_bytes() == CONTENT["data/one/a.csv"]
    assert len(written) == 5


def test_the_variable_names_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SWIMID_DOWNLOADS", str(lay_out(tmp_path / "there")))
    assert len(fetch(make_dataset(), tmp_path / "here")) == 5


def test_a_folder_may_lack_files(tmp_path: Path) -> None:
    there = lay_out(tmp_path / "there")
    (there / "data/b.csv").unlink()
    with pytest.warns(SwimidWarning, match=r"SWM178 .*there has no b\.csv"):
        written = fetch(make_dataset(), tmp_path / "here", address=str(there))
    assert [path.name for path in written] == ["a.csv", "notes.txt", "LICENSE", "CITATION.md"]
    assert "b.csv" not in written[-1].read_text()


def test_a_folder_without_any_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none of the files one/a\.csv, b\.csv, notes\.txt"):
        fetch(make_dataset(), tmp_path / "here", address=str(tmp_path))
    with pytest.raises(InputError, match="is no folder"):
        fetch(make_dataset(), tmp_path / "here", address=str(tmp_path / "nowhere"))


@pytest.mark.parametrize("served", [False, True])
def test_a_changed_file_is_refused(served: bool, serve: Callable[[Path], str], tmp_path: Path) -> None:
    there = lay_out(tmp_path / "there")
    (there / "notes.txt").write_text("other notes\n")
    address = str(there)
    if served:
        address = serve(there)
    with pytest.raises(InputError) as refused:
        fetch(make_dataset(), tmp_path / "here", address=address)
    for content in (b"other notes\n", CONTENT["notes.txt"]):
        assert hashlib.sha256(content).hexdigest() in str(refused.value)
    assert refused.value.file.endswith("notes.txt")
    assert not (tmp_path / "here").exists()


def test_a_server_without_the_file_is_named(serve: Callable[[Path], str], tmp_path: Path) -> None:
    there = lay_out(tmp_path / "there")
    (there / "notes.txt").unlink()
    with pytest.raises(InputError, match=r"notes\.txt: cannot be downloaded: 404") as refused:
        fetch(make_dataset(), tmp_path / "here", address=serve(there))
    assert "--from FOLDER" in str(refused.value)
    assert not (tmp_path / "here").exists()


def test_a_broken_connection_leaves_nothing(serve: Callable[[Path], str], tmp_path: Path) -> None:
    dataset = make_dataset(files={"cut.csv": "0" * 64})
    with pytest.raises(InputError, match="cannot be downloaded"):
        fetch(dataset, tmp_path / "here", address=serve(tmp_path))
    assert not (tmp_path / "here").exists()


def test_without_a_network_the_error_says_what_to_do(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    ran = swimid("sample", "fishsim", tmp_path / "fish", "--from", "http://127.0.0.1:9")
    assert ran.status == 3
    assert "markers_f0_50.csv: cannot be downloaded" in ran.err
    assert "--from FOLDER" in ran.err
    assert "https://github.com/srl-ethz/fishsim" in ran.err
    assert not (tmp_path / "fish").exists()


def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    there = lay_out(tmp_path / "there")
    with pytest.raises(KeyboardInterrupt):
        fetch(make_dataset(), tmp_path / "here", address=str(there), progress=interrupting(2))
    assert not (tmp_path / "here").exists()


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"files": {"../a.csv": "0" * 64}}, "no path inside"),
        ({"files": {"/a.csv": "0" * 64}}, "no path inside"),
        ({"files": {"x/a.csv": "0" * 64, "y/a.csv": "1" * 64}}, "one local name"),
        ({"files": {"LICENSE": "0" * 64}}, "LICENSE"),
        ({"files": {"a.csv": "0" * 63}}, "pattern"),
        ({"commit": "main"}, "pattern"),
    ],
)
def test_a_wrong_list_is_refused(changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_dataset(**changed)


def test_every_listed_sample_is_valid() -> None:
    lists = list(SAMPLES.glob("*/download.yaml"))
    assert SAMPLES / "fishsim/download.yaml" in lists
    for path in lists:
        assert yamlio.read_document(path, RemoteFiles).files


def test_all_samples_need_no_network(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    assert swimid("sample", "all", "-o", tmp_path / "all").status == 0
    assert not (tmp_path / "all/fishsim").exists()
    refused = swimid("sample", "rig", tmp_path / "rig", "--from", tmp_path)
    assert refused.status == 2
    assert "the files of the sample 'rig' are installed" in refused.err


# ---------------------------------------------------------------- the fish


@pytest.fixture
def fish(real_data: Path, tmp_path: Path) -> Path:
    """The sample with the films that are there, and their logs."""
    there = real_data / "fishsim"
    if not list(there.glob("markers_*.csv")):
        pytest.skip(f"no films in {there}")
    folder = tmp_path / "fish"
    shutil.copytree(SAMPLES / "fishsim", folder)
    for path in there.glob("markers_*.csv"):
        shutil.copy(path, folder)
    return folder


def test_the_plan_finds_the_robot_beside_itself(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    folder = tmp_path / "fish"
    shutil.copytree(SAMPLES / "fishsim", folder)
    (folder / "markers_f1_00.csv").write_text("1,2\n")
    ran = swimid("batch", folder / "plan.yaml", "-o", tmp_path / "run", "--dry-run")
    assert ran.status == 0, ran.err
    assert "--robot ../../../fish/robot.yaml" in ran.out


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::swimid.notices.SwimidWarning")
def test_speeds_of_the_fish(fish: Path, swimid: Callable[..., Ran]) -> None:
    """The commands of docs/real-fish.md, on the films that are there."""
    assert swimid("batch", fish / "plan.yaml", "-o", fish / "run").status == 0
    fitted = swimid(
        "fit-graybox", fish / "trials.yaml", "--free", "camera_rotation", "-o", fish / "fish.yaml"
    )
    assert fitted.status == 0, fitted.err
    errors = {}
    for name in ("trials", "unseen"):
        logs = [
            fish / trial["log"] for trial in yaml.safe_load((fish / f"{name}.yaml").read_text())["trials"]
        ]
        if not all(path.is_file() for path in logs):
            continue
        compared = fish / f"{name}-compared.yaml"
        ran = swimid("compare", fish / f"{name}.yaml", "--params", fish / "fish.yaml", "-o", compared)
        assert ran.status == 0, ran.err
        speeds = [trial["mean_speed"] for trial in yaml.safe_load(compared.read_text())["trials"]]
        errors[name] = np.array([one["simulated"] - one["measured"] for one in speeds])
    # The page states the error of a film as ± 0.014 m/s with 95 % probability, from a standard deviation of
    # 0.005 m/s. The mean magnitude of four such errors is 0.004 ± 0.0015 m/s.
    for found in errors.values():
        assert np.max(np.abs(found)) < 0.014
        assert np.mean(np.abs(found)) < 0.007


@pytest.mark.slow
def test_merged_labels_are_named(fish: Path, tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    """Labels of the tail lie on one place in the whole film at 2.00 Hz: the import names their distances."""
    points = tmp_path / "points.yaml"
    stations = {"p3": 0.0, "p4": 0.030, "p5": 0.062, "p6": 0.092, "p7": 0.117}
    spec = yaml.safe_load((fish / "points.yaml").read_text())
    spec["points"] |= {name: {"link": "tail", "at_m": [-at, 0]} for name, at in stations.items()}
    points.write_text(yaml.safe_dump(spec))
    words = ["--map", fish / "map.yaml", "--robot", fish / "robot.yaml", "--points", points]
    film = fish / "markers_f2_00.csv"
    ran = swimid("import", film, *words, "--calibrate-points", "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0, ran.err
    short = {frozenset(one["names"]): one["measured"] for one in ran.json["result"]["points"]["distances"]}
    for pair in (("p4", "p5"), ("p5", "p6"), ("p6", "p7")):
        assert short[frozenset(pair)] < 0.01  # 25 mm or more on the robot
