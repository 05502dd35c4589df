"""What a diagnosis says, in plain words: for the terminal, and sentences the report shares."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis.gap_file import (
    Absorbed,
    Cause,
    Cell,
    ChangedValue,
    ChannelGap,
    GapFile,
    Score,
    Shrinkage,
    Value,
)
from swimid.effects.reading import PREFIX
from swimid.results import numbers

#: Extent of the terminal summary.
MOST_LINES, WIDTH = 24, 100
#: A coefficient has moved when it did by more standard errors than this, and by this share of its value.
MOVED_STDERR, MOVED_SHARE = 2.0, 0.10
#: Of these so many are named on one screen.
_CHANNELS, _CELLS, _CAUSES, _MOVED, _GIVEN = 3, 3, 3, 2, 4
#: A channel with a smaller share of the gap is left to the report.
_SMALL = 0.02
#: Width of the left column.
_MARGIN = 11


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as a sentence has them: ``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def verdict_sentence(file: GapFile) -> str:
    """The verdict in one sentence, or in two."""
    names = [named_text(c) for c in file.causes]
    if file.verdict == "none":
        return _no_gap_sentence(file)
    if file.verdict == "explained":
        both = f"{listed(names)} together explain" if len(names) > 1 else f"{listed(names)} explains"
        gap = "The model has a gap, and"
        if file.changed:
            gap = "The model with the parameters as given has a gap; all others unchanged,"
        if file.mostly_open:
            return f"{gap} {both} it, though less than half closes {held_out_text(file)}."
        return f"{gap} {both} it {held_out_text(file)}."
    if file.verdict == "ambiguous":
        told = [
            f"these trials cannot tell {changes_text(c.parameters) or c.effect} from "
            f"{listed(c.equivalent, 'or')}"
            for c in file.causes
            if c.equivalent
        ]
        if file.unpredicted:
            trials = listed([t.trial for t in file.unpredicted])
            told.append(f"{listed(names)} closes most of it and does not predict {trials}")
        lead = f"{', '.join(c.effect for c in file.causes)}: "
        reasons = [reason.removeprefix(lead) for reason in file.reasons if reason.startswith(lead)]
        why = "; ".join(reasons) or "not by enough to name it"
        unsure = f"{listed(names)} is the likeliest cause, but {why}"
        return f"The model has a gap; {'; '.join(told) or unsure} ({otherwise_text(file)})."
    if file.unreproduced:
        shares = [f"{numbers.percent(v, 2)} of {c}" for c, v in file.unreproduced.items()]
        return (
            f"The model reproduces {listed(shares)}: whether what it leaves is noise or what it lacks, these "
            "trials do not tell."
        )
    if file.follows:
        trials = listed([t.trial for t in file.unpredicted])
        return f"The model follows the trials it is fitted to, and does not predict {trials}."
    if file.odd_trial is not None:
        odd = file.odd_trial.trial
        return f"The model has a gap, and {odd} contradicts the other trials: no effect of all explains it."
    if names:
        close = "close" if len(names) > 1 else "closes"
        return (
            f"The model has a gap that no known effect closes; {listed(names)} {close} part of it, at work "
            "or as an imitation of what is."
        )
    return "The model has a gap, and no effect in the catalogue closes it."


def _no_gap_sentence(file: GapFile) -> str:
    """The verdict ``none`` in one sentence, or in two."""
    if not file.told_of_gap:
        best = likeliest(file)
        known = f"{best.effect} {numbers.percent(best.probability, 2)}, " if best else ""
        return f"These trials do not tell whether the model has a gap: {known}{otherwise_text(file)}."
    if file.moved:
        return (
            "No gap is left once the coefficients are refitted, but the parameters as given are others: "
            f"{changes_text(file.moved)}."
        )
    if file.params == gap_format.ROBOT_FILE:
        return (
            "No gap is left above the noise floor once the coefficients are refitted. No parameter file "
            "was given: nothing is said of its values."
        )
    if file.unrepeated:
        return (
            "No gap that the trials share: they differ from one another by more than the noise within "
            "them, and without repeats of a setting nothing tells whether that is chance."
        )
    if file.single:
        return "No gap above the noise floor in these trials of one setting; another one is not tested."
    if any(c.differs for c in file.where.channels):
        return "No gap above the noise floor: all that is left are noise and what repeats differ by."
    return "No gap above the noise floor: the model describes these trials as well as their noise allows."


def named_text(cause: Cause) -> str:
    """A cause and its equivalents, as a sentence has them; of a parameter, how it has changed."""
    changes = changes_text(cause.parameters)
    text = changes or cause.effect
    if not cause.equivalent:
        return text
    if changes:
        return f"{text}, not to be told from {listed(cause.equivalent, 'or')},"
    return f"{text} (or {listed(cause.equivalent, 'or')}, which these trials cannot tell from it)"


def changes_text(parameters: Mapping[str, Value]) -> str:
    """How parameters have changed: ``k_t 0.06 → 0.0552 N·m/rad (-8 %, 71 standard errors)``."""
    changed = ((name, value) for name, value in parameters.items() if isinstance(value, ChangedValue))
    return listed([_change(name, value) for name, value in changed])


def _change(name: str, value: ChangedValue) -> str:
    change = math.nan if value.value is None else value.value - value.given
    share = numbers.percent(change / abs(value.given), 2) if value.given else None
    times = f"{numbers.number(value.standard_errors, 2)} standard errors"
    sizes = ", ".join(part for part in (share, times) if part)
    now = numbers.number(value.value, 4, value.unit)
    return f"{name} {numbers.number(value.given, 4)} → {now} ({sizes})"


def held_out_text(file: GapFile) -> str:
    """On what data a cause is judged: ``on the validation trials``."""
    return gap_format.HELD_OUT[file.held_out]


def otherwise_text(file: GapFile) -> str:
    """How likely it is that there is no gap, or another cause than those tried."""
    return (
        f"no gap {numbers.percent(file.no_gap, 2)}, a cause outside the catalogue "
        f"{numbers.percent(file.outside, 2)}"
    )


def likeliest(file: GapFile) -> Score | None:
    """The effect that is likeliest among the causes, of those refitted."""
    known = [s for s in file.scores if s.refitted and s.probability is not None]
    return max(known, key=lambda s: s.probability or 0.0, default=None)


def size_of(channel: ChannelGap) -> str:
    """How large the gap of a channel is."""
    share = f" ({numbers.percent(channel.share, 2)} of the gap)" if channel.share else ""
    return (
        f"{channel.channel} {numbers.percent(channel.nrmse)} of its range, "
        f"noise alone {numbers.percent(channel.floor)}{share}"
    )


def error_of(channel: ChannelGap) -> str:
    """How large the error of a channel without a gap is, and how much of it is not that trials differ."""
    apart = f", within trials {numbers.percent(channel.within)}" if channel.differs else ""
    return f"{channel.channel} {numbers.percent(channel.nrmse)} of its range{apart}"


def closed_text(s: Shrinkage) -> str:
    """What is closed of a channel's gap: ``89 % (95 %: 81 … 94 %)``."""
    share = numbers.percent(s.closed, 2)
    return share if None in s.ci95 else f"{share} (95 %: {interval_text(s)})"


