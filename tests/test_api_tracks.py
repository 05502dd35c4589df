"""The verbs that make logs, in memory: the same as on disk, and nothing written unless asked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError, UsageError
from swimid.files import provenance, yamlio
from swimid.imports import mapping
from swimid.imports.import_log import import_log
from swimid.imports.mapping import guess_mapping
from swimid.inertial.track_imu import track_imu
from swimid.kinematics.logged import Logged
from swimid.kinematics.plot import plot
from swimid.logs import log
from swimid.logs.log import Log
from swimid.results import evidence as ev
from swimid.tracking import setup as setup_format
from swimid.tracking.track_setup import track_setup
from swimid.tracking.track_video import Track, track_video
from tests.conftest import ROOT, Ran
from tests.generators import imu as imu_run
from tests.generators import pool_video

Run = Callable[..., Ran]
CAMERA = {
    "time": {"source": "Time (ms)", "unit": "ms"},
    "columns": [
        {"source": "X (mm)", "target": "x_m", "unit": "mm"},
        {"source": "Y (mm)", "target": "y_m", "unit": "mm"},
        {"source": "Heading (deg)", "target": "yaw_rad", "unit": "deg"},
    ],
}


@pytest.fixture(autouse=True)
def _nothing_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Each test runs in an empty folder, which stays so: what it does write goes to ``tmp_path``."""
    folder = tmp_path / "working folder"
    folder.mkdir()
    monkeypatch.chdir(folder)
    yield
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A film of three seconds with a dropout, and its setup."""
    scene = pool_video.Scene(duration_s=3.0, dropout_s=(1.5, 1.8), width=480, height=360)
    return pool_video.write_scene(tmp_path_factory.mktemp("film"), scene)[:2]


@pytest.fixture(scope="module")
def vehicle() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Readings of an inertial unit, and what a camera saw of the run."""
    rng = np.random.default_rng(2)
    run = imu_run.marching(rng, swim_s=8.0, rest_s=1.5)
    return pd.DataFrame(run.columns()), pd.DataFrame(imu_run.camera(run, rng, offset_s=0.037))


def proof(path: Path) -> dict[str, Any]:
    """Evidence as it lies on disk, without when and from where it was made; it has the name of its log."""
    read = json.loads(ev.sidecar(path).read_text())
    assert read["result"] == path.name
    return {k: v for k, v in read.items() if k not in ("provenance", "result", "sha256")}


def proved(made: Any) -> dict[str, Any]:
    """The same of evidence in memory."""
    return {
        k: v
        for k, v in made.evidence.model_dump(mode="json").items()
        if k not in ("provenance", "result", "sha256")
    }


def same(made: Logged, path: Path) -> None:
    """A log in memory holds what ``path`` does, and its evidence what lies beside that."""
    read = log.read(path)
    assert list(made.log.columns) == list(read.columns)
    for name, values in read.columns.items():
        np.testing.assert_array_equal(made.log[name], values, err_msg=name)
    assert log.metadata_of(yamlio.dumps_flat(made.log.metadata).splitlines(), path) == read.metadata
    assert proved(made) == proof(path)


def saved_alike(made: Logged, path: Path, folder: Path) -> None:
    """``save`` writes the files the command wrote, byte for byte but for the time and the command."""
    folder.mkdir()
    written = made.save(folder / path.name)
    assert [p.name for p in written.outputs] == [p.name for p in _beside(path)]
    for here, there in zip(written.outputs, _beside(path), strict=True):
        if here.name.endswith(".evidence.json"):
            assert proof(folder / path.name) == proof(path)
        else:
            assert here.read_bytes() == there.read_bytes(), here.name


def _beside(path: Path) -> list[Path]:
    files = [path, ev.sidecar(path), path.with_suffix(".png")]
    return [p for p in files if p.exists()]


# ---------------------------------------------------------------- films


@pytest.mark.slow
def test_a_film_in_memory_is_the_film_on_disk(film: tuple[Path, Path], swimid: Run, tmp_path: Path) -> None:
    video, setup = film
    path = tmp_path / "run.csv"
    ran = swimid("track", "video", video, "--setup", setup, "-o", path, "--json")
    assert [Path(p).name for p in ran.json["outputs"]] == ["run.csv", "run.evidence.json", "run.png"]
    made = track_video(video, setup=setup)
    assert made.outputs == ()
    assert made.data == ran.json["result"]
    same(made, path)
    words = pd.read_csv(path, comment="#")
    assert list(made.frame) == list(words)
    assert (made.frame["status"] == words["status"]).all()
    saved_alike(made, path, tmp_path / "saved")
    saved_alike(track_video(video, setup=setup_format.read(setup)), path, tmp_path / "from an object")


