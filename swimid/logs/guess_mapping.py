"""``swimid import --guess``: a mapping drafted from names and values."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic, yamlio
from swimid.files.provenance import path_of
from swimid.logs import log, mapping
from swimid.logs.foreign import Source, open_source
from swimid.logs.foreign.delimited import DelimitedSource
from swimid.logs.guessing import Guess, guess
from swimid.logs.log import LogLike
from swimid.logs.mapping import Mapping
from swimid.results.result import Result

Array = NDArray[np.float64]
#: Samples looked at.
SAMPLE = 20_000


@dataclass(frozen=True, eq=False)
class Draft(Result):
    """A mapping to look through, as ``guess_mapping`` gives it; ``document`` is its commented YAML."""

    format = mapping.FORMAT

    @property
    def mapping(self) -> Mapping:
        """The mapping itself, for ``import_log`` and ``track_imu``."""
        return mapping.of(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        return [path]


def guess_mapping(source: LogLike, *, output: str | Path | None = None) -> Draft:
    """Draft the mapping of a foreign log from names and values; each line says what it rests on.

    Parameters
    ----------
    source : path, DataFrame or Log
        The foreign log; a table has shape (n, k), one row a sample. Up to :data:`SAMPLE` rows are looked at.
    output : path, optional
        The mapping file; without it nothing is written.

    Returns
    -------
    Draft
        ``.document`` the text of the mapping file, ``.mapping`` the mapping in memory.

    Raises
    ------
    InputError
        When the file cannot be read.

    Examples
    --------
    >>> import pandas as pd
    >>> draft = guess_mapping(pd.DataFrame({"Time (ms)": [0, 20, 40], "Yaw [deg]": [1.0, 1.5, 1.2]}))
    >>> [(c.source, c.target, c.unit) for c in draft.mapping.columns]
    [('Yaw [deg]', 'yaw_rad', 'deg')]
    """
    given = log.unread(source)
    path = path_of(given)
    opened = open_source(given)
    try:
        columns = _sample(opened)
        headed, written = True, {}
        if isinstance(opened, DelimitedSource):
            headed = opened.layout.headed
            written = dict(zip(opened.layout.names, opened.layout.units, strict=False))
        guesses = guess(columns, written, headed=headed)
        text = _draft(path.name, opened, guesses, columns)
    finally:
        opened.close()
    listed = [{"source": g.source, "target": g.target, "unit": g.unit, "why": g.why} for g in guesses]
    data = {"file": str(path), "mapping": text, "columns": listed}
    if output is None:
        return Draft("import", text.rstrip("\n"), data, document=text)
    mapped = sum(g.target is not None for g in guesses)
    told = f"{path.name}: {mapped} of {len(guesses)} columns guessed; look at every line of {output}"
    return Draft("import", told, data, document=text).save(output)


def _sample(source: Source) -> dict[str, Array]:
    """The first samples of the columns of numbers and dates that are of the usual length."""
    columns = [column for column in source.columns if column.kind != "text"]
    lengths = [column.rows for column in columns if column.rows is not None]
    usual = max(set(lengths), key=lengths.count) if lengths else None
    names = [column.name for column in columns if column.rows in (None, usual)]
    if not names:
        return {}
    chunk = next(iter(source.chunks(names, lambda amount: None)), {name: np.empty(0) for name in names})
    return {name: mapping.epoch_seconds(values[:SAMPLE]).astype(float) for name, values in chunk.items()}


def _draft(name: str, source: Source, guesses: list[Guess], columns: dict[str, Array]) -> str:
    """The text of a mapping file with its reasons."""
    reader: dict[str, Any] = {}
    if isinstance(source, DelimitedSource):
        found = source.layout
        delimiter = {" ": "whitespace", "\t": "tab"}.get(found.delimiter, found.delimiter)
        reader = {"delimiter": delimiter, "header": found.headed}
        reader |= {"decimal": found.decimal} if found.decimal != "." else {}
    elif "topic" in source.metadata:
        reader = {"topic": source.metadata["topic"]}
    time, assumed = _time(source, guesses)
    lines = [
        f"# Drafted from {name} by swimid import --guess. Look at every line: names and values are hints,",
        "# no proof. Axes may be swapped or flipped (factor: -1), and a unit may be another one.",
        f"format: {mapping.FORMAT}",
        *([f"reader: {{{', '.join(f'{k}: {_scalar(v)}' for k, v in reader.items())}}}"] if reader else []),
        time,
        "columns:",
    ]
    known = [g for g in guesses if g.target not in (None, "t_s")]
    rest = [g for g in guesses if g.target is None]
    for g in known:
        unit = f", unit: {_scalar(g.unit)}" if g.unit else ""
        unit += f", factor: {g.factor:g}" if g.factor != 1 else ""
        why = "; ".join([*g.why, _range(columns[g.source])])
        lines.append(f"  - {{source: {_source(g)}, target: {g.target}{unit}}}   # {why}")
    if not known and rest:
        first = rest.pop(0)
        target = "column_" + "".join(c if c.isascii() and c.isalnum() else "_" for c in first.source)
        about = _range(columns[first.source])
        lines.append(f"  - {{source: {_source(first)}, target: {target}}}   # not known; {about}")
    for g in rest:
        why = "; ".join(["not known", *g.why, _range(columns[g.source])])
        lines.append(f"  # - {{source: {_source(g)}, target: ..., unit: ...}}   # {why}")
    for column in source.columns:
        if column.name not in columns:
            what = "text" if column.kind == "text" else "of another length"
            lines.append(f"  # {_scalar(column.name)} left out: {what}")
    # a rate that nobody gave must not look like one
    metadata = "{sample_rate: assumed}" if assumed else "{}"
    lines.append(
        f"metadata: {metadata}   # robot: ..., frequency_hz: ... (it is checked against the stroke found)"
    )
    return "\n".join(line.replace("\r", " ") for line in lines) + "\n"


def _time(source: Source, guesses: list[Guess]) -> tuple[str, bool]:
    """The line of the time, and whether its rate is assumed."""
    time = next((g for g in guesses if g.target == "t_s"), None)
    if time is not None:
        dates = next(c.kind for c in source.columns if c.name == time.source) == "time"
        unit = "s" if dates else time.unit or "s"
        origin = ", origin: first" if dates or "counts from 1970" in time.why else ""
        return f"time: {{source: {_source(time)}, unit: {unit}{origin}}}   # {'; '.join(time.why)}", False
    if source.scalars:
        likely = [n for n in source.scalars if n.lower() == "fs" or re.search("rate|freq", n.lower())]
        rate = (likely or list(source.scalars))[0]
        known = f"no column is a time; {rate} = {source.scalars[rate]:g}"
        return f"time: {{rate_hz: {_scalar(rate)}}}   # {known}", False
    return "time: {rate_hz: 100}   # no column grows like a time: PUT THE SAMPLE RATE HERE", True


def _scalar(value: Any) -> str:
    """A value as YAML on one line; JSON is YAML."""
    return json.dumps(value, ensure_ascii=False)


def _source(found: Guess) -> str:
    return found.source if found.source.isdecimal() else _scalar(found.source)


def _range(values: Array) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "no number in the first samples"
    empty = f", {len(values) - len(known)} empty" if len(known) < len(values) else ""
    return f"{known.min():.4g} … {known.max():.4g}{empty}"
