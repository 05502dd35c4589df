"""Experiments are found by themselves, and every command knows one in a file of the user."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.integrate import solve_ivp

import swimid as package
from swimid.errors import InputError, UsageError
from swimid.files import yamlio
from swimid.logs.experiments import Trials, find_experiments, list_experiments, read_experiments
from tests.conftest import ROOT

#: The example of CONTRIBUTING.md: a body that coasts.
CODE = re.search(
    r"^`swimid/experiments/coasting_body\.py`:\n\n```python\n(.*?)^```$",
    (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
    re.M | re.S,
)
TRUE = {"linear_per_mass": 0.15, "quadratic_per_mass": 0.8}


def glide(start: float, seed: int) -> pd.DataFrame:
    """Return the speeds of a body of 2 kg with drags of 0.3 N s/m and 1.6 N s2/m2, with noise."""
    time = np.arange(0.0, 6.0, 0.02)
    solved = solve_ivp(
        lambda t, u: -(0.3 * u + 1.6 * u**2) / 2.0, (0.0, 6.0), [start], t_eval=time, rtol=1e-9
    )
    noise = np.random.default_rng(seed).normal(0.0, 0.002, len(time))
    return pd.DataFrame({"t_s": time, "u_m_s": solved.y[0] + noise})


@pytest.fixture
def coasting(tmp_path: Path) -> Path:
    """A folder with the user's file, and a trials file of three glides."""
    assert CODE is not None
    (tmp_path / "coasting_body.py").write_text(CODE[1], encoding="utf-8")
    (tmp_path / "logs").mkdir()
    rows = ["format: swimid-trials/1", "experiment: coasting-body", "robot: boxfish", "trials:"]
    for seed, (start, role) in enumerate(((0.3, "fit"), (0.5, "validate"), (0.8, "fit"))):
        glide(start, seed).to_csv(tmp_path / "logs" / f"{seed}.csv", index=False)
        rows.append(f"  - {{log: logs/{seed}.csv, role: {role}}}")
    (tmp_path / "trials.yaml").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("name", list_experiments())
def test_an_experiment_has_the_name_of_its_module_and_a_valid_example(name: str) -> None:
    kind = find_experiments()[name]
    assert kind.title == name
    assert kind.about
    text = inspect.cleandoc(str(kind.__doc__)).split("Example::\n")[1]
    assert yamlio.validate(yaml.safe_load(text), kind, "example").experiment == name


class TestOwnExperiment:
    def test_every_command_knows_it(self, swimid, coasting, monkeypatch):
        monkeypatch.chdir(coasting)
        trials, params = coasting / "trials.yaml", coasting / "coasting.yaml"
        own = ("--experiment", coasting / "coasting_body.py")

        ran = swimid("fit", trials, *own, "-o", params, "--json")
        found = ran.json["result"]["parameters"]
        for name, true in TRUE.items():
            assert found[name]["value"] == pytest.approx(true, abs=3 * found[name]["stderr"])
        assert "--experiment" in ran.json["next"][0]

        ran = swimid("compare", trials, *own, "--params", params, "--json")
        assert ran.json["verdict"]["level"] == "good"
        ran = swimid("diagnose", trials, *own, "--params", params, "--json")
        assert ran.json["result"]["verdict"] == "none"

        ran = swimid("simulate", "--trials", trials, *own, "--params", params, "-o", coasting / "runs")
        assert ran.status == 0, ran.err
        again = pd.read_csv(coasting / "runs" / "0.csv", comment="#")
        np.testing.assert_allclose(again["u_m_s"], glide(0.3, 0)["u_m_s"], atol=0.01)
        alone = ("--set", "initial_speed=0.5", "--duration-s", "6", "-o", coasting / "run.csv")
        assert swimid("simulate", *own, "--params", params, *alone).status == 0
        last = pd.read_csv(coasting / "run.csv", comment="#")["u_m_s"].iloc[-1]
        assert last == pytest.approx(glide(0.5, 1)["u_m_s"].iloc[-1], abs=0.01)

    def test_init_drafts_its_trials_file(self, swimid, coasting):
        own = ("--experiment", coasting / "coasting_body.py")
        ran = swimid("init", coasting / "logs", "--robot", "boxfish", *own, "-o", coasting / "project")
        assert ran.status == 0, ran.err
        text = (coasting / "project" / "log-1.trials.yaml").read_text(encoding="utf-8")
        assert "experiment: coasting-body\n" in text
        steps = (coasting / "project" / "README.md").read_text(encoding="utf-8")
        assert "swimid fit log-1.trials.yaml --experiment ../coasting_body.py -o log-1.yaml" in steps

    def test_from_python_it_is_a_class_or_a_file(self, coasting):
        file = coasting / "coasting_body.py"
        (kind,) = read_experiments(file)
        logs = [{"log": glide(start, seed)} for seed, start in enumerate((0.3, 0.8))]
        for own in (kind, file):
            trials = package.load(logs, experiment=own, robot="boxfish")
            assert package.fit(trials)["quadratic_per_mass"].value == pytest.approx(0.8, abs=0.02)
        trials = package.load(coasting / "trials.yaml", experiment=kind)
        fitted = package.fit(trials)
        assert package.compare(trials, params=fitted).verdict == "good"


