"""What the columns of a foreign log may be, from their names and their values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from swimid.logs import units

Array = NDArray[np.float64]
#: Words of column names, in order of trust: pattern of the whole bare name, target column.
_AXIS = r"[ _.\[]*(?P<axis>[xyz123])\]?"
_NAMES: list[tuple[str, str]] = [
    (
        r"(lin(ear)?)?[ _.]*(acc(el(eration|erometer|erometro)?)?|imu[ _.]acc|linear_acceleration|a)" + _AXIS,
        "a{axis}_m_s2",
    ),
    (
        r"(imu[ _.])?(gyr(o(scope)?)?|ang(ular)?[ _.]?(vel(ocity)?|rate)|omega|w|rate)" + _AXIS,
        "w{axis}_rad_s",
    ),
    (r"(imu[ _.])?mag(net(ometer|ic)?(_field)?)?" + _AXIS, "m{axis}_T"),
    (r"m" + r"(?P<axis>[xyz])", "m{axis}_T"),
    (r"(opt[ _.])?(quat(ernion)?|orientation|att(itude)?|q|rot)[ _.\[]*(?P<axis>[wxyz1234])\]?", "q{axis}"),
    (r"(pos(ition)?|p|loc(ation)?|opt_pos|translation)?" + _AXIS, "{axis}_m"),
    (r"(vel(ocity)?|v|speed)" + _AXIS, "v{axis}_m_s"),
    (r"surge([ _.]?(vel(ocity)?|speed|rate))?|u", "u_m_s"),
    (r"sway([ _.]?(vel(ocity)?|speed|rate))?|v", "v_m_s"),
    (r"heave([ _.]?(vel(ocity)?|speed|rate))?|w", "w_m_s"),
    (r"(yaw|heading|psi)[ _.]?(rate|vel(ocity)?|speed)|r", "yaw_rate_rad_s"),
    (r"yaw|heading|psi|azimuth|theta_z", "yaw_rad"),
    (r"roll|phi|bank", "roll_rad"),
    (r"pitch|theta", "pitch_rad"),
    (r"(net[ _.]?)?force|load([ _.]?cell)?|thrust", "force_N"),
    (r"(m|marker|led|point)[ _.]?(?P<number>\d+)[ _.]?(?P<axis>[xyz])", "m{number}_{axis}_m"),
    (r"joint[ _.]?(angle)?[ _.\[]*(?P<axis>\d+)\]?", "joint{axis}_rad"),
    (r"(cmd|command|servo|setpoint)[ _.\[]*(?P<axis>\d+)\]?", "cmd{axis}_rad"),
]
_TIME = re.compile(
    r"(t|time|(time)?[ _.]?stamp|timestamp|zeit|temps|seconds|log_time|header[ _.]stamp|sampletime(fine)?|"
    r"epoch)"
)
#: Names of columns that count samples and are no time.
_COUNT = re.compile(r"frame([ _.]?(number|no|index))?|index|sample|n|unnamed: 0|column 1")
#: A point of a tracker of pictures, in pixels where the table tells how likely each one is.
_POINT = re.compile(r"(?P<point>[A-Za-z]\w*)_(?P<what>x|y|likelihood)")
_UNIT = re.compile(r"[\[(/]\s*(?P<unit>[^\])\d][^\])]*)\s*[\])]?\s*$")
#: Units at the end of a name, as in ``x_mm``.
_ENDINGS = {
    "mm": "mm",
    "cm": "cm",
    "deg": "deg",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
    "dps": "deg/s",
    "deg_s": "deg/s",
    "g": "g",
    "mg": "mg",
    "ut": "uT",
}
#: What the length of three columns tells: gravity, and the field of the earth, by unit.
_GRAVITY = {"m/s2": 9.81, "g": 1.0, "mg": 1000.0}
_FIELD = {"uT": 45.0, "G": 0.45, "mG": 450.0, "T": 4.5e-5}
#: Up to which value a quantity is taken for one in SI, and its unit above.
_SIZES = {
    "angle": (7.0, "rad", "deg"),
    "turn rate": (35.0, "rad/s", "deg/s"),
    "length": (30.0, "m", "mm"),
    "speed": (10.0, "m/s", "mm/s"),
    "force": (1000.0, "N", "mN"),
}
#: Rates a logger may have, Hz: within these a unit of time is believed.
SLOWEST_HZ, FASTEST_HZ = 0.2, 20_000.0


@dataclass
class Guess:
    """One column and what it may be.

    Attributes
    ----------
    source : str
        Name or number of the column.
    target : str or None
        Column of the log format, ``t_s`` for the time; None where nothing is known.
    unit : str or None
    factor : float
        Beside that of the unit.
    why : list of str
        The evidence.
    """

    source: str
    target: str | None = None
    unit: str | None = None
    factor: float = 1.0
    why: list[str] = field(default_factory=list)


def guess(columns: Mapping[str, Array], written: Mapping[str, str], *, headed: bool) -> list[Guess]:
    """Guess every column of a log.

    Parameters
    ----------
    columns : mapping of str to ndarray, each shape (n,)
        The first samples, raw; NaN where missing.
    written : mapping of str to str
        Units from a line of units.
    headed : bool
        Whether the names mean something.
    """
    guesses = [Guess(name) for name in columns]
    if headed:
        for found in guesses:
            _by_name(found, written.get(found.source))
        _points(guesses)
    time = _find_time(guesses, columns)
    if time is not None:
        _time_unit(time, columns[time.source])
    if not headed or not any(g.target for g in guesses if g is not time):
        _by_values([g for g in guesses if g is not time and g.target is None], columns)
    _units_by_values(guesses, columns)
    seen: set[str] = set()
    for g in guesses:
        if g.target in seen:
            g.why.append(f"{g.target} is another column already")
            g.target = None
        elif g.target is not None:
            seen.add(g.target)
    return guesses


def _points(guesses: Sequence[Guess]) -> None:
    """Points of a table of a picture tracker: each with its likelihood; the first is the track."""
    parts = [(g, match) for g in guesses if (match := _POINT.fullmatch(g.source.strip()))]
    sure = [match["point"] for _, match in parts if match["what"] == "likelihood"]
    for g, match in parts:
        point, what = match["point"], match["what"]
        if point not in sure:
            continue
        name = re.sub(r"[^A-Za-z0-9]+", "_", point)
        g.unit, g.target, g.why = None, f"{name}_likelihood", ["its name"]
        if what != "likelihood":
            g.target = f"{what}_px" if point == sure[0] else f"{name}_{what}_px"
            g.why = [f"{what} of the point {point}, with a likelihood: pixels"]
        if what == "y":
            g.factor = -1.0
            g.why.append("rows count downwards")


def _by_name(found: Guess, written: str | None) -> None:
    name = found.source.strip()
    match = _UNIT.search(name)
    unit = written or (match["unit"] if match else None)
    bare = (name[: match.start()] if match else name).strip().lower()
    if units.measured(name) is not None and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        found.target, found.why = name, ["named as in the log format"]
        return
    for ending, spelled in _ENDINGS.items():
        if unit is None and bare.endswith(f"_{ending}"):
            unit, bare = spelled, bare.removesuffix(f"_{ending}")
    if unit is not None and units.canonical(unit) in units.KNOWN:
        found.unit = units.canonical(unit)
        found.why.append(f"unit {unit} in the {'line of units' if written else 'name'}")
    found.target = _target(bare, found.unit)
    if found.target is not None:
        found.why.append("its name")
    elif found.unit is not None:
        suffix = next((s for s, q in units.SUFFIXES.items() if found.unit in units.UNITS[q]), None)
        word = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")
        if suffix is not None and re.match(r"[a-z]", word):
            found.target = f"{word}_{suffix}"


def _target(bare: str, unit: str | None) -> str | None:
    """The column of the log format that a name in small letters, without its unit, may mean."""
    if _TIME.fullmatch(bare):
        return "t_s"
    for pattern, target in _NAMES:
        hit = re.fullmatch(pattern, bare)
        if hit is None:
            continue
        parts = hit.groupdict()
        if target[:5] not in ("joint", "cmd{a") and parts.get("axis", "").isdecimal():
            parts["axis"] = ("wxyz" if target == "q{axis}" else "xyz")[int(parts["axis"]) - 1]
        wanted = target.format(**parts)
        if unit is None or _fits(unit, wanted):
            return wanted
    return None


def _fits(unit: str, target: str) -> bool:
    try:
        units.factor(unit, target)
    except ValueError:
        return False
    return True


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


def _find_time(guesses: list[Guess], columns: Mapping[str, Array]) -> Guess | None:
    """The column of the times: one that grows, by its name or else the first."""
    named = [g for g in guesses if g.target == "t_s"]
    # when it was measured before when it was recorded
    ranked = sorted(named, key=lambda g: "header" not in g.source)
    ranked += [g for g in guesses if g.target is None]
    chosen = next((g for g in ranked if _grows(g, columns[g.source])), None)
    for other in named:
        other.target = None
    if chosen in named:
        chosen.target = "t_s"
    elif chosen is not None:
        chosen.target, chosen.unit = "t_s", None
        chosen.why.append("the first column that always grows")
    return chosen


def _grows(found: Guess, values: Array) -> bool:
    """Whether a column grows as a time does, and does not number the samples."""
    known = _known(values)
    if len(known) < 3 or len(known) < 0.9 * len(values):
        return False
    steps = np.diff(known)
    usual = float(np.median(steps))
    numbers = _COUNT.fullmatch(found.source.strip().lower()) and np.all(steps == 1)
    even = usual > 0 and np.mean(np.abs(steps - usual) <= 0.5 * usual) > 0.5
    return bool(even and np.mean(steps >= 0) > 0.99 and not numbers)


def _time_unit(time: Guess, values: Array) -> None:
    known = _known(values)
    step = float(np.median(np.diff(known)))
    if time.unit is not None:
        time.why.append(f"steps of {step:.6g} {time.unit}")
        return
    factors = {unit: units.factor(unit, "t_s") for unit in ("s", "ms", "us", "ns")}
    rates = {unit: 1 / (step * factor) for unit, factor in factors.items()}
    likely = [unit for unit, rate in rates.items() if SLOWEST_HZ <= rate <= FASTEST_HZ]
    # a clock since 1970 tells its unit by its size alone
    since = next((unit for unit, factor in factors.items() if 9e8 < known[0] * factor < 4e9), None)
    time.unit = since or next((u for u in likely if rates[u] >= 5), (likely or ["s"])[0])
    time.why.append(f"steps of {step:.6g} would be {rates[time.unit]:.4g} Hz in {time.unit}")
    if since:
        time.why.append("counts from 1970")


def _by_values(unnamed: list[Guess], columns: Mapping[str, Array]) -> None:
    """Groups of neighbouring columns that measure what only one sensor measures."""
    rest, found_gravity = unnamed, False
    while rest:
        four = np.column_stack([columns[g.source] for g in rest[:4]])
        if len(rest) >= 4 and _steady(np.linalg.norm(four, axis=1), 1.0, 0.02) and np.ptp(four) > 0:
            why = "four columns of length 1: a quaternion; whether its real part is first, they do not tell"
            _name_axes(rest[:4], "wxyz", "q{axis}", why)
            rest = rest[4:]
            continue
        norm = np.linalg.norm(four[:, :3], axis=1) if len(rest) >= 3 else np.empty(0)
        unit = next((unit for unit, size in _GRAVITY.items() if _steady(norm, size, 0.06)), None)
        if unit is None or found_gravity:
            rest = rest[1:]
            continue
        found_gravity = True
        why = f"three columns of length {np.nanmedian(norm):.4g}: gravity in {unit}"
        _name_axes(rest[:3], "xyz", "a{axis}_m_s2", why, unit)
        rest, after = rest[3:], [columns[g.source] for g in rest[3:6]]
        if len(after) == 3 and all(abs(np.nanmedian(v)) < 0.2 * np.nanstd(v) + 0.1 for v in after):
            _name_axes(
                rest[:3],
                "xyz",
                "w{axis}_rad_s",
                "three columns about zero after the acceleration: turn rates",
            )
            rest = rest[3:]


def _name_axes(group: list[Guess], axes: str, target: str, why: str, unit: str | None = None) -> None:
    for g, axis in zip(group, axes, strict=True):
        g.target, g.unit = target.format(axis=axis), unit or g.unit
        g.why.append(why)


def _steady(norm: Array, wanted: float, share: float) -> bool:
    relative = _known(norm) / wanted - 1
    return bool(
        len(relative) > 3 and abs(np.median(relative)) < share and np.mean(np.abs(relative) < 2 * share) > 0.5
    )


def _units_by_values(guesses: list[Guess], columns: Mapping[str, Array]) -> None:
    """Units of what has a target and no unit yet."""
    for target, sizes, what in (
        ("a{}_m_s2", _GRAVITY, "gravity"),
        ("m{}_T", _FIELD, "the field of the earth"),
    ):
        group = [g for g in guesses if g.target in [target.format(axis) for axis in "xyz"]]
        if len(group) < 3 or all(g.unit for g in group):
            continue
        lengths = np.linalg.norm(np.column_stack([columns[g.source] for g in group]), axis=1)
        size = float(np.nanmedian(lengths))
        unit = next((u for u, known in sizes.items() if 0.6 < size / known < 1.6), None)
        for g in group:
            if unit is None:
                g.why.append(f"length {size:.4g} is {what} in no unit known: give a factor")
            elif not g.unit:
                g.unit = unit
                g.why.append(f"length {size:.4g} is {what} in {unit}")
    quantities = {g.source: units.measured(g.target) for g in guesses if g.target not in (None, "t_s")}
    lengths_of = [g for g in guesses if quantities.get(g.source) == "length"]
    pattern = next((g for g in lengths_of if g.unit), None)
    extents = [float(np.ptp(known)) for g in lengths_of if len(known := _known(columns[g.source]))]
    for g in guesses:
        quantity = quantities.get(g.source)
        if quantity is None or g.unit is not None or "named as in the log format" in g.why:
            continue
        if quantity == "length" and pattern is not None:
            g.unit = pattern.unit
            g.why.append(f"in the unit of {pattern.source}")
        elif quantity in _SIZES:
            limit, below, above = _SIZES[quantity]
            largest, what = float(np.max(np.abs(_known(columns[g.source])), initial=0.0)), "values up to"
            if quantity == "length":
                largest, what = max(extents, default=0.0), "they extend over"
            g.unit = above if largest > limit else below
            g.why.append(f"{what} {largest:.4g}: taken for {g.unit}")
