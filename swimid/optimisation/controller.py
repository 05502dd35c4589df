"""``optimise gait`` of a discrete-time model: a table from steps to speeds, and a PI controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from swimid.blackbox.model import to_control
from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance, yamlio
from swimid.files.yamlio import Number, Pair
from swimid.fitting.model import Array
from swimid.notices import Notice, recorded
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.parameters import Fit, ParameterFile
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import control

FORMAT: Literal["swimid-controller/1"] = "swimid-controller/1"
#: Largest of the sensitivity function: what disturbances are amplified by at most (Astrom and Hagglund 2006).
SENSITIVITY = 1.4
#: Margins a controller is to have: phase (deg) and gain; a sensitivity of 1.4 promises 41 deg and 3.5.
PHASE_DEG, GAIN = 40.0, 3.0
#: The steady gain is known where half of its 95 % interval is no more than this share of it.
GAIN_KNOWN = 0.5
#: Steps of the table; frequencies of the responses; gains that are tried.
STEPS, FREQUENCIES, TRIED = 5, 4000, 160
#: Samples of a step response at most; the last are its end within this share.
SAMPLES, SETTLED = 20_000, 0.02
REFERENCES = [
    "Shang, Wang, Tan, Cheng: Swimming locomotion modeling for biomimetic underwater vehicle with two "
    "undulating long-fins, Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159",
    "Astrom, Hagglund (2006): Advanced PID Control. ISA, chapters 6 and 7",
    "Fuller, Greiner, Moore, Murray, van Paassen, Yorke (2021): The Python Control Systems Library "
    "(python-control). IEEE Conference on Decision and Control, doi:10.1109/CDC45484.2021.9683368",
]


class StepRow(yamlio.Document):
    """A step of the input, and where it leads."""

    input: float
    output: float
    #: 95 % interval of the output, by the steady gain's.
    output_ci95: Pair = (None, None)
    rise_time_s: Number = None
    settling_time_s: Number = None
    overshoot: Number = None


class ControllerFile(yamlio.ResultFile):
    """A controller file: ``u = K (e + sum(e) T / T_i)`` with the error e and the sample time T."""

    kind: ClassVar[str] = "controller file"
    format: Literal["swimid-controller/1"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    robot: str | None = None
    params: str
    input: str
    output: str
    input_unit: str
    output_unit: str
    sample_time_s: float
    #: Deviations from it are what the model is about.
    input_level: float
    output_level: float
    steady_gain: float
    steps: list[StepRow]
    gain: float
    integral_time_s: float
    gain_margin: Number = None
    phase_margin_deg: Number = None
    crossover_hz: Number = None
    sensitivity: float
    #: Of the closed loop, to a step of the set point.
    rise_time_s: Number = None
    overshoot: Number = None
    #: Share of draws of the coefficients whose loop is stable, and the 95 % interval of the steady gain in
    #: them; missing where they have no errors.
    stable_draws: Number = None
    steady_gain_ci95: Pair = (None, None)
    provenance: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SpeedController(FileResult[ControllerFile]):
    """A table from steps to speeds and a PI controller, as ``optimise gait`` gives them.

    Attributes
    ----------
    file : ControllerFile
        What :meth:`save` writes: ``steps``, ``gain``, ``integral_time_s`` (s), margins.
    """

    format = FORMAT
    file_type = ControllerFile

    @classmethod
    def _told(cls, document: ControllerFile, evidence: ev.Evidence | None) -> str:
        return _summary(document, evidence) if evidence else super()._told(document, evidence)


def design(file: ParameterFile, options: OptimiseGaitOptions, output: Path | None) -> SpeedController:
    """Where steps of the input lead, and the PI controller of the output.

    Raises
    ------
    UsageError, InputError
        For options that do not belong here, and for a file that is none.
    NoTrustworthyResult
        When the model is unstable, or its output does not follow steps.
    """
    import control

    path = parameters_format.place(options.params)
    source, told = str(file.settings.get("input", "u")), str(file.settings.get("output", "y"))
    if list(options.vary) != [source]:
        raise UsageError(
            "between which values may the input be set, as deviations from its level? "
            f"give --vary {source}=LOW,HIGH"
        )
    low, high = options.vary[source]
    if not low < high:
        raise UsageError(f"--vary {source}: {low:g} is not below {high:g}")
    with recorded(repeat=True) as notices:
        plant = to_control(file)
        poles = np.abs(plant.poles())
        if len(poles) and poles.max() >= 1.0:
            raise NoTrustworthyResult(
                f"the model is unstable (a pole of {poles.max():.4f}): a step leads nowhere",
                hint="fit one that is stable: other orders, more data, a working point removed",
            )
        gain = float(np.real(plant(1.0)))
        if not abs(gain) > 0:
            raise NoTrustworthyResult("the model does not answer steps: its steady gain is zero")
        if output is not None:
            atomic.check_writable(output, inputs=[parameters_format.origin(options.params)])
        steps = [_row(plant, gain, u) for u in np.linspace(low, high, STEPS) if u]
        proportional, integral = tuned(plant)
        pi = _pi(proportional, integral, plant.dt)
        loop = control.minreal(plant * pi, verbose=False)
        margins = control.stability_margins(loop)
        closed = control.feedback(plant * pi, 1)
        closing = control.step_info(closed)
        share, interval = _drawn(file, pi, options)
        for row in steps:
            if interval[0] is not None and interval[1] is not None:
                first, last = sorted(row.input * end for end in interval if end is not None)
                row.output_ci95 = (first, last)
    origin = provenance.collect([parameters_format.origin(options.params)], settings=options.settings())
    result = ControllerFile(
        verdict="caution",
        robot=file.robot,
        params=path.name,
        input=source,
        output=told,
        input_unit=numbers.split_unit(source)[1],
        output_unit=numbers.split_unit(told)[1],
        sample_time_s=float(plant.dt),
        input_level=float(file.settings.get("input_level", 0.0)),
        output_level=float(file.settings.get("output_level", 0.0)),
        steady_gain=gain,
        steps=steps,
        gain=proportional,
        integral_time_s=proportional / integral,
        gain_margin=_finite(margins[0]),
        phase_margin_deg=_finite(margins[1]),
        crossover_hz=_finite(margins[4] / (2 * math.pi)),
        sensitivity=float(_sensitivity(loop)),
        rise_time_s=_finite(closing["RiseTime"]),
        overshoot=_finite(0.01 * closing["Overshoot"]),
        stable_draws=share,
        steady_gain_ci95=interval,
        provenance={key: origin[key] for key in ("version", "inputs", "settings")},
    )
    evidence = _evidence(result, file.fit, plant, closed, notices, origin)
    result.verdict = evidence.verdict.level
    return SpeedController.of(result, evidence).saved(output)


def _finite(value: Any) -> float | None:
    return float(value) if value is not None and math.isfinite(float(value)) else None


def _pi(gain: float, integral: float, step_s: float) -> control.TransferFunction:
    """``K + K_i T z / (z - 1)``."""
    import control

    return control.TransferFunction([gain + integral * step_s, -gain], [1.0, -1.0], step_s)


def _frequencies(step_s: float) -> Array:
    """Up to that of Nyquist, rad/s."""
    return np.geomspace(1e-5, 1.0, FREQUENCIES) * math.pi / step_s


def _sensitivity(loop: control.TransferFunction) -> float:
    """Largest magnitude of ``1 / (1 + L)``."""
    z = np.exp(1j * _frequencies(loop.dt) * loop.dt)
    return float(np.max(1.0 / np.abs(1.0 + loop(z))))


def tuned(plant: control.TransferFunction) -> tuple[float, float]:
    """Proportional and integral gain of the PI controller with the largest integral gain.

    Notes
    -----
    Among controllers with a largest sensitivity of :data:`SENSITIVITY` and a stable loop it lets a constant
    disturbance through the least (Astrom and Hagglund 2006, chapter 6).

    >>> import control
    >>> gain, integral = tuned(control.TransferFunction([0.1], [1.0, -0.9], 0.1))
    >>> round(gain / integral, 1)
    0.2
    """
    sign = math.copysign(1.0, float(np.real(plant(1.0))))
    z = np.exp(1j * _frequencies(plant.dt) * plant.dt)
    response = sign * plant(z)
    size = 1.0 / float(np.abs(response).max())
    sums = plant.dt * z / (z - 1.0)
    best = (0.0, 0.0)
    for gain in np.concatenate(([0.0], size * np.geomspace(1e-2, 1e2, TRIED))):
        low, high = 0.0, size * 10.0 / plant.dt
        for _ in range(50):
            middle = 0.5 * (low + high)
            loop = response * (gain + middle * sums)
            sound = np.max(1.0 / np.abs(1.0 + loop)) <= SENSITIVITY
            if sound and _closes(plant, sign * gain, sign * middle):
                low = middle
            else:
                high = middle
        if low > best[1] * (1.0 + 1e-9):
            best = (float(gain), low)
    if best[1] <= 0.0:
        raise NoTrustworthyResult("no PI controller of this model has a stable loop with sound margins")
    return sign * best[0], sign * best[1]


def _closes(plant: control.TransferFunction, gain: float, integral: float) -> bool:
    """Whether the loop is stable."""
    numerator, denominator = (np.ravel(p) for p in (plant.num[0][0], plant.den[0][0]))
    over = np.array([gain + integral * plant.dt, -gain])
    closed = np.polyadd(np.polymul(numerator, over), np.polymul(denominator, [1.0, -1.0]))
    return bool(np.abs(np.roots(closed)).max() < 1.0)


def _row(plant: control.TransferFunction, gain: float, size: float) -> StepRow:
    import control

    info = control.step_info(plant, SettlingTimeThreshold=SETTLED)
    return StepRow(
        input=float(size),
        output=gain * float(size),
        rise_time_s=_finite(info["RiseTime"]),
        settling_time_s=_finite(info["SettlingTime"]),
        overshoot=_finite(0.01 * info["Overshoot"]),
    )


def _drawn(
    file: ParameterFile, pi: control.TransferFunction, options: OptimiseGaitOptions
) -> tuple[float | None, tuple[float | None, float | None]]:
    """In draws of the coefficients: share of stable closed loops, and the interval of the steady gain."""
    errors = {
        n: e.stderr for n, e in file.parameters.items() if n[0] in "ab" and n[1:].isdigit() and e.stderr
    }
    if not errors or file.correlation is None:
        return None, (None, None)
    names = [name for name in file.correlation.names if name in errors]
    at = [file.correlation.names.index(name) for name in names]
    sd = np.array([errors[name] for name in names])
    matrix = np.array(file.correlation.matrix)[np.ix_(at, at)] * np.outer(sd, sd)
    values, vectors = np.linalg.eigh(matrix)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(options.seed)
    integral = float((pi.num[0][0][0] + pi.num[0][0][1]) / pi.dt)
    gain = float(-pi.num[0][0][1])
    held, gains = 0, []
    for _ in range(options.draws):
        moved = dict(zip(names, root @ rng.standard_normal(len(names)), strict=True))
        changed = {
            n: e.model_copy(update={"value": e.value + float(moved.get(n, 0.0))})
            for n, e in file.parameters.items()
        }
        plant = to_control(file.model_copy(update={"parameters": changed}))
        held += _closes(plant, gain, integral)
        gains.append(float(np.real(plant(1.0))))
    low, high = np.quantile(gains, [0.025, 0.975], method="weibull")
    return held / options.draws, (float(low), float(high))


# ------------------------------------------------------------ telling


def _model_checks(file: ControllerFile, fit: Fit | None) -> list[ev.Check]:
    """What the fit that the model comes from says of it; nothing of a model that was not fitted here."""
    if fit is None:
        return []
    checks = []
    if (white := fit.noise.get("white")) is not None:
        text = (
            ""
            if white
            else "coefficients are biased beyond their errors: raise the orders, or model the noise"
        )
        checks.append(
            ev.check(
                "residuals of the model are white", numbers.number(bool(white)), bool(white), "yes", text=text
            )
        )
    tried = bool(fit.validation)
    checks.append(
        ev.check(
            "model tried on data that were held out", numbers.number(tried), tried, "yes",
            text="" if tried else "hold some out: swimid rwls --validate",
        )
    )  # fmt: skip
    if told := (fit.model_extra or {}).get("input_range"):
        low, high = (float(end) for end in told)
        asked = [row.input for row in file.steps]
        slack = 1e-9 * max(abs(low), abs(high))
        inside = low - slack <= min(asked) and max(asked) <= high + slack
        checks.append(
            ev.check(
                "input within what was logged",
                numbers.interval(min(asked), max(asked), None, file.input_unit), inside,
                numbers.interval(low, high),
                text="" if inside else "beyond it is extrapolation: the robot need not be linear there",
            )
        )  # fmt: skip
    return checks


def _evidence(
    file: ControllerFile,
    fit: Fit | None,
    plant: control.TransferFunction,
    closed: control.TransferFunction,
    notices: Sequence[Notice],
    origin: dict[str, Any],
) -> ev.Evidence:
    phase, gain = file.phase_margin_deg, file.gain_margin
    checks = [
        *_model_checks(file, fit),
        ev.check(
            "phase margin", numbers.number(phase, 3, "deg"), phase is None or phase >= PHASE_DEG,
            f"≥ {PHASE_DEG:g} deg",
        ),
        ev.check("gain margin", numbers.number(gain, 3), gain is None or gain >= GAIN, f"≥ {GAIN:g}"),
        ev.check(
            "largest sensitivity", numbers.number(file.sensitivity, 3),
            file.sensitivity <= 1.01 * SENSITIVITY, f"≤ {SENSITIVITY:g}",
        ),
    ]  # fmt: skip
    if file.stable_draws is not None:
        share = file.stable_draws
        checks.append(
            ev.check(
                "loop stable in draws of the coefficients", numbers.percent(share, 3), share >= 0.99, "≥ 99 %"
            )
        )
    low, high = file.steady_gain_ci95
    if low is not None and high is not None:
        told = 0.5 * (high - low) <= GAIN_KNOWN * abs(file.steady_gain)
        text = "" if told else "the input of the log hardly changed slowly: log steps of it, and fit again"
        checks.append(
            ev.check(
                "steady gain", numbers.interval(low, high), told,
                f"half of it ≤ {numbers.percent(GAIN_KNOWN)} of {numbers.number(file.steady_gain, 3)}",
                text=text,
            )
        )  # fmt: skip
    rows: list[dict[str, blocks.Cell]] = [
        {
            file.input: numbers.number(row.input, 3, file.input_unit),
            file.output: numbers.number(row.output, 4, file.output_unit),
            f"{file.output}, 95 %": numbers.interval(*row.output_ci95),
            "rises in": numbers.number(row.rise_time_s, 3, "s"),
            "settles in": numbers.number(row.settling_time_s, 3, "s"),
            "overshoot": numbers.percent(row.overshoot, 2),
        }
        for row in file.steps
    ]
    caption = (
        "Deviations from the working point, "
        f"{numbers.number(file.input_level, 3, file.input_unit)} and "
        f"{numbers.number(file.output_level, 3, file.output_unit)}. The model is linear: times do not "
        "depend on the step."
    )
    return ev.Evidence(
        verb="optimise gait",
        title=f"Controller of {file.output}",
        verdict=ev.judged(_answer(file), checks),
        checks=checks,
        tables=[blocks.table("steps", "From steps to speeds", rows, caption)],
        figures=[_steps(file, plant, closed), _bode(file, plant)],
        notices=blocks.notices(notices),
        methods=[
            f"A discrete PI controller of {file.output} by {file.input} was tuned on the identified model "
            f"for the largest integral gain with a sensitivity of {SENSITIVITY:g} at most (Astrom and "
            "Hagglund 2006); margins and step responses by python-control."
        ],
        references=REFERENCES,
        provenance=origin,
    )


def _steps(
    file: ControllerFile, plant: control.TransferFunction, closed: control.TransferFunction
) -> ev.Figure:
    import control

    end = max(file.steps[0].settling_time_s or 0.0, 6 * (file.rise_time_s or 0.0), 50 * file.sample_time_s)
    count = min(max(round(1.3 * end / file.sample_time_s), 2), SAMPLES)
    time = file.sample_time_s * np.arange(count)
    traces = []
    for label, system, over in (
        ("open loop", plant, file.steady_gain),
        ("closed loop", closed, 1.0),
    ):
        _, y = control.step_response(system, T=time)
        x, thin = ev.thinned(time, np.asarray(y) / over, 600)
        traces.append(ev.Trace(x=x, y=thin, label=label))
    caption = (
        "Output over its steady value: open loop to a step of the input, closed loop to one of the set point."
    )
    return blocks.figure("steps", "Step responses", caption, "time (s)", "output over steady value", traces)


def _bode(file: ControllerFile, plant: control.TransferFunction) -> ev.Figure:
    omega = _frequencies(file.sample_time_s)
    pi = _pi(file.gain, file.gain / file.integral_time_s, file.sample_time_s)
    loop = (plant * pi)(np.exp(1j * omega * file.sample_time_s))
    keep = slice(None, None, 8)
    f = omega[keep] / (2 * math.pi)
    panels = [
        blocks.panel(
            "frequency (Hz)", "gain of the loop", [ev.Trace(x=f, y=np.abs(loop)[keep])], x_scale="log",
            y_scale="log", marks=[ev.Mark(at=1.0)],
        ),
        blocks.panel(
            "frequency (Hz)", "phase of the loop (deg)",
            [ev.Trace(x=f, y=np.degrees(np.unwrap(np.angle(loop)))[keep])], x_scale="log",
            marks=[ev.Mark(at=-180.0)],
        ),
    ]  # fmt: skip
    return blocks.panels(
        "bode", "The open loop", "Margins are read where gain is 1 and phase −180 deg.", panels
    )


def _answer(file: ControllerFile) -> str:
    return (
        f"PI controller: gain {numbers.number(file.gain, 3)}, integral time "
        f"{numbers.number(file.integral_time_s, 3, 's')}; phase margin "
        f"{numbers.number(file.phase_margin_deg, 3, 'deg')}, gain margin "
        f"{numbers.number(file.gain_margin, 3)}."
    )


def _summary(file: ControllerFile, evidence: ev.Evidence) -> str:
    lines = [
        f"{file.params}: {file.output} by {file.input}, deviations from "
        f"{numbers.number(file.output_level, 3, file.output_unit)} and "
        f"{numbers.number(file.input_level, 3, file.input_unit)}",
        "",
    ]
    for row in file.steps:
        ends = "" if row.output_ci95[0] is None else f" (95 %: {numbers.interval(*row.output_ci95)})"
        lines.append(
            f"  {numbers.number(row.input, 3, file.input_unit)} leads to "
            f"{numbers.number(row.output, 3, file.output_unit)}{ends} in "
            f"{numbers.number(row.settling_time_s, 3, 's')}"
        )
    low, high = file.steady_gain_ci95
    sure = "" if low is None else f" (95 %: {numbers.interval(low, high)})"
    lines += ["", f"  steady gain {numbers.number(file.steady_gain, 3)}{sure}"]
    lines += [f"  {_answer(file)}", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)
