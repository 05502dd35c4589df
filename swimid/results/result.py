"""Base classes of the results that commands return, functions for their text, and reading of results."""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from swimid.commands import COMMAND_SPECS, KINDS
from swimid.errors import InputError, Named, UnknownName, UsageError, nearest, suggestion
from swimid.files import atomic, provenance, tabular, yamlio
from swimid.files.provenance import paths_of
from swimid.notices import warn
from swimid.options import explain_types
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.next_command import format_command

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    from swimid.files.yamlio import ResultFile

File = TypeVar("File", bound="ResultFile")

#: Result class of each file format. The key is the name of the format, such as ``gap`` for ``swimid-gap/1``.
#: A class adds itself when it is defined.
_CLASSES: dict[str, type[FileResult[Any]]] = {}
#: Modules with the classes of parameter results and of log results, which several packages make.
PARAMETERS, LOG = "swimid.results.parameters", "swimid.kinematics.logged"
LOG_ENDINGS = (".csv", *tabular.PARQUET_ENDINGS)

#: Maximum width of a line on a terminal, and minimum width to which the texts of a table column may be
#: shortened, characters.
WIDTH, MIN_CUT = 100, 16
#: Pattern of a table cell that counts as a number: a number as :mod:`swimid.results.numbers` writes it, a
#: dash, or an empty text.
_NUMBER = re.compile(r"(> )?[(−-]?\d[\d.]*( ± [\d.]+)?\)?( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?( ?[°%])?|–|")

