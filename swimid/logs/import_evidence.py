"""What an imported log rests on, as evidence, and its summary."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.logs import figures as log_figures
from swimid.logs import log
from swimid.logs.interval import Estimate
from swimid.logs.mapping import Mapping
from swimid.notices import Notice
from swimid.results import numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, NoticeRecord, Table, Verdict

if TYPE_CHECKING:
    from swimid.logs.import_log import Imported

#: Samples a stroke needs for the path to be followed.
RESOLVED = 6.0
#: Beyond this share of its extent along a line the track does not keep to it.
OFF_LINE = 0.1
#: Of more jumps or missing samples than these shares a track is doubted.
MANY = 0.2


def build(
    found: Imported, target: Path, rules: Mapping | None, provenance: dict[str, Any], notices: list[Notice]
) -> Evidence:
    """The evidence of one imported log."""
    checks = _checks(found)
    figures = log_figures.figures([log.Log(target, found.metadata, found.columns)], found=found.stroke)
    return Evidence(
        verb="import",
        title=f"Log {target.name}, imported from {found.path.name}",
        verdict=_verdict(found, checks),
        checks=checks,
        tables=[_columns(found, rules), *_speeds(found), *_strokes(found)],
        figures=figures,
        notices=[NoticeRecord(code=n.code, text=n.text) for n in notices],
        methods=_methods(found),
        references=_references(found),
        provenance=provenance,
    )


def _checks(found: Imported) -> list[Check]:
    order, n = found.order, len(found.time_s)
    odd = order.untimed + order.repeated + order.clashing + order.late
    checks = [
        Check(
            name="Rows in order",
            value=f"{odd} of {n + odd} odd",
            limit="none",
            verdict="warn" if odd or found.notes else "pass",
            text="; ".join(found.notes) or "rows without a time, repeated, late or of a taken time",
        )
    ]
    if found.metadata.get("sample_rate") == "assumed":
        checks.append(
            Check(
                name="Sample rate",
                value="assumed",
                limit="known",
                verdict="warn",
                text="nothing in the file tells it: put it under 'time:' of the mapping and take "
                "'sample_rate: assumed' out; speeds and frequencies are as wrong as it is",
            )
        )
    checks.append(
        Check(
            name=POSSIBLE,
            value=f"{len({doubt.column for doubt in found.doubts})} columns beyond",
            limit="none",
            verdict="fail" if found.doubts else "pass",
            text="; ".join(f"{doubt.column} {doubt.text}" for doubt in found.doubts),
        )
    )
    line = found.projection
    if line is not None:
        checks.append(
            Check(
                name="Distance from the line",
                value=f"{numbers.number(line.across, 3, found.unit)} rms over "
                f"{numbers.number(line.extent, 3, found.unit)}",
                limit=f"≤ {100 * OFF_LINE:g} % of the extent along it",
                verdict="pass" if line.across <= OFF_LINE * line.extent else "warn",
                text="a track that leaves the line is shortened by projecting it",
            )
        )
    cleaning = found.cleaning
    if cleaning is not None:
        seen = int(cleaning.good.sum() + cleaning.repeated.sum() + cleaning.jumped.sum())
        done = "left out" if found.cleaned else "kept"
        lost = int(cleaning.jumped.sum())
        checks += [
            Check(
                name="Repeated pictures",
                value=f"{int(cleaning.repeated.sum())} of {seen} {done}",
                verdict="info" if found.cleaned or not cleaning.repeated.any() else "warn",
                text="the same pose as the sample before: a camera read faster than it takes pictures",
            ),
            Check(
                name="Jumps",
                value=f"{cleaning.jumps} ({lost} samples {done})",
                limit="few",
                verdict="pass"
                if not cleaning.jumps
                else "fail"
                if lost > MANY * seen or (cleaning.jumps and not found.cleaned)
                else "warn",
                text=f"the track goes on elsewhere {len(cleaning.offset_rows)} times"
                if cleaning.offset_rows
                else "away from the track before and after",
            ),
            Check(
                name="Gaps in the track",
                value=f"{len(cleaning.gaps)}, longest {numbers.number(_longest(cleaning.gaps), 3, 's')}",
                verdict="warn" if cleaning.gaps else "pass",
                text="kept as gaps, never bridged",
            ),
        ]
    if found.speed is not None and found.stroke is not None:
        assert cleaning is not None
        rate = float(cleaning.good.sum()) / found.speed.covered_s
        per_stroke = rate / found.stroke.beat.frequency_hz
        checks.append(
            Check(
                name="Samples a stroke",
                value=numbers.number(per_stroke, 3),
                limit=f"≥ {RESOLVED:g}",
                verdict="pass" if per_stroke >= RESOLVED else "warn",
                text="with fewer the path between samples is not known, and its speed too low",
            )
        )
    if found.stroke is not None:
        checks.append(
            Check(
                name="One stroke",
                value=" against ".join(
                    f"{beat.frequency_hz:.4g} Hz"
                    for beat in (found.stroke.beat, *found.stroke.rivals.values())
                ),
                limit="no channel beats at another",
                verdict="warn" if found.stroke.doubt else "pass",
                text=found.stroke.doubt or "multiples of it counted in",
            )
        )
    if found.stroke is not None and "frequency_hz" in found.metadata:
        checks.append(
            Check(
                name="Stroke against the metadata",
                value=_frequency(found),
                limit=f"{found.metadata['frequency_hz']} Hz",
                verdict="warn" if found.against else "pass",
                text=found.against or "",
            )
        )
    return checks


def _longest(gaps: list[tuple[float, float]]) -> float:
    return max((end - start for start, end in gaps), default=0.0)


def _verdict(found: Imported, checks: list[Check]) -> Verdict:
    head = f"{len(found.time_s)} samples in {len(found.columns) - 1} channels"
    failed = [check.name.lower() for check in checks if check.verdict == "fail"]
    doubted = [check.name.lower() for check in checks if check.verdict == "warn"]
    if failed:
        return Verdict(level="bad", text=f"{head}; failed: {', '.join(failed)}.")
    if doubted:
        return Verdict(level="caution", text=f"{head}; look at: {', '.join(doubted)}.")
    return Verdict(level="good", text=f"{head}; every check passes.")


def _columns(found: Imported, rules: Mapping | None) -> Table:
    sources: dict[str, list[str]] = {}
    if rules is not None:
        sources = {c.target: [str(c.source), f"{c.scale:.6g}", f"{c.offset:.6g}"] for c in rules.columns}
        if rules.time is not None:
            origin = rules.time.source if rules.time.source is not None else f"rate {rules.time.rate_hz}"
            sources[log.TIME] = [str(origin), rules.time.unit, str(rules.time.origin)]
    rows: list[list[str | float | int | bool | None]] = []
    for name, values in found.columns.items():
        low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
        ends = [None, None] if np.isnan(low) else [low, high]
        missing = int(np.count_nonzero(np.isnan(values)))
        rows.append([name, *(sources.get(name, [name, "1", "0"])), *ends, missing])
    return Table(
        id="columns",
        title="Columns",
        columns=["column", "source", "factor or unit", "offset", "smallest", "largest", "missing"],
        rows=rows,
    )


def _speeds(found: Imported) -> list[Table]:
    speed = found.speed
    if speed is None:
        return []
    rows: list[list[str | float | int | bool | None]] = [
        ["along the path", speed.path.value, speed.path.low, speed.path.high],
        ["along the line from start to end", speed.line.value, speed.line.low, speed.line.high],
        ["naive mean of |dx/dt|", speed.naive_m_s, None, None],
    ]
    return [
        Table(
            id="speed",
            title="Mean speed",
            columns=["speed", f"{found.unit}/s", "95 % from", "to"],
            rows=rows,
            caption=f"Over {speed.covered_s:.4g} s without the gaps; noise of a coordinate "
            f"{numbers.number(speed.noise_m, 3, found.unit)}. The interval holds noise and unsteady "
            "swimming. Jumps and noise lengthen the naive mean.",
        )
    ]


def _strokes(found: Imported) -> list[Table]:
    stroke = found.stroke
    if stroke is None:
        return []
    rows: list[list[str | float | int | bool | None]] = [
        [f"{h.order} ×", h.order * stroke.beat.frequency_hz, h.amplitude, h.stderr] for h in stroke.harmonics
    ]
    tables = [
        Table(
            id="stroke",
            title=f"Stroke and harmonics in {stroke.channel}",
            columns=["harmonic", "frequency (Hz)", "amplitude", "standard error"],
            rows=rows,
            caption=f"Period {numbers.measured(*stroke.period_s, 's')}, over {stroke.beat.cycles:.3g} cycles."
            + (
                " It may be twice the stroke: no channel that swings sideways is there."
                if stroke.maybe_double
                else ""
            ),
        )
    ]
    if len(stroke.channels) > 1:
        tables.append(
            Table(
                id="stroke-channels",
                title="Beat of every channel",
                columns=[
                    "channel",
                    "frequency (Hz)",
                    "standard error (Hz)",
                    "amplitude",
                    "share of the variance",
                ],
                rows=[
                    [n, b.frequency_hz, b.stderr_hz, b.amplitude, b.share] for n, b in stroke.channels.items()
                ],
            )
        )
    return tables


def _frequency(found: Imported) -> str:
    assert found.stroke is not None
    return numbers.measured(found.stroke.beat.frequency_hz, found.stroke.beat.stderr_hz, "Hz")


def _methods(found: Imported) -> list[str]:
    sentences = []
    if found.cleaned and found.cleaning is not None:
        sentences.append(
            "Repeated samples of the camera were collapsed; jumps were told by a Hampel identifier on the "
            "steps of the track and left out; gaps were not bridged."
        )
    if found.speed is not None:
        sentences.append(
            "The mean speed was taken along cubic smoothing splines through each stretch without a gap, "
            "their smoothness chosen by cross-validation, corrected for the noise by a parametric bootstrap; "
            "its interval is that of the means of blocks."
        )
    if found.stroke is not None:
        sentences.append(
            "The stroke frequency is the slope of the phases of a sine fitted in windows of two cycles "
            "beside a cubic drift, by generalised least squares; a beat counts where the coherence of "
            "windows that do not overlap exceeds what noise of any colour has once in a hundred records."
        )
    return sentences


def _references(found: Imported) -> list[str]:
    if found.cleaning is None:
        return []
    return [
        "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
        "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
        "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
        "377-403. doi:10.1007/BF01404567",
    ]


def summary(found: Imported, machine: dict[str, Any]) -> str:
    """The result for the terminal."""
    rate = machine["median_rate_hz"]
    lines = [
        f"{found.path.name}: {machine['samples']} samples over {machine['duration_s']:.4g} s"
        + (f" at {rate:.4g} Hz" if rate else "")
        + f": {', '.join(name for name in found.columns if name != log.TIME)}"
    ]
    track, speed = machine["track"], found.speed
    if track is not None and found.cleaning is not None:
        done = "left out" if found.cleaned else "kept"
        lines.append(
            f"  track   {track['repeats']} repeats and {track['jumps']} jumps "
            f"({track['samples_jumped']} samples) {done}; {len(track['gaps_s'])} gaps kept, "
            f"longest {_longest(found.cleaning.gaps):.3g} s"
        )
    if speed is not None:
        lines.append(
            f"  speed   path {_speed(speed.path, found.unit)}, line {_speed(speed.line, found.unit)}; "
            f"naive mean of |dx/dt| {speed.naive_m_s:.4g} {found.unit}/s"
        )
    stroke = found.stroke
    if stroke is not None:
        clear = [
            f"{h.order} × {100 * h.amplitude / stroke.harmonics[0].amplitude:.2g} %"
            for h in stroke.harmonics[1:]
        ]
        lines.append(
            f"  stroke  {_frequency(found)} in {stroke.channel}, "
            f"period {numbers.measured(*stroke.period_s, 's')}"
            + (f"; harmonics {', '.join(clear)} of its amplitude" if clear else "; no harmonic stands clear")
            + ("; may be twice the stroke" if stroke.maybe_double else "")
        )
    else:
        lines.append(f"  stroke  unknown: {found.unknown}")
    if found.projection is not None:
        way = ", ".join(f"{part:.4g}" for part in found.projection.direction)
        lines.append(
            f"  line    x_{found.unit} is the way along ({way}), "
            f"{numbers.number(found.projection.extent, 3, found.unit)} long; "
            f"rms distance from it {numbers.number(found.projection.across, 3, found.unit)}"
        )
    for against in (found.against, stroke.doubt if stroke is not None else ""):
        if against:
            lines.append(f"  BEWARE  {against}")
    level = machine["verdict"]["level"].upper()
    return "\n".join([*lines, f"{level}: {machine['verdict']['text']}"])


def _speed(speed: Estimate, unit: str) -> str:
    return f"{speed.value:.4g} {unit}/s (95 %: {speed.low:.4g} … {speed.high:.4g})"