class TestMessages:
    def test_an_unknown_experiment_in_a_trials_file(self, swimid, coasting):
        for name, hint in (("coasting-body", "--experiment"), ("free-deca", "did you mean 'free-decay'?")):
            path = coasting / f"{name}.yaml"
            text = (coasting / "trials.yaml").read_text(encoding="utf-8")
            path.write_text(text.replace("coasting-body", name), encoding="utf-8")
            ran = swimid("compare", path, "--params", ROOT / "sample_logs" / "gap" / "params.yaml")
            assert ran.status == 3
            assert f"line 2, 'experiment': '{name}' is not allowed; allowed here: arma, cruise, " in ran.err
            assert hint in ran.err

    def test_an_experiment_of_another_command(self, swimid, samples):
        ran = swimid("fit-drag", samples / "tfish" / "trials.yaml")
        assert "here: falling-weight, free-decay, towed" in ran.err
        assert "swimid fit-graybox" in ran.err
        ran = swimid("fit", samples / "rig" / "trials.yaml")
        assert "swimid fit-drag" in ran.err

    def test_an_unknown_experiment_elsewhere(self, swimid, coasting):
        ran = swimid("init", coasting / "logs", "--experiment", "free-deca")
        assert ran.status == 2
        assert "did you mean 'free-decay'?" in ran.err
        with pytest.raises(UsageError, match="there are: arma, cruise"):
            package.load([], experiment="glide", robot="boxfish")

    @pytest.mark.parametrize(
        ("before", "after", "words"),
        [
            ('Literal["coasting-body"]', "str", "needs a field 'experiment'"),
            ('Literal["coasting-body"]', 'Literal["towed"]', "has a name that is used already: 'towed'"),
            ("def load(", "def read(", r"lacks load\(\)"),
            ("    models = (CoastingModel.name,)\n", "", "lacks models"),
            ("(Trials)", "", "defines no experiment"),
            ("import annotations", "import annotation", "is no valid Python"),
        ],
    )
    def test_a_faulty_file(self, coasting, before, after, words):
        path = coasting / "coasting_body.py"
        path.write_text(path.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
        with pytest.raises(InputError, match=words) as caught:
            read_experiments(path)
        assert "coasting_body.py" in str(caught.value)

    def test_a_name_in_place_of_a_file(self, swimid, coasting):
        ran = swimid("fit", coasting / "trials.yaml", "--experiment", "coasting-body")
        assert ran.status == 3
        assert "coasting-body: there is no such file" in ran.err

    def test_parameters_of_an_unknown_model(self, swimid, coasting):
        own = ("--experiment", coasting / "coasting_body.py")
        params = coasting / "coasting.yaml"
        assert swimid("fit", coasting / "trials.yaml", *own, "-o", params).status == 0
        ran = swimid("simulate", "--params", params, "-o", coasting / "run.csv")
        assert ran.status == 3
        assert "holds parameters of the model 'coasting'" in ran.err
        assert "--experiment" in ran.err


def test_a_base_class_is_no_experiment() -> None:
    assert Trials.title == ""
