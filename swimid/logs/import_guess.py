"""``swimid import --guess``: a mapping drafted from names and values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.files import atomic
from swimid.logs import mapping
from swimid.logs.foreign import Source, open_source
from swimid.logs.foreign.delimited import DelimitedSource
from swimid.logs.guessing import Guess, guess
from swimid.results.result import Result

#: Samples looked at.
SAMPLE = 20_000


def guess_mapping(path: str | Path, *, output: Path | None = None) -> Result:
    """Draft the mapping of a file; each line says what it rests on.

    Parameters
    ----------
    path : path
        The foreign log.
    output : path, optional
        The mapping; without it the text is the outcome's summary.

    Raises
    ------
    InputError
        When the file cannot be read.
    """
    path = Path(path)
    source = open_source(path)
    try:
        columns = _sample(source)
        headed, written = True, {}
        if isinstance(source, DelimitedSource):
            headed = source.layout.headed
            written = dict(zip(source.layout.names, source.layout.units, strict=False))
        guesses = guess(columns, written, headed=headed)
        text = draft(path.name, source, guesses, columns)
    finally:
        source.close()
    result = {
        "file": str(path),
        "mapping": text,
        "columns": [
            {"source": g.source, "target": g.target, "unit": g.unit, "why": g.why or []} for g in guesses
        ],
    }
    if output is None:
        return Result("import", text.rstrip("\n"), result)
    atomic.write_text(output, text)
    mapped = sum(g.target is not None for g in guesses)
    return Result(
        "import",
        f"{path.name}: {mapped} of {len(guesses)} columns guessed; look at every line of {output}",
        result,
        [output],
    )


def _sample(source: Source) -> dict[str, NDArray[np.float64]]:
    names = [column.name for column in source.columns if column.kind != "text"]
    lengths = [column.rows for column in source.columns if column.rows is not None]
    if lengths:
        usual = max(set(lengths), key=lengths.count)
        names = [c.name for c in source.columns if c.name in names and c.rows in (None, usual)]
    if not names:
        return {}
    chunk = next(iter(source.chunks(names, lambda amount: None)), {name: np.empty(0) for name in names})
    found = {}
    for name, values in chunk.items():
        part = values[:SAMPLE]
        if part.dtype.kind == "M":
            part = np.where(np.isnat(part), np.nan, part.astype("datetime64[ns]").astype(np.int64) * 1e-9)
        found[name] = part.astype(float)
    return found


def draft(name: str, source: Source, guesses: list[Guess], columns: dict[str, NDArray[np.float64]]) -> str:
    """The text of a mapping file with its reasons."""
    lines = [
        f"# Drafted from {name} by swimid import --guess. Look at every line: names and values are hints,",
        "# no proof. Axes may be swapped or flipped (factor: -1), and a unit may be another one.",
        f"format: {mapping.FORMAT}",
    ]
    reader: dict[str, Any] = {}
    assumed = False
    if isinstance(source, DelimitedSource):
        found = source.layout
        reader = {
            "delimiter": {" ": "whitespace", "\t": "tab"}.get(found.delimiter, found.delimiter),
            "header": found.headed,
        }
        if found.decimal != ".":
            reader["decimal"] = found.decimal
    elif "topic" in source.metadata:
        reader = {"topic": source.metadata["topic"]}
    if reader:
        lines.append(f"reader: {{{', '.join(f'{k}: {_scalar(v)}' for k, v in reader.items())}}}")
    time = next((g for g in guesses if g.target == "t_s"), None)
    kinds = {column.name: column.kind for column in source.columns}
    if time is not None:
        unit = "s" if kinds.get(time.source) == "time" else time.unit or "s"
        origin = (
            ", origin: first"
            if kinds.get(time.source) == "time" or "counts from 1970" in (time.why or [])
            else ""
        )
        lines.append(
            f"time: {{source: {_source(time)}, unit: {unit}{origin}}}   # {'; '.join(time.why or [])}"
        )
    elif source.scalars:
        likely = next(
            (n for n in source.scalars if "rate" in n.lower() or "freq" in n.lower() or n.lower() == "fs"),
            None,
        )
        rate = likely or next(iter(source.scalars))
        lines.append(
            f"time: {{rate_hz: {_scalar(rate)}}}   # no column is a time; {rate} = {source.scalars[rate]:g}"
        )
    else:
        lines.append("time: {rate_hz: 100}   # no column grows like a time: PUT THE SAMPLE RATE HERE")
        assumed = True
    lines.append("columns:")
    known = [g for g in guesses if g.target not in (None, "t_s")]
    rest = [g for g in guesses if g.target is None]
    for g in known:
        unit = f", unit: {_scalar(g.unit)}" if g.unit else ""
        unit += f", factor: {g.factor:g}" if g.factor != 1 else ""
        why = "; ".join([*(g.why or []), _range(columns[g.source])])
        lines.append(f"  - {{source: {_source(g)}, target: {g.target}{unit}}}   # {why}")
    if not known and rest:
        first = rest.pop(0)
        target = "column_" + "".join(c if c.isascii() and c.isalnum() else "_" for c in first.source)
        about = _range(columns[first.source])
        lines.append(f"  - {{source: {_source(first)}, target: {target}}}   # not known; {about}")
    for g in rest:
        why = "; ".join(["not known", *(g.why or []), _range(columns[g.source])])
        lines.append(f"  # - {{source: {_source(g)}, target: ..., unit: ...}}   # {why}")
    for column in source.columns:
        if column.name not in columns:
            what = "text" if column.kind == "text" else "of another length"
            lines.append(f"  # {_scalar(column.name)} left out: {what}")
    # a rate that nobody gave must not look like one
    known_of = "{sample_rate: assumed}" if assumed else "{}"
    lines += [
        f"metadata: {known_of}   # robot: ..., frequency_hz: ... (it is checked against the stroke found)"
    ]
    return "\n".join(line.replace("\r", " ") for line in lines) + "\n"


def _scalar(value: Any) -> str:
    """A value as YAML on one line; JSON is YAML."""
    return json.dumps(value, ensure_ascii=False)


def _source(found: Guess) -> str:
    return found.source if found.source.isdecimal() else _scalar(found.source)


def _range(values: NDArray[np.float64]) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "no number in the first samples"
    empty = f", {len(values) - len(known)} empty" if len(known) < len(values) else ""
    return f"{known.min():.4g} … {known.max():.4g}{empty}"
