"""Declaration of the options of a command, in one class that serves Python and the command line.

A class of options derives from :class:`Options` and has one field for each option, declared with
:func:`option`. The class determines the keyword arguments and the docstring of the Python function
(:func:`takes`), the command with its options and help text (``swimid.cli.main``), and the entry ``settings``
in the provenance of a result (:meth:`Options.settings`).

A module with a class of options imports nothing that takes long to load, so that ``--help`` is fast.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from swimid import reading
from swimid.commands import CommandUsage
from swimid.errors import SwimidError, UsageError, name_arguments, suggestion
from swimid.notices import automatic

Returned = TypeVar("Returned")

#: Smallest and largest magnitude of a number other than 0 in a file or an option. The limits prevent
#: overflow: fits raise accelerations, which are values divided by squared times, to at most the third power,
#: and the result must be within the range of double precision (1e-308 to 1e308).
SMALLEST, LARGEST = 1e-30, 1e30

#: Type of an option whose value is an input: a file, or an object in memory with the content of the file. On
#: the command line it is always a file.
Source = Annotated[Path | Any, Field(union_mode="left_to_right")]


#: Clause of messages about a number that is too small or too large in magnitude.
BEYOND = f"not usable: a number other than 0 must be finite, from {SMALLEST:g} to {LARGEST:g} in magnitude"


def is_beyond(value: Any) -> bool:
    """Return whether a value is a number whose magnitude is too small or too large for computations.

    >>> [is_beyond(value) for value in (0.0, -1e300, float("inf"), "1e300", True)]
    [False, True, True, False, False]
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and value != 0 and not SMALLEST <= abs(value) <= LARGEST


def option(
    default: Any = ...,
    *,
    help: str,
    flag: str | None = None,
    metavar: str | None = None,
    separated: bool = False,
    written: bool = False,
    recorded: bool | str = True,
    part: str = "",
    **limits: float,
) -> Any:
    """Declare one option of a command as a field of a class of options.

    Parameters
    ----------
    default
        Default value. An option without a default is required.
    help : str
        Description with the unit. It appears in ``--help``, in the docstring and in the documentation.
    flag : str, optional
        Name on the command line, by default ``--`` and the name of the field. ``--on/--off`` declares a flag
        and its negation.
    metavar : str, optional
        Placeholder for the value in the help text.
    separated : bool
        Whether several values may be given, separated by commas.
    written : bool
        Whether the value is a file to write. By default, a value that is a file is read.
    recorded : bool or str
        True records the option in the settings of the provenance, under the name of the field. A string is
        the key to use instead of the name. False does not record the option.
    part : str
        Name of the group to which the option belongs. The command handles a group of options in one way.
    **limits
        Bounds of a number: ``ge``, ``gt``, ``le``, ``lt``.
    """
    notes = {
        "flag": flag, "metavar": metavar, "separated": separated, "written": written, "recorded": recorded,
        "part": part, "limits": limits,
    }  # fmt: skip
    return Field(default, description=help, json_schema_extra=cast(Any, notes), **cast(Any, limits))


class Options(BaseModel):
    """Base class of the classes that declare the options of a command.

    The values of an object are validated and cannot be changed afterwards.

    The docstring of a class for a command is the help text of the command. The class arguments are those of
    :class:`swimid.commands.CommandUsage`. A row of :data:`swimid.commands.TABLE` names the class.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    usage: ClassVar[CommandUsage] = CommandUsage()

    def __init_subclass__(cls, **usage: Any) -> None:
        super().__init_subclass__()
        cls.usage = CommandUsage(**usage)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Create an object of this class from option values by name. None selects the default of an option.

        Raises
        ------
        UsageError
            If an option does not exist or is missing, or if a value is not allowed.
        """
        stated = {name: value for name, value in given.items() if value is not None}
        try:
            options = cls(**stated)
        except ValidationError as error:
            raise _refusal(cls, error) from error
        for name, value in stated.items():
            parts = value.values() if isinstance(value, Mapping) else [value]
            if wrong := [part for part in parts if is_beyond(part)]:
                raise UsageError(f"{cls.declarations()[name].flag}: {wrong[0]!r:.20} is {BEYOND}")
        return options

    @classmethod
    def declarations(cls) -> dict[str, Declared]:
        """Return the declaration of each option. The key is the name of its field in the class of options."""
        return {name: Declared(name, info) for name, info in cls.model_fields.items()}

    def settings(self, **actual: Any) -> dict[str, Any]:
        """Return the options with their values, as plain data for the provenance of a result.

        Options that are declared as not recorded are left out.

        Parameters
        ----------
        **actual
            Values by key that replace the option values in the settings.
        """
        keys = {entry.key: name for name, entry in self.declarations().items() if entry.key}
        return {key: actual.get(key, _plain(getattr(self, name))) for key, name in keys.items()}