def test_a_setup_may_be_a_dictionary(film: tuple[Path, Path], tmp_path: Path) -> None:
    video, setup = film
    keys = yamlio.plain(yamlio.load(setup))
    del keys["format"]
    made, again = track_video(video, setup=keys), track_video(video, setup=setup)
    pd.testing.assert_frame_equal(made.frame, again.frame)
    assert made.evidence is not None
    assert again.evidence is not None
    settings = made.evidence.provenance["settings"]
    assert settings == again.evidence.provenance["settings"]
    assert settings["setup"] == setup_format.read(setup).model_dump(mode="json", exclude_none=True)
    inputs = made.evidence.provenance["inputs"]
    assert len(inputs) == 2
    assert inputs["setup"] == setup_format.read_setup(keys).digest()
    with pytest.raises(InputError, match="setup, 'markrs': unknown key"):
        track_video(video, setup=keys | {"markrs": []})


def test_an_overlay_is_written_without_a_log(film: tuple[Path, Path], tmp_path: Path) -> None:
    video, setup = film
    made = track_video(video, setup=setup, overlay_path=tmp_path / "overlay.mp4")
    assert [p.name for p in made.outputs] == ["overlay.mp4"]
    assert [p.name for p in tmp_path.glob("*.*")] == ["overlay.mp4"]


def test_a_saved_track_is_read_back(film: tuple[Path, Path], tmp_path: Path) -> None:
    made = track_video(film[0], setup=film[1]).save(tmp_path / "run.csv")
    read = Track.load(tmp_path / "run.csv")
    np.testing.assert_array_equal(read.log["x_m"], made.log["x_m"])
    assert read.evidence == made.evidence


@pytest.mark.slow
def test_a_drafted_setup_is_used_as_it_is(film: tuple[Path, Path], swimid: Run, tmp_path: Path) -> None:
    video, _ = film
    ran = swimid("track", "setup", video, "--metres-per-pixel", 0.004, "-o", tmp_path / "s.yaml", "--json")
    draft = track_setup(video, metres_per_pixel=0.004)
    assert draft.outputs == ()
    assert draft.data == ran.json["result"]
    assert draft.document == (tmp_path / "s.yaml").read_text()
    assert draft.setup == setup_format.read(tmp_path / "s.yaml")
    assert draft.sheet is not None
    assert draft.sheet.shape[2] == 3
    (tmp_path / "again").mkdir()
    draft.save(tmp_path / "again" / "s.yaml")
    for name in ("s.yaml", "s.markers.png"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / name).read_bytes()
    assert track_video(video, setup=draft.setup).data["found"] > 60


# ---------------------------------------------------------------- inertial recordings


@pytest.mark.slow
def test_motion_in_memory_is_the_motion_on_disk(
    vehicle: tuple[pd.DataFrame, pd.DataFrame], swimid: Run, tmp_path: Path
) -> None:
    readings, seen = vehicle
    readings.to_csv(tmp_path / "imu", index=False)
    seen.to_csv(tmp_path / "other", index=False)
    path = tmp_path / "run.csv"
    for more in ([], ["--with", tmp_path / "other"]):
        ran = swimid("track", "imu", tmp_path / "imu", *more, "-o", path, "--json")
        made = track_imu(readings, other=seen if more else None)
        assert made.outputs == ()
        assert made.data == ran.json["result"]
        same(made, path)
        saved_alike(made, path, tmp_path / f"saved {len(more)}")
        again = track_imu(tmp_path / "imu", other=Log.from_frame(seen, name="other") if more else None)
        pd.testing.assert_frame_equal(again.frame, made.frame)