#: Members of results that the commands and reports use, and that :func:`dir` does not list.
_INTERNAL = frozenset((
    "bare", "content", "ending", "exit_status", "file_type", "keys", "kind", "leads_page", "next_command",
    "next_step", "of", "text", "write_output",
))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a command: its content, its evidence (verdict, checks, figures), and the files written.

    Files are written by :meth:`save`, or by the function that computes the result if ``output`` is given.

    Attributes
    ----------
    command : str
        Command that gives the same result, such as ``"fit-drag"``.
    text : str
        Text that the command prints; if empty, the command prints a summary of the evidence.
    data : dict
        Content of the result as plain data (``--json``), at full precision.
    outputs : sequence of Path
        Files written so far.
    evidence : Evidence or None
        Verdict, checks, tables and figures as data; None for a result without evidence (a report, a schema).
    document : object
        Content of the result file: a parameter file, a gap file, a log.
    verdict : str
        ``"good"``, ``"caution"`` or ``"bad"``; empty without evidence.
    warnings : DataFrame
        Warnings raised during the computation, with the columns ``code`` and ``text``.
    figure_names : list of str
        Names of the figures that :meth:`plot` draws.

    Examples
    --------
    >>> import swimid
    >>> result = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> isinstance(result, Result), result.verdict, set(result.checks()["verdict"])
    (True, 'good', {'pass'})
    """

    command: str
    text: str = ""
    data: dict[str, Any] = field(default_factory=dict)
    outputs: Sequence[Path] = ()
    evidence: ev.Evidence | None = None
    document: Any = None

    #: Name that reports give to results of this class, such as ``Parameter file``.
    kind: ClassVar[str] = "Result"
    #: Extension of the default name of a result file, which is used until the file is written.
    ending: ClassVar[str] = ".yaml"
    #: Whether a report of several results begins with the verdict of this result.
    leads_page: ClassVar[bool] = False
    #: Command that a user may run next. ``{file}`` stands for the result file, ``{trials}`` and ``{params}``
    #: for two of its inputs, ``{data[key]}`` for a name in :attr:`data`, ``{free[gap.yaml]}`` for an output.
    next_step: ClassVar[Any] = ""

    @property
    def exit_status(self) -> int:
        """Exit status of the command that prints this result."""
        return 0

    def summary(self) -> str:
        """Return a summary of the result in plain text, as the command prints it."""
        if self.text or self.evidence is None:
            return self.text
        shown = self.content()
        facts = "; ".join(f"{name[:1].lower()}{name[1:]} {value}" for name, value in shown.facts.items())
        parts = [shown.title, *filter(None, [_wrap(facts)])]
        for table in [table for table in shown.tables if not table.folded][:1]:
            parts += ["", table_text(table)]
        if shown.notes:
            parts += ["", *(_wrap(note) for note in shown.notes)]
        word = (shown.verdict.word or shown.verdict.level).upper()
        verdict = f"{word}: {shown.verdict.text} {ev.count_checks(shown.checks)}".rstrip()
        return "\n".join([*parts, "", textwrap.fill(verdict, WIDTH, break_on_hyphens=False)])

    def next_command(self, file: str | Path, folder: Path = Path()) -> str:
        """Return the command that a user may run next on this result; empty if there is none.

        All its names are quoted for the shell, and its outputs replace no file.

        Parameters
        ----------
        file : path
            Path of the result file from ``folder``.
        folder : Path
            Folder in which the command is typed. This folder, the folder of the result file, or a folder
            above the latter must contain the inputs of the result. Without the inputs there is no command.
        """
        return format_command(self, file, folder)

    def content(self) -> ev.Evidence:
        """Return the content of a report on the result: its evidence, with facts and tables of its file.

        The verdict on a result file without evidence is caution or bad.
        """
        shown = self.evidence or self.bare()
        facts = {**self._own_facts(), **shown.facts}
        if shown.provenance.get("simulated"):
            facts = {"Data": "simulated", **facts}
        own = {
            "tables": [*self._own_tables(), *shown.tables],
            "facts": facts,
            "notes": [*self._own_notes(), *shown.notes],
        }
        return shown.model_copy(update=own)

    @property
    def path(self) -> Path:
        """Path of the result file, or the default name of a file that is not written yet."""
        unwritten = Path((self.command or self.kind).replace(" ", "-") + self.ending)
        written = [path for path in self.outputs if path.suffix == self.ending]
        return next(iter([*written, *self.outputs, unwritten]))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the result as plain data at full precision, as ``--json`` prints it."""
        return self.data

    @property
    def verdict(self) -> str:
        """Level of the verdict: ``"good"``, ``"caution"`` or ``"bad"``; empty if there is no evidence."""
        return "" if self.evidence is None else self.evidence.verdict.level

    @property
    def warnings(self) -> pd.DataFrame:
        """Table of the warnings of the computation, with their code (``docs/warnings.md``) and text."""
        return _frame(["code", "text"], [[n.code, n.text] for n in self._list_evidence("notices")])

    def checks(self) -> pd.DataFrame:
        """Return a table of all checks, with the name, value, limit and verdict of each check."""
        names = list(ev.Check.model_fields)
        return _frame(
            names, [[getattr(check, name) for name in names] for check in self._list_evidence("checks")]
        )

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the tables that a report shows for the result. The key is the id of the table."""
        return Named({table.id: _frame(table.columns, table.rows) for table in self.content().tables})

    @property
    def figure_names(self) -> list[str]:
        """Names of the figures of the result that :meth:`plot` draws."""
        return [figure.id for figure in self._list_evidence("figures")]

    def figures(self) -> dict[str, Canvas]:
        """Draw the figures that a report shows for the result. The key is the id of the figure."""
        from swimid.results import drawing

        return Named({figure.id: drawing.canvas([figure]) for figure in self._list_evidence("figures")})

    def plot(self, name: str, axes: Axes | Sequence[Axes] | None = None) -> Axes | list[Axes]:
        """Draw one figure of the result. A notebook shows the figure, and ``pyplot.savefig`` saves it.

        Parameters
        ----------
        name : str
            Name of the figure, one of :attr:`figure_names`.
        axes : matplotlib Axes or sequence of Axes, optional
            Axes to draw on, one for each panel; by default the axes of a new figure.

        Returns
        -------
        Axes or list of Axes
            A list if the figure has several panels.

        Raises
        ------
        UsageError
            If there is no such figure, or if the number of axes is not the number of panels.
        """
        from swimid.results import drawing

        figures = {figure.id: figure for figure in self._list_evidence("figures")}
        if name not in figures:
            raise UnknownName(f"there is no figure '{name}'", hint=suggestion(name, list(figures)))
        figure = figures[name]
        if axes is None:
            from matplotlib import pyplot

            drawn = list(drawing.canvas([figure], new=pyplot.figure).axes)
        else:
            given = list(np.atleast_1d(np.asarray(axes, dtype=object)).ravel())
            if len(given) != len(figure.panels):
                raise UsageError(f"'{name}' has {len(figure.panels)} panels: give as many axes")
            slots = drawing.slots_of(figure)
            for panel, place in zip(figure.panels, given, strict=True):
                drawing.paint(place, panel, slots)
            drawn = given
        if len(drawn) == 1:
            return drawn[0]
        return drawn

    def save(self, path: str | Path) -> Self:
        """Write the result file and its evidence file, both or neither.

        Returns
        -------
        Result
            Copy of this result with the written files in :attr:`outputs`.

        Raises
        ------
        InputError
            If the folder does not exist or cannot be written.
        UsageError
            If this result cannot be written to a file, or if the path is one of its inputs.
        """
        inputs = paths_of((self.evidence or self.bare()).provenance)
        target = atomic.check_writable(Path(path), inputs=inputs)
        for owner in (self.document, self.evidence):
            provenance.rename(getattr(owner, "provenance", {}), target)
        with atomic.write_together():
            written = self._write(target)
            if self.evidence is not None and not atomic.is_device(target):
                made_for = {"result": target.name, "sha256": self.document.digest()}
                ev.write(ev.sidecar(target), self.evidence.model_copy(update=made_for))
                written.insert(1, ev.sidecar(target))
        return replace(self, outputs=[*self.outputs, *written])

    def write_output(self, output: str | Path | None) -> Self:
        """Return this result, after it is written to the file ``output`` if that is given."""
        if output is None:
            return self
        return self.save(output)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result file and its evidence file.

        Raises
        ------
        InputError
            If the result file is missing, or if a file is invalid.
        """
        document = cls._read(path)
        loaded = cls("", "", cls._plain(document), [Path(path)], document=document)
        if not ev.sidecar(path).exists():
            return loaded
        evidence = _of_document(ev.read(ev.sidecar(path)), document, Path(path).name)
        return replace(loaded, command=evidence.command, evidence=evidence)

    def _own_facts(self) -> dict[str, str]:
        """Return the facts that a report takes from the content of the result file, by name."""
        return {}

    def _own_notes(self) -> list[str]:
        """Return the notes (sentences) that a report takes from the content of the result file."""
        return []

    def _own_tables(self) -> list[ev.Table]:
        """Return the tables that a report makes from the content of the result file."""
        return []

    @classmethod
    def _plain(cls, document: Any) -> dict[str, Any]:
        """Return the content of a result file as plain data. It is empty unless a subclass overrides this."""
        return {}

    def bare(self) -> ev.Evidence:
        """Return a verdict and a table of the result file, for use if the evidence file is missing."""
        return ev.Evidence(
            command=self.command,
            title=f"{self.kind} {self.path.name}",
            verdict=ev.Verdict(level="caution", text="No evidence file, so its checks cannot be shown."),
            tables=[ev.leaf_table("content", "Content of the file", self.data)],
            provenance=getattr(self.document, "provenance", {}),
        )

    @classmethod
    def _read(cls, path: str | Path) -> Any:
        raise UsageError(f"{path} cannot be read as {cls.__name__}, which has no file format")

    def _write(self, path: Path) -> list[Path]:
        hint = "use its text, .summary()"
        raise UsageError(f"the result of {self.command} cannot be written to a file", hint=hint)

    def _list_evidence(self, what: str) -> Sequence[Any]:
        """Return the checks, tables, figures or notices of the evidence, as selected by ``what``.

        The list is empty for a result without evidence.
        """
        return getattr(self.evidence, what, [])

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # Replace the default ``__repr__`` of a dataclass, because it prints all fields including large
        # arrays.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        parts = [self.verdict, f"{len(self.figure_names)} figures"]
        return f"<{type(self).__name__} of {self.command}: {', '.join(filter(None, parts))}>"

    def __str__(self) -> str:
        return self.summary()

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name[0] != "_" and name not in _INTERNAL]

    def _repr_html_(self) -> str:
        return notebook_html(self)