class Declared:
    """Declaration of one option of a command.

    Attributes that are not listed are the arguments of :func:`option`.

    Attributes
    ----------
    name : str
        Name of the field and of the keyword argument.
    flags : str
        Name on the command line; ``--on/--off`` for a flag with a negation.
    kind : type
        Type of the value, without None.
    key : str
        Key in the settings of the provenance; empty if the option is not recorded.
    """

    def __init__(self, name: str, info: FieldInfo) -> None:
        notes = cast("dict[str, Any]", info.json_schema_extra)
        self.name = name
        self.flags: str = notes["flag"] or f"--{name.replace('_', '-')}"
        self.metavar: str | None = notes["metavar"]
        self.help = info.description or ""
        self.kind = remove_none(info.annotation)
        self.annotation = info.annotation
        self.required = info.is_required()
        self.default = None if self.required else info.default
        self.limits: dict[str, float] = notes["limits"]
        self.separated: bool = notes["separated"]
        self.written: bool = notes["written"]
        self.key: str = {True: name, False: ""}.get(notes["recorded"], notes["recorded"])
        self.part: str = notes["part"]

    @property
    def flag(self) -> str:
        """Name by which messages refer to the option, such as ``--start-state``."""
        return self.flags.split("/")[0].split(" ")[-1]

    def files(self, value: Any) -> list[Path]:
        """Return the paths of the input files among the values of this option; empty if it has no file."""
        if value is None or self.written or Path not in _leaves(self.kind):
            return []
        if not isinstance(value, list | tuple):
            value = [value]
        return [Path(one) for one in value if isinstance(one, str | Path)]

    def type_text(self) -> str:
        """Return the type and default value of the option as text for a docstring."""
        text = re.sub(r"\b(?:\w+\.)+", "", inspect.formatannotation(self.kind))
        text = re.sub(r"Literal\[(.*?)\]", r"{\1}", text)
        text = text.replace("Union[Path, Any]", "path or its content").replace("Path", "path")
        if self.required or self.default in ((), {}):
            return text
        return f"{text}, default {self.default!r}".replace("default None", "optional")


def remove_none(kind: Any) -> Any:
    """Remove None from the alternatives of a type: ``float | None`` becomes ``float``."""
    if get_origin(kind) in (Union, UnionType):
        return Union[tuple(one for one in get_args(kind) if one is not type(None))]  # noqa: UP007 - made of a tuple
    return kind