def interval_text(s: Shrinkage) -> str:
    """The interval of what is closed: ``81 … 94 %``."""
    low, high = s.ci95
    if low is None or high is None:
        return numbers.NOTHING
    return f"{numbers.number(100.0 * low, 2)} … {numbers.percent(high, 2)}"


def errors_text(s: Shrinkage) -> str:
    """The errors before and after, over the measured range."""
    return f"{numbers.percent(s.before)} → {numbers.percent(s.after)}, noise alone {numbers.percent(s.floor)}"


def value_text(value: Value) -> str:
    """An estimate with its error and unit, angles in degrees beside."""
    if value.status == "unidentifiable":
        return "not determined by these trials"
    text = numbers.measured(value.value, value.stderr, value.unit)
    factor, unit = numbers.in_degrees(value.unit)
    if unit != value.unit and value.value is not None:
        text += f" ({numbers.number(factor * value.value, 3, unit)})"
    return text + (" (at its bound)" if value.status == "at-bound" else "")


def moved(file: GapFile) -> list[Absorbed]:
    """Coefficients that stood in for the causes, those that moved farthest first."""
    far = [(_shift(a), a) for a in file.absorbed]
    return [a for shift, a in sorted(far, key=lambda pair: -pair[0]) if shift > 0]


def _shift(a: Absorbed) -> float:
    """Movement in standard errors; 0 where it is small."""
    before, after = a.without.value, a.with_effect.value
    errors = [v.stderr for v in (a.without, a.with_effect) if v.stderr]
    if before is None or after is None or not errors:
        return 0.0
    by = abs(before - after)
    count = by / max(errors)
    return count if count > MOVED_STDERR and by > MOVED_SHARE * abs(after) else 0.0


def bounds_text(file: GapFile) -> str:
    """Coefficients that end at their bounds without effects: ``c_d4 at 6 and c_f0 at 0``."""
    return listed([f"{name} at {numbers.number(bound, 3)}" for name, bound in file.at_bound.items()])


def unpredicted_text(file: GapFile) -> str:
    """Validation trials that are not predicted: ``w30: 22 times``."""
    return listed([f"{t.trial}: {numbers.number(t.times, 2)} times" for t in file.unpredicted])


def parts(file: GapFile) -> list[Cell]:
    """The gap in each part of the data: settings, phases, times."""
    return [*file.where.regime, *file.where.phase, *file.where.time]


def remaining_text(file: GapFile) -> str:
    """What the causes leave."""
    left = file.remaining
    known = left.share is not None
    share = f"{numbers.percent(left.share, 2)} of the squared gap" if known else "an unknown share"
    where = f", {left.where}" if left.where else ""
    return f"{share}{where}" + (", no structure in it" if left.white else "")


