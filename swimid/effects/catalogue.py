"""List all effects that a model may lack: those of this package, and those that a user's file defines."""

from __future__ import annotations

import copy
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from swimid.effects.base import STAGES, Effect
from swimid.errors import InputError, suggestion
from swimid.files.user_code import find_classes, last_line, run_file
from swimid.fitting.model import Model, Trial

#: Names of the simulation hooks that an effect may use in :attr:`Effect.needs`.
HOOK_NAMES = frozenset({"command", "stroke", "tables", "coefficients", "force", "flow", "output", "clock"})


@functools.cache
def _every_effect() -> dict[tuple[str, str | None], Effect]:
    """Return every effect of this package by its name and the kind of model that it is a form for."""
    effects: list[Effect] = []
    for module in pkgutil.iter_modules([str(Path(__file__).parent)], "swimid.effects."):
        kinds = find_classes(importlib.import_module(module.name), Effect)
        effects += [kind() for kind in kinds if not inspect.isabstract(kind)]
    return {(effect.name, effect.of_model): effect for effect in effects}


@functools.cache
def list_effects() -> tuple[Effect, ...]:
    """Return every effect of this package in the order of `STAGES`, and by name within a stage.

    Of the forms of an effect for kinds of models, only the general one is included, if there is one.
    """
    every = _every_effect()
    general = [effect for (name, kind), effect in every.items() if kind is None or (name, None) not in every]
    return tuple(sorted(general, key=lambda e: (STAGES.index(e.stage), e.name)))


def forms(effect: Effect, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
    """Return the forms of an effect that apply to a model and its trials.

    A kind of model may have a form of its own, which is a class with :attr:`Effect.of_model`.
    """
    own = _every_effect().get((effect.name, model.name), effect)
    return own.variants(model, trials) if own.of_model in (None, model.name) else []


def applicable(effects: Iterable[Effect], model: Model, trials: Sequence[Trial]) -> list[Effect]:
    """Return those forms of the given effects that apply to a model and its trials."""
    return [variant for effect in effects for variant in forms(effect, model, trials)]


def constants(effect: Effect) -> dict[str, Any]:
    """Return the constants of a form of an effect, such as a reference speed, that are not parameters.

    They are the attributes of the effect that a YAML file can hold.
    """
    return {
        name: value
        for name, value in vars(effect).items()
        if isinstance(value, bool | int | float | str | tuple) and not name.startswith("_")
    }


def restore_form(
    effect: Effect,
    names: Collection[str],
    given: Mapping[str, Any],
    model: Model,
    trials: Sequence[Trial],
) -> Effect | None:
    """Return the form of an effect that has the given parameters; None if no form has them.

    Parameters
    ----------
    effect : Effect
        Effect of the catalogue.
    names : collection of str
        Names of the parameters of the form.
    given : mapping of name to value
        Constants of the form (see :func:`constants`). Without them the form is that for the given trials.
    """
    own = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    kind = type(effect)
    for form in [*forms(effect, model, trials), *(one() for one in (kind, *kind.__subclasses__()))]:
        form = copy.copy(form)
        vars(form).update(own)
        # A form that cannot act on the model has no parameters there.
        with suppress(AttributeError, IndexError, TypeError, ValueError):
            if {p.name for p in form.parameters(model, trials)} == set(names):
                return form
    return None


def from_file(path: str | Path) -> list[Effect]:
    """Return the effects that a Python file defines.

    Parameters
    ----------
    path : path
        Python file, which is run. Its classes that are derived from :class:`Effect` and have no abstract
        methods are the effects. They are created without arguments.

    Raises
    ------
    InputError
        If the file cannot be run or defines no effect, or if an effect is incomplete, has an unknown stage,
        or has the name of another effect. The error states file and line.
    """
    path = Path(path)
    module = run_file(path, "effects")
    effects: dict[str, Effect] = {}
    taken = [e.name for e in list_effects()]
    for kind in find_classes(module, Effect):
        if inspect.isabstract(kind) and not hasattr(kind, "name"):
            continue
        _check(kind, path, [*taken, *effects])
        try:
            effects[kind.name] = kind()
        except Exception as error:
            line = last_line(error, path) or inspect.getsourcelines(kind)[1]
            problem = f"the effect {kind.__name__} cannot be made: {error}"
            raise InputError(problem, file=path, line=line) from error
    if not effects:
        hint = "derive a class from swimid.effects.base.Effect"
        raise InputError("defines no effect", file=path, hint=hint)
    return list(effects.values())


def _check(kind: type[Effect], path: Path, taken: Collection[str]) -> None:
    """Raise an error if a user's effect lacks an attribute or has an invalid one."""
    lacking = [name for name in ("name", "stage", "meaning") if not hasattr(kind, name)]
    if not kind.needs and (kind.applies, kind.variants) == (Effect.applies, Effect.variants):
        lacking.append("needs")
    lacking += [f"{name}()" for name in sorted(kind.__abstractmethods__)]
    name, stage, meaning, needs = (getattr(kind, n, "") for n in ("name", "stage", "meaning", "needs"))
    hooks, stages = f"a set of: {', '.join(sorted(HOOK_NAMES))}", suggestion(f"{stage}", STAGES)
    faults = (
        (lacking, f"lacks {', '.join(lacking)}", None),
        (not name or {type(name), type(meaning)} != {str}, "needs a name and a meaning in words", None),
        (stage not in STAGES, f"has the unknown stage '{stage}'", stages),
        (isinstance(needs, str) or not set(needs) <= HOOK_NAMES, f"needs unknown hooks: {needs!r}", hooks),
        (name in taken, f"has a name that is used already: '{name}'", None),
    )
    for fault, problem, hint in faults:
        if fault:
            line = inspect.getsourcelines(kind)[1]
            raise InputError(f"the effect {kind.__name__} {problem}", file=path, line=line, hint=hint)
