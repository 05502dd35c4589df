"""Results: the return value of every public function, an answer with the evidence it rests on."""

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
    """An answer, the evidence it rests on, and the files it was written to.

    Nothing is written unless :meth:`save` is called, or an ``output`` was given to the function that made it.

    Attributes
    ----------
    command : str
        The command that gives the same, ``"fit-drag"``.
    text : str
        What the command prints where that is no summary of the evidence.
    data : dict
        The same for machines (``--json``), at full precision.
    outputs : sequence of Path
        The files written so far.
    evidence : Evidence or None
        Verdict, checks, tables and figures as data; None for what has none (a report, a schema).
    document : object
        What is in the result file: a parameter file, a gap file, a log.
    verdict : str
        ``"good"``, ``"caution"`` or ``"bad"``; empty without evidence.
    warnings : DataFrame
        The warnings raised on the way: ``code``, ``text``.
    figure_names : list of str
        What :meth:`plot` draws.

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

    #: Kind of result, as a report names it.
    kind: ClassVar[str] = "Result"
    #: Usual ending of the file it is written to.
    ending: ClassVar[str] = ".yaml"

    def summary(self) -> str:
        """Return the answer in plain text, as the command prints it."""
        if self.text or self.evidence is None:
            return self.text
        return terminal.summary(self.content())

    def content(self) -> Evidence:
        """Return what a report shows: the evidence, preceded by the facts and tables of the file itself.

        Without evidence its verdict is caution.
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
        """The file it was written to, or the name that file would have."""
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
        """The warnings raised on the way: ``code``, ``text`` (``docs/warnings.md``)."""
        return _frame(["code", "text"], [[n.code, n.text] for n in self._shown("notices")])

    def checks(self) -> pd.DataFrame:
        """Return every test of the result: ``name``, ``value``, ``limit``, ``verdict``, ``text``."""
        names = list(Check.model_fields)
        return _frame(names, [[getattr(check, name) for name in names] for check in self._shown("checks")])

    def tables(self) -> dict[str, pd.DataFrame]:
        """Return the tables of the report by their id."""
        return {table.id: _frame(table.columns, table.rows) for table in self.content().tables}

    @property
    def figure_names(self) -> list[str]:
        """The ids of the figures :meth:`plot` draws."""
        return [figure.id for figure in self._shown("figures")]

    def figures(self) -> dict[str, Canvas]:
        """Draw every figure of the report by matplotlib; return them by their id."""
        from swimid.results import drawing

        return {figure.id: drawing.canvas([figure]) for figure in self._shown("figures")}

    def plot(self, name: str, axes: Axes | Sequence[Axes] | None = None) -> Axes | list[Axes]:
        """Draw one figure of the report; a notebook shows it, and ``pyplot.savefig`` saves it.

        Parameters
        ----------
        name : str
            One of :attr:`figure_names`.
        axes : matplotlib Axes or sequence of Axes, optional
            Where to draw, one a panel; by default on a figure of its own.

        Returns
        -------
        Axes or list of Axes
            The list where the figure has several panels.

        Raises
        ------
        UsageError
            When there is no such figure, or not as many axes as panels.
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
        """Write the result and its evidence beside it, both or neither.

        Returns
        -------
        Result
            The same, with the files in :attr:`outputs`.

        Raises
        ------
        InputError
            When the folder does not exist or cannot be written.
        UsageError
            For a result that is no file, and for a path that is one of its inputs.
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
        """Return the result itself, written if an output is named."""
        if output is None:
            return self
        return self.save(output)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result that was written, with its evidence.

        Raises
        ------
        InputError
            When the file or its evidence is broken or not there.
        """
        document = cls._read(path)
        loaded = cls("", "", cls._plain(document), [Path(path)], document=document)
        if not sidecar(path).exists():
            return loaded
        evidence = _of_document(read_evidence(sidecar(path)), document, Path(path).name)
        return replace(loaded, command=evidence.command, evidence=evidence)

    def _own_facts(self) -> dict[str, str]:
        """Return the facts that the file itself holds."""
        return {}

    def _own_notes(self) -> list[str]:
        """Return the sentences that the file itself holds."""
        return []

    def _own_tables(self) -> list[Table]:
        """Return tables of what the file itself holds."""
        return []

    @classmethod
    def _plain(cls, document: Any) -> dict[str, Any]:
        """Return the plain data of a document."""
        return {}

    def bare(self) -> Evidence:
        """Return what a report shows of a file whose evidence is missing."""
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
        """Return checks, tables, figures or notices of the evidence; none without it."""
        return getattr(self.evidence, what, [])

    def _figure(self, name: str) -> Figure:
        for figure in self._shown("figures"):
            if figure.id == name:
                return figure
        known = ", ".join(self.figure_names) or "none"
        raise UsageError(f"there is no figure '{name}'", hint=f"there are: {known}")

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # a dataclass writes all its fields, arrays among them, unless its class has a __repr__ of its own
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        parts = [self.verdict, f"{len(self.figure_names)} figures"]
        return f"<{type(self).__name__} of {self.command}: {', '.join(filter(None, parts))}>"

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """Return the view of a notebook: the summary, and the checks folded below it."""
        shown = f"<pre>{html.escape(self.summary())}</pre>"
        if self.evidence is not None and self.evidence.checks:
            table = self.checks().to_html(index=False, border=0)
            shown += f"<details><summary>checks</summary>{table}</details>"
        return f"<div>{shown}</div>"


@dataclass(frozen=True, eq=False)
class Text(Result):
    """A text, as ``report`` and ``export`` give it; ``document`` is the text itself."""

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
    """Return the evidence of a file, with a lower verdict if it was made for other content.

    Warns
    -----
    SWM052
        The file was edited, or is from another run than its evidence.
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
    """A result that is a YAML file of a format of its own."""

    file_type: ClassVar[type[ResultFile]]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.kind = cls.file_type.kind.capitalize()

    @property
    def file(self) -> File:
        """File that :meth:`save` writes."""
        file: File = self.document
        return file

    @classmethod
    def of(cls, file: File, evidence: Evidence) -> Self:
        """Return the result whose file and evidence these are."""
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
