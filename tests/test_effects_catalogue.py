"""The catalogue of effects, and effects of a user's file."""

from __future__ import annotations

import re
import textwrap

import numpy as np
import pytest

from swimid.effects import catalogue
from swimid.effects.base import STAGES
from swimid.errors import InputError
from swimid.fitting.model import CruiseInput, Trial
from swimid.propulsion.model import RecoilModel
from tests import effect_cases
from tests.conftest import ROOT
from tests.toy_models import DECAY, Toy, decay

#: Names that reports, files and other programs rely on.
PINNED = {
    "actuation": "servo-lag servo-delay servo-backlash amplitude-loss rate-limit amplitude-offset slip",
    "structure": "fin-flexibility joint-stiffness joint-damping joint-locked water-ingress com-offset "
    "hardening stribeck load-friction",
    "fluid": "linear-drag drag-reynolds added-mass wake-lift lift-damping",
    "environment": "current waves tether wall surface-breach buoyancy",
    "sensing": "camera-scale camera-rotation time-offset clock-rate marker-dropout marker-offset imu-tilt "
    "imu-bias",
    "rig": "pulley-friction pulley-viscous pulley-inertia string-stretch start-offset initial-speed",
}
OWN = """
from swimid.effects.base import Effect
from swimid.fitting.model import Parameter
from swimid.fitting.model import Hooks


class Common(Effect):
    stage = "sensing"
    needs = frozenset({"output"})

    def parameters(self, model, trials):
        return (Parameter("size", "m", -1.0, 1.0, 0.0, 0.1),)


class Tick(Common):
    name = "tick"
    meaning = "A tick."

    def hooks(self, values, trial, model):
        return Hooks(output=(lambda channels, time: {n: v + values[0] for n, v in channels.items()},))
"""


def own(tmp_path, text):
    path = tmp_path / "own.py"
    path.write_text(textwrap.dedent(text))
    return path


@pytest.mark.parametrize("stage", STAGES)
def test_pinned_names(stage):
    found = {e.name for e in catalogue.list_effects() if e.stage == stage}
    assert set(PINNED[stage].split()) <= found


def test_effects_have_order_stage_and_meaning():
    found = catalogue.list_effects()
    assert list(found) == sorted(found, key=lambda e: (STAGES.index(e.stage), e.name))
    for effect in found:
        # a module of forms for one kind of model has effects of all stages
        assert type(effect).__module__.split(".")[2] in (effect.stage, effect.of_model)
        assert len(effect.meaning.split()) > 2
        assert isinstance(effect.sources, tuple)
        assert effect.needs <= catalogue.HOOK_NAMES


def test_own_effects_are_used(tmp_path):
    (effect,) = catalogue.from_file(own(tmp_path, OWN))
    assert effect.name == "tick"
    model = Toy(decay, DECAY, ("y", "v"))
    assert catalogue.applicable([effect], model, []) == [effect]
    assert not catalogue.applicable(
        [e for e in catalogue.list_effects() if e.name in ("servo-lag", "current")], model, []
    )
    seen = effect.hooks(np.array([0.5]), None, model).sense({"y": np.zeros(2)}, np.zeros(2))
    assert seen["y"].tolist() == [0.5, 0.5]


@pytest.mark.parametrize(
    "text, line, words",
    [
        ("x = 1\n", None, "defines no effect"),
        ("x = 1\ny = = 2\n", 2, "no valid Python"),
        ("x = 1\n\ny = x / 0\n", 3, "ZeroDivisionError"),
        (OWN.replace('meaning = "A tick."', ""), 15, "lacks meaning"),
        (OWN.replace("def hooks", "def hook"), 15, r"lacks hooks\(\)"),
        (OWN.replace('"sensing"', '"sencing"'), 15, "did you mean 'sensing'"),
        (OWN.replace('{"output"}', '{"putout"}'), 15, "needs unknown hooks"),
        (OWN.replace('"tick"', '"waves"'), 15, "used already: 'waves'"),
        (OWN + "\n    def __init__(self):\n        raise RuntimeError('no')\n", 23, "cannot be made: no"),
    ],
)
def test_own_effects_that_cannot_be_used(tmp_path, text, line, words):
    path = own(tmp_path, text)
    with pytest.raises(InputError, match=words) as caught:
        catalogue.from_file(path)
    assert caught.value.line == line
    assert str(path) in str(caught.value)


def test_a_file_without_effects_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        catalogue.from_file(tmp_path / "none.py")
    (tmp_path / "own.txt").write_text("")
    with pytest.raises(InputError, match="no Python file"):
        catalogue.from_file(tmp_path / "own.txt")


def test_typical_sizes_are_those_of_the_document():
    """Of a fish, a falling weight and a cruise, by the table of docs/effects.md."""
    fish, cruise = (
        effect_cases.swimmer("tfish"),
        RecoilModel(drag_area_kg_m=2.4, moving_mass_kg=1.9, fins={"a": 1e-4}),
    )
    inputs = {"frequency_hz": [2.0, 3.0], "amplitude_rad": [0.2, 0.3], "distance_m": [1.0, 1.0]}
    runs = Trial(
        "a", "fit", np.arange(2.0), {"mean_speed_m_s": np.array([0.1, 0.2])},
        inputs={name: np.array(values) for name, values in inputs.items()},
        cruise=CruiseInput(fin="a", inertia_kg_m2=1e-4, middle=(2.5, 0.25)),
    )  # fmt: skip
    found = {}
    for kind, model, trials in (
        ("", fish, [effect_cases.swim(fish)]),
        (" of a rig", effect_cases.weight_model(), [effect_cases.weight_trial()]),
        (" of a cruise", cruise, [runs]),
    ):
        for effect in catalogue.applicable(catalogue.list_effects(), model, trials):
            for p in effect.parameters(model, trials):
                found[effect.name + kind, p.name] = (p.scale, p.unit)
                found.setdefault((effect.name, p.name), (p.scale, p.unit))
    text = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8").split("### Typical sizes")[1]
    stated, effect = 0, ""
    for line in re.findall(r"^\|.*`.*$", text.split("\n## ")[0], re.M):
        first, names, size, unit = (cell.strip() for cell in line.strip("|").split("|"))
        effect = first.replace("`", "") or effect
        for name in re.findall(r"`(\w+)`", names):
            assert found[effect, name] == (pytest.approx(float(size)), unit), (effect, name)
            stated += 1
    assert stated == 19
