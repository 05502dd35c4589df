"""Command ``swimid import --guess``: drafts a mapping, with ``ASK`` for all that the file does not state."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.files import atomic, yamlio
from swimid.files.provenance import path_of
from swimid.logs import log, mapping, units
from swimid.logs.foreign import Table, is_text, open_table
from swimid.logs.log import TIME, LogLike
from swimid.logs.mapping import ASK, Mapping
from swimid.results.result import Result

_XYZ = r"[ _.\[]*(?P<axis>[xyz])\]?"
#: Names that state a quantity but no unit: pattern of the whole name in lower case, and target column.
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
    (r"heading", "yaw_rad"),
    (r"(?P<axis>roll|pitch|yaw)", "{axis}_rad"),
    (r"(net[ _.]?)?force|thrust|load[ _.]?cell", "force_N"),
    (r"joint[ _.]?(angle)?[ _.\[]*(?P<axis>\d+)\]?", "joint{axis}_rad"),
    (r"(cmd|command|setpoint)[ _.\[]*(?P<axis>\d+)\]?", "cmd{axis}_rad"),
]
_UNIT = re.compile(r"(?P<bare>.*?)[ _]*(?:[\[(](?P<inside>[^\])]+)[\])]|/ ?(?P<over>[^\d\s]\S*))\s*")
#: Pattern of a column name that ends in a unit, such as ``heading_deg`` or ``x mm``.
_ENDING = re.compile(r"(?P<bare>.+?)[ _](?P<unit>[A-Za-z°µ/]+(?:_s2?)?)")


@dataclass(frozen=True, eq=False)
class Draft(Result):
    """Drafted mapping: result of ``guess_mapping``. Its ``document`` is YAML text with comments."""

    @property
    def mapping(self) -> Mapping:
        """Mapping, which ``import_log`` and ``track_imu`` accept.

        Raises
        ------
        InputError
            A value is still ``ASK``.
        """
        return mapping.of(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        return [path]


def guess_mapping(source: LogLike, *, select: str | None = None, output: str | Path | None = None) -> Draft:
    """Draft the mapping of a foreign log.

    The draft states what follows from a profile, from the name of a column or from a stated unit. All other
    values are ``ASK``, with the first values of the column in a comment. A mapping with ``ASK`` is refused.
    Nothing is inferred from the magnitude of the values.

    Parameters
    ----------
    source : path, DataFrame or Log
        Foreign log. A table has shape (n, k), one row per sample.
    select : str, optional
        Track, topic, struct or group to read, if the file holds several.
    output : path, optional
        Path of the mapping file. Without a path nothing is written.

    Returns
    -------
    Draft
        ``.document`` holds the text of the mapping file, ``.mapping`` the mapping in memory.

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
    table = open_table(given, select=select, kind="")
    lines = [
        f"# Drafted from {path.name} by swimid import --guess. Answer or delete every line with {ASK};",
        "# an axis may be swapped or flipped (factor: -1), which no name states.",
        f"format: {mapping.FORMAT}",
    ]
    if select is not None or "topic" in table.metadata:
        lines.append(_line("select", select or table.metadata["topic"]))
    if table.profile not in ("", "swimid"):
        lines += _of_profile(table)
    else:
        lines += _of_names(table)
    asked = sum(ASK in line.partition("#")[0] for line in lines)
    text = "".join(re.sub(r"[\r\n]", " ", line) + "\n" for line in lines)
    data = {"file": str(path), "mapping": text, "open": asked}
    if output is None:
        return Draft("import", text.rstrip("\n"), data, document=text)
    todo = f"answer the {asked} lines with {ASK}" if asked else "look at every line"
    told = f"{path.name}: mapping drafted; {todo}, then swimid import {path.name} --map {output} -o run.csv"
    return Draft("import", told, data, document=text).save(output)


def _of_profile(table: Table) -> list[str]:
    """Return the lines of the draft for a file of a known format."""
    lines = [f"as: {table.profile}"]
    if TIME not in table.columns and "rate_hz" not in table.scalars:
        lines.append(_line("time", {"rate_hz": ASK}, "frames per second of the film"))
    names = [name for name in table.columns if name not in (TIME, "frame")]
    return [*lines, f"# columns of the log, which 'columns:' may choose and rename: {', '.join(names)}"]


def _of_names(table: Table) -> list[str]:
    """Return the lines of the draft that follow from column names and stated units."""
    usual = max((len(v) for v in table.columns.values()), default=0)
    columns = {key: values for key, values in table.columns.items() if len(values) == usual}
    time = _time(table, columns)
    taken: list[str] = []
    if isinstance(time, dict):
        taken = np.atleast_1d(time.get("source") or time["frame"]).tolist()
    forms = "{source: ..., unit: ...}, {frame: ..., rate_hz: ...} or {rate_hz: ...}"
    lines = [_line("time", time, forms), "columns:"]
    for source, values in columns.items():
        if source in taken:
            continue
        target, unit = named(source, table.units.get(source))
        if is_text(values) or values.dtype.kind == "M" or not np.isfinite(values.astype(float)).any():
            left_out = _line("-", {"source": source, "target": "..."}, f"no numbers: {_first(values)}")
            lines.append(f"  # {left_out}")
            continue
        entries = {"source": source, "target": target, "unit": unit}
        lines.append("  " + _line("-", entries, _first(values)))
    lines.append("metadata: {}   # robot: ..., frequency_hz: ... (of the stroke, if known)")
    return lines