def test_a_foreign_unit_through_a_mapping_in_memory(vehicle: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    readings, _ = vehicle
    foreign = readings.rename(columns={"t_s": "ms", "ax_m_s2": "ax"}).assign(ms=1e3 * readings.t_s)
    same_names = [n for n in readings if n not in ("t_s", "ax_m_s2")]
    rules = {
        "time": {"source": "ms", "unit": "ms"},
        "columns": [{"source": "ax", "target": "ax_m_s2"}] + [{"source": n, "target": n} for n in same_names],
        "metadata": {"frequency_hz": 1.0},
    }
    made = track_imu(foreign, map_path=rules, method="paper")
    plain = track_imu(readings, method="paper")
    np.testing.assert_allclose(made.log["x_m"], plain.log["x_m"], atol=1e-9)
    assert made.log.metadata["frequency_hz"] == 1.0
    assert made.evidence is not None
    inputs = made.evidence.provenance["inputs"]
    assert inputs == {
        "imu": log.unread(foreign, name="imu").digest(),  # type: ignore[union-attr]
        "mapping": mapping.read_mapping(rules).digest(),
    }
    short = {**rules, "columns": rules["columns"][1:]}  # type: ignore[index]
    with pytest.raises(InputError, match="mapping, 'ax_m_s2'"):
        track_imu(foreign, map_path=short)


def test_a_table_to_fuse_with_is_checked(vehicle: tuple[pd.DataFrame, pd.DataFrame]) -> None:
    readings, seen = vehicle
    with pytest.raises(InputError, match="row 5, 't_s': time goes back"):
        track_imu(readings, other=seen.assign(t_s=seen.t_s.where(seen.index != 5, -1.0)))
    with pytest.raises(InputError, match="imu, 'wz_rad_s'"):
        track_imu(readings.drop(columns="wz_rad_s"))


# ---------------------------------------------------------------- foreign logs


@pytest.fixture(scope="module")
def camera() -> pd.DataFrame:
    """The sample of a camera read faster than it takes pictures, as another program wrote it."""
    return pd.read_csv(ROOT / "sample_logs" / "camera" / "polled.csv", sep=";", comment="#")


@pytest.mark.slow
@pytest.mark.parametrize("asked", [{}, {"clean": False}], ids=["cleaned", "raw"])
def test_an_import_in_memory_is_the_import_on_disk(
    camera: pd.DataFrame, asked: dict[str, Any], swimid: Run, tmp_path: Path
) -> None:
    source = ROOT / "sample_logs" / "camera" / "polled.csv"
    rules = ROOT / "docs" / "examples" / "camera.yaml"
    path = tmp_path / "run.csv"
    options = ["--raw"] if asked else []
    ran = swimid("import", source, "--map", rules, *options, "-o", path, "--json")
    made = import_log(source, map_path=rules, **asked)
    assert made.outputs == ()
    assert made.data == ran.json["result"]
    saved_alike(made, path, tmp_path / "saved")
    here = tmp_path / "polled.csv"
    swimid("import", source, "--map", rules, *options, "-o", here)
    same(made, here)
    table = import_log(camera, map_path=yamlio.plain(yamlio.load(rules)), **asked)
    for name, values in made.log.columns.items():
        np.testing.assert_array_equal(table.log[name], values, err_msg=name)
    assert table.data | {"file": ""} == made.data | {"file": ""}


@pytest.mark.slow
def test_a_table_is_not_changed(camera: pd.DataFrame) -> None:
    before = camera.copy(deep=True)
    made = import_log(camera, map_path=CAMERA)
    pd.testing.assert_frame_equal(camera, before)
    again = Log.from_frame(made.frame)
    kept = {name: values.copy() for name, values in again.columns.items()}
    import_log(again, clean=True)
    for name, values in kept.items():
        np.testing.assert_array_equal(again[name], values)


def test_dates_words_and_whole_numbers_of_a_table() -> None:
    """Stamps keep every digit, words are told and left out, as of a file."""
    n = 50
    table = pd.DataFrame(
        {
            "when": pd.date_range("2024-05-01", periods=n, freq="20ms", tz="Europe/Berlin"),
            "ns": 1_700_000_000_000_000_000 + 20_000_000 * np.arange(n),
            "x": pd.array([None, *range(1, n)], dtype="Int64"),
            "state": ["ok"] * n,
        }
    )
    columns = [{"source": "x", "target": "x_m", "unit": "mm"}]
    for source, unit in (("when", "s"), ("ns", "ns")):
        rules = {"time": {"source": source, "unit": unit, "origin": "first"}, "columns": columns}
        made = import_log(table, map_path=rules)
        np.testing.assert_allclose(made.log.time_s, 0.02 * np.arange(n), atol=1e-12)
        assert np.isnan(made.log["x_m"][0])
        assert made.log["x_m"][3] == pytest.approx(0.003)
    with pytest.raises(InputError, match="log, 'state': holds text, not numbers"):
        import_log(table, map_path={**rules, "columns": [{"source": "state", "target": "x_m"}]})


@pytest.mark.slow
def test_a_drafted_mapping_is_used_as_it_is(camera: pd.DataFrame, swimid: Run, tmp_path: Path) -> None:
    yawing = camera.rename(columns={"Heading (deg)": "Yaw (deg)"})  # a heading may be that of a compass
    yawing.to_csv(tmp_path / "log", index=False)
    ran = swimid("import", tmp_path / "log", "--guess", "-o", tmp_path / "m.yaml")
    assert ran.status == 0
    draft = guess_mapping(tmp_path / "log")
    assert draft.outputs == ()
    draft.save(tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "m.yaml").read_bytes()
    table = guess_mapping(yawing)
    assert [c.target for c in table.mapping.columns] == [c.target for c in draft.mapping.columns]
    made = import_log(yawing, map_path=table.mapping)
    np.testing.assert_array_equal(made.log["x_m"], import_log(camera, map_path=CAMERA).log["x_m"])


# ---------------------------------------------------------------- figures


@pytest.mark.slow
def test_figures_are_written_on_request(
    vehicle: tuple[pd.DataFrame, pd.DataFrame], swimid: Run, tmp_path: Path
) -> None:
    _, seen = vehicle
    seen.to_csv(tmp_path / "log", index=False)
    there = tmp_path / "there.svg"
    ran = swimid("plot", tmp_path / "log", "-o", there, "--json")
    drawn = plot(seen)
    assert drawn.data["figures"] == ran.json["result"]["figures"] == drawn.figure_names
    assert drawn.summary() == plot(Log.from_frame(seen)).summary()
    assert drawn.plot("path") is not None
    assert len(drawn.figures()) == len(drawn.figure_names)
    drawn.save(tmp_path / "here.svg")
    assert [p.name for p in tmp_path.glob("here*")] == ["here.svg"]
    assert (tmp_path / "here.svg").read_bytes() == there.read_bytes()
    with pytest.raises(UsageError, match="a picture must end in"):
        drawn.save(tmp_path / "here.pdf")
    with pytest.raises(UsageError, match="name at least one log"):
        plot([])


# ---------------------------------------------------------------- tables


def test_a_table_is_checked_as_a_file_is() -> None:
    good = pd.DataFrame({"t_s": [0.0, 0.1, 0.2], "x_m": [0, 1, 2], "note": ["a", "b", "c"]})
    found = Log.from_frame(good, name="trial", metadata={"robot": "fish"})
    assert list(found.columns) == ["t_s", "x_m"]
    assert found.metadata == {"robot": "fish"}
    assert found["x_m"].dtype == float
    assert list(Log.from_frame(good.set_index("t_s")[["x_m"]]).columns) == ["t_s", "x_m"]
    for changed, message in (
        (good.assign(t_s=[0.0, 0.2, 0.1]), "trial, row 2, 't_s': time goes back: 0.1 after 0.2"),
        (good.assign(t_s=[0.0, 0.1, 0.1]), "trial, row 2, 't_s': time repeats"),
        (good.assign(t_s=[0.0, np.nan, 0.1]), "trial, row 1, 't_s': has no value"),
        (good.assign(t_s=["0", "x", "1"]), "trial, row 1, 't_s': 'x' is not a number"),
        (good.assign(x_m=[0, np.inf, 1]), "trial, row 1, 'x_m': is infinite"),
        (good.assign(x_m=["0", "1", "l"]), "trial, row 2, 'x_m': 'l' is not a number"),
        (good.assign(x_m=np.nan), "trial, 'x_m': every sample is missing"),
        (good.rename(columns={"t_s": "time"}), "trial, 't_s': "),
        (good.rename(columns={"x_m": "x"}), "trial, 'x_m': "),
        (good[:1], "trial: has 1 samples"),
        (pd.concat([good, good["x_m"]], axis=1), "trial, 'x_m': two columns have this name"),
    ):
        with pytest.raises(InputError, match=message):
            Log.from_frame(changed, name="trial", required=["x_m"])


def test_the_digest_is_that_of_the_samples() -> None:
    good = pd.DataFrame({"t_s": [0.0, 0.1, 0.2], "x_m": [0.0, np.nan, 2.0]})
    found = Log.from_frame(good, name="trial")
    assert found.digest() == Log.from_frame(good, name="another", metadata={"a": 1}).digest()
    assert found.digest() != Log.from_frame(good.assign(x_m=[0.0, np.nan, 2.5])).digest()
    assert found.digest() != Log.from_frame(good.rename(columns={"x_m": "y_m"})).digest()
    assert provenance.digests_of([found]) == {"trial": found.digest()}
