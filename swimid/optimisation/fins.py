"""``optimise gait`` of a robot with a falling-fin law: fin, frequency and amplitude that reach a speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError, NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance, yamlio
from swimid.files.yamlio import Number, Pair
from swimid.fitting.model import Array
from swimid.notices import Notice, recorded
from swimid.optimisation import trust
from swimid.optimisation.draws import drawn
from swimid.optimisation.options import OptimiseGaitOptions
from swimid.propulsion import trials as propulsion
from swimid.propulsion.model import RecoilModel
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.parameters import ParameterFile
from swimid.results.result import FileResult
from swimid.robots import file as robot_format
from swimid.simulation import catalogue
from swimid.simulation.applied import Applied

FORMAT: Literal["swimid-fins/1"] = "swimid-fins/1"
#: Amplitudes that are looked at for each fin.
AMPLITUDES = 400
#: What may limit a fin, and its unit as it is typed.
LIMITS = ("joint_rate_deg_s", "battery_W")
REFERENCES = [
    "Chan, Lee, Kim, Choi, Kang: Experimental Parameter Identification and Performance Analysis of a Fish "
    "Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins"
]


class FinGait(yamlio.Document):
    """What a fin needs to reach the speed at the least power; nothing where it cannot."""

    fin: str
    amplitude_deg: Number = None
    frequency_hz: Number = None
    #: 95 % interval of the frequency, from the covariance of efficiency and offset.
    frequency_ci95: Pair = (None, None)
    #: Delivered to the fin by its whole amplitude, W.
    power_W: Number = None
    #: Largest rate of the fin, rad/s.
    rate_rad_s: Number = None
    at_bound: list[str] = []


class FinFile(yamlio.ResultFile):
    """A fin file."""

    kind: ClassVar[str] = "fin file"
    format: Literal["swimid-fins/1"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    robot: str
    params: str
    speed_m_s: float
    amplitude_deg: tuple[float, float]
    frequency_hz: tuple[float, float]
    #: Where the ranges come from.
    ranges: Literal["given", "runs of the fit"]
    #: Range of the runs that the law was fitted to; outside it is extrapolation.
    identified: dict[str, tuple[float, float]] = {}
    limits: dict[str, float] = {}
    #: Power of propulsion at this speed over the recoil efficiency, W: what any fin needs at the least.
    least_power_W: float
    best: str
    fins: list[FinGait]
    provenance: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FinChoice(FileResult[FinFile]):
    """Fin, frequency and amplitude that reach a speed, as ``optimise gait`` gives them for a recoil law.

    Attributes
    ----------
    best : FinGait
        The fin of least power: ``fin``, ``amplitude_deg``, ``frequency_hz``, ``power_W``.
    file : FinFile
        What :meth:`save` writes; it has every fin.
    """

    format = FORMAT
    file_type = FinFile

    @property
    def best(self) -> FinGait:
        """The fin of least power."""
        return next(one for one in self.file.fins if one.fin == self.file.best)

    @classmethod
    def _told(cls, document: FinFile, evidence: ev.Evidence | None) -> str:
        return _summary(document, evidence) if evidence else super()._told(document, evidence)


@dataclass(frozen=True)
class Law:
    """The recoil law of the boxfish (Eqs 4, 5 and 27) for one set of parameters.

    ``8 eta pi^2 I f^3 (theta - theta_off)^2 = k v^3`` with ``k = rho C_d A / 2``: the power of propulsion.
    """

    drag_area_kg_m: float
    efficiency: float
    offset_rad: float

    def frequency(self, speed_m_s: float, inertia_kg_m2: float, amplitude_rad: Array) -> Array:
        """Frequency that reaches a speed, Hz; NaN within the offset."""
        over = amplitude_rad - self.offset_rad
        need = self.drag_area_kg_m * speed_m_s**3
        with np.errstate(divide="ignore", invalid="ignore"):
            cube = need / (8.0 * self.efficiency * np.pi**2 * inertia_kg_m2 * over**2)
            return np.asarray(np.where(over > 0, np.cbrt(cube), np.nan))


def delivered(inertia_kg_m2: float, frequency_hz: Array, amplitude_rad: Array) -> Array:
    """Power that a fin gives the water with its whole amplitude, ``8 pi^2 I f^3 theta^2``, W (Eq 4)."""
    return np.asarray(8.0 * np.pi**2 * inertia_kg_m2 * frequency_hz**3 * amplitude_rad**2)


def choose(file: ParameterFile, options: OptimiseGaitOptions, output: Path | None) -> FinChoice:
    """The fin, frequency and amplitude that reach a speed at the least power.

    Raises
    ------
    UsageError, InputError
        For options that do not belong here, and for anything wrong in a file.
    NoTrustworthyResult
        When no fin reaches the speed.
    """
    path = parameters_format.place(options.params)
    if options.reach_speed_m_s is None:
        raise UsageError("which speed is to be reached? give --reach-speed-m-s")
    for name in options.vary:
        if name not in ("frequency_hz", "amplitude_deg"):
            hint = suggestion(name, ["frequency_hz", "amplitude_deg"], "there are")
            raise UsageError(f"--vary: a fin has no '{name}'", hint=hint)
    for name in options.limits:
        if name not in LIMITS:
            raise UsageError(f"--limit {name} is not for fins", hint=f"there are {', '.join(LIMITS)}")
    with recorded(repeat=True) as notices:
        robot_name, folder = catalogue.robot_of_parameters(file, path, options.robot)
        robot = robot_format.read(robot_name, folder)
        drag_path = catalogue.drag_file(file, path)
        drag = parameters_format.read(drag_path, model=("falling-weight", "towed", "free-decay"))
        area, mass = propulsion.drag_numbers(drag, parameters_format.place(drag_path), robot)
        place = robot_format.locate(robot_name, folder)
        inertias = propulsion.fin_inertias(robot, list(robot.fins), place)
        estimated = {
            n.removeprefix("inertia_"): e.value
            for n, e in file.parameters.items()
            if n.startswith("inertia_")
        }
        fins = {name: estimated.get(name, inertia) for name, inertia in inertias.items()}
        fins = {name: inertia for name, inertia in fins.items() if inertia is not None}
        if not fins:
            raise InputError(
                "no fin of this robot has a known hydrodynamic inertia", file=place, column="fins"
            )
        model = RecoilModel(
            drag_area_kg_m=area,
            moving_mass_kg=mass,
            fins={n: None if n in estimated else i for n, i in fins.items()},
        )
        applied = Applied(model, file, path, options.chosen)
        inputs = [parameters_format.origin(options.params), parameters_format.origin(drag_path), place]
        if output is not None:
            atomic.check_writable(output, inputs=inputs)
        runs = _runs(file)
        ranges = _ranges(runs, options)
        law = _law(applied, applied.values(), area)
        vectors = drawn(applied, options.draws, options.seed).vectors if applied.uncertain()[0] else []
        laws = [_law(applied, values, area) for values in vectors]
        found = [_of_fin(name, i, law, laws, options, ranges) for name, i in fins.items()]  # type: ignore[arg-type]
        reached = [one for one in found if one.power_W is not None]
        if not reached:
            raise NoTrustworthyResult(
                f"no fin reaches {options.reach_speed_m_s:g} m/s within "
                f"{ranges['frequency_hz'][1]:g} Hz, {ranges['amplitude_deg'][1]:g} deg and the limits",
                hint="widen --vary or the limits; beyond the runs of the fit it is extrapolation",
            )
        best = min(reached, key=lambda one: (round(one.power_W or 0.0, 12), one.rate_rad_s or 0.0))
    settings = options.settings()
    origin = provenance.collect(inputs, settings=settings)
    result = FinFile(
        verdict="caution",
        robot=robot.name,
        params=path.name,
        speed_m_s=options.reach_speed_m_s,
        amplitude_deg=ranges["amplitude_deg"],
        frequency_hz=ranges["frequency_hz"],
        ranges="given" if options.vary else "runs of the fit",
        identified=runs,
        limits=dict(options.limits),
        least_power_W=area * options.reach_speed_m_s**3 / law.efficiency,
        best=best.fin,
        fins=found,
        provenance={key: origin[key] for key in ("version", "inputs", "settings")},
    )
    evidence = _evidence(result, law, fins, notices, origin)  # type: ignore[arg-type]
    result.verdict = evidence.verdict.level
    return FinChoice.of(result, evidence).saved(output)


def _law(applied: Applied, values: Array, area: float) -> Law:
    value = {p.name: float(v) for p, v in zip(applied.model.parameters, values, strict=True)}
    for name, law in (("frequency_exponent", 3.0), ("amplitude_exponent", 2.0)):
        if value[name] != law:
            raise UsageError(f"{name} was freed in this fit: the law that is used here has {law:g}")
    return Law(area, value["recoil_efficiency"], math.radians(value["amplitude_offset_deg"]))


def _runs(file: ParameterFile) -> dict[str, tuple[float, float]]:
    """What the runs that the law was fitted to were driven with; empty where the file does not tell.

    Frequencies that depart from the law (SWM030) are none of it.
    """
    extra = (file.fit.model_extra or {}) if file.fit is not None else {}
    out = [float(one["frequency_hz"]) for one in extra.get("departures", [])]
    runs = [
        run for run in extra.get("operating_points", []) if not np.isclose(run["frequency_hz"], out).any()
    ]
    if not runs:
        return {}
    found = {}
    for name in ("frequency_hz", "amplitude_deg"):
        values = [float(run[name]) for run in runs]
        found[name] = (min(values), max(values))
    return found


def _ranges(
    runs: dict[str, tuple[float, float]], options: OptimiseGaitOptions
) -> dict[str, tuple[float, float]]:
    """What may be set: as given, or what the runs of the fit were driven with."""
    found = {}
    for name in ("frequency_hz", "amplitude_deg"):
        if name in options.vary:
            low, high = options.vary[name]
            if not 0 < low < high:
                raise UsageError(f"--vary {name}: {low:g} is not above zero and below {high:g}")
            found[name] = (low, high)
        elif name in runs:
            found[name] = runs[name]
        else:
            raise UsageError(f"the parameter file tells no runs: give --vary {name}=LOW,HIGH")
    return found


def _of_fin(
    name: str,
    inertia: float,
    law: Law,
    laws: Sequence[Law],
    options: OptimiseGaitOptions,
    ranges: dict[str, tuple[float, float]],
) -> FinGait:
    """Amplitude and frequency of least power of one fin."""
    speed = options.reach_speed_m_s
    assert speed is not None
    amplitude = np.radians(np.linspace(*ranges["amplitude_deg"], AMPLITUDES))
    frequency = law.frequency(speed, inertia, amplitude)
    power, rate = delivered(inertia, frequency, amplitude), 2 * np.pi * frequency * amplitude
    low, high = ranges["frequency_hz"]
    allowed = (frequency >= low) & (frequency <= high)
    if "joint_rate_deg_s" in options.limits:
        allowed &= rate <= math.radians(options.limits["joint_rate_deg_s"])
    if "battery_W" in options.limits:
        allowed &= power / options.efficiency <= options.limits["battery_W"]
    if not allowed.any():
        return FinGait(fin=name)
    k = int(np.argmin(np.where(allowed, power, np.inf)))
    ends = [float(one.frequency(speed, inertia, amplitude[k : k + 1])[0]) for one in laws]
    ends = [f for f in ends if math.isfinite(f)]
    edge = [] if 0 < k < AMPLITUDES - 1 else ["amplitude_deg"]
    if len(ends) > 1:
        a, b = np.quantile(ends, [0.025, 0.975], method="weibull")
        interval: tuple[float | None, float | None] = (float(a), float(b))
    else:
        interval = (None, None)
    return FinGait(
        fin=name,
        amplitude_deg=math.degrees(amplitude[k]),
        frequency_hz=float(frequency[k]),
        frequency_ci95=interval,
        power_W=float(power[k]),
        rate_rad_s=float(rate[k]),
        at_bound=edge,
    )


# ------------------------------------------------------------ telling


def _evidence(
    file: FinFile, law: Law, fins: dict[str, float], notices: Sequence[Notice], origin: dict[str, Any]
) -> ev.Evidence:
    best = next(one for one in file.fins if one.fin == file.best)
    checks = [
        ev.check(
            "amplitude within its range",
            "at its end" if best.at_bound else "yes",
            not best.at_bound,
            "inside",
            "a larger amplitude at a lower frequency would need less power" if best.at_bound else "",
        ),
        trust.region_check(
            file.identified,
            [{"frequency_hz": best.frequency_hz or 0.0, "amplitude_deg": best.amplitude_deg or 0.0}],
        ),
        *trust.coefficients_check(notices),
    ]
    if best.frequency_ci95[0] is None:
        text = "the parameter file has no standard errors"
        checks.append(ev.check("uncertainty of the frequency", "not known", None, text=text))
    traces = []
    for group, (name, inertia) in enumerate(fins.items()):
        amplitude = np.linspace(*file.amplitude_deg, 60)
        frequency = law.frequency(file.speed_m_s, inertia, np.radians(amplitude))
        traces.append(ev.Trace(x=amplitude, y=frequency, label=name, group=group))
    reached = [one for one in file.fins if one.power_W is not None]
    traces.append(
        blocks.points(
            reached, lambda one: one.amplitude_deg, lambda one: one.frequency_hz, label="least power",
            group=len(fins),
        )
    )  # fmt: skip
    marks = [ev.Mark(at=f, label="range of the frequency") for f in file.frequency_hz]
    caption = f"Each fin reaches {file.speed_m_s:g} m/s along its curve; within the marks it is allowed to."
    figure = blocks.figure(
        "fins", "What reaches the speed", caption, "amplitude (deg)", "frequency (Hz)", traces, marks=marks
    )
    rows = []
    for one in file.fins:
        row: dict[str, blocks.Cell] = {
            "fin": one.fin,
            "amplitude": numbers.number(one.amplitude_deg, 3, "deg"),
            "frequency": numbers.number(one.frequency_hz, 3, "Hz"),
            "frequency, 95 %": numbers.interval(*one.frequency_ci95),
            "power": numbers.number(None if one.power_W is None else 1e3 * one.power_W, 3, "mW"),
            "largest rate": numbers.number(
                None if one.rate_rad_s is None else math.degrees(one.rate_rad_s), 3, "deg/s"
            ),
        }
        rows.append(row)
    table = blocks.table(
        "fins", "Fins", rows,
        "Power delivered to the fin with its whole amplitude, 8 π² I f³ θ²; of propulsion over efficiency it "
        f"is {numbers.number(1e3 * file.least_power_W, 3)} mW with any fin: the law tells fins apart by the "
        "amplitude that is lost within the offset, and by what their servos must do.",
    )  # fmt: skip
    return ev.Evidence(
        verb="optimise gait",
        title=f"Fin of {file.robot}",
        verdict=ev.judged(_answer(file), checks),
        checks=checks,
        tables=[table],
        figures=[figure],
        notices=blocks.notices(notices),
        methods=[
            f"Frequency and amplitude of each fin that reach {file.speed_m_s:g} m/s follow from the energy "
            "recoil law (Eqs 5 and 27) with the identified drag, efficiency and offset; of these the "
            "least power delivered to the fin (Eq 4, with the whole amplitude) was taken."
        ],
        references=REFERENCES,
        provenance=origin,
    )


def _answer(file: FinFile) -> str:
    best = next(one for one in file.fins if one.fin == file.best)
    low, high = best.frequency_ci95
    text = "" if low is None else f" (95 %: {numbers.interval(low, high)})"
    return (
        f"{file.speed_m_s:g} m/s with {best.fin} at {numbers.number(best.frequency_hz, 3, 'Hz')}{text} and "
        f"{numbers.number(best.amplitude_deg, 3, 'deg')}: "
        f"{numbers.number(1e3 * (best.power_W or 0.0), 3, 'mW')}."
    )


def _summary(file: FinFile, evidence: ev.Evidence) -> str:
    lines = [f"{file.robot}, {file.params}: {file.speed_m_s:g} m/s", ""]
    width = max(len(one.fin) for one in file.fins)
    for one in file.fins:
        if one.power_W is None:
            lines.append(f"  {one.fin:<{width}}  does not reach it")
            continue
        lines.append(
            f"  {one.fin:<{width}}  {numbers.number(one.frequency_hz, 3, 'Hz')}, "
            f"{numbers.number(one.amplitude_deg, 3, 'deg')}: {numbers.number(1e3 * one.power_W, 3, 'mW')}, "
            f"{numbers.number(math.degrees(one.rate_rad_s or 0.0), 3, 'deg/s')}"
        )
    lines += ["", f"  {_answer(file)}", f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}"]
    return "\n".join(lines)