def _line(key: str, value: Any, comment: str = "") -> str:
    """Return a line of YAML, ``key: value   # comment``, or an item of a list if the key is a dash."""
    text = _written(key, value)
    if isinstance(value, dict):
        entries = [f"{name}: {_written(name, v)}" for name, v in value.items() if v is not None]
        text = f"{{{', '.join(entries)}}}"
    start = f"{key}:".replace("-:", "-")
    if comment:
        text += f"   # {comment}"
    return f"{start} {text}"


def _written(key: str, value: Any) -> str:
    """Return a value as YAML: names and units of the file in quotes, column numbers and keywords plain."""
    if value == ASK or key in ("target", "origin") or (key in ("source", "frame") and str(value).isdecimal()):
        return str(value)
    return json.dumps(value, ensure_ascii=False)


def named(source: str, written: str | None = None) -> tuple[str, str | None]:
    """Return the target and the unit that follow from the name of a column and from the unit stated for it.

    An unknown target or unit is ``ASK``. The unit is None for a column of the log format.

    >>> named("Yaw [deg]"), named("accX"), named("x_m"), named("level (mm)")
    (('yaw_rad', 'deg'), ('ax_m_s2', 'ASK'), ('x_m', None), ('level_m', 'mm'))
    """
    name = source.strip()
    if re.fullmatch(r"[A-Za-z]\w*", name, re.A) and units.is_known(name) and not written:
        return name, None
    bare, unit = _split(name)
    unit = units.canonical(written or unit or "")
    if unit not in units.KNOWN:
        unit = None
    target = _target(bare.strip(" _.").lower(), unit)
    if target is not None and units.measured(target) is None:
        return target, unit
    return target or ASK, unit or ASK


def _split(name: str) -> tuple[str, str | None]:
    """Return the name of a column without its unit, and the unit; None if the name states no unit."""
    if hit := _UNIT.fullmatch(name):
        return hit["bare"], hit["inside"] or hit["over"]
    if hit := _ENDING.fullmatch(name):
        unit = units.canonical(re.sub(r"(?<=.)_(s2?)$", r"/\1", hit["unit"]))
        if unit in units.KNOWN:
            return hit["bare"], unit
    return name, None


def _target(bare: str, unit: str | None) -> str | None:
    """Return the column of the log format that a name without unit states; None if there is none."""
    for pattern, target in _NAMES:
        hit = re.fullmatch(pattern, bare)
        if hit is not None:
            wanted = target.format(**hit.groupdict())
            fitting = units.UNITS.get(units.measured(wanted) or "", {})
            return wanted if unit is None or unit in fitting else None
    if unit is None or bare == "":
        return None
    # the unit determines the quantity if no other quantity has this unit
    quantities = [quantity for quantity, table in units.UNITS.items() if unit in table]
    word = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")
    if len(quantities) != 1 or not word[:1].isalpha():
        return None
    return f"{word}_{next(iter(units.UNITS[quantities[0]])).replace('/', '_')}"


def _time(table: Table, columns: dict[str, Any]) -> dict[str, Any] | str:
    """Return the value of ``time:``, as far as names and units state it."""
    stated = {name: _unit_of_time(name, table.units.get(name)) for name in columns}
    stamps = [n for n in columns if stated[n] != ASK or mapping.OF_TIME.fullmatch(_split(n.strip())[0])]
    # the time stamp of the sensor has precedence over the time stamp of the recorder
    stamps.sort(key=lambda name: "header" not in name.lower())
    counts = [name for name in columns if mapping.COUNT.fullmatch(name.strip().lower())]
    if TIME in columns:
        return {"source": TIME, "unit": "s"}
    if stamps and is_text(columns[stamps[0]]):
        texts = [name for name in stamps if is_text(columns[name])]
        return {"source": texts if len(texts) > 1 else texts[0], "origin": "first"}
    if stamps and columns[stamps[0]].dtype.kind == "M":
        return {"source": stamps[0], "origin": "first"}
    if stamps:
        return {"source": stamps[0], "unit": stated[stamps[0]]}
    if counts:
        return {"frame": counts[0], "rate_hz": ASK}
    return ASK


def _unit_of_time(name: str, written: str | None) -> str:
    """Return the unit of time that a column states, in its name or as its name; ``ASK`` if it states none."""
    units_stated = (named(name, written)[1], units.canonical(name))
    return next((unit for unit in units_stated if unit in units.UNITS["time"]), ASK)


def _first(values: Any) -> str:
    """Return the first three values of a column as text."""
    if values.dtype.kind == "f":
        return ", ".join(f"{value:.6g}" for value in values[:3])
    return ", ".join(str(value)[:30] for value in values[:3])
