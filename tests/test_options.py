"""Options are declared once: signature, docstring, command, provenance and docs say the same."""

from __future__ import annotations

import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import click
import pytest

from swimid.cli.builder import Verb
from swimid.cli.main import main
from swimid.cli.parsing import value_of
from swimid.cli.verbs import VERBS
from swimid.errors import UsageError
from swimid.options import Options, Source, option, takes
from swimid.results import parameters
from tests.conftest import ROOT, Ran

verbs = pytest.mark.parametrize("verb", VERBS, ids=lambda v: v.name)


def _function(verb: Verb) -> Callable[..., Any]:
    module, _, name = verb.function.partition(":")
    return getattr(importlib.import_module(module), name)


def _command(verb: Verb) -> click.Command:
    command: click.Command = main
    for word in verb.name.split():
        assert isinstance(command, click.Group)
        command = command.commands[word]
    return command


def _options(verb: Verb) -> dict[str, click.Option]:
    command = _command(verb)
    made = command.get_params(click.Context(command))
    return {p.name: p for p in made if isinstance(p, click.Option) and p.name is not None}


@verbs
def test_the_signature_shows_every_option(verb: Verb) -> None:
    shown = inspect.signature(_function(verb)).parameters
    assert "options" not in shown
    for name, entry in verb.model().declared().items():
        assert shown[name].kind is inspect.Parameter.KEYWORD_ONLY
        empty = inspect.Parameter.empty
        assert shown[name].default == (empty if entry.required else entry.default), name


@verbs
def test_the_docstring_and_the_help_describe_every_option(verb: Verb) -> None:
    documented = inspect.getdoc(_function(verb)) or ""
    typed = _options(verb)
    for name, entry in verb.model().declared().items():
        assert entry.help, name
        assert f"\n{name} : {entry.type_text()}\n    {entry.help}" in documented, name
        assert typed[name].help == entry.help


@verbs
def test_defaults_of_the_command_are_those_of_the_function(verb: Verb) -> None:
    typed = _options(verb)
    for name, entry in verb.model().declared().items():
        command = _command(verb)
        ctx = click.Context(command)
        default = value_of(entry, typed[name].get_default(ctx))
        assert default in (None, entry.default) or default == entry.default, name
        assert typed[name].required == entry.required


@verbs
def test_an_unknown_option_is_refused_with_the_nearest(verb: Verb) -> None:
    last = list(verb.model().model_fields)[-1]
    with pytest.raises(UsageError, match=f"has no option '{last}x'") as caught:
        _function(verb)("absent.yaml", **{f"{last}x": 1})
    assert caught.value.hint is not None
    assert last in caught.value.hint


@verbs
def test_a_verbs_options_import_nothing_heavy(verb: Verb) -> None:
    code = (
        f"import sys; import {verb.options.partition(':')[0]}; "
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
            (
                {"params": "a", "method": "bad"},
                "method: 'bad' is not allowed: input should be 'fast' or 'good'",
            ),
            ({"params": "a", "step_s": 0}, "step_s: 0 is not allowed: input should be greater than 0"),
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
        assert text.index("trials : str") < text.index('method : {"fast", "good"}') < text.index("Raises")
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


@verbs
def test_the_docs_list_every_option(verb: Verb) -> None:
    """The table on the verb's page is the one its options give."""
    from swimid.cli.table import PAGES, table

    page = (ROOT / "docs" / PAGES[verb.name]).read_text()
    assert table(verb) in page, (
        f"run python -m swimid.cli.table {verb.name} and put its table into {PAGES[verb.name]}"
    )
