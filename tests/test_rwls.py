"""``swimid rwls`` from the command line: results, evidence, warnings, exit statuses."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.linalg import expm
from scipy.signal import lfilter

import swimid
from swimid.blackbox import model as arma
from swimid.cli.main import main
from swimid.fitting.model import Trial
from swimid.results import evidence, parameters
from tests.generators import longfin

A, B = [-1.5, 0.7], [0.5, 0.25]


def write_log(path, columns):
    longfin.write_csv(path, {k: np.asarray(v, dtype=float) for k, v in columns.items()}, {"note": "test"})
    return path


def arx_columns(seed=1, *, n=1200, step=0.05, noise=0.05, a=A, b=B, source=None):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n) if source is None else source
    polynomial = [1.0, *a]
    y = lfilter([0.0, *b], polynomial, u) + lfilter([1.0], polynomial, noise * rng.normal(size=n))
    return {"t_s": np.round(np.arange(n) * step, 6), "cmd1_rad": u, "u_m_s": y}


def run(*args):
    """Run the command; gives exit status, the JSON document, and stderr."""
    done = CliRunner().invoke(main, ["rwls", *map(str, args), "--json"])
    assert "Traceback" not in done.stderr
    return done.exit_code, json.loads(done.stdout) if done.stdout else {}, done.stderr


def codes(document):
    return {w["code"] for w in document["warnings"]}


COLUMNS = ("--input", "cmd1_rad", "--output", "u_m_s")


def test_a_simulated_arx_comes_back(tmp_path):
    log = write_log(tmp_path / "run.csv", arx_columns())
    target = tmp_path / "arma.yaml"
    arguments = (*COLUMNS, "--na", 2, "--nb", 2, "--weight", 0.95, "--validate", 0.25, "-o", target)
    status, document, _ = run(log, *arguments)
    assert status == 0
    assert codes(document) == set()
    file = parameters.read(target, model="arma")
    for name, truth in zip(("a1", "a2", "b1", "b2"), A + B, strict=True):
        e = file.parameters[name]
        assert abs(e.value - truth) < 3 * e.stderr
        assert e.status == "estimated"
    assert (file.delay, file.sample_time_s, file.stable) == (1, 0.05, True)
    assert file.parameters["b1"].unit == "(m/s)/rad"
    assert sorted(p.magnitude for p in file.poles) == pytest.approx([np.sqrt(0.7)] * 2, abs=0.01)
    held = file.fit.validation["u_m_s"]["data"]["held-out part"]
    assert held["free_run"]["fit_percent"] > 80
    assert held["one_step"]["rmse"] == pytest.approx(0.05, rel=0.15)
    assert document["result"]["parameters"]["a1"]["value"] == file.value("a1")
    assert list(file.provenance["inputs"]) == [log.name]
    shown = evidence.read(evidence.sidecar(target))
    names = {f.id for f in shown.figures}
    assert names == {"free-run", "residuals"}
    assert shown.verdict.level == "good"


def test_commands_of_few_levels_are_exact(tmp_path):
    """Binary, stepped and square commands have no decimals, and no rounding either."""
    rng = np.random.default_rng(41)
    n = 1000
    inputs = {
        "binary": np.repeat(rng.integers(0, 2, n // 5), 5),
        "three": np.repeat(rng.integers(-1, 2, n // 4), 4),
        "square": (np.arange(n) // 40) % 2,
        "stairs": np.arange(n) // 100,
        "step": (np.arange(n) >= 100) * 1,
    }
    for name, source in inputs.items():
        log = write_log(tmp_path / f"{name}.csv", arx_columns(42, n=n, noise=0.01, source=source * 1.0))
        status, document, _ = run(log, *COLUMNS, "--na", 2, "--nb", 2)
        assert status == 0, name
        for key, truth in zip(("a1", "a2", "b1", "b2"), A + B, strict=True):
            e = document["result"]["parameters"][key]
            assert e["status"] == "estimated", (name, key)
            assert abs(e["value"] - truth) < 4 * e["stderr"], (name, key)


def test_the_result_equals_batch_least_squares_on_raw_data(tmp_path):
    columns = arx_columns(2)
    log = write_log(tmp_path / "run.csv", columns)
    _, document, _ = run(log, *COLUMNS, "--na", 2, "--nb", 2)
    u, y = columns["cmd1_rad"], columns["u_m_s"]
    h = np.column_stack((-y[1:-1], -y[:-2], u[1:-1], u[:-2]))
    expected = np.linalg.lstsq(h, y[2:], rcond=None)[0]
    got = [document["result"]["parameters"][name]["value"] for name in ("a1", "a2", "b1", "b2")]
    np.testing.assert_allclose(got, expected, rtol=1e-8)


def test_the_search_finds_orders_and_delay(tmp_path):
    log = write_log(tmp_path / "run.csv", arx_columns(3, b=[0.0, 0.5, 0.25]))
    target = tmp_path / "a.yaml"
    status, document, _ = run(log, *COLUMNS, "--validate", 0.25, "-o", target)
    assert status == 0
    assert document["result"]["settings"]["orders"] == {"na": 2, "nb": 2, "nk": 2, "nc": 0}
    assert len(document["result"]["orders_tried"]) == 7 * 6 * 5


def test_the_search_finds_an_input_without_delay(tmp_path):
    rng = np.random.default_rng(45)
    u = rng.normal(size=1000)
    y = lfilter([0.5, 0.3], [1.0, *A], u) + lfilter([1.0], [1.0, *A], 0.05 * rng.normal(size=1000))
    log = write_log(tmp_path / "run.csv", {"t_s": np.arange(1000) * 0.05, "cmd1_rad": u, "u_m_s": y})
    document = run(log, *COLUMNS)[1]
    assert document["result"]["settings"]["orders"] == {"na": 2, "nb": 2, "nk": 0, "nc": 0}
    assert "SWM023" not in codes(document)
    late = dict(arx_columns(46, b=[0.0, 0.0, 0.5, 0.25]))
    log = write_log(tmp_path / "late.csv", late)
    document = run(log, *COLUMNS, "--max-nk", 3, "--max-order", 3)[1]
    assert document["result"]["settings"]["orders"]["nk"] == 3
    assert any("nk 0 to 3" in w["text"] and "--max-nk" in w["text"] for w in document["warnings"])


def test_a_copy_of_the_input_is_refused(tmp_path):
    columns = arx_columns(47, n=300)
    log = write_log(tmp_path / "run.csv", dict(columns, u_m_s=columns["cmd1_rad"]))
    status, document, _ = run(log, *COLUMNS, "--na", 2, "--nb", 2)
    assert status == 3
    assert "same values" in document["error"]["message"]
    assert "--output" in document["error"]["hint"]


def test_other_logs_hold_out_and_trials_files_name_everything(tmp_path):
    write_log(tmp_path / "one.csv", arx_columns(4))
    write_log(tmp_path / "two.csv", arx_columns(5))
    write_log(tmp_path / "three.csv", arx_columns(6, n=400))
    flags = (*COLUMNS, "--na", 2, "--nb", 2)
    by_hand = run(tmp_path / "one.csv", tmp_path / "two.csv", *flags, "--validate", tmp_path / "three.csv")[1]
    (tmp_path / "trials.yaml").write_text(
        "format: swimid-trials/1\nexperiment: arma\nrobot: long-fin\n"
        "input: cmd1_rad\noutput: u_m_s\ntrials:\n"
        "  - {log: one.csv}\n  - {log: two.csv}\n  - {log: three.csv, role: validate}\n"
    )
    listed = run(tmp_path / "trials.yaml", "--na", 2, "--nb", 2)[1]
    assert listed["result"]["parameters"] == by_hand["result"]["parameters"]
    assert listed["result"]["robot"] == "long-fin"
    assert list(listed["result"]["fit"]["validation"]["u_m_s"]["data"]) == ["three.csv"]
    assert listed["result"]["fit"]["rows"] == 2 * 1198


def test_stretches_of_one_recording_are_fitted_and_held_out_apart(tmp_path):
    # half the recording is of another robot: what is fitted there tells nothing of it
    first, second = arx_columns(4), arx_columns(5, a=[-0.5, 0.2])
    both = {name: np.concatenate([first[name], second[name]]) for name in first}
    both["t_s"] = np.round(np.arange(2400) * 0.05, 6)
    write_log(tmp_path / "run.csv", both)
    write_log(tmp_path / "first.csv", first)
    (tmp_path / "trials.yaml").write_text(
        "format: swimid-trials/1\nexperiment: arma\nrobot: long-fin\n"
        "input: cmd1_rad\noutput: u_m_s\ntrials:\n"
        "  - {id: early, log: run.csv, end_s: 59.95}\n"
        "  - {id: late, log: run.csv, start_s: 60.0, role: validate}\n"
    )
    alone = run(tmp_path / "first.csv", *COLUMNS, "--na", 2, "--nb", 2)[1]
    status, document, _ = run(tmp_path / "trials.yaml", "--na", 2, "--nb", 2)
    assert status == 0
    assert document["result"]["parameters"] == alone["result"]["parameters"]
    assert document["result"]["fit"]["trials"] == ["early"]
    fitted = document["result"]["fit"]["channels"]["u_m_s"]["free_run"]["fit_percent"]
    held_out = document["result"]["fit"]["validation"]["u_m_s"]["data"]["late"]["free_run"]["fit_percent"]
    assert fitted > 85.0 > 20.0 > held_out
    assert "SWM015" in codes(document)


def test_a_second_trials_file_is_refused(tmp_path):
    write_log(tmp_path / "one.csv", arx_columns(4))
    (tmp_path / "one.yaml").write_text(
        "format: swimid-trials/1\nexperiment: arma\nrobot: long-fin\n"
        "input: cmd1_rad\noutput: u_m_s\ntrials:\n  - {log: one.csv}\n"
    )
    status, document, _ = run(tmp_path / "one.yaml", tmp_path / "one.yaml", "--na", 2, "--nb", 2)
    assert status == 2
    assert "two trials files are given" in document["error"]["message"]


def test_gaps_are_counted_and_do_not_bias_the_estimates(tmp_path):
    columns = arx_columns(7)
    columns["u_m_s"][300:310] = np.nan
    keep = np.ones(1200, dtype=bool)
    keep[600:603] = False  # rows missing from the file: a jump over whole samples
    columns = {k: v[keep] for k, v in columns.items()}
    columns["t_s"] = np.where(np.arange(1197) > 900, columns["t_s"] + 0.021, columns["t_s"])  # off the grid
    log = write_log(tmp_path / "run.csv", columns)
    status, document, _ = run(log, *COLUMNS, "--na", 2, "--nb", 2)
    assert status == 0
    text = [w["text"] for w in document["warnings"] if w["code"] == "SWM001"]
    assert any("restarted 3 times" in t for t in text)
    for name, truth in zip(("a1", "a2", "b1", "b2"), A + B, strict=True):
        e = document["result"]["parameters"][name]
        assert abs(e["value"] - truth) < 3.5 * e["stderr"]


def test_a_computed_sine_input(tmp_path):
    time = np.arange(1000) * 0.05
    columns = arx_columns(8, n=1000, source=30 * np.sin(2 * np.pi * 0.8 * time))
    log = write_log(tmp_path / "run.csv", {k: columns[k] for k in ("t_s", "u_m_s")})
    status, document, _ = run(log, "--input-sine", 30, 0.8, 0, "--output", "u_m_s", "--na", 2, "--nb", 2)
    assert status == 0
    values = [document["result"]["parameters"][n]["value"] for n in ("a1", "a2", "b1", "b2")]
    errors = [document["result"]["parameters"][n]["stderr"] for n in ("a1", "a2", "b1", "b2")]
    assert np.all(np.abs(np.array(values) - (A + B)) < 3 * np.array(errors))
    three = run(log, "--input-sine", 30, 0.8, 0, "--output", "u_m_s", "--na", 2, "--nb", 3)[1]
    assert {"SWM022", "SWM010"} <= codes(three)
    assert three["result"]["parameters"]["b1"]["status"] == "unidentifiable"
    assert three["result"]["parameters"]["b1"]["stderr"] is None
    assert three["result"]["parameters"]["a1"]["status"] == "estimated"


def test_coloured_noise_is_reported_as_bias(tmp_path):
    columns = arx_columns(9, n=3000, noise=0.0)
    columns["u_m_s"] = columns["u_m_s"] + 0.5 * np.random.default_rng(10).normal(size=3000)
    log = write_log(tmp_path / "run.csv", columns)
    document = run(log, *COLUMNS, "--na", 2, "--nb", 2)[1]
    assert "SWM013" in codes(document)
    assert document["result"]["fit"]["noise"]["standard_errors"] == "sandwich"
    # Output noise is ARMAX with C = A.
    with_noise = run(log, *COLUMNS, "--na", 2, "--nb", 2, "--nc", 2)[1]
    assert "SWM013" not in codes(with_noise)
    for name, truth in zip(("a1", "a2", "b1", "b2", "c1", "c2"), A + B + A, strict=True):
        e = with_noise["result"]["parameters"][name]
        assert abs(e["value"] - truth) < 3.5 * e["stderr"]


def test_an_unstable_model_is_reported(tmp_path):
    columns = arx_columns(11, n=300, a=[-1.02], b=[0.1])
    log = write_log(tmp_path / "run.csv", columns)
    target = tmp_path / "a.yaml"
    status, document, _ = run(log, *COLUMNS, "--na", 1, "--nb", 1, "--centre", "none", "-o", target)
    assert status == 0
    assert "SWM020" in codes(document)
    assert document["result"]["stable"] is False
    shown = evidence.read(evidence.sidecar(target))
    assert shown.verdict.level == "bad"
    assert "is unstable" in shown.verdict.text
    assert {c.name: c.verdict for c in shown.checks}["Largest pole"] == "fail"


def test_an_integrating_model_is_reported(tmp_path):
    rng = np.random.default_rng(12)
    u = rng.normal(size=800)
    y = np.cumsum(np.concatenate(([0.0], 0.1 * u[:-1])) + 0.02 * rng.normal(size=800))
    log = write_log(tmp_path / "run.csv", {"t_s": np.arange(800) * 0.1, "cmd1_rad": u, "u_m_s": y})
    target = tmp_path / "a.yaml"
    document = run(log, *COLUMNS, "--na", 1, "--nb", 1, "--validate", 0.25, "-o", target)[1]
    assert "SWM020" in codes(document)
    assert document["result"]["fit"]["integrating"] is True
    shown = evidence.read(evidence.sidecar(target))
    assert "the model integrates" in shown.verdict.text
    assert {c.name: c.verdict for c in shown.checks}["Largest pole"] == "warn"


USAGE = [
    (["--input", "u_m_s", "--output", "u_m_s", "--na", "2", "--nb", "2"], "same column"),
    ([*COLUMNS, "--na", "2"], "both --na and --nb"),
    ([*COLUMNS, "--na", "2", "--nb", "2", "--validate", "1.5"], "between 0 and 1"),
    (
        [*COLUMNS, "--na", "2", "--nb", "2", "--validate", "0.2", "--validate", "0.3"],
        "has several shares, 0.2 0.3",
    ),
    (["--output", "u_m_s", "--na", "2", "--nb", "2"], "--input"),
    (["--output", "u_m_s", "--input-sine", "0", "1", "0", "--na", "2", "--nb", "2"], "amplitude must not"),
    ([*COLUMNS, "--na", "2", "--nb", "2", "-o", "RUN"], "also an input"),
]


@pytest.mark.parametrize("options,text", USAGE)
def test_wrong_usage_exits_2(tmp_path, options, text):
    log = write_log(tmp_path / "run.csv", arx_columns(13, n=100))
    status, document, stderr = run(log, *[str(log) if o == "RUN" else o for o in options])
    assert status == 2
    assert text in document["error"]["message"] + stderr


def test_a_misnamed_column_exits_3_with_the_nearest(tmp_path):
    log = write_log(tmp_path / "run.csv", arx_columns(14, n=100))
    status, document, stderr = run(log, "--input", "cmd_rad", "--output", "u_m_s", "--na", 2, "--nb", 2)
    assert status == 3
    assert "cmd1_rad" in document["error"]["hint"]
    assert "run.csv" in stderr


def test_uneven_sampling(tmp_path):
    columns = arx_columns(15, n=300)
    rng = np.random.default_rng(16)
    far = dict(columns, t_s=np.round(np.cumsum(rng.exponential(0.05, size=300) + 1e-4), 6))
    status, document, _ = run(write_log(tmp_path / "far.csv", far), *COLUMNS, "--na", 2, "--nb", 2)
    assert status == 3
    assert "constant rate" in document["error"]["message"]
    jitter = dict(columns, t_s=columns["t_s"] + 0.004 * rng.uniform(-1, 1, size=300))
    status, document, _ = run(write_log(tmp_path / "near.csv", jitter), *COLUMNS, "--na", 2, "--nb", 2)
    assert status == 0
    assert "SWM003" in codes(document)


def test_logs_of_different_rate_exit_3(tmp_path):
    one = write_log(tmp_path / "one.csv", arx_columns(17, n=200))
    two = write_log(tmp_path / "two.csv", arx_columns(18, n=200, step=0.02))
    status, document, _ = run(one, two, *COLUMNS, "--na", 2, "--nb", 2)
    assert status == 3
    assert document["error"]["file"].endswith("two.csv")


@pytest.mark.parametrize(
    "change,options,text",
    [
        (lambda c: c["u_m_s"].fill(0.3), (), "constant"),
        (lambda c: c["cmd1_rad"].fill(0.0), (), "the input is constant"),
        (lambda c: c["u_m_s"].__setitem__(slice(0, None, 3), np.nan), (), "usable rows"),
        (lambda c: None, ("--validate", "0.01"), "held-out part"),
    ],
)
def test_data_without_information_exit_4(tmp_path, change, options, text):
    columns = arx_columns(19, n=150)
    change(columns)
    target = tmp_path / "a.yaml"
    log = write_log(tmp_path / "run.csv", columns)
    status, document, _ = run(log, *COLUMNS, "--na", 3, "--nb", 2, *options, "-o", target)
    assert status == 4
    assert text in document["error"]["message"]
    assert not target.exists()


def test_a_singular_regression_exits_4(tmp_path):
    time = np.arange(400) * 0.05
    columns = {"t_s": time, "cmd1_rad": np.sin(6 * time), "u_m_s": 0.3 * np.cos(6 * time)}
    log = write_log(tmp_path / "run.csv", columns)
    status, document, _ = run(log, *COLUMNS, "--na", 3, "--nb", 3)
    assert status == 4
    assert "singular" in document["error"]["message"]


def test_reading_back_gives_the_same_bits_and_the_same_run(tmp_path):
    columns = arx_columns(20)
    log = write_log(tmp_path / "run.csv", columns)
    target = tmp_path / "a.yaml"
    document = run(log, *COLUMNS, "--na", 2, "--nb", 2, "-o", target)[1]
    file = parameters.read(target)
    for name, e in document["result"]["parameters"].items():
        assert file.parameters[name].value == e["value"]
        assert file.parameters[name].stderr == e["stderr"]
    model = arma.ArxModel(file)
    trial = Trial("t", "fit", columns["t_s"], {"u_m_s": columns["u_m_s"]}, {"cmd1_rad": columns["cmd1_rad"]})
    values = np.array([p.start for p in model.parameters])
    simulated = model.simulate(values, trial)["u_m_s"]
    error = simulated[2:] - columns["u_m_s"][2:]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(file.fit.channels["u_m_s"]["rmse"], rel=1e-9)


def test_transfer_function_equals_the_filter(tmp_path):
    import control

    log = write_log(tmp_path / "run.csv", arx_columns(21, b=[0.0, 0.5, 0.25]))
    target = tmp_path / "a.yaml"
    run(log, *COLUMNS, "--na", 2, "--nb", 2, "--nk", 2, "-o", target)
    file = parameters.read(target)
    system = arma.to_control(file)
    assert system.dt == file.sample_time_s
    time = np.arange(30) * file.sample_time_s
    got = control.step_response(system, time).outputs
    a, b = [file.value(f"a{i}") for i in (1, 2)], [file.value(f"b{i}") for i in (1, 2)]
    np.testing.assert_allclose(
        np.squeeze(got), lfilter([0, 0, *b], [1, *a], np.ones(30)), rtol=1e-9, atol=1e-12
    )


def test_published_long_fin_models():
    """Poles of Tables II and III; the rotating model is unstable in free run."""
    sizes = {n: [round(p.magnitude, 3) for p in arma.load_published(n).poles] for n in arma.list_published()}
    assert sizes["long-fin-marching-3-2"] == pytest.approx([0.9955, 0.72, 0.20], abs=6e-3)
    assert sizes["long-fin-marching-4-3"] == pytest.approx([0.987, 0.941, 0.614, 0.614], abs=1e-3)
    assert sizes["long-fin-rotating-4-3"] == pytest.approx([1.0013, 0.549, 0.549, 0.272], abs=1e-3)
    assert [arma.load_published(n).stable for n in arma.list_published()] == [True, True, False]
    with pytest.raises(KeyError, match="there are"):
        arma.load_published("long-fin-receding")


def test_a_published_model_runs_from_rest():
    model = arma.ArxModel(arma.load_published("long-fin-marching-4-3"))
    time = np.arange(800) * 0.02375
    trial = Trial("t", "validate", time, {}, {"cmd1_rad": 0.5 * np.sin(2 * np.pi * 1.2 * time)})
    u = model.simulate(np.array([p.start for p in model.parameters]), trial)["u_m_s"]
    assert np.isfinite(u).all()
    assert 1e-4 < np.ptp(u[400:]) < 0.1


def test_long_fin_sample_logs(tmp_path):
    """The generated marching run is identified well enough to simulate another one."""
    paths = longfin.write_sample(tmp_path)
    assert sum(p.stat().st_size for p in paths) < 300_000
    options = (*COLUMNS, "--na", 4, "--nb", 3, "--weight", 0.95, "--validate", 0.25, "--validate", paths[1])
    status, document, _ = run(paths[0], *options)
    assert status == 0
    result = document["result"]
    assert result["sample_time_s"] == pytest.approx(0.02375)
    assert result["stable"] is True
    for part in result["fit"]["validation"]["u_m_s"]["data"].values():
        assert part["one_step"]["fit_percent"] > 95
        assert part["free_run"]["fit_percent"] > 60


DATA = os.environ.get("SWIMID_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="SWIMID_DATA is not set: no real recordings here")


def _daisy(tmp_path, name, step):
    table = np.loadtxt(Path(DATA) / "sysid" / f"{name}.dat")
    time = np.round(np.arange(len(table)) * step, 6)
    return write_log(tmp_path / f"{name}.csv", {"t_s": time, "u": table[:, 0], "y": table[:, 1]})


@needs_data
def test_hair_dryer(tmp_path):
    log = _daisy(tmp_path, "dryer", 0.08)
    status, document, _ = run(log, "--input", "u", "--output", "y", "--na", 4, "--nb", 4, "--validate", 0.5)
    assert status == 0
    assert "SWM021" in codes(document)
    free = document["result"]["fit"]["validation"]["y"]["data"]["held-out part"]["free_run"]
    assert free["fit_percent"] >= 89.0
    assert free["level_shift"] == pytest.approx(0.095, abs=0.02)


@needs_data
def test_ball_beam(tmp_path):
    log = _daisy(tmp_path, "ballbeam", 0.1)
    target = tmp_path / "a.yaml"
    options = ("--input", "u", "--output", "y", "--na", 4, "--nb", 4, "--validate", 0.5, "-o", target)
    status, document, _ = run(log, *options)
    assert status == 0
    assert "SWM020" in codes(document)
    assert document["result"]["fit"]["integrating"] is True
    assert (
        document["result"]["fit"]["validation"]["y"]["data"]["held-out part"]["free_run"]["diverged"] is True
    )


def test_modes_are_those_of_the_oscillator() -> None:
    """Samples of an oscillator of 1.5 Hz with the damping ratio 0.2, whose force is held for a sample."""
    frequency, ratio, step = 2 * np.pi * 1.5, 0.2, 0.04
    matrix = np.array([[0.0, 1.0], [-(frequency**2), -2 * ratio * frequency]])
    whole = expm(np.block([[matrix * step, np.array([[0.0], [frequency**2 * step]])], [np.zeros((1, 3))]]))
    state, rng = np.zeros(2), np.random.default_rng(5)
    force, seen = rng.normal(size=600), []
    for value in force:
        seen.append(state[0])
        state = whole[:2, :2] @ state + whole[:2, 2] * value
    table = pd.DataFrame({"t_s": step * np.arange(600), "force_N": force, "x_m": seen})
    fit = swimid.rwls([table], input_column="force_N", output_column="x_m", na=2, nb=2, held_out=[0.25])
    modes = fit.tables()["modes"]
    assert modes["natural frequency (Hz)"].astype(float).tolist() == pytest.approx([1.5, 1.5], rel=1e-3)
    assert modes["damping ratio"].astype(float).tolist() == pytest.approx([0.2, 0.2], rel=1e-3)
