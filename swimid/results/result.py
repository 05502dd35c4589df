"""Base classes of the results that commands return: an answer together with its evidence."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.notices import warn
from swimid.results import terminal
from swimid.results.evidence import (
    Check,
    Evidence,
    NoticeRecord,
    Table,
    Verdict,
    leaf_table,
    sidecar,
)
from swimid.results.evidence import read as read_evidence
from swimid.results.evidence import write as write_evidence

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    from swimid.files.yamlio import ResultFile
    from swimid.results.evidence import Figure

File = TypeVar("File", bound="ResultFile")


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a command: an answer, the evidence for it, and the files that were written.

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
    evidence: Evidence | None = None
    document: Any = None

    #: Name of this kind of result in reports.
    kind: ClassVar[str] = "Result"
    #: Default ending of the result file.
    ending: ClassVar[str] = ".yaml"

    def summary(self) -> str:
        """Return the answer in plain text, as the command prints it."""
        if self.text or self.evidence is None:
            return self.text
        return terminal.summary(self.content())

    def content(self) -> Evidence:
        """Return the content of a report: the evidence, preceded by facts and tables from the result file.

        Without evidence, the verdict is not better than caution.
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
        """Return the answer as plain data at full precision, as ``--json`` prints it."""
        return self.data

    @property
    def verdict(self) -> str:
        """``"good"``, ``"caution"`` or ``"bad"``; empty for a result without evidence."""
        return "" if self.evidence is None else self.evidence.verdict.level

    @property
    def warnings(self) -> pd.DataFrame:
        """Warnings raised during the computation: ``code``, ``text`` (``docs/warnings.md``)."""
        return _frame(["code", "text"], [[n.code, n.text] for n in self._shown("notices")])

    def checks(self) -> pd.DataFrame:
        """Return a table of all checks: ``name``, ``value``, ``limit``, ``verdict``, ``text``."""
        names = list(Check.model_fields)
        return _frame(names, [[getattr(check, name) for name in names] for check in self._shown("checks")])

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the tables of the report by their id."""
        return {table.id: _frame(table.columns, table.rows) for table in self.content().tables}

    @property
    def figure_names(self) -> list[str]:
        """Ids of the figures that :meth:`plot` draws."""
        return [figure.id for figure in self._shown("figures")]

    def figures(self) -> dict[str, Canvas]:
        """Draw every figure of the report with matplotlib, and return the figures by their id."""
        from swimid.results import drawing

        return {figure.id: drawing.canvas([figure]) for figure in self._shown("figures")}

    def plot(self, name: str, axes: Axes | Sequence[Axes] | None = None) -> Axes | list[Axes]:
        """Draw one figure of the report. A notebook shows the figure, and ``pyplot.savefig`` saves it.

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

        figure = self._figure(name)
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
        inputs = (self.evidence or self.bare()).provenance.get("inputs", {})
        target = atomic.check_writable(Path(path), inputs=inputs)
        with atomic.together():
            written = self._write(target)
            if self.evidence is not None and not atomic.is_device(target):
                made_for = {"result": target.name, "sha256": self.document.digest()}
                write_evidence(sidecar(target), self.evidence.model_copy(update=made_for))
                written.insert(1, sidecar(target))
        return replace(self, outputs=[*self.outputs, *written])

    def saved(self, output: str | Path | None) -> Self:
        """Return the result, which is written first if ``output`` is given."""
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
        if not sidecar(path).exists():
            return loaded
        evidence = _of_document(read_evidence(sidecar(path)), document, Path(path).name)
        return replace(loaded, command=evidence.command, evidence=evidence)

    def _own_facts(self) -> dict[str, str]:
        """Return the facts that are stored in the result file."""
        return {}

    def _own_notes(self) -> list[str]:
        """Return the notes that are stored in the result file."""
        return []

    def _own_tables(self) -> list[Table]:
        """Return the tables of the content of the result file."""
        return []

    @classmethod
    def _plain(cls, document: Any) -> dict[str, Any]:
        """Return the content of a result file as plain data."""
        return {}

    def bare(self) -> Evidence:
        """Return the minimal evidence for a result file whose evidence file is missing."""
        return Evidence(
            command=self.command,
            title=f"{self.kind} {self.path.name}",
            verdict=Verdict(level="caution", text="No evidence file, so its checks cannot be shown."),
            tables=[leaf_table("content", "Content of the file", self.data)],
            provenance=getattr(self.document, "provenance", {}),
        )

    @classmethod
    def _read(cls, path: str | Path) -> Any:
        raise UsageError(f"{path} cannot be read as {cls.__name__}")

    def _write(self, path: Path) -> list[Path]:
        raise UsageError(f"the result of {self.command} is no file", hint="its text is .summary()")

    def _shown(self, what: str) -> Sequence[Any]:
        """Return the checks, tables, figures or notices of the evidence; an empty list without evidence."""
        return getattr(self.evidence, what, [])

    def _figure(self, name: str) -> Figure:
        for figure in self._shown("figures"):
            if figure.id == name:
                return figure
        known = ", ".join(self.figure_names) or "none"
        raise UsageError(f"there is no figure '{name}'", hint=f"there are: {known}")

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # The default ``__repr__`` of a dataclass prints all fields, also large arrays.
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        parts = [self.verdict, f"{len(self.figure_names)} figures"]
        return f"<{type(self).__name__} of {self.command}: {', '.join(filter(None, parts))}>"

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows: the summary, and the checks in a folded table."""
        shown = f"<pre>{html.escape(self.summary())}</pre>"
        if self.evidence is not None and self.evidence.checks:
            table = self.checks().to_html(index=False, border=0)
            shown += f"<details><summary>checks</summary>{table}</details>"
        return f"<div>{shown}</div>"


@dataclass(frozen=True, eq=False)
class Text(Result):
    """Result of ``report`` or ``export``: a text, which is stored in ``document``."""

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        return [path]

    def _repr_html_(self) -> str:
        text = str(self.document)
        if text.startswith("<!DOCTYPE html>"):
            frame = "width:100%;height:40em;border:0"
            return f'<iframe srcdoc="{html.escape(text)}" style="{frame}"></iframe>'
        return f"<pre>{html.escape(text)}</pre>"


def _of_document(evidence: Evidence, document: Any, name: str) -> Evidence:
    """Return the evidence of a result file, with a lower verdict if the file was changed since.

    Warns
    -----
    SWM052
        The file was edited, or was written by another run than its evidence.
    """
    in_memory = evidence.model_copy(update={"result": "", "sha256": ""})
    if evidence.sha256 == document.digest():
        return in_memory
    text = (
        f"{name} was edited or replaced after its evidence was made: figures, checks and tables may not "
        "describe its numbers; run its command again"
    )
    warn("SWM052", text)
    said = f"The file was changed after this verdict: {evidence.verdict.text}"
    notices = [*evidence.notices, NoticeRecord(code="SWM052", text=text)]
    verdict = evidence.verdict.lowered("caution", said)
    return in_memory.model_copy(update={"verdict": verdict, "notices": notices})


def _frame(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame([list(row) for row in rows], columns=list(columns))


@dataclass(frozen=True, eq=False)
class FileResult(Result, Generic[File]):
    """Result that is stored in a YAML file with a format of its own."""

    file_type: ClassVar[type[ResultFile]]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.kind = cls.file_type.kind.capitalize()

    @property
    def file(self) -> File:
        """Content of the file that :meth:`save` writes."""
        file: File = self.document
        return file

    @classmethod
    def of(cls, file: File, evidence: Evidence) -> Self:
        """Return the result with the given file content and evidence."""
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
