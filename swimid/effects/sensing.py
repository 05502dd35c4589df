"""Effects between what the robot does and what the log shows of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials
from swimid.effects.common import parameter
from swimid.fitting.hooks import NONE
from swimid.fitting.model import MEAN_SPEED


class CameraRotation(Effect):
    """Positions turned about where the trial starts, the heading as it is."""

    name = "camera-rotation"
    meaning = "The axes of the measured positions are turned against those of the measured heading."
    sources = ("sea lion, section II (a camera on a wall of the tank)",)
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where both positions are measured and the model does not estimate it."""
        if model.body is None or model.estimates("camera_rotation"):
            return []
        both = len(common.measured(model.body.pose[:2], trials)) == 2
        return super().variants(model, trials) if both else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The angle, rad."""
        words = "axes of the positions against those of the heading"
        return (parameter("angle_rad", "rad", 0.03, words, lower=-math.pi, upper=math.pi),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Turned positions."""
        angle = float(values[0])
        first, second, _ = common.links(model).pose
        origin = model.origin(trial)

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            a, b = channels[first] - origin[first], channels[second] - origin[second]
            # minus the unturned, so that no angle changes nothing at all
            c, s = math.cos(angle) - 1.0, math.sin(angle)
            return {
                **channels,
                first: channels[first] + c * a - s * b,
                second: channels[second] + s * a + c * b,
            }

        return Hooks(output=(seen,))


#: Steps in which a place is found from where it is seen.
ITERATIONS = 8