def notebook_html(result: Result) -> str:
    """Return the HTML that a notebook shows: summary, figures (folded after the first), folded checks."""
    from swimid.results import drawing

    shown = f"<pre>{html.escape(result.summary())}</pre>"
    figures = [] if result.evidence is None else result.evidence.figures
    for k, figure in enumerate(figures):
        picture = drawing.for_notebook(figure)
        if k:
            picture = f"<details><summary>{html.escape(figure.title)}</summary>{picture}</details>"
        shown += picture
    if result.evidence is not None and result.evidence.checks:
        table = result.checks().to_html(index=False, border=0)
        shown += f"<details><summary>checks</summary>{table}</details>"
    return f"<div>{shown}</div>"


class Text(Result):
    """Result whose ``document`` is the text of a file: a page, a draft or an exported model."""

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        return [path]

    def _repr_html_(self) -> str:
        text = str(self.document)
        if text.startswith("<!DOCTYPE html>"):
            frame = "width:100%;height:40em;border:0"
            return f'<iframe srcdoc="{html.escape(text)}" style="{frame}"></iframe>'
        return f"<pre>{html.escape(text)}</pre>"


def _of_document(evidence: ev.Evidence, document: Any, name: str) -> ev.Evidence:
    """Return the evidence of a result file, with a lower verdict if the evidence does not fit the file.

    Warns
    -----
    SWM052
        The file was edited, or its evidence belongs to another result.
    """
    in_memory = evidence.model_copy(update={"result": "", "sha256": ""})
    if evidence.sha256 == document.digest():
        return in_memory
    text = (
        f"{name} was edited or replaced after the evidence file was made: figures, checks and tables may "
        "not describe the result; run the command again"
    )
    warn("SWM052", text)
    said = f"The file was changed after this verdict: {evidence.verdict.text}"
    notices = [*evidence.notices, ev.NoticeRecord(code="SWM052", text=text)]
    verdict = evidence.verdict.lower_to("caution", said)
    return in_memory.model_copy(update={"verdict": verdict, "notices": notices})


