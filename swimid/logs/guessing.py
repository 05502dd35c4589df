"""What the columns of a foreign log may be, from their names and their values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
#: Correlation from which on a column is the rate of change of another.
ALIKE = 0.8
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
    why: list[str] | None = None

    def say(self, reason: str) -> None:
        """Add a reason."""
        self.why = [*(self.why or []), reason]


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
        _by_values(guesses, columns, time)
    _units_by_values(guesses, columns)
    _unique(guesses)
    return guesses


def _points(guesses: Sequence[Guess]) -> None:
    """Points of a table of a picture tracker: each with its likelihood; the first is the track."""
    parts = {g.source: _POINT.fullmatch(g.source.strip()) for g in guesses}
    sure = [m["point"] for m in parts.values() if m is not None and m["what"] == "likelihood"]
    for g in guesses:
        match = parts[g.source]
        if match is None or match["point"] not in sure:
            continue
        point, what = match["point"], match["what"]
        name = re.sub(r"[^A-Za-z0-9]+", "_", point)
        g.unit = None
        if what == "likelihood":
            g.target, g.why = f"{name}_likelihood", ["its name"]
        else:
            g.target = f"{what}_px" if point == sure[0] else f"{name}_{what}_px"
            g.why = [f"{what} of the point {point}, with a likelihood: pixels"]
            if what == "y":
                g.factor = -1.0
                g.say("rows count downwards")


def _by_name(found: Guess, written: str | None) -> None:
    name = found.source.strip()
    match = _UNIT.search(name)
    unit = written or (match["unit"] if match else None)
    bare = (name[: match.start()] if match else name).strip().lower()
    quantity = units.measured(name)
    if quantity is not None and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        found.target, found.unit = name, None
        found.say("named as in the log format")
        return
    for ending, spelled in (
        ("_mm", "mm"),
        ("_cm", "cm"),
        ("_deg", "deg"),
        ("_ms", "ms"),
        ("_us", "us"),
        ("_ns", "ns"),
        ("_dps", "deg/s"),
        ("_deg_s", "deg/s"),
        ("_g", "g"),
        ("_mg", "mg"),
        ("_ut", "uT"),
    ):
        if unit is None and bare.endswith(ending):
            unit, bare = spelled, bare.removesuffix(ending)
    if unit is not None and units.canonical(unit) in {u for table in units.UNITS.values() for u in table}:
        found.unit = units.canonical(unit)
        found.say(f"unit {unit} in the {'line of units' if written else 'name'}")
    if _TIME.fullmatch(bare):
        found.target = "t_s"
        found.say("its name")
        return
    for pattern, target in _NAMES:
        hit = re.fullmatch(pattern, bare)
        if hit is None:
            continue
        axis: str | None = hit.groupdict().get("axis")
        letters = (
            dict(zip("1234", "wxyz", strict=True))
            if target == "q{axis}"
            else dict(zip("123", "xyz", strict=True))
        )
        if axis is not None and target[:5] not in ("joint", "cmd{a"):
            axis = letters.get(axis) or axis
        wanted = target.format(axis=axis, number=hit.groupdict().get("number"))
        if found.unit is not None and not _fits(found.unit, wanted):
            continue
        found.target = wanted
        found.say("its name")
        return
    if found.unit is not None:
        suffix = next((s for s, q in units.SUFFIXES.items() if found.unit in units.UNITS[q]), None)
        word = re.sub(r"[^a-z0-9]+", "_", bare).strip("_")
        if suffix is not None and re.match(r"[a-z]", word):
            found.target = f"{word}_{suffix}"


def _fits(unit: str, target: str) -> bool:
    try:
        units.factor(unit, target)
    except ValueError:
        return False
    return True


def _find_time(guesses: list[Guess], columns: Mapping[str, Array]) -> Guess | None:
    named = [g for g in guesses if g.target == "t_s"]
    growing = [
        g
        for g in guesses
        if g.target in (None, "t_s") and _grows(columns[g.source]) and not _counts(g, columns[g.source])
    ]
    # when it was measured before when it was recorded
    named.sort(key=lambda g: "header" not in g.source)
    chosen = next((g for g in named if g in growing), None)
    if chosen is None and growing:
        chosen = growing[0]
        chosen.target, chosen.unit = "t_s", None
        chosen.say("the first column that always grows")
    for other in named:
        if other is not chosen:
            other.target = None
    return chosen


def _counts(found: Guess, values: Array) -> bool:
    """Whether a column numbers the samples."""
    known = values[np.isfinite(values)]
    return bool(
        _COUNT.fullmatch(found.source.strip().lower()) and len(known) > 1 and np.all(np.diff(known) == 1)
    )


def _grows(values: Array) -> bool:
    known = values[np.isfinite(values)]
    if len(known) < 3 or len(known) < 0.9 * len(values):
        return False
    steps = np.diff(known)
    usual = float(np.median(steps))
    even = np.mean(np.abs(steps - usual) <= 0.5 * usual) if usual > 0 else 0.0
    return bool(np.mean(steps >= 0) > 0.99 and usual > 0 and even > 0.5)


def _time_unit(time: Guess, values: Array) -> None:
    known = values[np.isfinite(values)]
    step = float(np.median(np.diff(known)))
    if time.unit is None:
        order = ["s", "ms", "us", "ns"]
        rates = {unit: 1 / (step * units.factor(unit, "t_s")) for unit in order}
        likely = [unit for unit, rate in rates.items() if SLOWEST_HZ <= rate <= FASTEST_HZ]
        # a clock since 1970 tells its unit by its size alone
        since = next((u for u in order if 9e8 < known[0] * units.factor(u, "t_s") < 4e9), None)
        best = since or next((u for u in likely if rates[u] >= 5), (likely or order)[0])
        time.unit = best
        time.say(f"steps of {step:.6g} would be {rates[best]:.4g} Hz in {best}")
        if since:
            time.say("counts from 1970")
    else:
        time.say(f"steps of {step:.6g} {time.unit}")


def _by_values(guesses: list[Guess], columns: Mapping[str, Array], time: Guess | None) -> None:
    """Groups of neighbouring columns that measure what only one sensor measures."""
    names = [g for g in guesses if g is not time and g.target is None]
    at = 0
    while at < len(names):
        here = names[at : at + 4]
        four = np.column_stack([columns[g.source] for g in here])
        if len(here) == 4 and _steady(np.linalg.norm(four, axis=1), 1.0, 0.02) and np.ptp(four) > 0:
            for g, axis in zip(here, "wxyz", strict=True):
                g.target = f"q{axis}"
                g.say(
                    "four columns of length 1: a quaternion; whether its real part is first, they do not tell"
                )
            at += 4
            continue
        norm = np.linalg.norm(four[:, :3], axis=1) if four.shape[1] >= 3 else np.empty(0)
        gravity = next(
            (
                u
                for u, g in (("m/s2", 9.81), ("g", 1.0), ("mg", 1000.0))
                if len(norm) and _steady(norm, g, 0.06)
            ),
            None,
        )
        if gravity is not None and not any(g.target == "ax_m_s2" for g in guesses):
            for g, axis in zip(here[:3], "xyz", strict=True):
                g.target, g.unit = f"a{axis}_m_s2", gravity
                g.say(f"three columns of length {np.nanmedian(norm):.4g}: gravity in {gravity}")
            after = names[at + 3 : at + 6]
            if len(after) == 3 and all(
                abs(float(np.nanmedian(columns[g.source]))) < 0.2 * float(np.nanstd(columns[g.source])) + 0.1
                for g in after
            ):
                for g, axis in zip(after, "xyz", strict=True):
                    g.target = f"w{axis}_rad_s"
                    g.say("three columns about zero after the acceleration: turn rates")
                at += 3
            at += 3
            continue
        at += 1
    if time is not None and time.unit is not None:
        _by_rates(guesses, columns, columns[time.source] * units.factor(time.unit, "t_s"))


def _by_rates(guesses: list[Guess], columns: Mapping[str, Array], time: Array) -> None:
    """Columns that are the rate of change of another."""
    open_ones = [g for g in guesses if g.target is None]
    for rate in open_ones:
        for base in open_ones:
            if base is rate or rate.target is not None or base.target is not None:
                continue
            gain, r = _rate_of(time, columns[base.source], columns[rate.source])
            if r > ALIKE:
                rate.say(
                    f"follows the rate of change of column {base.source} (r = {r:.3f}, factor {gain:.3g})"
                )
                base.say(f"its rate of change is column {rate.source}")


def _rate_of(time: Array, base: Array, rate: Array) -> tuple[float, float]:
    known = np.isfinite(time) & np.isfinite(base) & np.isfinite(rate)
    t, x, y = time[known], base[known], rate[known]
    if len(t) < 30 or np.any(np.diff(t) <= 0):
        return 0.0, 0.0
    slope = (x[2:] - x[:-2]) / (t[2:] - t[:-2])
    y = y[1:-1]
    if np.std(slope) == 0 or np.std(y) == 0:
        return 0.0, 0.0
    r = float(np.corrcoef(slope, y)[0, 1])
    return float(np.std(y) / np.std(slope)), r


def _steady(norm: Array, wanted: float, share: float) -> bool:
    known = norm[np.isfinite(norm)]
    return bool(
        len(known) > 3
        and abs(np.median(known) / wanted - 1) < share
        and np.mean(np.abs(known / wanted - 1) < 2 * share) > 0.5
    )


def _units_by_values(guesses: list[Guess], columns: Mapping[str, Array]) -> None:
    """Units of what has a target and no unit yet."""
    by_target = {g.target: g for g in guesses if g.target}
    for axes, table in (
        (("ax_m_s2", "ay_m_s2", "az_m_s2"), (("m/s2", 9.81), ("g", 1.0), ("mg", 1000.0))),
        (("mx_T", "my_T", "mz_T"), (("uT", 45.0), ("G", 0.45), ("mG", 450.0), ("T", 4.5e-5))),
    ):
        group = [by_target[a] for a in axes if a in by_target]
        if len(group) < 3 or all(g.unit for g in group):
            continue
        size = float(
            np.nanmedian(np.linalg.norm(np.column_stack([columns[g.source] for g in group]), axis=1))
        )
        what = "gravity" if axes[0] == "ax_m_s2" else "the field of the earth"
        unit = next((u for u, known in table if 0.6 < size / known < 1.6), None)
        for g in group:
            if unit is None:
                g.say(f"length {size:.4g} is {what} in no unit known: give a factor")
            elif not g.unit:
                g.unit = unit
                g.say(f"length {size:.4g} is {what} in {unit}")
    lengths = [g for g in guesses if g.target and units.measured(g.target) == "length"]
    pattern = next((g for g in lengths if g.unit), None)
    spread = max((_extent(columns[g.source]) for g in lengths), default=0.0)
    for g in guesses:
        if g.target is None or g.unit is not None or g.target == "t_s" or "named as" in str(g.why):
            continue
        if g in lengths and pattern is not None:
            g.unit = pattern.unit
            g.say(f"in the unit of {pattern.source}")
        else:
            known = columns[g.source][np.isfinite(columns[g.source])]
            largest = spread if g in lengths else float(np.max(np.abs(known), initial=0.0))
            _unit_by_size(g, units.measured(g.target), largest)


def _extent(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def _unit_by_size(found: Guess, quantity: str | None, largest: float) -> None:
    rules: dict[str, tuple[float, str, str]] = {
        "angle": (7.0, "deg", "rad"),
        "turn rate": (35.0, "deg/s", "rad/s"),
        "length": (30.0, "mm", "m"),
        "speed": (10.0, "mm/s", "m/s"),
        "force": (1000.0, "mN", "N"),
    }
    if quantity not in rules:
        return
    limit, above, below = rules[quantity]
    found.unit = above if largest > limit else below
    what = "they extend over" if quantity == "length" else "values up to"
    found.say(f"{what} {largest:.4g}: taken for {found.unit}")


def _unique(guesses: Sequence[Guess]) -> None:
    seen: set[str] = set()
    for g in guesses:
        if g.target in seen:
            g.say(f"{g.target} is another column already")
            g.target = None
        elif g.target is not None:
            seen.add(g.target)
