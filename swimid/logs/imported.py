"""The result of importing a log: the log in order, its examination, and its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from swimid.logs import figures as log_figures
from swimid.logs import log
from swimid.logs.examine import Examined
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import usual_step
from swimid.notices import Notice, recorded
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, Table, check, judged

Array = NDArray[np.float64]
#: Samples a stroke needs for the path to be followed.
RESOLVED = 6.0
#: Beyond this share of its extent along a line the track does not keep to it.
OFF_LINE = 0.1
#: Largest share of the rows that may be dropped: with more the time is hardly complete.
MAX_DROPPED = 0.1
#: Of more jumps or missing samples than these shares a track is doubted.
MANY = 0.2
REFERENCES = [
    "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
    "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
    "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
    "377-403. doi:10.1007/BF01404567",
]


@dataclass(frozen=True, eq=False)
class Imported(Logged):
    """A log of another program in the log format, as ``import_log`` returns it.

    Attributes
    ----------
    examined : Examined
        Rows in order, jumps and speed of the track, and the stroke; None for a result read from a file.
    notices : sequence of Notice
        Warnings raised before the figures were drawn.
    progress : Progress
        Shows the writing.
    """

    examined: Examined | None = None
    notices: Sequence[Notice] = ()
    progress: Progress = field(default=silent, repr=False)

    def save(self, path: str | Path) -> Self:
        """Write the log, and its evidence beside it.

        Raises
        ------
        InputError
            The folder does not exist or cannot be written.
        """
        renamed, path = self, Path(path)
        if self.examined is not None and self.evidence is not None and path.name != self.log.name:
            made = replace(self.log, path=path)
            proof = _evidence(made, self.examined, self.evidence.provenance, self.notices)
            renamed = replace(self, document=made, evidence=proof)
        return super(Imported, renamed).save(path)

    def _write(self, path: Path) -> list[Path]:
        with self.progress(f"writing {path.name}", total=len(self.log)) as step:
            log.write_numbers(path, self.log.columns, self.log.metadata, step=step)
        return [path]


def result(
    found: Examined,
    name: str,
    provenance: dict[str, Any],
    notices: Sequence[Notice],
    progress: Progress,
) -> Imported:
    """Return the result of importing one log, to be written as ``name``."""
    made = Log(Path(name), found.metadata, found.columns, None)
    proof = _evidence(made, found, provenance, notices)
    return Imported(
        "import",
        _summary(found, proof),
        _facts(found, proof),
        evidence=proof,
        document=made,
        examined=found,
        notices=notices,
        progress=progress,
    )


def _evidence(
    made: Log,
    found: Examined,
    provenance: dict[str, Any],
    notices: Sequence[Notice],
) -> Evidence:
    checks = [*_row_checks(found), *_track_checks(found), *_stroke_checks(found)]
    with recorded(repeat=True) as drawn:
        figures = log_figures.figures([made], found=found.stroke)
    return Evidence(
        verb="import",
        title=f"Log {made.name}, imported from {found.path.name}",
        verdict=judged(f"{len(found.time_s)} samples in {len(found.columns) - 1} channels.", checks),
        checks=checks,
        tables=[_columns(found), *_speeds(found), *_strokes(found)],
        figures=figures,
        notices=blocks.notices([*notices, *drawn]),
        methods=_methods(found),
        references=[] if found.cleaning is None else REFERENCES,
        provenance=provenance,
    )


def _row_checks(found: Examined) -> list[Check]:
    mapped = found.mapped
    odd, n = sum(found.order.counts.values()), len(mapped)
    why = "; ".join(found.notes) or "rows without a time, repeated, late, or with the time of the row before"
    checks = [check("Rows in order", f"{odd} of {n} odd", not odd and not found.notes, "none", why)]
    dropped = found.order.untimed + found.order.clashing
    why = "rows without a time, or with the time of the row before but other values: is the time complete?"
    limit, value = f"≤ {100 * MAX_DROPPED:g} %", f"{dropped} of {n}"
    checks.append(
        blocks.check("Rows kept", value, limit, dropped <= MAX_DROPPED * n, otherwise="fail", text=why)
    )
    unknown = ", ".join(mapped.unknown)
    why = "every name states a quantity and its unit"
    if unknown:
        why = f"nothing states the quantity of {unknown}: map it to a name with a unit, or to unit: '1'"
    value = f"{len(mapped.unknown)} columns unknown"
    checks.append(
        blocks.check(
            "Quantity of every column", value, "none", not mapped.unknown, otherwise="fail", text=why
        )
    )
    if found.metadata.get("sample_rate") == "assumed":
        why = "speeds and frequencies are as wrong as it is: state it under 'time:' of the mapping"
        checks.append(blocks.check("Sample rate", "assumed", "stated", False, otherwise="fail", text=why))
    for name, emptied in mapped.unlikely.items():
        why = "its tracker hardly believes these points: they are left empty"
        checks.append(check(f"Samples by {name}", f"{emptied} of {n} left empty", False, "none", why))
    told = "; ".join(
        f"{one.column} {one.text} (against {one.against}: {one.gain:.3g})" for one in found.contradictions
    )
    value = f"{len(found.contradictions)} contradictions"
    checks.append(
        blocks.check("Columns agree", value, "none", not found.contradictions, otherwise="fail", text=told)
    )
    if found.uneven:
        why = f"{found.uneven}; " + (
            "stamps in bursts tell when samples arrived: log the time at which they are taken"
            if found.bursts
            else "samples are used at their own stamps"
        )
        grade: Literal["warn", "fail"] = "fail" if found.bursts else "warn"
        checks.append(
            blocks.check("Sampling", "uneven", "even, but for gaps", False, otherwise=grade, text=why)
        )
    held = "; ".join(f"{name} from {a:.4g} to {b:.4g} s" for name, (a, b) in found.frozen.items())
    why = f"{held}: it holds one value amid its motion; cut that part with --start and --end" if held else ""
    number = f"{len(found.frozen)} channels"
    checks.append(blocks.check("Frozen channels", number, "none", not held, otherwise="fail", text=why))
    beyond = f"{len({doubt.column for doubt in found.doubts})} columns beyond"
    why = "; ".join(f"{doubt.column} {doubt.text}" for doubt in found.doubts)
    return [*checks, blocks.check(POSSIBLE, beyond, "none", not found.doubts, text=why)]


def _track_checks(found: Examined) -> list[Check]:
    checks = []
    line, cleaning = found.projection, found.cleaning
    if line is not None:
        across, extent = (numbers.number(v, 3, found.unit) for v in (line.across, line.extent))
        keeps, limit = line.across <= OFF_LINE * line.extent, f"≤ {100 * OFF_LINE:g} % of the extent along it"
        why = "a track that leaves the line is shortened by projecting it"
        checks.append(check("Distance from the line", f"{across} rms over {extent}", keeps, limit, why))
    if cleaning is None:
        return checks
    lost, repeats, done = cleaning.counts["samples_jumped"], cleaning.counts["repeats"], _done(found)
    seen = int(cleaning.good.sum()) + repeats + lost
    passed = None if found.cleaned or not repeats else False
    why = "the same pose as the sample before: a camera read faster than it takes pictures"
    checks.append(check("Repeated pictures", f"{repeats} of {seen} {done}", passed, text=why))
    why = "away from the track before and after"
    if cleaning.offset_rows:
        why = f"the track goes on elsewhere {len(cleaning.offset_rows)} times"
    too_many = lost > MANY * seen or not found.cleaned
    value = f"{cleaning.jumps} ({lost} samples {done})"
    checks.append(
        blocks.check(
            "Jumps", value, "few", not cleaning.jumps, otherwise="fail" if too_many else "warn", text=why
        )
    )
    gaps = f"{len(cleaning.gaps)}, longest {numbers.number(cleaning.longest_gap_s, 3, 's')}"
    return [*checks, check("Gaps in the track", gaps, not cleaning.gaps, text="kept as gaps, never bridged")]


def _stroke_checks(found: Examined) -> list[Check]:
    stroke = found.stroke
    if stroke is None:
        return []
    checks = []
    if found.speed is not None and found.cleaning is not None:
        rate = float(found.cleaning.good.sum()) / found.speed.covered_s
        per_stroke = rate / stroke.beat.frequency_hz
        why = "with fewer the path between samples is not known, and its speed too low"
        value, limit = numbers.number(per_stroke, 3), f"≥ {RESOLVED:g}"
        checks.append(check("Samples a stroke", value, per_stroke >= RESOLVED, limit, why))
    beats = (f"{beat.frequency_hz:.4g} Hz" for beat in (stroke.beat, *stroke.rivals.values()))
    why = stroke.doubt or "multiples of it counted in"
    limit = "no channel beats at another"
    checks.append(check("One stroke", " against ".join(beats), not stroke.doubt, limit, why))
    if "frequency_hz" in found.metadata:
        stated, name = f"{found.metadata['frequency_hz']} Hz", "Stroke against the metadata"
        checks.append(check(name, _frequency(stroke), not found.against, stated, found.against or ""))
    return checks


def _done(found: Examined) -> str:
    return "left out" if found.cleaned else "kept"


def _columns(found: Examined) -> Table:
    sources = {
        target: (source, f"{factor:.6g}", f"{offset:.6g}")
        for target, (source, factor, offset) in found.mapped.sources.items()
    }
    return Table(
        id="columns",
        title="Columns",
        columns=["column", "source", "factor", "offset", "smallest", "largest", "missing"],
        rows=[
            [
                name,
                *sources.get(name, (name, "1", "0")),
                *_ends(values),
                int(np.count_nonzero(np.isnan(values))),
            ]
            for name, values in found.columns.items()
        ],
    )


def _ends(values: Array) -> list[float | None]:
    """The smallest and the largest value."""
    low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
    return [None, None] if np.isnan(low) else [low, high]


def _speeds(found: Examined) -> list[Table]:
    speed = found.speed
    if speed is None:
        return []
    rows = [
        ["along the path", speed.path.value, speed.path.low, speed.path.high],
        ["along the line from start to end", speed.line.value, speed.line.low, speed.line.high],
        ["naive mean of |dx/dt|", speed.naive_m_s, None, None],
    ]
    caption = (
        f"Over {speed.covered_s:.4g} s without the gaps; noise of a coordinate "
        f"{numbers.number(speed.noise_m, 3, found.unit)}. The interval holds noise and unsteady "
        "swimming. Jumps and noise lengthen the naive mean."
    )
    columns = ["speed", f"{found.unit}/s", "95 % from", "to"]
    return [Table(id="speed", title="Mean speed", columns=columns, rows=rows, caption=caption)]


def _strokes(found: Examined) -> list[Table]:
    stroke = found.stroke
    if stroke is None:
        return []
    caption = f"Period {numbers.measured(*stroke.period_s, 's')}, over {stroke.beat.cycles:.3g} cycles."
    if stroke.maybe_double:
        caption += " It may be twice the stroke: no channel that swings sideways is there."
    tables = [
        Table(
            id="stroke",
            title=f"Stroke and harmonics in {stroke.channel}",
            columns=["harmonic", "frequency (Hz)", "amplitude", "standard error"],
            rows=[
                [f"{h.order} ×", h.order * stroke.beat.frequency_hz, h.amplitude, h.stderr]
                for h in stroke.harmonics
            ],
            caption=caption,
        ),
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
                [name, beat.frequency_hz, beat.stderr_hz, beat.amplitude, beat.share]
                for name, beat in stroke.channels.items()
            ],
        ),
    ]
    return tables if len(stroke.channels) > 1 else tables[:1]


def _frequency(stroke: Rhythm) -> str:
    return numbers.measured(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")


def _methods(found: Examined) -> list[str]:
    sentences = []
    if found.cleaned:
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


def _facts(found: Examined, proof: Evidence) -> dict[str, Any]:
    """The result for machines."""
    time, unit = found.time_s, found.unit
    cleaning, speed, stroke, line = found.cleaning, found.speed, found.stroke, found.projection
    track = speeds = way = None
    if cleaning is not None:
        track = {
            "cleaned": found.cleaned,
            **cleaning.counts,
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        }
    if speed is not None:
        speeds = {
            f"path_{unit}_s": speed.path.value,
            "path_ci95": [speed.path.low, speed.path.high],
            f"line_{unit}_s": speed.line.value,
            "line_ci95": [speed.line.low, speed.line.high],
            f"naive_{unit}_s": speed.naive_m_s,
            f"noise_{unit}": speed.noise_m,
            "covered_s": speed.covered_s,
        }
    if line is not None:
        way = {"direction": line.direction.tolist(), "extent": line.extent, "across_rms": line.across}
    return {
        "file": str(found.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": _rate(time),
        "columns": list(found.columns),
        "missing": {n: int(np.isnan(v).sum()) for n, v in found.columns.items() if n != log.TIME},
        "rows": found.order.counts,
        "notes": found.notes,
        "profile": found.mapped.profile,
        "unlikely": found.mapped.unlikely,
        "contradictions": [asdict(one) for one in found.contradictions],
        "track": track,
        "speed": speeds,
        "stroke": {"unknown": found.unknown} if stroke is None else _stroke_facts(stroke, found.against),
        "line": way,
        "verdict": proof.verdict.model_dump(),
        "checks": [check.model_dump() for check in proof.checks],
    }


def _rate(time_s: Array) -> float | None:
    step = usual_step(time_s)
    return 1 / step if step > 0 else None


def _stroke_facts(stroke: Rhythm, against: str | None) -> dict[str, Any]:
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
        "contradiction": against,
    }


def _summary(found: Examined, proof: Evidence) -> str:
    """The result for the terminal."""
    time, unit, rate = found.time_s, found.unit, _rate(found.time_s)
    at = f" at {rate:.4g} Hz" if rate else ""
    channels = ", ".join(name for name in found.columns if name != log.TIME)
    lines = [f"{found.path.name}: {len(time)} samples over {float(time[-1] - time[0]):.4g} s{at}: {channels}"]
    cleaning, speed, stroke, line = found.cleaning, found.speed, found.stroke, found.projection
    if cleaning is not None:
        counts = cleaning.counts
        lines.append(
            f"  track   {counts['repeats']} repeats and {counts['jumps']} jumps "
            f"({counts['samples_jumped']} samples) {_done(found)}; {len(cleaning.gaps)} gaps kept, "
            f"longest {cleaning.longest_gap_s:.3g} s"
        )
    if speed is not None:
        path, along = (
            f"{mean.value:.4g} {unit}/s (95 %: {mean.low:.4g} … {mean.high:.4g})"
            for mean in (speed.path, speed.line)
        )
        lines.append(
            f"  speed   path {path}, line {along}; naive mean of |dx/dt| {speed.naive_m_s:.4g} {unit}/s"
        )
    if stroke is None:
        lines.append(f"  stroke  unknown: {found.unknown}")
    else:
        first, *others = stroke.harmonics
        clear = ", ".join(f"{h.order} × {100 * h.amplitude / first.amplitude:.2g} %" for h in others)
        lines.append(
            f"  stroke  {_frequency(stroke)} in {stroke.channel}, "
            f"period {numbers.measured(*stroke.period_s, 's')}"
            + (f"; harmonics {clear} of its amplitude" if clear else "; no harmonic stands clear")
            + ("; may be twice the stroke" if stroke.maybe_double else "")
        )
    if line is not None:
        way = ", ".join(f"{part:.4g}" for part in line.direction)
        extent, across = (numbers.number(length, 3, unit) for length in (line.extent, line.across))
        lines.append(
            f"  line    x_{unit} is the way along ({way}), {extent} long; rms distance from it {across}"
        )
    against = (found.against, stroke.doubt if stroke is not None else "")
    lines += [f"  BEWARE  {text}" for text in against if text]
    return "\n".join([*lines, f"{proof.verdict.level.upper()}: {proof.verdict.text}"])