def takes(options: type[Options]) -> Callable[[Callable[..., Returned]], Callable[..., Returned]]:
    """Decorate a function so that it takes the options of a class as keyword arguments.

    The function as it is written has one argument ``options``, an object of the class. The caller of the
    decorated function passes each option as a keyword argument, or such an object as ``options=...``.
    Signature and docstring list all options. An unknown option is an error, with the most similar name as a
    hint. Messages name arguments in place of options, unless the function is called from the command line.
    """

    def decorate(function: Callable[..., Returned]) -> Callable[..., Returned]:
        signature = inspect.signature(function)
        own = [p for p in signature.parameters.values() if p.name != "options"]
        keywords = {p.name for p in own}

        arguments = {"-o": "output"}
        for entry in options.declarations().values():
            on, _, off = entry.flags.partition("/")
            arguments |= {on: entry.name, off: f"{entry.name}=False"}

        @functools.wraps(function)
        def call(*args: Any, **given: Any) -> Returned:
            mine = {name: given.pop(name) for name in list(given) if name in keywords}
            if isinstance(mine.get("output"), str):
                mine["output"] = Path(mine["output"])
            known = [*options.model_fields, *sorted(keywords)]
            if "progress" in keywords:
                mine.setdefault("progress", automatic)
            with name_arguments(arguments), explain_types(function, args), reading.record(mine.get("output")):
                if isinstance(given.get("options"), options) and len(given) == 1:
                    return function(*args, **given, **mine)
                for name in given:
                    if name not in known:
                        hint = suggestion(name, known)
                        raise UsageError(f"{function.__name__} has no option '{name}'", hint=hint)
                return function(*args, options=options.of(given), **mine)

        positional = [p for p in own if p.kind is not p.KEYWORD_ONLY]
        shown = [
            inspect.Parameter(
                entry.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if entry.required else entry.default,
                annotation=entry.annotation,
            )
            for entry in options.declarations().values()
        ]
        rest = [p for p in own if p.kind is p.KEYWORD_ONLY]
        rest = [p.replace(default=automatic) if p.name == "progress" else p for p in rest]
        call.__signature__ = signature.replace(parameters=[*positional, *shown, *rest])  # type: ignore[attr-defined]
        call.options = options  # type: ignore[attr-defined]
        call.__doc__ = _document_options(function.__doc__, options, [p.name for p in rest])
        return call

    return decorate


#: Names of the further classes that are accepted for a class that an annotation names.
ALSO = {
    "LogLike": ("str", "Path", "Log", "DataFrame"), "Mapping": ("dict",), "Array": ("ndarray",),
    "float": ("int",), "None": ("NoneType",),
}  # fmt: skip


@contextmanager
def explain_types(function: Callable[..., Any], args: Sequence[Any]) -> Iterator[None]:
    """Convert an exception in the ``with`` block into a :class:`UsageError` if an argument has a wrong type.

    Parameters
    ----------
    function : callable
        Function whose annotations and docstring state the types of its arguments.
    args : sequence
        Positional arguments with which the function is called.
    """
    try:
        yield
    except SwimidError:
        raise
    except Exception as error:
        for name, value in zip(inspect.signature(function).parameters, args, strict=False):
            wanted = set(re.findall(r"\w+", str(inspect.get_annotations(function).get(name, "Any"))))
            wanted |= {kind for word in wanted & ALSO.keys() for kind in ALSO[word]}
            several = isinstance(value, list | tuple) and "Sequence" in wanted
            for one in value if several else [value]:
                kinds = {kind.__name__ for kind in type(one).__mro__}
                if "Any" not in wanted and not kinds & wanted:
                    raise _wrong_type(function, name, one, wanted) from error
        raise


def _wrong_type(function: Callable[..., Any], name: str, value: Any, wanted: set[str]) -> UsageError:
    """Return the error for an argument of a wrong type. The hint is the description in the docstring."""
    text = inspect.getdoc(function) or ""
    match = re.search(rf"^{name} : (.+)\n((?:    .+\n?)+)", text, re.MULTILINE)
    kind, about = match.groups() if match else (" or ".join(sorted(wanted)), "")
    hint = re.sub(r":\w+:`~?(.+?)`|``(.+?)``", r"\1\2", " ".join(about.split()))
    if "TrialSet" in wanted and type(value).__name__ in ("DataFrame", "Log"):
        hint = "swimid.load([{'log': table, ...}], experiment=..., robot=...) makes trials of tables"
    text = f"{function.__name__} takes {name} as {kind}, not as {type(value).__name__}"
    return UsageError(text, hint=hint or None)


def _document_options(text: str | None, options: type[Options], rest: Sequence[str]) -> str | None:
    """Add descriptions of the options to the section Parameters of the docstring of a function.

    The descriptions are placed before the arguments ``rest``.
    """
    if text is None:
        return None
    lines = inspect.cleandoc(text).splitlines()
    begin = lines.index("Parameters") + 2
    heads = [k for k in range(begin, len(lines) - 1) if set(lines[k + 1]) == {"-"}]
    end = min(heads, default=len(lines) + 1) - 1
    place = next((k for k in range(begin, end) if lines[k].split(" :")[0] in rest), end)
    entries = []
    for entry in options.declarations().values():
        entries += [f"{entry.name} : {entry.type_text()}", f"    {entry.help}"]
    return "\n".join([*lines[:place], *entries, *lines[place:]])


