"""Plan file (``swimid-plan/1``) of a batch, and its resolution into items with their command lines.

A plan names files by globs and states the steps for these files. A step is a command of swimid with its
options as they are typed, or ``trials``, which writes a trials file for the logs of the item. Files in a plan
are relative to its folder. The resolved plan names files relative to the folder of each item.
"""

from __future__ import annotations

import fnmatch
import glob
import hashlib
import json
import os
import re
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args, get_origin

import click
from pydantic import BaseModel, Field, field_validator

import swimid
from swimid.cli.main import check_words
from swimid.commands import COMMAND_SPECS, CommandSpec
from swimid.errors import InputError, SwimidError, UsageError, suggestion
from swimid.files import atomic, yamlio
from swimid.options import Declared

#: Name of the step that writes a trials file for the logs of an item.
TRIALS = "trials"
#: Extension of the output file of a command, by the kind of file that the command makes.
OUTPUT_ENDINGS = {
    "log": ".csv",
    "parameters": ".yaml",
    "setup": ".yaml",
    "result": ".yaml",
    "picture": ".svg",
    "page": ".html",
}
#: Placeholders of the positional argument in the help of commands that take one input file at a time.
EACH = ("VIDEO", "FILE", "IMU")
#: Kind of file, by option, that an earlier step supplies if the plan does not state the required option.
TAKEN = {"params": "parameters", "setup": "setup"}
#: Maximum length of the name of an item, which is the name of its folder, and of a result, bytes. The limit
#: leaves room for the suffixes that commands add, because file systems allow 255 bytes.
MAX_NAME = 120

Steps = list[tuple[str, dict[str, Any]]]


def _step(value: Any) -> tuple[str, dict[str, Any]]:
    """Return the command and the options of a step, which a plan states as a name or as a mapping."""
    if isinstance(value, str):
        return value, {}
    if isinstance(value, Mapping) and len(value) == 1:
        (name, options), *_ = value.items()
        if options is None or isinstance(options, Mapping):
            return str(name), dict(options or {})
    raise ValueError("a step is a command, or 'command: {option: value}'")


def _steps(value: Any) -> Any:
    if value is not None and not isinstance(value, list):
        raise ValueError("steps are a list: begin the line of each step with '- '")
    return value and [_step(one) for one in value]


class ItemLimits(yamlio.Document):
    """Limit of one item."""

    #: Maximum time of an item, s.
    time_s: float = Field(default=14400.0, gt=0, le=1e8)


