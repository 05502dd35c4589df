"""Texts of a diagnosis: its answer, its notes, and sentences for a methods section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from swimid.diagnosis import gap_file as gap_format
from swimid.diagnosis.gap_file import Absorbed, Cause, Cell, ChangedValue, GapFile, Value
from swimid.results import numbers

#: Prefix of the names of other interpretations of the robot. The rest of such a name is a value of the option
#: ``--reading``.
READING = "reading:"
#: Minimum change of a coefficient that is reported, in standard errors and as a fraction of its value. Both
#: must be exceeded.
MOVED_STDERR, MOVED_SHARE = 2.0, 0.10
#: Maximum number of notes, and maximum number of parts of the data in one note.
MAX_NOTES, MAX_PARTS = 5, 3


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return names joined as in a sentence: ``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def answer(file: GapFile) -> str:
    """Return the answer: the causes with their sizes, and the reduction of the held-out errors by them."""
    names = [_named(c) for c in file.causes]
    if file.verdict == "none":
        return _no_gap(file)
    if file.verdict == "explained":
        gap = "the gap of the parameters as given" if file.changed else "the gap"
        said = f"{listed(names)} {'explains' if len(names) == 1 else 'together explain'} {gap}."
    elif file.verdict == "ambiguous":
        kind = "cause is" if len(names) == 1 else "causes are"
        said = f"The model has a gap whose likeliest {kind} {listed(names)}."
    elif file.unreproduced:
        said = "The model does not describe these trials, so that their gap cannot be separated from noise."
    elif file.unpredicted:
        said = "The model follows the trials it is fitted to, but not the validation trials."
    elif names:
        closes = "closes" if len(names) == 1 else "close"
        said = f"The model has a gap that no known effect closes; {listed(names)} {closes} part of it."
    else:
        said = "The model has a gap, and no effect of the catalogue closes it."
    for s in file.closing[:1]:
        if s.before is not None and s.after is not None:
            to = f"from {numbers.percent(s.before)} to {numbers.percent(s.after)} of its range"
            held_out = held_out_text(file)
            said += f" {held_out[0].upper()}{held_out[1:]} the error of {s.channel} goes {to}"
            said += f" (noise alone: {numbers.percent(s.floor)})."
    return said


def _no_gap(file: GapFile) -> str:
    if not file.told_of_gap:
        return "These trials do not tell whether the model has a gap."
    if file.moved or file.params == gap_format.ROBOT_FILE:
        return "The refitted model describes these trials as well as their noise allows."
    if any(c.differs for c in file.where.channels):
        return "The model leaves noise, and differences between trials."
    return "The model describes these trials as well as their noise allows."


def _named(cause: Cause) -> str:
    """Return a cause with its sizes and its equivalents as part of a sentence."""
    sizes = [f"{name} {value_text(v)}" for name, v in list(cause.parameters.items())[:2]]
    name = cause.effect
    if changes_text(cause.parameters):
        name = changes_text(cause.parameters)
    elif sizes:
        name = f"{name} ({', '.join(sizes)})"
    return listed([name, *cause.equivalent], "or")


def changes_text(parameters: Mapping[str, Value]) -> str:
    """Return the changes of parameters: ``k_t 0.06 → 0.05520 ± 0.00003 N·m/rad (71 standard errors)``."""
    changed = [(name, value) for name, value in parameters.items() if isinstance(value, ChangedValue)]
    return listed(
        [
            f"{name} {numbers.number(v.given)} → {numbers.measured(v.value, v.stderr, v.unit)} "
            f"({numbers.number(v.standard_errors, 2)} standard errors)"
            for name, v in changed
        ]
    )


def value_text(value: Value) -> str:
    """Return an estimate with its standard error and unit."""
    if value.status == "unidentifiable":
        return "not identifiable"
    text = numbers.measured(value.value, value.stderr, value.unit)
    if value.status == "at-bound":
        text += ", at its bound"
    return text


def held_out_text(file: GapFile) -> str:
    """Return a phrase that names the held-out data: ``on the validation trials``."""
    return gap_format.HELD_OUT[file.held_out]


def otherwise_text(file: GapFile) -> str:
    """Return the probabilities of no gap and of a cause outside the catalogue, in words."""
    none, outside = probability_text(file.no_gap), probability_text(file.outside)
    return f"no gap {none}, a cause outside the catalogue {outside}"


def probability_text(probability: float | None) -> str:
    """Return a probability in percent; ``< 0.1 %`` for values below a thousandth."""
    if probability is not None and probability < 1e-3:
        return "< 0.1 %"
    return numbers.percent(probability, 2)


def remaining_text(file: GapFile) -> str:
    """Return in words how much of the gap remains, and where."""
    left, share = file.remaining, "an unknown share"
    if left.share is not None:
        share = numbers.percent(left.share, 2)
    said = f"{share} of the squared gap remains"
    if left.where:
        said += f" ({left.where})"
    return said


def moved(file: GapFile) -> list[Absorbed]:
    """Return the coefficients that compensated for the missing causes, the largest change first."""
    far = [(_shift(a), a) for c in file.causes for a in c.absorbed]
    return [a for shift, a in sorted(far, key=lambda pair: -pair[0]) if shift > 0]


def _shift(a: Absorbed) -> float:
    """Return the change of a coefficient in standard errors; 0 if it is small."""
    before, after = a.without.value, a.with_effect.value
    errors = [v.stderr for v in (a.without, a.with_effect) if v.stderr]
    if before is None or after is None or not errors:
        return 0.0
    by = abs(before - after)
    count = by / max(errors)
    if count > MOVED_STDERR and by > MOVED_SHARE * abs(after):
        return count
    return 0.0


def parts(file: GapFile) -> list[Cell]:
    """Return the gap in each part of the data: settings, stroke phases and times."""
    return [*file.where.regime, *file.where.phase, *file.where.time]


def notes(file: GapFile) -> list[str]:
    """Return notes on the next experiment, the place of the gap, and the reasons for the verdict."""
    said = [f"next experiment: {a.text}" for a in file.advice[:1]]
    worst: dict[str, Cell] = {}
    for cell in sorted(parts(file), key=lambda c: -(c.ratio or 0.0)):
        worst.setdefault(cell.kind, cell)
    if worst and file.verdict != "none" and not file.changed:
        places = []
        for c in list(worst.values())[:MAX_PARTS]:
            name = c.label
            if c.kind not in ("time", "change"):
                name = f"{c.kind} {c.label}"
            places.append(f"{name} ({numbers.number(c.ratio, 2)} times the noise)")
        said.append(f"the gap is largest at {listed(places)}")
    for a in moved(file)[:1]:
        values = " without the cause and ".join(value_text(v) for v in (a.without, a.with_effect))
        said.append(f"the coefficient {a.coefficient} stood in for the cause: it is {values} with it")
    said += [
        f"to work with the other reading: --reading {c.effect.removeprefix(READING)}"
        for c in file.causes
        if c.effect.startswith(READING)
    ]
    sentences = [f"{text[:1].upper()}{text[1:].rstrip('.')}." for text in (*said, *file.reasons)]
    return sentences[:MAX_NOTES]


def methods(file: GapFile) -> list[str]:
    """Return sentences for a methods section that describe this diagnosis."""
    refitted = sum(s.refitted for s in file.scores)
    count = f"{refitted} of {len(file.scores)}"
    if refitted == len(file.scores):
        count = str(refitted)
    said = [
        f"The discrepancy between {len(file.trials)} {file.experiment} trials of {file.robot} and the model "
        f"{file.model} was treated as part of the model (Kennedy and O'Hagan 2001): its coefficients were "
        "refitted by output error, with residuals weighted by their own colour (Klein and Morelli 2006), "
        f"alone and together with each of {count} candidate effects, from several sizes of it.",
        "Effects and sets of them were weighed by a Student likelihood of what each leaves beyond the noise "
        "at its optimum, folds weighted by the Bayesian bootstrap (Yao et al. 2018): "
        f"{otherwise_text(file)}. Held-out gains are drops of the squared residuals in approximate "
        "cross-validation: one Gauss-Newton step from the fit to all trials leaves a group of them out (Rad "
        "and Maleki 2020); noise model and spreads between trials stay those of all.",
    ]
    if file.floor_from:
        said.append(f"The noise floor: {file.floor_from.rstrip('.')}.")
    said += [f"{text.rstrip('.')}." for text in file.rounds]
    said.append(answer(file))
    if file.advice:
        said.append(
            "The next experiment was chosen by how far the rivals' predictions differ in it (Box and Hill "
            "1967)."
        )
    return said