class CameraScale(common.Sensing):
    """Displacements and speeds times ``1 + scale_error``, about where the trial starts.

    On a rig it is the circumference of the encoder's pulley, on a cruising run the length of the
    course or the rate of the clock.
    """

    name = "camera-scale"
    meaning = "The measured lengths are too long or too short by a constant share."
    sources = (
        "boxfish, section 4.2 (error of the course's length)",
        "tendon fish, section V (global camera)",
        "robotic dolphin, section 4 (global camera)",
    )
    channels = common.LENGTHS
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The same everywhere, and of a swimmer in a plane changing towards the edge of the picture."""
        found = super().variants(model, trials)
        body = model.body
        if not found or body is None or not body.free:
            return found
        both = len(common.measured(body.pose[:2], trials)) == 2
        return [*found, _Lens()] if both else found

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The relative error of the scale."""
        return (parameter("scale_error", "1", 0.03, "relative error of the lengths", lower=-0.5, upper=1.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Scaled positions and speeds."""
        error, origin = float(values[0]), model.origin(trial)
        return self.shown(lambda name, length: length + error * (length - origin.get(name, 0.0)))


class _Lens(CameraScale):
    """A scale that changes towards the edge: a picture whose lens is not, or wrongly, rectified.

    A body that is at *p* is seen at ``c + (1 + e) (p - c) (1 + k |p - c|^2)``: radial distortion of the first
    order about the centre *c* [1]_.

    References
    ----------
    .. [1] D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.
    """

    meaning = "The measured lengths are too long or too short, more so far from the centre of the picture."

    def variants(self, model: Model, trials: Trials) -> Effects:
        """None but those of the effect itself."""
        return []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The relative error at the centre, the distortion (1/m2) and the centre (m)."""
        places = np.concatenate([_places(model, t) for t in trials])
        places = places[np.isfinite(places)]
        middle = complex(np.mean(places)) if len(places) else 0j
        reach = max(float(np.max(np.abs(places - middle), initial=0.0)), 1e-3)
        (scale,) = super().parameters(model, trials)
        first, second = common.links(model).pose[:2]
        return (
            scale,
            parameter(
                "distortion_1_m2", "1/m^2", 0.03 / reach**2, "radial distortion of the picture",
                lower=-0.2 / reach**2, upper=0.5 / reach**2,
            ),
            *(
                parameter(
                    f"centre_{name}", "m", 0.5 * reach, "centre of the picture",
                    lower=at - 3.0 * reach, upper=at + 3.0 * reach, start=at,
                )
                for name, at in ((first, middle.real), (second, middle.imag))
            ),
        )  # fmt: skip

    def tries(self, parameters: Parameters) -> list[Array]:
        """Both errors, of both signs; the centre alone changes nothing."""
        return [point for point in super().tries(parameters) if point[0] or point[1]]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Positions as the lens shows them, and speeds scaled as at its centre."""
        error, bent, centre = 1.0 + float(values[0]), float(values[1]), complex(values[2], values[3])
        first, second = common.links(model).pose[:2]
        origin = model.origin(trial)
        begin = complex(origin[first], origin[second])

        def moved(place: Any) -> Any:
            """How far from its place something is seen."""
            off = place - centre
            return off * (error * (1.0 + bent * np.abs(off) ** 2) - 1.0)

        # where the body is that is first seen at its origin, from there: Newton's method for its distance
        off = begin - centre
        shown = abs(off) / error
        distance = shown
        for _ in range(ITERATIONS):
            slope = 1.0 + 3.0 * bent * distance**2
            distance -= (distance * (1.0 + bent * distance**2) - shown) / slope
        away = off * (distance / abs(off) - 1.0) if off else 0j

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            place = channels[first] + 1j * channels[second] + away
            change = moved(place) + away
            speeds = {n: error * v for n, v in channels.items() if n in common.SPEEDS}
            shown = {first: channels[first] + change.real, second: channels[second] + change.imag}
            return {**channels, **speeds, **shown}

        return Hooks(output=(seen,))


def _places(model: Model, trial: Trial) -> Array:
    """Where the log has the body, its two axes as one complex number; nothing where it does not say."""
    first, second = (trial.measured.get(name) for name in common.links(model).pose[:2])
    if first is None or second is None:
        return np.empty(0, dtype=complex)
    return np.asarray(first + 1j * second)


#: Largest error that is looked for, either way: RC oscillators that nobody calibrated are 10 % off.
LARGEST = 0.1


class ClockRate(Effect):
    """A stamp ``t`` of the log shows what happened at ``t_0 + (t - t_0) / (1 + rate)``.

    The clocks of log and drive agree at ``t_0``, where the drive or the run begins (the first sample of a
    recorded command or input); how far they are apart there is ``time-offset``. Where a log holds turn rates
    beside poses, the camera's clock alone may run at another rate than the robot's.

    Parameters
    ----------
    camera : bool
        Whether only poses are stamped by that clock.
    """

    name = "clock-rate"
    meaning = "The clock of the measurement runs fast, or slow, against that of the drive."
    sources = (
        "Atmel, ATmega328P data sheet (internal oscillator within 10 % as it leaves the factory)",
        "SMPTE 170M (29.97 frames per second, often called 30)",
    )
    needs = frozenset({"clock"})
    smooth = True

    def __init__(self, *, camera: bool = False) -> None:
        self.camera = camera

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Where there is a clock; the camera's alone beside it."""
        alone = [ClockRate(camera=True)] if common.clocks_apart(model, trials) else []
        return [*super().variants(model, trials), *alone]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The share by which the log runs fast; 0.2 % are 20 ms after 10 s, an offset one begins to see."""
        name = "camera_rate" if self.camera else "rate"
        words = "share by which the clock of the log is fast"
        return (parameter(name, "1", 0.002, words, lower=-LARGEST, upper=LARGEST),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A clock that drifts from where the run begins."""
        rate = float(values[0])
        onset = model.onset(trial)
        begin = onset if math.isfinite(onset) else float(trial.time_s[0])
        drift = rate / (1.0 + rate)
        if self.camera and rate != 0.0:
            return common.poses_at(trial, lambda time_s: time_s - drift * (time_s - begin))
        return Hooks() if self.camera else Hooks(clock_s=-drift * begin, clock_drift=drift)


class ImuBias(common.Sensing):
    """A constant added to the turn rate."""

    name = "imu-bias"
    meaning = "The gyroscope shows a constant turn rate at rest."
    sources = ("long-fin vehicle, section 5.2 (drift and calibration errors; the mean is filtered out)",)
    channels = common.TURN_RATES
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The bias, rad/s."""
        return (parameter("bias_rad_s", "rad/s", 0.02, "turn rate shown at rest", lower=-1.0, upper=1.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Turn rates with the bias."""
        return self.shown(lambda name, rate: rate + float(values[0]))


class ImuTilt(common.Sensing):
    """The turn rate in the plane of motion times the cosine of the tilt."""

    name = "imu-tilt"
    meaning = "The inertial sensor is tilted: its axis sees only part of the turn rate."
    sources = ("long-fin vehicle, section 5 (inertial unit fixed in the hull)",)
    channels = common.TURN_RATES

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The tilt, rad."""
        return (parameter("tilt_rad", "rad", 0.2, "tilt of the gyroscope's axis", lower=0.0, upper=1.4),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Smaller turn rates."""
        return self.shown(lambda name, rate: math.cos(float(values[0])) * rate)


class MarkerDropout(Effect):
    """Stretches in which the tracker froze, jumped to something else or strayed.

    No simulation contains it: it is found in the samples themselves, by their being frozen,
    displaced or far outside the noise.
    """

    name = "marker-dropout"
    meaning = "For some stretches the tracker lost the markers or followed something else."
    sources = (
        "tendon fish, section V.A (failed detection of the colour labels at 4 s)",
        "sea lion, section II (two markers tracked)",
    )
    needs = frozenset()

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """None: nothing is simulated, so that it applies to no model."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """None."""
        return NONE


#: Farthest a marker may be off, m.
FARTHEST_M = 0.5


class MarkerOffset(Effect):
    """The tracked point lies beside the reference point, the tracked direction beside the heading.

    ``x + R(yaw) (along, across)`` less its value at the first sample, ``yaw + misalignment``, and
    the velocity of that point in the axes of that direction.
    """

    name = "marker-offset"
    meaning = "The markers sit off the robot's reference point, or are not aligned with its axis."
    sources = ("sea lion, section II (markers on the front and rear ends give pose and heading)",)
    needs = frozenset({"output"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where a pose or a velocity of the body is measured."""
        body = common.free_body(model)
        if body is None:
            return []
        seen = common.measured((*body.pose, *body.velocity[:2]), trials)
        return super().variants(model, trials) if seen else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Place of the tracked point ahead of the reference point and to its side, m; its direction, rad."""
        return tuple(
            parameter(name, unit, size, words, lower=-most, upper=most)
            for name, unit, size, words, most in (
                ("along_m", "m", 0.01, "tracked point ahead of the reference", FARTHEST_M),
                ("across_m", "m", 0.01, "tracked point beside the reference", FARTHEST_M),
                ("heading_rad", "rad", 0.03, "tracked against true heading", math.pi),
            )
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Pose and velocity of the tracked point."""
        body = common.links(model)
        along, across, turn = (float(v) for v in values)
        (first, second, heading), (ahead, beside, rate) = body.pose, body.velocity

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            yaw, r = channels[heading], channels[rate]
            c, s = np.cos(yaw), np.sin(yaw)
            a, b = along * c - across * s, along * s + across * c
            u, v = channels[ahead] - across * r, channels[beside] + along * r
            # minus the unturned, so that no angle changes nothing at all
            cosine, sine = math.cos(turn) - 1.0, math.sin(turn)
            return {
                **channels,
                first: channels[first] + a - a[0],
                second: channels[second] + b - b[0],
                heading: yaw + turn,
                ahead: u + cosine * u + sine * v,
                beside: v + cosine * v - sine * u,
            }

        return Hooks(output=(seen,))


#: Largest offset that is looked for, s.
LARGEST_S = 2.0


class TimeOffset(Effect):
    """The log shows what happened a constant time earlier; a timed run takes that much longer.

    Where a log holds turn rates beside poses, the camera's clock alone may be late against that of the robot.

    Parameters
    ----------
    camera : bool
        Whether only poses are late.
    """

    name = "time-offset"
    meaning = "The clock of the measurement is late, or early, against that of the drive."
    sources = (
        "boxfish, section 3.4 (time read from a video to 0.1 s)",
        "sea lion, section II (time zero is the frame of release)",
    )
    needs = frozenset({"clock"})
    smooth = True
    scatters = True

    def __init__(self, *, camera: bool = False) -> None:
        self.camera = camera

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Where there is a clock the model does not estimate; the camera's alone beside it."""
        if model.timed_runs:
            return [self]
        if model.estimates("clock_offset"):
            return []
        alone = [TimeOffset(camera=True)] if common.clocks_apart(model, trials) else []
        return [*super().variants(model, trials), *alone]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The time by which the log is late, s."""
        name, typical = "camera_offset_s" if self.camera else "offset_s", 0.1 if model.timed_runs else 0.03
        words = "time by which the log is late"
        return (parameter(name, "s", typical, words, lower=-LARGEST_S, upper=LARGEST_S),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A late clock; longer times of cruising runs."""
        offset = float(values[0])
        if self.camera:
            return common.poses_at(trial, lambda time_s: time_s - offset) if offset != 0.0 else Hooks()
        if not model.timed_runs:
            return Hooks(clock_s=offset)
        distance = trial.inputs["distance_m"]

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            speed = channels[MEAN_SPEED]
            with np.errstate(divide="ignore"):
                # no watch reads less than a tenth of the run
                longer = np.maximum(1.0 + offset * speed / distance, 0.1)
            return {**channels, MEAN_SPEED: speed / longer}

        return Hooks(output=(seen,))