class ItemGroup(yamlio.Document):
    """Files that go through the same steps. Each file is an item, or each folder of files is an item."""

    files: list[str] = Field(min_length=1)
    name: str = ""
    #: Patterns of files that are left out.
    exclude: list[str] = []
    #: Whether the files of one folder are one item.
    together: bool = False
    steps: Steps | None = None

    @field_validator("files", "exclude", mode="before")
    @classmethod
    def _as_list(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value

    _read_steps = field_validator("steps", mode="before")(_steps)


class PlanFile(yamlio.Document):
    """Content of a plan file."""

    kind: ClassVar[str] = "plan file"

    format: Literal["swimid-plan/1"]
    limits: ItemLimits = ItemLimits()
    #: Options of each command that apply in every group.
    defaults: dict[str, dict[str, Any]] = {}
    #: Steps of the groups that state no steps.
    steps: Steps = []
    items: list[ItemGroup] = Field(min_length=1)
    #: Options of each command for files whose path matches a pattern. If several patterns match, the last
    #: wins.
    overrides: dict[str, dict[str, dict[str, Any]]] = {}

    _read_steps = field_validator("steps", mode="before")(_steps)


class ItemStep(BaseModel):
    """Step of an item: command lines to run, or the text of a file to write.

    The command lines name files relative to the folder of the item.
    """

    name: str
    command: str
    outputs: list[str]
    argv: list[list[str]] = []
    text: str = ""
    #: Dotted names of numbers in the ``--json`` output that the summary shows. ``*`` stands for any name.
    metrics: list[str] = []


class Item(BaseModel):
    """Item of a run: one or several files that go through the steps together.

    ``files`` are relative to the folder of the plan, and ``inputs`` to the folder of the item. ``root`` is
    the path from the folder of the item to the folder of the plan.
    """

    id: str
    root: str
    group: str
    files: list[str]
    inputs: list[str]
    steps: list[ItemStep]

    def digest(self) -> str:
        """Return the SHA-256 of the steps and of the version of swimid."""
        text = json.dumps([[step.model_dump() for step in self.steps], swimid.__version__], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


class Resolved(BaseModel):
    """Resolved plan: items with their command lines. The folder of a run has it as ``plan.json``."""

    format: Literal["swimid-run/1"] = "swimid-run/1"
    version: str
    plan: str
    #: Path of the plan relative to the folder of the run.
    place: str = ""
    limits: ItemLimits
    items: list[Item]

    @classmethod
    def of_run(cls, run: str | Path) -> Resolved:
        """Read the resolved plan of a run.

        Raises
        ------
        InputError
            If the folder is not the folder of a run, or if its plan is damaged.
        """
        path = Path(run) / "plan.json"
        if not path.is_file():
            raise InputError(
                "is not the folder of a run: it has no plan.json", file=run, hint="swimid batch writes one"
            )
        try:
            return cls.model_validate_json(path.read_bytes())
        except ValueError as error:
            raise InputError("is not the plan of a run", file=path, hint="run swimid batch again") from error


def item_of(run: str | Path, ident: str) -> tuple[Item, ItemLimits]:
    """Read one item of the resolved plan of a run, and the limits of the run.

    The other items are not validated, because their validation takes long in a large run.

    Raises
    ------
    UsageError
        If the run has no such item, because the plan was changed in the meantime.
    """
    plan = json.loads((Path(run) / "plan.json").read_bytes())
    found = next((item for item in plan["items"] if item["id"] == ident), None)
    if found is None:
        raise UsageError(f"the plan of {run} was replaced and lacks {ident}: run the new plan")
    return Item.model_validate(found), ItemLimits.model_validate(plan["limits"])


def folder_of(run: Path, ident: str) -> Path:
    """Return the folder of an item in the folder of its run."""
    return run / "items" / ident


def is_linked(folder: Path) -> bool:
    """Return whether the folder of an item, or the folder of all items, is a symbolic link."""
    return folder.is_symlink() or folder.parent.is_symlink()


def resolve(path: Path, run: Path, data: Any = None) -> Resolved:
    """Read a plan file, and return its items with all command lines.

    Parameters
    ----------
    path : Path
        Plan file.
    run : Path
        Folder of the run.
    data : mapping, optional
        Content of a plan that is not written yet.

    Raises
    ------
    InputError
        If the plan is invalid: a pattern that matches no files, an unknown command or option, or a step
        without input. The message names the line of the plan.
    """
    if data is None:
        data = yamlio.load(path)
    plan = yamlio.validate(data, PlanFile, path)
    return _Resolution(path, data, plan, run.resolve(), path.parent.resolve()).resolve_items()


@dataclass
class _Resolution:
    """Resolution of a plan file. ``data`` is its content with line numbers."""

    path: Path
    data: Any
    plan: PlanFile
    run: Path
    #: Folder of the plan. Symbolic links in the paths of plan and run are resolved.
    root: Path
    #: Patterns of the overrides that matched a file, and commands that appear in a group.
    matched: set[str] = field(default_factory=set)
    commands: set[str] = field(default_factory=set)
    #: Pairs of command and options whose values have been checked.
    checked: set[str] = field(default_factory=set)

    def error(self, message: str, *place: Any, hint: str | None = None) -> InputError:
        line = yamlio.line_of(self.data, place)
        return InputError(message, file=self.path, line=line, hint=hint)

    def resolve_items(self) -> Resolved:
        named: list[tuple[int, str, list[str]]] = []
        for number, group in enumerate(self.plan.items):
            for files in self.find_files(number, group):
                what = files[0]
                if group.together:
                    what = os.path.dirname(files[0]) or "."
                named.append((number, _inside(what, group.files), files))
        counts = Counter(name for _, name, _ in named)
        named = [(number, self.distinct(number, name, counts), files) for number, name, files in named]
        for name, count in Counter(name for _, name, _ in named).items():
            if count > 1:
                raise self.error(
                    f"{count} items would have the name {name}",
                    "items",
                    hint="divide them into several groups",
                )
        idents = _file_names([name for _, name, _ in named])
        items = [
            self.item(number, ident, files) for ident, (number, _, files) in zip(idents, named, strict=True)
        ]
        for pattern, commands in self.plan.overrides.items():
            if pattern not in self.matched:
                hint = "patterns are matched with the paths of the files as the plan names them"
                raise self.error(f"'{pattern}' matches no file of an item", "overrides", pattern, hint=hint)
            self.insist_used(commands, "overrides", pattern)
        self.insist_used(self.plan.defaults, "defaults")
        return Resolved(
            version=swimid.__version__,
            plan=self.path.name,
            place=_relative(self.root / self.path.name, self.run),
            limits=self.plan.limits,
            items=items,
        )

    def distinct(self, number: int, name: str, counts: Mapping[str, int]) -> str:
        """Return the name of an item, with the name of its group if several groups use this item name."""
        if counts[name] == 1:
            return name
        group = self.plan.items[number].name
        if not group or sum(group == other.name for other in self.plan.items) > 1:
            hint = "give each of these groups a 'name' of its own"
            raise self.error(f"{name} is an item of two groups", "items", number, hint=hint)
        return f"{group}/{name}"

    def insist_used(self, commands: Mapping[str, Any], *place: Any) -> None:
        for command in commands:
            if command not in self.commands:
                hint = suggestion(command, sorted(self.commands), "the steps are")
                raise self.error(f"no step is '{command}'", *place, command, hint=hint)

    def find_files(self, number: int, group: ItemGroup) -> Iterator[list[str]]:
        """Yield the files of each item of a group, relative to the folder of the plan.

        A pattern that ends with ``/`` matches folders, for instance folders with the pictures of a film.
        """
        root, own = self.root, self.run
        found: dict[str, str] = {}
        for k, pattern in enumerate(group.files):
            names = [
                name.rstrip("/")
                for name in sorted(_matches(root, pattern))
                if not os.path.realpath(root / name).startswith(f"{own}{os.sep}")
                and (root / name).is_dir() == pattern.endswith("/")
                and not any(fnmatch.fnmatchcase(name, left_out) for left_out in group.exclude)
            ]
            if not names:
                hint = f"patterns are relative to {root}; 'name/' stands for folders"
                raise self.error(f"no file matches '{pattern}'", "items", number, "files", k, hint=hint)
            for name in names:
                if re.search("[\ud800-\udfff]", name):
                    hint = "rename it, or list it under 'exclude'"
                    raise self.error(f"the name {name!a} is not UTF-8", "items", number, hint=hint)
                found.setdefault(os.path.realpath(root / name), name)
        if not group.together:
            yield from ([name] for name in found.values())
            return
        folders: dict[str, list[str]] = {}
        for name in found.values():
            folders.setdefault(os.path.dirname(name), []).append(name)
        yield from folders.values()

    def item(self, number: int, ident: str, files: list[str]) -> Item:
        """Return an item with the command lines of its steps."""
        group = self.plan.items[number]
        given, place = group.steps, ("items", number, "steps")
        if given is None:
            given, place = self.plan.steps, ("steps",)  # type: ignore[assignment]
        if not given:
            raise self.error(
                "the group has no steps", "items", number, hint="add steps to it, or to the plan"
            )
        chain = _Chain(self, folder_of(self.run, ident), files)
        for k, (command, options) in enumerate(given):
            self.commands.add(command)
            chain.add(command, options, (*place, k))
        return Item(
            id=ident,
            root=_relative(self.root, chain.folder),
            group=group.name or group.files[0],
            files=files,
            inputs=sorted(chain.inputs),
            steps=chain.steps,
        )

    def options(self, command: str, options: Mapping[str, Any], file: str) -> dict[str, Any]:
        """Return the options of a step for a file, from the defaults, the step itself and the overrides."""
        merged = {**self.plan.defaults.get(command, {}), **options}
        return merged | self.overridden(command, file)

    def overridden(self, command: str, file: str) -> dict[str, Any]:
        """Return the options of a command that the overrides of the plan state for a file."""
        found: dict[str, Any] = {}
        for pattern, commands in self.plan.overrides.items():
            if fnmatch.fnmatchcase(file, pattern):
                self.matched.add(pattern)
                found |= commands.get(command, {})
        return found


def _inside(name: str, patterns: Sequence[str]) -> str:
    """Return the path of a file relative to the last folder in its pattern before a wildcard.

    A path inside the folder of the plan is returned unchanged.
    """
    if not (os.path.isabs(name) or name.startswith("..")):
        return name
    for pattern in patterns:
        fixed = os.path.dirname(re.split(r"[*?\[]", pattern)[0])
        if fixed and name.startswith(f"{fixed}/"):
            return os.path.relpath(name, os.path.dirname(fixed))
    return name


def _matches(root: Path, pattern: str) -> Iterator[str]:
    """Yield the paths that match a glob. A folder that several links reach is searched once."""
    before, deep, after = re.sub(r"(^|/)\*\*$", r"\1**/*", pattern).partition("**/")
    if not deep or before[-1:] not in ("", "/"):
        yield from glob.glob(pattern, root_dir=root, recursive=True)
        return
    seen: set[str] = set()
    todo = deque(glob.glob(before, root_dir=root) if before else [""])
    while todo:
        name = todo.popleft()
        real = os.path.realpath(root / name)
        if real in seen:
            continue
        seen.add(real)
        found = _matches(root / name, after) if after else [""]
        yield from (os.path.join(name, one) for one in found)
        with suppress(OSError):
            inner = [one for one in os.scandir(real) if os.path.isdir(one) and one.name[0] != "."]
            # Follow symbolic links last, so that a folder is found under its own name.
            todo.extendleft(os.path.join(name, one.name) for one in inner if not one.is_symlink())
            todo.extend(os.path.join(name, one.name) for one in inner if one.is_symlink())


def _relative(path: Path, folder: Path) -> str:
    """Return the path of a file relative to a folder, whose symbolic links are resolved first."""
    if ".." in path.parts:
        path = path.parent.resolve() / path.name
    return Path(os.path.relpath(path, folder)).as_posix()


def _file_names(names: Sequence[str], paths: Sequence[str] | None = None) -> list[str]:
    """Return a distinct file name for each name. A name that is too long or not distinct gets a hash suffix.

    The hash of equal names is computed from ``paths``, which are distinct.
    """
    safe = [atomic.file_names([name], [""])[0] for name in names]
    counts = Counter(name.casefold() for name in safe)
    made = []
    for name, path in zip(safe, paths or names, strict=True):
        if counts[name.casefold()] > 1 or len(name.encode()) > MAX_NAME or not name.strip("."):
            cut = name.strip(".").encode()[: MAX_NAME - 9].decode(errors="ignore")
            name = f"{cut or 'files'}-{hashlib.sha256(path.encode()).hexdigest()[:8]}"
        made.append(name)
    return made


@dataclass
class _Chain:
    """Steps of one item while they are resolved. ``made`` has the outputs so far by kind of file."""

    plan: _Resolution
    folder: Path
    files: list[str]
    steps: list[ItemStep] = field(default_factory=list)
    made: dict[str, list[str]] = field(default_factory=dict)
    inputs: set[str] = field(default_factory=set)
    #: Names of all outputs so far.
    written: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.sources = [self.path_of(name) for name in self.files]

    @property
    def what(self) -> str:
        """Path by which overrides name the item: the path of its file, or of the folder of its files."""
        if len(self.files) == 1:
            return self.files[0]
        return os.path.dirname(self.files[0])

    def path_of(self, name: str) -> str:
        """Return the path of a file relative to the folder of the item, and add the file to the inputs."""
        place = _relative(self.plan.root / name, self.folder)
        self.inputs.add(place)
        return place

    def add(self, command: str, options: Mapping[str, Any], place: tuple[Any, ...]) -> None:
        """Append a step. ``place`` are the keys of the step in the plan."""
        if command == TRIALS:
            self.add_trials(options)
            return
        specs = {name: spec for name, spec in COMMAND_SPECS.items() if spec.section != "Many at once"}
        if command not in specs:
            known = [TRIALS, *(name for name, spec in specs.items() if spec.usage.kind)]
            raise self.plan.error(f"there is no command '{command}'", *place, hint=suggestion(command, known))
        spec = specs[command]
        name = str(options.get("as", command.replace(" ", "-")))
        step = ItemStep(name=name, command=command, outputs=[], metrics=list(spec.usage.metrics))
        words, stems = [(self.argument(spec, place), self.what)], [name]
        if spec.usage.argument in EACH:
            words = [([source], file) for source, file in zip(words[0][0], self.files, strict=True)]
            stems = _file_names([Path(file).stem for file in self.files], self.files)
        for (files, file), stem in zip(words, stems, strict=True):
            typed = self.plan.options(command, options, file)
            output = self.name_output(spec, stem, typed.pop("as", None), place)
            flag = spec.usage.output_flags[0]
            argv = [*command.split(), *files, *self.option_words(spec, typed, place), flag, str(output)]
            self.check(spec, argv[len(command.split()) :], typed, place)
            step.argv.append(argv)
            step.outputs.append(str(output))
        self.steps.append(step)
        self.made.setdefault(spec.usage.kind, []).extend(step.outputs)

    def name_output(self, spec: CommandSpec, stem: str, stated: Any, place: tuple[Any, ...]) -> str:
        """Return the name of the output of a step, with the usual extension if the stated name has none."""
        name = str(stated or stem)
        if Path(name).name != name or name.startswith("."):
            raise self.plan.error(f"'as: {name}' must be the name of a file without a folder", *place)
        if stated is None or not Path(name).suffix:
            if spec.usage.kind not in OUTPUT_ENDINGS:
                hint = "add as: NAME.ENDING"
                raise self.plan.error(f"'{spec.command}' needs a name for its file", *place, hint=hint)
            name += OUTPUT_ENDINGS[spec.usage.kind]
        if name in self.written:
            raise self.plan.error(
                f"two files would be named {name}", *place, hint="give one of them another name: as: NAME"
            )
        self.written.add(name)
        if name.startswith("-"):
            name = f"./{name}"  # A name with a leading dash would be read as an option.
        return name

    def argument(self, spec: CommandSpec, place: tuple[Any, ...]) -> list[str]:
        """Return the files of the positional argument of a command.

        For an import, the files are the logs that tracking has made. A mapping joins other files to these
        logs.
        """
        made = self.made
        if spec.usage.argument == "FILE" and len(made.get("log", [])) == len(self.sources):
            return made.pop("log")
        chosen = {
            **dict.fromkeys(EACH, self.sources),
            "TRIALS": made.get(TRIALS, self.sources)[-1:],
            "LOG...": made.get("log", self.sources),
            "RESULT...": [p for kind in ("log", "parameters", "result") for p in made.get(kind, [])],
            "PARAMS": made.get("parameters", self.sources)[-1:],
        }.get(spec.usage.argument, [])
        if spec.usage.argument == "TRIALS" and TRIALS not in made:
            if "log" in made:
                hint = "a step 'trials: {experiment: ..., robot: ...}' before it writes one"
                raise self.plan.error(f"'{spec.command}' needs a trials file of the logs", *place, hint=hint)
            if len(self.sources) > 1:
                raise self.plan.error(
                    f"'{spec.command}' takes one trials file, and the item has {len(self.sources)} files",
                    *place,
                    hint="make an item of each file: together: false",
                )
        if spec.usage.argument == "RESULT..." and not chosen:
            raise self.plan.error(f"no step before '{spec.command}' makes a result", *place)
        return chosen

    def option_words(
        self, spec: CommandSpec, options: Mapping[str, Any], place: tuple[Any, ...]
    ) -> list[str]:
        """Return the options of a step as words of a command line."""
        declared = spec.model().declarations()
        by_key: dict[str, Declared] = {}
        for entry in declared.values():
            by_key |= dict.fromkeys([entry.name, *re.findall(r"--([\w-]+)", entry.flags)], entry)
        words: list[str] = []
        stated = set()
        for key, value in options.items():
            if key not in by_key:
                hint = suggestion(str(key), sorted(by_key), f"options of {spec.command}")
                raise self.plan.error(
                    f"'{spec.command}' has no option '{key}'", *place, spec.command, key, hint=hint
                )
            entry = by_key[key]
            if entry.name == "pick" and value:
                hint = f"run 'swimid {spec.command} --pick' before, and name its file in the plan"
                raise self.plan.error(
                    f"'{key}' waits for input of a user, and a batch has none",
                    *place,
                    spec.command,
                    key,
                    hint=hint,
                )
            stated.add(entry.name)
            words += _words(entry, key, self.with_paths(entry, value, (*place, spec.command, key)))
        for entry in declared.values():
            if entry.name == "jobs" and "jobs" not in stated:
                words += [entry.flag, "1"]
            if entry.required and entry.name not in stated:
                words += [entry.flag, self.take_output(entry, spec, place)]
        return words

    def take_output(self, entry: Declared, spec: CommandSpec, place: tuple[Any, ...]) -> str:
        """Return the file that a required option takes from an earlier step."""
        made = self.made.get(TAKEN.get(entry.name, ""), [])
        if not made:
            raise self.plan.error(
                f"'{spec.command}' needs '{entry.flag.strip('-')}', and no step before it makes one", *place,
                hint=f"state it: {spec.command}: {{{entry.flag.strip('-')}: FILE}}",
            )  # fmt: skip
        return made[-1]

    def with_paths(self, entry: Declared, value: Any, place: tuple[Any, ...]) -> Any:
        """Replace the files in the value of an option by their paths relative to the folder of the item.

        The plan states a file as the name of the earlier step that makes it, or as a path relative to the
        plan.
        """
        if isinstance(value, list):
            return [self.with_paths(entry, one, place) for one in value]
        if not isinstance(value, str) or entry.written:
            return value
        for step in self.steps:
            if value == step.name and entry.files(value):
                return step.outputs[-1]
        root = self.plan.root
        if entry.files(value):
            if not (root / value).exists():
                steps = ", ".join(step.name for step in self.steps) or "none"
                hint = f"files are relative to {root}; steps before it: {steps}"
                raise self.plan.error(f"there is no file '{value}'", *place, hint=hint)
            return self.path_of(value)
        if "FILE" in (entry.metavar or "") and (root / value).is_file():
            return self.path_of(value)
        return value

    def check(
        self, spec: CommandSpec, argv: list[str], options: Mapping[str, Any], place: tuple[Any, ...]
    ) -> None:
        """Raise an error if a command does not accept the values of its options."""
        key = f"{spec.command} {options}"
        if key in self.plan.checked:
            return
        self.plan.checked.add(key)
        try:
            check_words(spec, argv)
        except (click.UsageError, SwimidError) as error:
            text = error.format_message() if isinstance(error, click.UsageError) else str(error)
            raise self.plan.error(f"{spec.command}: {text}", *place) from error

    def add_trials(self, options: Mapping[str, Any]) -> None:
        """Append the step that writes a trials file with a trial for each log of the item."""
        merged = {**self.plan.plan.defaults.get(TRIALS, {}), **options}
        each = merged.pop("each", {})
        root = self.plan.root
        for key in ("robot", "drag", "table"):
            if isinstance(merged.get(key), str) and (root / merged[key]).is_file():
                merged[key] = self.path_of(merged[key])
        trials = []
        logs = self.made.get("log", self.sources)
        stems = Counter(Path(file).stem for file in self.files)
        for log, file in zip(logs, self.files, strict=True):
            own = self.plan.overridden(TRIALS, file)
            ident = Path(file).stem
            if stems[ident] > 1:
                ident = Path(file).name
            trials.append({"id": ident, "log": log, **each, **own})
        content = {"format": "swimid-trials/1", **merged, "trials": trials}
        name = "trials.yaml"
        self.steps.append(ItemStep(name=TRIALS, command=TRIALS, outputs=[name], text=yamlio.dumps(content)))
        self.made[TRIALS] = [name]


def _words(entry: Declared, key: str, value: Any) -> list[str]:
    """Return the words of a command line for an option and its value in a plan."""
    on, _, off = entry.flags.partition("/")
    if value is None:
        return []
    if entry.kind is bool:
        return list(filter(None, [on if value is not (key in off) else off]))
    is_pair = get_origin(entry.kind) is tuple and get_args(entry.kind)[-1] is not Ellipsis
    values = value
    if isinstance(value, Mapping):
        values = [f"{name}={_word(one)}" for name, one in value.items()]
    elif not isinstance(value, list) or entry.separated or (is_pair and "," in (entry.metavar or "")):
        values = [value]
    elif is_pair:
        return [entry.flag, *map(_word, value)]
    return [word for one in values for word in (entry.flag, _word(one))]


def _word(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_word, value))
    return str(value)
