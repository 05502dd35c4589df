"""``swimid import --guess``: a drafted mapping, with ``ASK`` for everything that the file does not state."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.files import atomic, mark, yamlio
from swimid.files.provenance import path_of
from swimid.logs import clock, instances, log, mapping, profiles, units
from swimid.logs.choices import Choices
from swimid.logs.foreign import open_table
from swimid.logs.foreign.base import Table, is_text
from swimid.logs.log import TIME, LogLike
from swimid.logs.mapping import Mapping
from swimid.logs.stated import ASK
from swimid.results.result import Result

#: Names of single numbers that are a rate, and of columns that are parts of a time, in small letters.
RATES, SECONDS = ("fs", "rate", "rate_hz", "fps", "sample_rate"), ("secs", "sec", "s", "seconds")
NANOSECONDS = ("nsecs", "nsec", "nanosec", "nanosecs", "nanoseconds", "ns")
#: Number of values that are shown beside a question.
SHOWN = 3
_XYZ = r"[ _.\[]*(?P<axis>[xyz])\]?"
#: Names that state a quantity (not its unit): pattern of the whole name in small letters, target column.
_NAMES: list[tuple[str, str]] = [
    (r"(lin(ear)?[ _.]*)?acc(el(eration|erometer)?)?" + _XYZ, "a{axis}_m_s2"),
    (r"(gyr(o(scope)?)?|ang(ular)?[ _.]?(vel(ocity)?|rate)|omega)" + _XYZ, "w{axis}_rad_s"),
    (r"mag(net(ometer|ic)?([ _]field)?)?" + _XYZ, "m{axis}_T"),
    (r"(quat(ernion)?|q)[ _.\[]*(?P<axis>[wxyz])\]?", "q{axis}"),
    (r"(pos(ition)?|location)" + _XYZ, "{axis}_m"),
    (r"(vel(ocity)?|speed)" + _XYZ, "v{axis}_m_s"),
    (r"surge[ _.]?(vel(ocity)?|speed)", "u_m_s"),
    (r"sway[ _.]?(vel(ocity)?|speed)", "v_m_s"),
    (r"heave[ _.]?(vel(ocity)?|speed)", "w_m_s"),
    (r"(yaw|heading)[ _.]?(rate|vel(ocity)?|speed)", "yaw_rate_rad_s"),
    (r"yaw|heading", "yaw_rad"),
    (r"roll", "roll_rad"),
    (r"pitch", "pitch_rad"),
    (r"(net[ _.]?)?force|thrust|load[ _.]?cell", "force_N"),
    (r"joint[ _.]?(angle)?[ _.\[]*(?P<axis>\d+)\]?", "joint{axis}_rad"),
    (r"(cmd|command|setpoint)[ _.\[]*(?P<axis>\d+)\]?", "cmd{axis}_rad"),
]
_TIME = re.compile(
    r"t|time|(time)?[ _.]?stamp|timestamp|seconds|secs?|(header|log)?[ _.]?(stamp|time)|clock|date"
)
_UNIT = re.compile(r"(?P<bare>.*?)[ _]*(?:[\[(](?P<inside>[^\])]+)[\])]|/ ?(?P<over>[^\d\s]\S*))\s*")
#: Word and unit at the end of a name, as in ``heading_deg`` or ``x mm``.
_ENDING = re.compile(r"(?P<bare>.+?)[ _](?P<unit>[A-Za-z°µ/]+(?:_s2?)?)")


@dataclass(frozen=True, eq=False)
class Draft(Result):
    """A drafted mapping, as ``guess_mapping`` returns it; ``document`` is its commented YAML."""

    format = mapping.FORMAT

    @property
    def mapping(self) -> Mapping:
        """The mapping, for ``import_log`` and ``track_imu``.

        Raises
        ------
        InputError
            Something is still ``ASK``.
        """
        return mapping.of(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, mark.draft(self.document))
        return [path]


@dataclass(frozen=True)
class Drafted:
    """What the name of one column and the file state about it; None where nothing is stated."""

    source: str
    target: str | None = None
    unit: str | None = None
    needs_unit: bool = False


def guess_mapping(source: LogLike, *, output: str | Path | None = None) -> Draft:
    """Draft the mapping of a foreign log.

    The draft holds what a profile, the name of a column or a stated unit says. It has ``ASK`` for everything
    else, with the first values beside it; a mapping with an open ``ASK`` is refused. Nothing is inferred from
    the size of values.

    Parameters
    ----------
    source : path, DataFrame or Log
        The foreign log; a table has shape (n, k), one row a sample.
    output : path, optional
        The mapping file; without it nothing is written.

    Returns
    -------
    Draft
        ``.document`` the text of the mapping file, ``.mapping`` the mapping in memory.

    Raises
    ------
    InputError
        The file cannot be read.

    Examples
    --------
    >>> import pandas as pd
    >>> draft = guess_mapping(pd.DataFrame({"Time (ms)": [0, 20, 40], "Yaw [deg]": [1.0, 1.5, 1.2]}))
    >>> [(c.source, c.target, c.unit) for c in draft.mapping.columns]
    [('Yaw [deg]', 'yaw_rad', 'deg')]
    """
    given = log.unread(source)
    path = path_of(given)
    profile = profiles.find(path, Choices()) if isinstance(given, Path) else None
    if profile is not None and profile.name != "swimid":
        text = _of_profile(profile, path)
    else:
        text = _of_names(path.name, open_table(given))
    asked = sum(ASK in line.partition("#")[0] for line in text.splitlines())
    data = {"file": str(path), "mapping": text, "open": asked}
    if output is None:
        return Draft("import", text.rstrip("\n"), data, document=text)
    todo = f"answer the {asked} lines with {ASK}, then" if asked else "look at every line, then"
    told = f"{path.name}: mapping drafted; {todo} swimid import {path.name} --map {output} -o run.csv"
    return Draft("import", told, data, document=text).save(output)


def _of_profile(profile: profiles.Profile, path: Path) -> str:
    """Return the draft for a file of a known format."""
    lines = [
        f"# Drafted from {path.name} ({profile.title}) by swimid import --guess.",
        f"format: {mapping.FORMAT}",
    ]
    lines.append(f"as: {profile.name}")
    try:
        table = profile.table(path, Choices())
    except InputError as error:
        lines.append(f"select: {ASK}   # {error}; {error.hint or ''}".replace("\n", " "))
        return "\n".join(lines) + "\n"
    lines += [f"# {note}" for note in table.notes]
    if TIME not in table.columns and "rate_hz" not in table.scalars:
        lines.append(
            f"time: {{rate_hz: {ASK}}}   # frames per second of the film; the file does not state them"
        )
    lines += ["# the log gets these columns; 'columns:' takes some of them, under other names:"]
    lines += [
        f"#   - {{source: {name}, target: {name}}}" for name in table.columns if name not in (TIME, "frame")
    ]
    return "\n".join(lines) + "\n"


def _of_names(name: str, table: Table) -> str:
    """Return the draft that follows from names and stated units."""
    usual = max((len(v) for v in table.columns.values()), default=0)
    columns = {key: values for key, values in table.columns.items() if len(values) == usual}
    lines = [
        f"# Drafted from {name} by swimid import --guess. Answer or delete every line with {ASK};",
        "# an axis may be swapped or flipped (factor: -1), which no name states.",
        f"format: {mapping.FORMAT}",
    ]
    if "topic" in table.metadata:
        lines.append(f"reader: {{topic: {_scalar(table.metadata['topic'])}}}")
    time, taken = _time(table, columns)
    mixed, by = _mixed(table, columns, time, taken)
    lines += mixed
    taken |= by
    found: list[str] = []
    seen: set[str] = set()
    for source, values in columns.items():
        if source in taken:
            continue
        shown = _first(values)
        drafted = named(source, table.units.get(source))
        if is_text(values) or values.dtype.kind == "M":
            found.append(f"  # - {{source: {_source(source)}, target: ...}}   # no numbers: {shown}")
            continue
        if not np.isfinite(values.astype(float)).any():
            found.append(f"  # {_scalar(source)} is empty")
            continue
        target = drafted.target if drafted.target not in seen else None
        unit = (
            f", unit: {_scalar(drafted.unit)}"
            if drafted.unit
            else f", unit: {ASK}"
            if drafted.needs_unit
            else ""
        )
        unit = unit if target else f", unit: {_scalar(drafted.unit) if drafted.unit else ASK}"
        found.append(f"  - {{source: {_source(source)}, target: {target or ASK}{unit}}}   # {shown}")
        seen |= {target} if target else set()
    lines += [
        time,
        "columns:",
        *found,
        "metadata: {}   # robot: ..., frequency_hz: ... (of the stroke, if known)",
    ]
    return "\n".join(line.replace("\r", " ") for line in lines) + "\n"


def named(source: str, written: str | None = None) -> Drafted:
    """Return what the name of a column and a unit written beside it state.

    >>> named("Yaw [deg]").target, named("Yaw [deg]").unit
    ('yaw_rad', 'deg')
    >>> named("accX").target, named("accX").needs_unit
    ('ax_m_s2', True)
    """
    name = source.strip()
    if re.fullmatch(r"[A-Za-z]\w*", name, re.A) and units.is_known(name) and not written:
        return Drafted(source, name)
    bare, unit = name, written
    if hit := _UNIT.fullmatch(name):
        bare, unit = hit["bare"], unit or hit["inside"] or hit["over"]
    elif hit := _ENDING.fullmatch(name):
        ending = units.canonical(re.sub(r"(?<=.)_(s2?)$", r"/\1", hit["unit"]))
        if unit is None and ending in units.KNOWN:
            bare, unit = hit["bare"], ending
    unit = units.canonical(unit) if unit else None
    if unit not in units.KNOWN:
        unit = None
    target = _target(bare.strip(" _.").lower(), unit)
    return Drafted(source, target, unit, needs_unit=target is not None and unit is None and target[0] != "q")


def _target(bare: str, unit: str | None) -> str | None:
    """Return the column of the log format that a bare name states; None if it states none."""
    for pattern, target in _NAMES:
        hit = re.fullmatch(pattern, bare)
        if hit is not None:
            wanted = target.format(**hit.groupdict())
            return wanted if unit is None or _fits(unit, wanted) else None
    if unit is None or bare == "":
        return None
    # a word with a unit: the unit states the quantity, if it is that of one quantity only
    quantities = [quantity for quantity, table in units.UNITS.items() if unit in table]
    word = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")
    if len(quantities) != 1 or not word[:1].isalpha():
        return None
    return f"{word}_{next(iter(units.UNITS[quantities[0]])).replace('/', '_')}"


def _fits(unit: str, target: str) -> bool:
    try:
        units.factor(unit, target)
    except ValueError:
        return False
    return True


def _time(table: Table, columns: dict[str, Any]) -> tuple[str, set[str]]:
    """Return the line of the time, and the columns it takes."""
    stamps = [name for name in columns if _is_time(name)]
    # the stamp of the sensor before that of the recorder
    stamps.sort(key=lambda name: "header" not in name.lower())
    counts = [name for name, values in columns.items() if _counts(name, values)]
    if TIME in columns:
        return f"time: {{source: {TIME}, unit: s}}", {TIME}
    if not stamps and counts:
        return f"time: {{frame: {_source(counts[0])}, rate_hz: {ASK}}}   # frames per second", {counts[0]}
    if not stamps:
        rate = next((name for name in table.scalars if name.lower() in RATES), None)
        if rate is not None:
            return f"time: {{rate_hz: {_scalar(rate)}}}   # = {table.scalars[rate]:g}", set()
        ways = "{source: ..., unit: ...}, {frame: ..., rate_hz: ...} or {rate_hz: ...}"
        return f"time: {ASK}   # {ways}", set()
    chosen = stamps[0]
    values, shown = columns[chosen], _first(columns[chosen])
    if values.dtype.kind == "M":
        return f"time: {{source: {_source(chosen)}, origin: first}}   # {shown}", {chosen}
    if is_text(values):
        parts = [name for name in stamps if is_text(columns[name])][:2]
        parts.sort(key=lambda name: "date" not in name.lower())
        source = _source(parts[0]) if len(parts) == 1 else f"[{', '.join(map(_source, parts))}]"
        ambiguous = re.match(r"\d{1,2}[/.-]\d{1,2}[/.-]\d{4}", str(columns[parts[0]][0]))
        day = f", day_first: {ASK}" if ambiguous else ""
        return f"time: {{source: {source}, origin: first{day}}}   # {_first(columns[parts[0]])}", set(parts)
    rest = next((name for name in columns if name.strip().lower() in NANOSECONDS), None)
    if rest is not None and chosen.strip().lower() in SECONDS:
        source = f"[{_source(chosen)}, {_source(rest)}]"
        return f"time: {{source: {source}, unit: [s, ns], origin: first}}   # {shown}", {chosen, rest}
    unit = named(chosen, table.units.get(chosen)).unit
    unit = unit if unit in units.UNITS["time"] else None
    return f"time: {{source: {_source(chosen)}, unit: {unit or ASK}}}   # {shown}", {chosen}


def _is_time(name: str) -> bool:
    bare = name.strip().lower()
    if (hit := _UNIT.fullmatch(bare)) or (
        (hit := _ENDING.fullmatch(bare)) and units.canonical(hit["unit"]) in units.UNITS["time"]
    ):
        bare = hit["bare"]
    return _TIME.fullmatch(re.sub(r"(us|ms|ns)$", "", bare).strip(" _.")) is not None


def _counts(name: str, values: Any) -> bool:
    """Return whether a column counts frames or rows: by its name, or since it is 0, 1, 2, ..."""
    if is_text(values) or values.dtype.kind == "M":
        return False
    known = values[np.isfinite(values.astype(float))]
    whole = len(known) > 2 and bool(np.all(known == np.round(known)) and np.all(np.diff(known) >= 0))
    named_so = clock.COUNT.fullmatch(name.strip().lower()) or name.lower().startswith(("column 1", "unnamed"))
    return whole and bool(named_so or np.all(np.diff(known) == 1))


def _mixed(table: Table, columns: dict[str, Any], line: str, taken: set[str]) -> tuple[list[str], set[str]]:
    """Return the line that chooses one of several instances whose rows stand in turn, and its column."""
    # the scale of the time does not matter here, thus a rate or a unit may still be open
    answered = line.partition(": ")[2].replace(f"unit: {ASK}", "unit: s").replace(ASK, "1")
    stated = yamlio.parse_scalar(answered)
    if not isinstance(stated, dict):
        return [], set()
    rows = len(next(iter(columns.values())))
    try:
        time = clock.seconds(table, clock.Time(**stated), rows, Path(""), {})
        instances.refuse_mixed(Table(columns), time, np.ones(rows, dtype=bool), taken, Path(""))
    except InputError as error:
        if "instances" in error.reason and error.column is not None:
            there = error.reason.rpartition(": ")[2]
            return [f"where: {{{_source(error.column)}: {ASK}}}   # {there}"], {error.column}
    return [], set()


def _scalar(value: Any) -> str:
    """Return a value as YAML on one line; JSON is YAML."""
    return json.dumps(value, ensure_ascii=False)


def _source(name: str) -> str:
    return name if name.isdecimal() else _scalar(name)


def _first(values: Any) -> str:
    """Return the first values of a column, for the reader of the draft."""
    shown = [f"{value:.6g}" if isinstance(value, float) else str(value)[:30] for value in values[:SHOWN]]
    return ", ".join(shown)