def _frame(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([list(row) for row in rows], columns=list(columns))


class FileResult(Result, Generic[File]):
    """Base class of results that are stored in a YAML file. Each subclass has its own file format."""

    file_type: ClassVar[type[ResultFile]]
    next_step = "swimid report {file} -o {free[report.html]}"

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.kind = cls.file_type.kind.capitalize()
        _CLASSES[_format_name(cls.file_type.model_fields["format"].default)] = cls

    @property
    def file(self) -> File:
        """Content of the result file that :meth:`save` writes."""
        file: File = self.document
        return file

    @classmethod
    def of(cls, file: File, evidence: ev.Evidence) -> Self:
        """Create a result in memory from the content of its file and its evidence."""
        return cls(evidence.command, "", cls._plain(file), evidence=evidence, document=file)

    @classmethod
    def _plain(cls, document: Any) -> dict[str, Any]:
        return dict(document.model_dump(mode="json"))

    @classmethod
    def _read(cls, path: str | Path) -> Any:
        return cls.file_type.read(path)

    def _write(self, path: Path) -> list[Path]:
        self.document.write(path)
        return [path]


# ---------------------------------------------------------------- text for a terminal


def _wrap(text: str) -> str:
    return textwrap.fill(text, WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)


def cell_text(value: Any) -> str:
    """Return the text of a table cell: numbers with four significant digits, an empty cell as a dash."""
    if isinstance(value, str):
        return value or numbers.MISSING_TEXT
    return numbers.format_number(value)


def is_numeric(table: ev.Table) -> list[bool]:
    """Return for each column of a table whether all its cells are numbers. Such a column is right-aligned."""
    right = []
    for k in range(len(table.columns)):
        column = [row[k] for row in table.rows]
        right.append(all(not isinstance(v, bool) and _NUMBER.fullmatch(cell_text(v)) for v in column))
    return right


def table_text(table: ev.Table) -> str:
    """Return a table as text in aligned columns for a terminal.

    If the lines are too long, the texts of a column are shortened, or the last columns are left out.
    """
    rows = [table.columns, *([cell_text(value) for value in row] for row in table.rows)]
    right, left = is_numeric(table), WIDTH
    columns: list[list[str]] = []
    for k, column in enumerate(zip(*rows, strict=True)):
        width = max(map(len, column))
        left -= width + 2
        if left < 0:
            width += left
            if right[k] or width < MIN_CUT:
                break
            column = tuple(textwrap.shorten(cell, width, placeholder="…") for cell in column)
        columns.append([f"{cell:{'<>'[right[k]]}{width}}" for cell in column])
        if left <= 0:
            break
    return "\n".join(f"  {'  '.join(line)}".rstrip() for line in zip(*columns, strict=True))


# ---------------------------------------------------------------- results in files


def load_result(path: str | Path) -> Result:
    """Read any result that swimid wrote, together with its evidence file.

    Parameters
    ----------
    path : path
        A parameter, comparison, gap, power, sensitivity, map, rule or gait file, or a log.

    Returns
    -------
    Result
        Result, an object of the class that belongs to the format of the file.

    Raises
    ------
    InputError
        If the file is not a result, or is invalid.

    Examples
    --------
    >>> load_result("sample_logs/gap/params.yaml").parameters.loc["c_ma", "unit"]
    '1'
    """
    with explain_types(load_result, [path]):
        path = Path(path)
    ending = path.suffix.lower()
    if path.name.endswith(".evidence.json"):
        stem = path.name.removesuffix(".evidence.json")
        there = [e for e in (".yaml", ".yml", *LOG_ENDINGS) if path.with_name(stem + e).exists()]
        result = stem + (there or [".yaml"])[0]
        raise InputError("is an evidence file, not a result", file=path, hint=f"name the result: {result}")
    if ending in LOG_ENDINGS:
        log: Result = import_module(LOG).Logged.load(path)
        return log
    if ending not in (".yaml", ".yml"):
        allowed = ", ".join([".yaml", *LOG_ENDINGS])
        raise InputError(f"is no result file; the name must end in one of {allowed}", file=path)
    form = yamlio.load(path).get("format")
    name = _format_name(str(form))
    if name not in list_result_formats():
        reason = f"the format '{form}' is not a format of results"
        if form is None:
            reason = "has no 'format'"
        hint = suggestion(name, list_result_formats(), "known")
        if close := nearest(name, list_result_formats()):
            hint = f"did you mean '{class_of(close).file_type.model_fields['format'].default}'?"
        raise InputError(reason, file=path, line=1, column="format", hint=hint)
    return class_of(name).load(path)


def _format_name(form: str) -> str:
    return form.removeprefix("swimid-").partition("/")[0]


def list_result_formats() -> list[str]:
    """Return the names of the formats of all result files, such as ``gap`` for ``swimid-gap/1``."""
    names = [
        name for spec in COMMAND_SPECS.values() for name in spec.usage.makes.split("|") if name not in KINDS
    ]
    return ["parameters", *names]


def class_of(name: str) -> type[FileResult[Any]]:
    """Return the result class of a format, and import the module that defines the class if necessary."""
    import_module(PARAMETERS)
    for spec in COMMAND_SPECS.values():
        if name not in _CLASSES and name in spec.usage.makes.split("|"):
            spec.run()
    return _CLASSES[name]
