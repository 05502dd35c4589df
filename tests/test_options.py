"""Options are declared once: signature, docstring, command, provenance and docs say the same."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import click
import pytest
from click.shell_completion import ShellComplete

import swimid as package
from swimid.cli.main import main, value_of
from swimid.commands import COMMAND_SPECS, CommandSpec
from swimid.errors import UsageError
from swimid.imports.options import ImportOptions
from swimid.notices import SwimidWarning
from swimid.options import Options, Source, option, takes
from swimid.results import parameters
from swimid.swimmer.options import FitGrayboxOptions
from swimid.tracking.options import Pick
from tests.conftest import ROOT, Ran

SPECS = list(COMMAND_SPECS.values())
commands = pytest.mark.parametrize("spec", SPECS, ids=lambda s: s.command)


def _command(spec: CommandSpec) -> click.Command:
    command: click.Command = main
    for word in spec.command.split():
        assert isinstance(command, click.Group)
        command = command.commands[word]
    return command


def _options(spec: CommandSpec) -> dict[str, click.Option]:
    command = _command(spec)
    made = command.get_params(click.Context(command))
    return {p.name: p for p in made if isinstance(p, click.Option) and p.name is not None}


@commands
def test_the_signature_shows_every_option(spec: CommandSpec) -> None:
    shown = inspect.signature(spec.run()).parameters
    assert "options" not in shown
    for name, entry in spec.model().declarations().items():
        assert shown[name].kind is inspect.Parameter.KEYWORD_ONLY
        empty = inspect.Parameter.empty
        assert shown[name].default == (empty if entry.required else entry.default), name


@commands
def test_the_docstring_and_the_help_describe_every_option(spec: CommandSpec) -> None:
    documented = inspect.getdoc(spec.run()) or ""
    typed = _options(spec)
    for name, entry in spec.model().declarations().items():
        assert entry.help, name
        assert f"\n{name} : {entry.type_text()}\n    {entry.help}" in documented, name
        assert typed[name].help == entry.help


@commands
def test_defaults_of_the_command_are_those_of_the_function(spec: CommandSpec) -> None:
    typed = _options(spec)
    for name, entry in spec.model().declarations().items():
        assert typed[name].required == entry.required
        if not entry.required:
            default = value_of(entry, typed[name].get_default(click.Context(_command(spec))))
            assert default == entry.default or (default is None and entry.default in ((), {})), name


@commands
def test_an_unknown_option_is_refused_with_the_nearest(spec: CommandSpec) -> None:
    last = [*spec.model().model_fields, "output"][-1]
    with pytest.raises(UsageError, match=f"has no option '{last}x'") as caught:
        spec.run()("absent.yaml", **{f"{last}x": 1})
    assert caught.value.hint is not None
    assert last in caught.value.hint


@commands
def test_a_verbs_options_import_nothing_heavy(spec: CommandSpec) -> None:
    code = (
        f"import sys; import {spec.model().__module__}; "
        "heavy = {'numpy', 'scipy', 'pandas', 'numba', 'cv2', 'control', 'matplotlib', 'ruamel'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


class Example(Options):
    """Of every type there is."""

    params: Source = option(help="A file.")
    method: Literal["fast", "good"] = option("good", help="How.")
    step_s: float = option(0.1, gt=0, flag="--dt", recorded="max_step_s", help="Step, s.")
    held: Mapping[str, float] = option({}, flag="--hold", metavar="NAME=VALUE", help="Hold.")
    names: tuple[str, ...] = option((), separated=True, metavar="A,B", help="Names.")
    ends: tuple[float, float] | None = option(None, metavar="X1,X2", help="Ends, m.")
    secret: bool = option(False, recorded=False, help="Not told.")


@takes(Example)
def example(trials: str, *, options: Example, output: Path | None = None) -> Example:
    """Return the options.

    Parameters
    ----------
    trials : str

    Raises
    ------
    UsageError
        For a wrong one.
    """
    return options


class TestModel:
    """What a model of options takes, refuses and records."""

    def test_values_are_validated(self) -> None:
        found = example("t", params="a.yaml", held={"drag": 1}, ends=[0, 1], method=None)
        assert found.params == Path("a.yaml")
        assert found.held == {"drag": 1.0}
        assert found.ends == (0.0, 1.0)
        assert found.method == "good"

    def test_a_source_may_be_what_is_in_the_file(self) -> None:
        fitted = object()
        assert example("t", params=fitted).params is fitted

    @pytest.mark.parametrize(
        "given, text",
        [
            ({}, "the option 'params' is missing"),
            ({"params": "a", "method": "bad"}, "method: 'bad' is not allowed: allowed are 'fast' or 'good'"),
            ({"params": "a", "step_s": 0}, "step_s: 0 is not allowed: it must be greater than 0"),
            ({"params": "a", "names": "ab"}, "names: 'ab' is not allowed"),
            ({"params": "a", "metod": "fast"}, "has no option 'metod'"),
            ({"params": "a", "outptu": "x"}, "has no option 'outptu'"),
        ],
    )
    def test_what_is_wrong_is_named(self, given: dict[str, Any], text: str) -> None:
        with pytest.raises(UsageError, match=re.escape(text)):
            example("t", **given)

    def test_options_cannot_be_changed(self) -> None:
        with pytest.raises(ValueError, match="frozen"):
            example("t", params="a").method = "fast"

    def test_settings_are_plain_data_in_order(self) -> None:
        found = example("t", params="a", ends=(0, 1))
        assert list(found.settings()) == ["params", "method", "max_step_s", "held", "names", "ends"]
        assert found.settings()["ends"] == [0.0, 1.0]
        assert found.settings(method="both")["method"] == "both"

    def test_the_docstring_has_them_where_parameters_are(self) -> None:
        text = inspect.getdoc(example) or ""
        assert text.index("trials : str") < text.index("method : {'fast', 'good'}") < text.index("Raises")
        assert "step_s : float, default 0.1\n    Step, s." in text


def test_the_provenance_records_the_options(
    swimid: Callable[..., Ran], samples: Path, tmp_path: Path
) -> None:
    from swimid.rig.fit_drag import fit_drag

    out = tmp_path / "drag.yaml"
    trials = samples / "rig" / "trials.yaml"
    words = ("--fix", "pulley_friction=0.01", "--bounds", "added_mass=0,2", "--start-state", "rest")
    assert swimid("fit-drag", trials, *words, "-o", out).status == 0
    same = fit_drag(
        trials, fixed={"pulley_friction": 0.01}, bounds={"added_mass": (0, 2)}, start_state="rest"
    )
    assert same.evidence is not None
    settings = same.evidence.provenance["settings"]
    assert list(settings) == ["method", "start_state", "fixed", "freed", "bounds"]
    assert settings["bounds"] == {"added_mass": [0.0, 2.0]}
    assert parameters.read(out).provenance["settings"] == settings


#: Keys of ``settings`` in the provenance, in the order of the files.
RECORDED = {
    "fit-drag": "method start_state fixed freed bounds",
    "fit-propulsion": "keep_departures fixed freed",
    "fit-graybox": "fixed freed bounds share channels start_state starts max_iterations seed readings "
    "max_step_s method",
    "compare": "channels refit_start start_state set readings dt",
    "sensitivity": "samples range coefficients set readings seed dt",
    "diagnose": "effects own_effects seed max_causes readings max_step_s tank_length_m max_frequency_hz"
    " max_amplitude_deg",
    "import": "",
    "track video": "setup fps max_gap_s from_s to_s",
}


@pytest.mark.parametrize("spec", [s for s in SPECS if s.command in RECORDED], ids=lambda s: s.command)
def test_what_the_provenance_records_is_as_ever(spec: CommandSpec) -> None:
    """A key that is renamed or reordered makes files of one run differ, and ends unfinished searches."""
    model = spec.model()
    required = {name: "a" for name, entry in model.declarations().items() if entry.required}
    assert list(model.of(required).settings()) == RECORDED[spec.command].split()


def test_the_settings_of_a_front_are_recorded_where_there_is_one() -> None:
    settings = FitGrayboxOptions.of({"method": "nsga2", "population": 12}).settings()
    assert list(settings)[-3:] == ["population", "generations", "scales"]
    assert settings["population"] == 12
    # by default those of the sea lion paper
    usual = FitGrayboxOptions.of({"method": "nsga2"}).settings()
    assert (usual["population"], usual["generations"]) == (80, 50)


def test_only_what_was_asked_of_an_import_is_recorded() -> None:
    settings = ImportOptions.of({"rate_hz": 30, "stroke_hz": (1, 2)}).settings(clean=True)
    assert settings == {"rate_hz": 30.0, "clean": True, "stroke_hz": [1.0, 2.0]}


@pytest.mark.parametrize(
    "words, text",
    [
        (
            ["fit-graybox", "t.yaml", "--front", "f.csv"],
            "--front is valid only with --method nsga2 or hybrid",
        ),
        (["fit-drag", "t.yaml", "--points", "1"], "--points: '1' should be two numbers with a comma"),
        (["map", "--over", "f=1:2"], "--over: 'f=1:2' should be NAME=LOW:HIGH:COUNT"),
        (["track", "setup", "v.mp4", "--marker", "red", "-o", "s.yaml"], "--marker: 'red' is not a name"),
        (["simulate", "--asymmetry", "1"], "is not in the range -1<x<1"),
        (["export", "a.yaml"], "Missing option '--to'"),
        (["compare", "a.yaml", "--params", "b.yaml", "--dt", "0"], "is not in the range x>0"),
    ],
)
def test_what_is_typed_wrong_is_told(swimid: Callable[..., Ran], words: list[str], text: str) -> None:
    ran = swimid(*words)
    assert ran.status == 2
    assert text in ran.err


class TestWording:
    """Messages name arguments in Python, and options on the command line."""

    RIG, SWIM = (f"sample_logs/{name}/trials.yaml" for name in ("rig", "tfish"))
    LOG = "sample_logs/longfin/longfin_marching.csv"

    @pytest.mark.parametrize(
        "words, call, typed, told",
        [
            (
                ["rwls", LOG, "--input", "cmd1_rad", "--output", "u_m_s", "--na", "2"],
                lambda: package.rwls([TestWording.LOG], output_column="u_m_s", na=2),
                "only one of --na and --nb is given",
                "only one of na and nb is given",
            ),
            (
                ["fit-propulsion", SWIM, "--drag", "drag.yaml"],
                lambda: package.fit_propulsion(TestWording.SWIM, drag="drag.yaml"),
                "--drag is valid only for a cruise experiment",
                "drag is valid only for a cruise experiment",
            ),
            (
                ["track", "setup", "v.mp4", "--background", "--marker", "a@1,2", "-o", "{out}"],
                lambda: package.track_setup("v.mp4", background=True, picks=(Pick("a", 1, 2),)),
                "--background and --marker contradict each other",
                "background and picks contradict each other",
            ),
        ],
        ids=["rwls", "fit-propulsion", "track setup"],
    )
    def test_errors(
        self,
        swimid: Callable[..., Ran],
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        words: list[str],
        call: Callable[[], object],
        typed: str,
        told: str,
    ) -> None:
        monkeypatch.chdir(ROOT)
        assert typed in swimid(*(word.format(out=tmp_path / "s.yaml") for word in words)).err
        with pytest.raises(UsageError, match=f"^{re.escape(told)}"):
            call()

    def test_warnings(self, swimid: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(ROOT)
        with pytest.warns(
            SwimidWarning,
            match="^SWM004 coordinate has no effect: it is used only in a free-decay experiment",
        ):
            package.fit_drag(self.RIG, coordinate="roll_rad")
        ran = swimid("fit-drag", self.RIG, "--coordinate", "roll_rad")
        assert (
            "warning SWM004: --coordinate has no effect: it is used only in a free-decay experiment"
            in ran.err
        )

    def test_commands_in_hints_can_still_be_typed(self) -> None:
        @takes(Example)
        def failing(*, options: Example) -> None:
            hint = "add -o out.yaml, leave --secret out, or run swimid example t --hold k=1 -o x"
            raise UsageError("--dt and --dt-x: the step", hint=hint)

        with pytest.raises(UsageError) as caught:
            failing(params="a")
        assert caught.value.message == "step_s and --dt-x: the step"
        said = "add output out.yaml, leave secret out, or run swimid example t --hold k=1 -o x"
        assert caught.value.hint == said


@pytest.mark.parametrize(
    "words, begun, found",
    [
        (["fit-drag"], "--st", {"--start-state"}),
        (["fit-drag", "--method"], "t", {"two-point"}),
        (["track", "imu"], "--mo", {"--motion-mode", "--mount-deg"}),
    ],
)
def test_completion(words: list[str], begun: str, found: set[str]) -> None:
    complete = ShellComplete(main, {}, "swimid", "_SWIMID_COMPLETE")
    assert {item.value for item in complete.get_completions(words, begun)} == found


def test_options_may_be_given_whole() -> None:
    made = Example(params="a", step_s=0.2)
    assert example("t", options=made) is made
    with pytest.raises(UsageError, match="no option 'options'"):
        example("t", options=made, method="fast")