def _leaves(kind: Any) -> list[Any]:
    """Return the innermost types of a nested type, such as ``str`` and ``Path`` of ``list[str | Path]``."""
    return [leaf for one in get_args(kind) for leaf in _leaves(one)] or [kind]


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | int | float):
        return value
    return str(getattr(value, "name", type(value).__name__))


def _refusal(options: type[Options], error: ValidationError) -> SwimidError:
    """Convert the validation error of pydantic for a class of options into an error of swimid.

    If there are several problems, the first one is reported.
    """
    problem = error.errors()[0]
    raised = problem.get("ctx", {}).get("error")
    if isinstance(raised, SwimidError):
        return raised
    name = str(problem["loc"][0])
    if problem["type"] == "missing":
        return UsageError(f"the option '{name}' is missing", hint=options.declarations()[name].help)
    value = f"{problem.get('input')!r:.60}"
    return UsageError(f"{name}: {value} is not allowed: {describe_problem(problem)}")


#: Description of the allowed values for each type of validation error of pydantic.
ALLOWED = {
    **dict.fromkeys(("float_parsing", "float_type"), "a number is needed"),
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float"), "a whole number is needed"),
    **dict.fromkeys(("bool_parsing", "bool_type"), "true or false is needed"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list is needed"),
    **dict.fromkeys(("dict_type", "mapping_type", "model_type"), "'key: value' lines are needed"),
    "missing": "this key is missing",
    "extra_forbidden": "this key is unknown",
    "string_type": "a text is needed",
    "finite_number": "a finite number is needed",
    "literal_error": "allowed are {expected}",
    "greater_than": "it must be greater than {gt:g}",
    "greater_than_equal": "it must be at least {ge:g}",
    "less_than": "it must be less than {lt:g}",
    "less_than_equal": "it must be at most {le:g}",
    "too_short": "at least {min_length} entries are needed",
    "too_long": "at most {max_length} entries are allowed",
}


def describe_problem(problem: Any) -> str:
    """Return a description of the allowed values, from a validation error of pydantic."""
    message = problem["msg"]
    text = ALLOWED.get(problem["type"], f"{message[0].lower()}{message[1:]}")
    return text.format(**problem.get("ctx", {})) if problem["type"] in ALLOWED else text


# ---------------------------------------------------------------- options that several commands share


#: Type of the option ``--start-state``. ``auto``: the log shows whether a trial starts at rest. ``rest``:
#: trials are assumed to start at rest. ``estimate``: the fit estimates the initial state of each trial.
StartState = Literal["auto", "rest", "estimate"]


def fix_option() -> Any:
    """Return the declaration of the option ``--fix``, which holds parameters at a value."""
    return option({}, flag="--fix", metavar="NAME=VALUE", help="Hold a parameter at a value.")


def free_option() -> Any:
    """Return the declaration of the option ``--free``, which frees parameters that are fixed by default."""
    return option((), flag="--free", metavar="NAME", help="Estimate a parameter that is fixed by default.")


def bounds() -> Any:
    """Return the declaration of the option ``--bounds``, which replaces the bounds of parameters."""
    return option({}, metavar="NAME=LOW,HIGH", help="Change a parameter's bounds.")


def own_experiments() -> Any:
    """Return the declaration of the option ``--experiment``, which reads experiments that a user defines."""
    help = "Python file with the experiment of one's own that the trials file names. Repeatable."
    return option((), flag="--experiment", metavar="FILE", help=help, recorded=False)


def jobs(help: str = "Threads; default one per processor.") -> Any:
    """Return the declaration of the option ``--jobs`` for the number of threads.

    The number of threads changes no result and is not recorded.
    """
    return option(None, ge=1, help=help, recorded=False)
