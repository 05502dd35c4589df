"""The result of importing a log: the log in order, what was found in it, and its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from swimid.logs import bulk, log
from swimid.logs import figures as log_figures
from swimid.logs.examine import Examined
from swimid.logs.interval import Estimate
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.logs.mapping import Mapping
from swimid.logs.sampling import usual_step
from swimid.notices import Notice, recorded
from swimid.progress import Progress, silent
from swimid.results import numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, NoticeRecord, Table, check, judged

#: Samples a stroke needs for the path to be followed.
RESOLVED = 6.0
#: Beyond this share of its extent along a line the track does not keep to it.
OFF_LINE = 0.1
#: Of more jumps or missing samples than these shares a track is doubted.
MANY = 0.2


@dataclass(frozen=True, eq=False)
class Imported(Logged):
    """A log of another program in the log format, as ``import_log`` gives it.

    Attributes
    ----------
    examined : Examined
        Rows put in order, jumps of the track, its speed, and the stroke; None where it was read from a file.
    mapping : Mapping or None
        What said which column is which.
    notices : sequence of Notice
        Warnings that were raised before its figures were drawn.
    progress : Progress
        Shows the writing.
    """

    examined: Examined | None = None
    mapping: Mapping | None = None
    notices: Sequence[Notice] = ()
    progress: Progress = field(default=silent, repr=False)

    def save(self, path: str | Path) -> Self:
        """Write the log, and beside it its evidence, in which the log has the file's name.

        Raises
        ------
        InputError
            When the folder does not exist or cannot be written.
        """
        renamed, path = self, Path(path)
        if self.examined is not None and self.evidence is not None and path.name != self.log.name:
            made = replace(self.log, path=path)
            proof = _evidence(made, self.examined, self.mapping, self.evidence.provenance, self.notices)
            renamed = replace(self, document=made, evidence=proof)
        return super(Imported, renamed).save(path)

    def _write(self, path: Path) -> list[Path]:
        with self.progress(f"writing {path.name}", total=len(self.log)) as step:
            bulk.write(path, self.log.columns, self.log.metadata, step=step)
        return [path]


def result(
    found: Examined,
    name: str,
    rules: Mapping | None,
    provenance: dict[str, Any],
    notices: Sequence[Notice],
    progress: Progress,
) -> Imported:
    """The result of importing one log, to be called ``name``."""
    made = Log(Path(name), found.metadata, found.columns, None)
    proof = _evidence(made, found, rules, provenance, notices)
    data = _facts(found, proof)
    return Imported(
        "import",
        _summary(found, data),
        data,
        evidence=proof,
        document=made,
        examined=found,
        mapping=rules,
        notices=notices,
        progress=progress,
    )


def _evidence(
    made: Log,
    found: Examined,
    rules: Mapping | None,
    provenance: dict[str, Any],
    notices: Sequence[Notice],
) -> Evidence:
    checks = _checks(found)
    with recorded(repeat=True) as drawn:
        figures = log_figures.figures([made], found=found.stroke)
    return Evidence(
        verb="import",
        title=f"Log {made.name}, imported from {found.path.name}",
        verdict=judged(checks, f"{len(found.time_s)} samples in {len(found.columns) - 1} channels"),
        checks=checks,
        tables=[_columns(found, rules), *_speeds(found), *_strokes(found)],
        figures=figures,
        notices=[NoticeRecord(code=n.code, text=n.text) for n in [*notices, *drawn]],
        methods=_methods(found),
        references=_references(found),
        provenance=provenance,
    )


def _checks(found: Examined) -> list[Check]:
    order, n = found.order, len(found.time_s)
    odd = order.untimed + order.repeated + order.clashing + order.late
    why = "; ".join(found.notes) or "rows without a time, repeated, late or of a taken time"
    in_order = not odd and not found.notes
    checks = [check("Rows in order", f"{odd} of {n + odd} odd", in_order, "none", why)]
    if found.metadata.get("sample_rate") == "assumed":
        why = (
            "nothing in the file tells it: put it under 'time:' of the mapping and take "
            "'sample_rate: assumed' out; speeds and frequencies are as wrong as it is"
        )
        checks.append(check("Sample rate", "assumed", False, "known", why))
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
        across, extent = (numbers.number(v, 3, found.unit) for v in (line.across, line.extent))
        keeps, limit = line.across <= OFF_LINE * line.extent, f"≤ {100 * OFF_LINE:g} % of the extent along it"
        why = "a track that leaves the line is shortened by projecting it"
        checks.append(check("Distance from the line", f"{across} rms over {extent}", keeps, limit, why))
    checks += _track_checks(found)
    stroke = found.stroke
    if stroke is not None and found.speed is not None and found.cleaning is not None:
        rate = float(found.cleaning.good.sum()) / found.speed.covered_s
        per_stroke = rate / stroke.beat.frequency_hz
        why = "with fewer the path between samples is not known, and its speed too low"
        value, limit = numbers.number(per_stroke, 3), f"≥ {RESOLVED:g}"
        checks.append(check("Samples a stroke", value, per_stroke >= RESOLVED, limit, why))
    if stroke is not None:
        beats = (f"{beat.frequency_hz:.4g} Hz" for beat in (stroke.beat, *stroke.rivals.values()))
        why = stroke.doubt or "multiples of it counted in"
        limit = "no channel beats at another"
        checks.append(check("One stroke", " against ".join(beats), not stroke.doubt, limit, why))
    if stroke is not None and "frequency_hz" in found.metadata:
        stated, against = f"{found.metadata['frequency_hz']} Hz", found.against
        name = "Stroke against the metadata"
        checks.append(check(name, _frequency(found), not against, stated, against or ""))
    return checks


def _track_checks(found: Examined) -> list[Check]:
    cleaning = found.cleaning
    if cleaning is None:
        return []
    seen = int(cleaning.good.sum() + cleaning.repeated.sum() + cleaning.jumped.sum())
    lost, repeats = int(cleaning.jumped.sum()), int(cleaning.repeated.sum())
    done = "left out" if found.cleaned else "kept"
    too_many = lost > MANY * seen or (cleaning.jumps and not found.cleaned)
    gaps = f"{len(cleaning.gaps)}, longest {numbers.number(_longest(cleaning.gaps), 3, 's')}"
    why = "the same pose as the sample before: a camera read faster than it takes pictures"
    return [
        check(
            "Repeated pictures",
            f"{repeats} of {seen} {done}",
            None if found.cleaned or not repeats else False,
            text=why,
        ),
        Check(
            name="Jumps",
            value=f"{cleaning.jumps} ({lost} samples {done})",
            limit="few",
            verdict="pass" if not cleaning.jumps else "fail" if too_many else "warn",
            text=f"the track goes on elsewhere {len(cleaning.offset_rows)} times"
            if cleaning.offset_rows
            else "away from the track before and after",
        ),
        check("Gaps in the track", gaps, not cleaning.gaps, text="kept as gaps, never bridged"),
    ]


def _longest(gaps: list[tuple[float, float]]) -> float:
    return max((end - start for start, end in gaps), default=0.0)


def _columns(found: Examined, rules: Mapping | None) -> Table:
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


def _speeds(found: Examined) -> list[Table]:
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


def _strokes(found: Examined) -> list[Table]:
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


def _frequency(found: Examined) -> str:
    assert found.stroke is not None
    return numbers.measured(found.stroke.beat.frequency_hz, found.stroke.beat.stderr_hz, "Hz")


def _methods(found: Examined) -> list[str]:
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


def _references(found: Examined) -> list[str]:
    if found.cleaning is None:
        return []
    return [
        "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
        "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
        "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
        "377-403. doi:10.1007/BF01404567",
    ]


def _facts(found: Examined, record: Evidence) -> dict[str, Any]:
    """The result for machines."""
    time = found.time_s
    step = usual_step(time)
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    return {
        "file": str(found.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": 1 / step if step > 0 else None,
        "columns": list(found.columns),
        "missing": {n: int(np.isnan(v).sum()) for n, v in found.columns.items() if n != log.TIME},
        "rows": {k: getattr(found.order, k) for k in ("untimed", "repeated", "clashing", "late")},
        "notes": found.notes,
        "track": None
        if cleaning is None
        else {
            "cleaned": found.cleaned,
            "repeats": int(cleaning.repeated.sum()),
            "jumps": cleaning.jumps,
            "samples_jumped": int(cleaning.jumped.sum()),
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        },
        "speed": None
        if speed is None
        else {
            f"path_{found.unit}_s": speed.path.value,
            "path_ci95": [speed.path.low, speed.path.high],
            f"line_{found.unit}_s": speed.line.value,
            "line_ci95": [speed.line.low, speed.line.high],
            f"naive_{found.unit}_s": speed.naive_m_s,
            f"noise_{found.unit}": speed.noise_m,
            "covered_s": speed.covered_s,
        },
        "stroke": {"unknown": found.unknown}
        if stroke is None
        else {
            "frequency_hz": stroke.beat.frequency_hz,
            "stderr_hz": stroke.beat.stderr_hz,
            "ci95_hz": list(stroke.interval_hz),
            "period_s": stroke.period_s[0],
            "cycles": stroke.beat.cycles,
            "channel": stroke.channel,
            "maybe_double": stroke.maybe_double,
            "harmonics": [
                {"order": h.order, "amplitude": h.amplitude, "stderr": h.stderr} for h in stroke.harmonics
            ],
            "channels_hz": {n: b.frequency_hz for n, b in stroke.channels.items()},
            "rivals_hz": {n: b.frequency_hz for n, b in stroke.rivals.items()},
            "contradiction": found.against,
        },
        "line": None
        if found.projection is None
        else {
            "direction": [float(part) for part in found.projection.direction],
            "extent": found.projection.extent,
            "across_rms": found.projection.across,
        },
        "verdict": record.verdict.model_dump(),
        "checks": [check.model_dump() for check in record.checks],
    }


def _summary(found: Examined, machine: dict[str, Any]) -> str:
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