def summary(file: GapFile) -> str:
    """One screen for the terminal.

    Returns
    -------
    str
        At most :data:`MOST_LINES` lines of :data:`WIDTH` characters.
    """
    head = f"{file.robot}, {file.experiment}: {len(file.trials)} trials against {file.params}"
    verdict = f"{file.verdict.upper()}: {verdict_sentence(file)}"
    lines = [*_wrapped(head), "", *_wrapped(verdict), ""]
    # what comes last matters least of the cause's details, but the next step has to be seen
    tail = _row("next", file.advice[0].text, max_lines=4) if file.advice else []
    body = [line for label, text in _rows(file) for line in _row(label, text)]
    room = MOST_LINES - len(lines) - len(tail)
    if len(body) > room:
        body = [*body[: room - 1], " " * _MARGIN + "... the rest is in the gap file and its report"]
    return "\n".join([*lines, *body, *tail])


_wrapped = partial(textwrap.wrap, width=WIDTH, break_on_hyphens=False, placeholder=" ...")


def _row(label: str, text: str, max_lines: int | None = None) -> list[str]:
    """The lines of a row, its label in the left column."""
    first = f"  {label:<{_MARGIN - 2}}"
    return _wrapped(text, initial_indent=first, subsequent_indent=" " * _MARGIN, max_lines=max_lines)


def _rows(file: GapFile) -> Iterable[tuple[str, str]]:
    """Label and text of each row but the last; without a label it goes on with what is above."""
    if file.odd_trial is not None:
        odd, times = file.odd_trial.trial, numbers.number(file.odd_trial.times, 2)
        yield "odd", f"{odd}: the others predict it {times} times worse than one another"
    if file.as_given:
        errors = [f"{c} {numbers.percent(s.nrmse)}" for c, s in file.as_given.items()]
        yield "as given", f"{', '.join(errors[:_GIVEN])} of the measured range, as compare has it"
    if file.moved:
        yield "moved", f"{changes_text(file.moved)} in the refit"
    if file.at_bound:
        yield "bounds", f"{bounds_text(file)} in the refit without effects: look there first"
    if not file.changed:
        yield from _gap_rows(file)
    if file.verdict == "none":
        best = likeliest(file)
        if best is not None:
            told = f"the likeliest, {best.effect}, has {numbers.percent(best.probability, 2)}"
            yield "tried", f"{len({s.effect for s in file.scores})} effects; {told}; {otherwise_text(file)}"
    else:
        yield from _cause_rows(file)
        yield "left", remaining_text(file)
    if file.unpredicted:
        yield "predicts", f"not {unpredicted_text(file)} the error that may be expected"
    if file.refuted:
        worse = "likeliest by the fits, but held-out errors are worse by more than the gap"
        yield "refuted", f"{listed(file.refuted)}: {worse}"


def _gap_rows(file: GapFile) -> Iterable[tuple[str, str]]:
    shown = [
        c
        for k, c in enumerate(file.where.channels[:_CHANNELS])
        if c.nrmse is not None and (k == 0 or c.share is None or c.share >= _SMALL or file.verdict == "none")
    ]
    first, size = ("error", error_of) if file.verdict == "none" or file.follows else ("gap", size_of)
    for k, c in enumerate(shown):
        yield "" if k else first, size(c)
    if file.verdict == "none":
        return
    worst: dict[str, Cell] = {}
    for cell in sorted((c for c in parts(file) if c.ratio is not None), key=lambda c: -(c.ratio or 0.0)):
        worst.setdefault(cell.kind, cell)
    if worst:
        told = [f"{_place(c)} {numbers.number(c.ratio, 2)} ×" for c in worst.values()]
        yield "largest", f"{', '.join(told[:_CELLS])} the noise"


def _place(cell: Cell) -> str:
    """A part of the data in words: ``phase 30-60 deg``, ``start-up``."""
    return cell.label if cell.kind in ("time", "change") else f"{cell.kind} {cell.label}"


def _cause_rows(file: GapFile) -> Iterable[tuple[str, str]]:
    for cause in file.causes[:_CAUSES]:
        meaning = f": {cause.meaning.rstrip('.')}" if cause.meaning else ""
        sure = f"probability {numbers.percent(cause.probability, 2)}"
        said = ", ".join(part for part in (cause.stage, None if cause.equivalent else sure) if part)
        yield "cause", f"{cause.effect} ({said}){meaning}" if said else f"{cause.effect}{meaning}"
        for name, value in cause.parameters.items():
            yield "", f"{name}  {value_text(value)}"
        if cause.effect.startswith(PREFIX):
            yield "", f"to work with it: --reading {cause.effect.removeprefix(PREFIX)}"
        if cause.equivalent:
            yield "", f"not to be told from it: {', '.join(cause.equivalent)}; together: {sure}"
    for k, s in enumerate([s for s in file.closing if s.closed is not None][:_CHANNELS]):
        yield "" if k else "closed", f"{s.channel} {closed_text(s)}: {errors_text(s)}"
    for k, a in enumerate(moved(file)[:_MOVED]):
        without, beside = (numbers.measured(v.value, v.stderr, v.unit) for v in (a.without, a.with_effect))
        bound = "; at its bound without" if a.without.status == "at-bound" else ""
        yield "" if k else "absorbed", f"{a.coefficient} {without} without, {beside} with the effect{bound}"
