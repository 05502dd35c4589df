"""Evidence of ``swimid import``: checks, tables and figures of an examined log, and the same as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Literal

import numpy as np

from swimid.logs import figures, log
from swimid.logs.examine import Examined
from swimid.logs.log import Log
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import usual_step
from swimid.notices import Notice, recorded
from swimid.results import blocks, numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, Table, check, judged

#: Minimum number of samples a stroke for the path between them to be known.
MIN_SAMPLES_PER_STROKE = 6.0
#: A track farther from a line than this share of its extent along the line does not keep to it.
OFF_LINE = 0.1
#: Largest share of the rows that may be dropped: with more the time is hardly complete.
MAX_DROPPED = 0.1
#: With more samples that jump than this share a track is no track.
MAX_JUMPED = 0.2
REFERENCES = [
    "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
    "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
    "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
    "377-403. doi:10.1007/BF01404567",
]


def build(found: Examined, provenance: dict[str, Any], notices: Sequence[Notice]) -> Evidence:
    """Assemble the evidence of a log."""
    checks = [*_row_checks(found), *_track_checks(found), *_stroke_checks(found)]
    with recorded(repeat=True) as drawn:
        shown = figures.figures([Log(found.path, {}, found.columns)], found=found.stroke)
    return Evidence(
        verb="import",
        title=f"Log imported from {found.path.name}",
        verdict=judged(f"{len(found.time_s)} samples in {len(found.columns) - 1} channels.", checks),
        facts=_facts(found),
        checks=checks,
        tables=[*_speed(found), *_stroke(found), _sources(found)],
        figures=shown,
        notices=blocks.notices([*notices, *drawn]),
        methods=_methods(found),
        references=[] if found.cleaning is None else REFERENCES,
        provenance=provenance,
    )


def _check(
    name: str, value: str, passed: bool, limit: str, reason: str, otherwise: Literal["warn", "fail"] = "warn"
) -> Check:
    """Return a check whose text is the reason why it does not pass, unless its value says it all."""
    text = "" if passed or value in reason else reason
    return check(name, value, passed, limit, text, otherwise=otherwise, reason=reason)


def _row_checks(found: Examined) -> list[Check]:
    mapped, order, n = found.mapped, found.order, len(found.mapped)
    odd, dropped = sum(order.counts.values()), order.untimed + order.clashing
    remarks = "; ".join([f"rows {order.summary}"] * bool(odd) + found.mapped.notes)
    grade, sampling = _grade(dropped > MAX_DROPPED * n), found.uneven or "even"
    if grade == "fail":
        remarks = f"{dropped} of {n} rows have no time of their own: is the time complete?"
    names = ", ".join(mapped.unknown)
    open_ = f"nothing states the quantity of {names}: map it to a name with a unit, or to unit: '1'"
    disagree = "; ".join(f"{one.column} {one.text} (against {one.against})" for one in found.contradictions)
    uneven = f"the sampling is uneven{', in bursts' if found.bursts else ''}: {found.uneven}"
    holds = "; ".join(f"{name} from {a:.4g} to {b:.4g} s" for name, (a, b) in found.frozen.items())
    frozen = f"channels hold one value amid their motion: {holds}"
    doubts = "; ".join(f"{doubt.column} {doubt.text}" for doubt in found.doubts)
    checks = [
        _check("Rows in order", f"{odd} of {n} odd", not remarks, "none", remarks, grade),
        _check("Quantity of every column", names or "known", not names, "known", open_, "fail"),
        _check("Columns agree", disagree or "all", not disagree, "all", disagree, "fail"),
        _check("Sampling", sampling, not found.uneven, "even", uneven, _grade(found.bursts)),
        _check("Frozen channels", holds or "none", not holds, "none", frozen, "fail"),
        _check(POSSIBLE, "beyond" if doubts else "within", not doubts, "within", doubts),
    ]
    if found.metadata.get("sample_rate") == "assumed":
        why = "the sample rate is assumed, and speeds and frequencies are as wrong as it is"
        checks.append(_check("Sample rate", "assumed", False, "stated", why, "fail"))
    for name, emptied in mapped.unlikely.items():
        why = f"{emptied} of {n} samples are left empty for their {name}"
        checks.append(_check(f"Samples by {name}", f"{emptied} of {n}", False, "none", why))
    return checks


def _grade(fails: bool) -> Literal["warn", "fail"]:
    return "fail" if fails else "warn"


def _track_checks(found: Examined) -> list[Check]:
    checks = []
    line, cleaning = found.projection, found.cleaning
    if line is not None:
        across, extent = (numbers.number(v, 3, found.unit) for v in (line.across, line.extent))
        why = f"the track leaves the line by {across} over {extent}, and is shortened by projecting it"
        keeps, limit = line.across <= OFF_LINE * line.extent, f"≤ {100 * OFF_LINE:g} % of the extent"
        checks.append(_check("Distance from the line", across, keeps, limit, why))
    if cleaning is None:
        return checks
    done = "left out" if found.cleaned else "kept"
    lost, repeats = cleaning.counts["samples_jumped"], cleaning.counts["repeats"]
    seen = int(cleaning.good.sum()) + repeats + lost
    value, why = f"{repeats} of {seen} {done}", "the track holds repeated pictures (--clean leaves them out)"
    checks.append(_check("Repeated pictures", value, found.cleaned or not repeats, "none kept", why))
    why = f"the track jumps {cleaning.jumps} times ({lost} samples {done})"
    if cleaning.offset_rows:
        why += f" and goes on elsewhere {len(cleaning.offset_rows)} times"
    value, grade = (
        f"{cleaning.jumps} ({lost} samples {done})",
        _grade(lost > MAX_JUMPED * seen or not found.cleaned),
    )
    checks.append(_check("Jumps", value, not cleaning.jumps, "none", why, grade))
    value = f"{len(cleaning.gaps)}, longest {numbers.number(cleaning.longest_gap_s, 3, 's')}"
    why = f"the track has gaps ({value}), which are kept"
    return [*checks, _check("Gaps in the track", value, not cleaning.gaps, "none", why)]


def _stroke_checks(found: Examined) -> list[Check]:
    stroke = found.stroke
    if stroke is None:
        return []
    checks = []
    if found.speed is not None and found.cleaning is not None:
        count = float(found.cleaning.good.sum()) / found.speed.covered_s / stroke.beat.frequency_hz
        value, limit = numbers.number(count, 3), f"≥ {MIN_SAMPLES_PER_STROKE:g}"
        why = f"the track has {value} samples a stroke, too few to know the path between them"
        checks.append(_check("Samples a stroke", value, count >= MIN_SAMPLES_PER_STROKE, limit, why))
    value = " against ".join(f"{b.frequency_hz:.4g} Hz" for b in (stroke.beat, *stroke.rivals.values()))
    limit = "no channel beats at another frequency"
    checks.append(_check("One stroke", value, not stroke.doubt, limit, stroke.doubt))
    if "frequency_hz" in found.metadata:
        stated, against = f"{found.metadata['frequency_hz']} Hz", found.against or ""
        name = "Stroke against the metadata"
        checks.append(_check(name, _frequency(stroke), not against, stated, against))
    return checks


def _facts(found: Examined) -> dict[str, str]:
    """Return the particulars beside those of any log."""
    cleaning, speed, stroke, line = found.cleaning, found.speed, found.stroke, found.projection
    facts = {"Stroke": f"unknown: {found.unknown}"}
    if stroke is not None:
        facts["Stroke"] = f"{_frequency(stroke)} in {stroke.channel}"
        if stroke.maybe_double:
            facts["Stroke"] += ", may be twice the stroke: no channel that swings sideways is there"
    if cleaning is not None:
        counts, done = cleaning.counts, "left out" if found.cleaned else "kept"
        facts["Track"] = (
            f"{counts['repeats']} repeats and {counts['jumps']} jumps {done}, {len(cleaning.gaps)} gaps kept"
        )
    if speed is not None:
        path, straight = (f"{mean.value:.4g} {found.unit}/s" for mean in (speed.path, speed.line))
        facts["Speed"] = f"{path} along the path, {straight} along the line"
    if line is not None:
        way = ", ".join(f"{part:.4g}" for part in line.direction)
        facts["Line"] = f"x_{found.unit} is the way along ({way})"
    return facts


def _speed(found: Examined) -> list[Table]:
    speed, unit = found.speed, found.unit
    if speed is None:
        return []
    rows: list[list[Any]] = [
        ["along the path", speed.path.value, speed.path.low, speed.path.high],
        ["along the line from start to end", speed.line.value, speed.line.low, speed.line.high],
        ["naive mean of |dx/dt|", speed.naive_m_s, None, None],
    ]
    noise = numbers.number(speed.noise_m, 3, unit)
    caption = f"Over {speed.covered_s:.4g} s without the gaps; the noise of a coordinate is {noise}."
    columns = ["mean speed", f"{unit}/s", "95 % from", "to"]
    return [Table(id="speed", title="Mean speed", columns=columns, rows=rows, caption=caption)]


def _stroke(found: Examined) -> list[Table]:
    stroke = found.stroke
    if stroke is None:
        return []
    harmonics: list[list[Any]] = []
    for h in stroke.harmonics:
        frequency_hz = h.order * stroke.beat.frequency_hz
        harmonics.append([f"{h.order} ×", frequency_hz, numbers.measured(h.amplitude, h.stderr)])
    channels: list[list[Any]] = []
    for name, beat in stroke.channels.items():
        frequency = numbers.measured(beat.frequency_hz, beat.stderr_hz)
        channels.append([name, frequency, beat.amplitude, 100 * beat.share])
    title = f"Stroke and harmonics in {stroke.channel}, over {stroke.beat.cycles:.3g} cycles"
    columns = ["harmonic", "frequency (Hz)", "amplitude"]
    of_channels = ["channel", "frequency (Hz)", "amplitude", "share of the variance (%)"]
    return [
        Table(id="stroke", title=title, columns=columns, rows=harmonics, folded=True),
        Table(id="beats", title="Beat of every channel", columns=of_channels, rows=channels, folded=True),
    ]


def _sources(found: Examined) -> Table:
    rows: list[list[Any]] = [
        [name, *found.mapped.sources.get(name, (name, 1.0, 0.0))] for name in found.columns
    ]
    columns = ["column", "source", "factor", "offset"]
    return Table(id="columns", title="Sources of the columns", columns=columns, rows=rows, folded=True)


def _frequency(stroke: Rhythm) -> str:
    return numbers.measured(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")


def _methods(found: Examined) -> list[str]:
    sentences = []
    if found.cleaned:
        sentences.append(
            "Repeated samples of the camera and jumps, found by a Hampel identifier on the steps of the "
            "track, were left out; gaps were not bridged."
        )
    if found.speed is not None:
        sentences.append(
            "The mean speed was taken along cubic smoothing splines, their smoothness chosen by "
            "cross-validation, and corrected for the noise by a parametric bootstrap."
        )
    if found.stroke is not None:
        sentences.append(
            "The stroke frequency is the slope of the phases of a sine fitted in windows of two cycles "
            "beside a cubic drift, by generalised least squares."
        )
    return sentences


def data(found: Examined, proof: Evidence) -> dict[str, Any]:
    """Return what was found as plain data."""
    time, unit, step = found.time_s, found.unit, usual_step(found.time_s)
    cleaning, speed, line = found.cleaning, found.speed, found.projection
    made: dict[str, Any] = {
        "file": str(found.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": 1 / step if step > 0 else None,
        "columns": list(found.columns),
        "missing": {n: int(np.isnan(v).sum()) for n, v in found.columns.items() if n != log.TIME},
        "rows": found.order.counts,
        "notes": found.mapped.notes,
        "profile": found.mapped.profile,
        "unlikely": found.mapped.unlikely,
        "contradictions": [asdict(one) for one in found.contradictions],
        "stroke": {"unknown": found.unknown},
        **dict.fromkeys(("track", "speed", "line")),
        "verdict": proof.verdict.model_dump(),
        "checks": [check.model_dump() for check in proof.checks],
    }
    if cleaning is not None:
        made["track"] = {
            "cleaned": found.cleaned,
            **cleaning.counts,
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        }
    if speed is not None:
        made["speed"] = {
            f"path_{unit}_s": speed.path.value,
            "path_ci95": [speed.path.low, speed.path.high],
            f"line_{unit}_s": speed.line.value,
            "line_ci95": [speed.line.low, speed.line.high],
            f"naive_{unit}_s": speed.naive_m_s,
            f"noise_{unit}": speed.noise_m,
            "covered_s": speed.covered_s,
        }
    if found.stroke is not None:
        made["stroke"] = _stroke_data(found.stroke) | {"contradiction": found.against}
    if line is not None:
        direction = line.direction.tolist()
        made["line"] = {"direction": direction, "extent": line.extent, "across_rms": line.across}
    return made


def _stroke_data(stroke: Rhythm) -> dict[str, Any]:
    return {
        "frequency_hz": stroke.beat.frequency_hz,
        "stderr_hz": stroke.beat.stderr_hz,
        "ci95_hz": list(stroke.beat.interval_hz),
        "period_s": stroke.period_s[0],
        "cycles": stroke.beat.cycles,
        "channel": stroke.channel,
        "maybe_double": stroke.maybe_double,
        "harmonics": [asdict(harmonic) for harmonic in stroke.harmonics],
        "channels_hz": {n: b.frequency_hz for n, b in stroke.channels.items()},
        "rivals_hz": {n: b.frequency_hz for n, b in stroke.rivals.items()},
    }
