"""Effects of sensors and clocks: errors between the motion of the robot and its log."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from swimid.effects import base
from swimid.effects.base import Effect, Effects, Parameters, Trials, parameter
from swimid.fitting.model import MEAN_SPEED, NONE, Array, Hooks, Model, Trial


class CameraRotation(Effect):
    """Measured positions that are rotated about the start of the trial. The heading is unchanged."""

    name = "camera-rotation"
    meaning = "The axes of the measured positions are turned against those of the measured heading."
    sources = ("sea lion, section II (a camera on a wall of the tank)",)
    needs = frozenset({"output"})
    smooth = True
    own = ("camera_rotation",)

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: both position coordinates of a swimmer must be measured."""
        return super().applies(model, trials) and _both_measured(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the rotation angle of the camera as a parameter, rad."""
        words = "axes of the positions against those of the heading"
        return (parameter("angle_rad", "rad", 0.03, words, -math.pi, math.pi),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that rotate the simulated positions about the start of the trial."""
        first, second, _ = model.planar_pose
        origin = model.origin(trial)
        # Add the difference to the unrotated position, so that a zero angle changes nothing.
        turn = np.exp(1j * values[0]) - 1.0

        def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            change = turn * (channels[first] - origin[first] + 1j * (channels[second] - origin[second]))
            return {**channels, first: channels[first] + change.real, second: channels[second] + change.imag}

        return Hooks(output=(observe,))


def _both_measured(model: Model, trials: Trials) -> bool:
    """Return whether both coordinates of the position of a planar robot are measured."""
    return len(base.select_measured(model.planar_pose[:2], trials)) == 2


#: Number of Newton iterations that compute a position from its image by a distorting lens.
ITERATIONS = 8


class CameraScale(base.Sensing):
    """Scale error of a camera: measured displacements and speeds are multiplied by ``1 + scale_error``.

    The displacements are counted from the start of the trial. On a rig the effect is an error of the
    circumference of the encoder's pulley. In timed cruising it is an error of the length of the course, or of
    the rate of the clock.
    """

    name = "camera-scale"
    meaning = "The measured lengths are too long or too short by a constant fraction."
    sources = (
        "boxfish, section 4.2 (error of the course's length)",
        "tendon fish, section V (global camera)",
        "robotic dolphin, section 4 (global camera)",
    )
    channels = base.LENGTHS
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the form with a constant scale error, and the form with lens distortion.

        The form with lens distortion is for swimmers whose two position coordinates are measured.
        """
        found = super().variants(model, trials)
        if found and _both_measured(model, trials):
            return [*found, _Lens()]
        return found

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the relative scale error as a parameter."""
        return (parameter("scale_error", "1", 0.03, "relative error of the lengths", -0.5, 1.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that multiply the simulated displacements and speeds by ``1 + scale_error``."""
        error, origin = float(values[0]), model.origin(trial)
        return self.show(lambda name, length: length + error * (length - origin.get(name, 0.0)))


class _Lens(CameraScale):
    """Camera scale that changes towards the edge of the image because of lens distortion.

    A body at *p* is seen at ``c + (1 + e) (p - c) (1 + k |p - c|^2)``: radial distortion of the first order
    about the centre *c* [1]_.

    References
    ----------
    .. [1] D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.
    """

    meaning = "The measured lengths are too long or too short, more so far from the centre of the picture."

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the lens.

        They are the relative scale error at the centre of the image, the radial distortion (1/m2) and the
        coordinates of the centre (m).
        """
        places = np.concatenate([np.empty(0), *(_places(model, t) for t in trials)])
        places = places[np.isfinite(places)]
        middle = complex(np.mean(places)) if len(places) else 0j
        reach = max(float(np.max(np.abs(places - middle), initial=0.0)), 1e-3)
        (scale,) = super().parameters(model, trials)
        area, words = reach**2, "radial distortion of the picture"
        bend = parameter("distortion_1_m2", "1/m^2", 0.03 / area, words, -0.2 / area, 0.5 / area)
        size, far, words = 0.5 * reach, 3.0 * reach, "centre of the picture"
        first, second = model.planar_pose[:2]
        centre = [
            parameter(f"centre_{name}", "m", size, words, at - far, at + far, start=at)
            for name, at in ((first, middle.real), (second, middle.imag))
        ]
        return (scale, bend, *centre)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit.

        Either the scale error or the distortion is not zero. A change of only the image centre would have no
        influence.
        """
        return [point for point in super().tries(parameters) if point[0] or point[1]]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that distort the simulated positions as the lens does.

        Speeds are multiplied by the scale at the centre of the image.
        """
        error, bent, centre = 1.0 + float(values[0]), float(values[1]), complex(values[2], values[3])
        first, second = model.planar_pose[:2]
        origin = model.origin(trial)
        begin = complex(origin[first], origin[second])

        def displace(place: Any) -> Any:
            """Return the displacement from a position to its image."""
            off = place - centre
            return off * (error * (1.0 + bent * np.abs(off) ** 2) - 1.0)

        # Find the position whose image is the origin of the trial, by Newton's method for the distance from
        # the centre.
        off = begin - centre
        shown = abs(off) / error
        distance = shown
        for _ in range(ITERATIONS):
            slope = 1.0 + 3.0 * bent * distance**2
            distance -= (distance * (1.0 + bent * distance**2) - shown) / slope
        away = off * (distance / (abs(off) or 1.0) - 1.0)

        def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            place = channels[first] + 1j * channels[second] + away
            change = displace(place) + away
            speeds = {n: error * v for n, v in channels.items() if n in base.SPEEDS}
            shown = {first: channels[first] + change.real, second: channels[second] + change.imag}
            return {**channels, **speeds, **shown}

        return Hooks(output=(observe,))


def _places(model: Model, trial: Trial) -> Array:
    """Return the measured positions of a swimmer as complex numbers; empty if they are not measured.

    The real and imaginary parts are the two coordinates.
    """
    first, second = (trial.measured.get(name) for name in model.planar_pose[:2])
    if first is None or second is None:
        return np.empty(0, dtype=complex)
    return np.asarray(first + 1j * second)


#: Maximum relative error of a clock, fast or slow. RC oscillators without calibration are up to 10 % off.
LARGEST = 0.1


class ClockRate(base.ClockError):
    """Rate error of a clock: a log whose clock runs fast shows later times than the true ones.

    The time stamp ``t`` belongs to the event at the true time ``t_0 + (t - t_0) / (1 + rate)``. The clocks of
    log and drive agree at ``t_0``, where the drive or the trial begins (the first sample of a recorded
    command or input). A difference at ``t_0`` is the effect ``time-offset``. If a log contains turn rates
    or joint angles in addition to poses, only the clock of the camera may run at another rate than the clock
    of the robot.
    """

    name = "clock-rate"
    meaning = "The clock of the measurement is faster or slower than the clock of the command."
    sources = (
        "Atmel, ATmega328P data sheet (internal oscillator within 10 % as it leaves the factory)",
        "SMPTE 170M (29.97 frames per second, often called 30)",
    )

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the fraction by which the clock of the log runs fast.

        The scale of 0.2 % is 20 ms after 10 s, which is a visible offset.
        """
        name, words = f"{self.camera * 'camera_'}rate", "fraction by which the clock of the log is fast"
        return (parameter(name, "1", 0.002, words, -LARGEST, LARGEST),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that let the clock of the log drift from the beginning of the trial."""
        begin = model.onset(trial)
        if not math.isfinite(begin):
            begin = float(trial.time_s[0])
        drift = float(values[0]) / (1.0 + float(values[0]))
        if self.camera and drift:
            return base.shift_poses(trial, lambda time_s: time_s - drift * (time_s - begin))
        return Hooks(clock_s=-drift * begin, clock_drift=drift)


class ImuBias(base.Sensing):
    """Bias of a gyroscope: a constant that is added to the measured turn rate."""

    name = "imu-bias"
    meaning = "The gyroscope shows a constant turn rate at rest."
    sources = ("long-fin vehicle, section 5.2 (drift and calibration errors; the mean is filtered out)",)
    channels = base.TURN_RATES
    smooth = True

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the bias of the gyroscope as a parameter, rad/s."""
        return (parameter("bias_rad_s", "rad/s", 0.02, "turn rate shown at rest", -1.0, 1.0),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the bias to the simulated turn rates."""
        return self.show(lambda name, rate: rate + float(values[0]))


class ImuTilt(base.Sensing):
    """A tilted gyroscope: the turn rate in the plane of motion is multiplied by the cosine of the tilt."""

    name = "imu-tilt"
    meaning = "The inertial sensor is tilted: its axis sees only part of the turn rate."
    sources = ("long-fin vehicle, section 5 (inertial unit fixed in the hull)",)
    channels = base.TURN_RATES

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the tilt of the gyroscope's axis as a parameter, rad."""
        return (parameter("tilt_rad", "rad", 0.2, "tilt of the gyroscope's axis", 0.0, 1.4),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that multiply the simulated turn rates by the cosine of the tilt."""
        return self.show(lambda name, rate: math.cos(float(values[0])) * rate)


class MarkerDropout(Effect):
    """Failure of the marker tracker: intervals in which it stopped, jumped to another object or strayed.

    The effect is not simulated. It is detected in the samples, which are constant, displaced or far outside
    the noise.
    """

    name = "marker-dropout"
    meaning = "The tracker lost the markers, or followed another object, for parts of a trial."
    sources = (
        "tendon fish, section V.A (failed detection of the colour labels at 4 s)",
        "sea lion, section II (two markers tracked)",
    )

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return no parameters, because the effect is not simulated."""
        return ()

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return no hooks, because the effect is not simulated."""
        return NONE


#: Maximum offset of the tracked point from the reference point of the robot, m.
FARTHEST_M = 0.5


class MarkerOffset(Effect):
    """Offset of the tracked point from the robot's reference point, and of the tracked direction.

    The measured position is ``x + R(yaw) (along, across)``, minus the offset at the first sample. The
    measured heading is ``yaw + misalignment``. The measured velocity is that of the tracked point, in axes
    along and across the tracked direction.
    """

    name = "marker-offset"
    meaning = "The markers sit off the robot's reference point, or are not aligned with its axis."
    sources = ("sea lion, section II (markers on the front and rear ends give pose and heading)",)
    needs = frozenset({"output"})
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        It applies to a robot that moves in a plane and whose pose or velocity is measured.
        """
        if not (model.planar_pose and super().applies(model, trials)):
            return False
        speeds = () if model.body is None else model.body.velocity[:2]
        return bool(base.select_measured((*model.planar_pose, *speeds), trials))

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the tracked point.

        They are its distances ahead of and beside the reference point, m, and the angle of the tracked
        direction to the heading, rad.
        """
        ends = -FARTHEST_M, FARTHEST_M
        return (
            parameter("along_m", "m", 0.01, "tracked point ahead of the reference", *ends),
            parameter("across_m", "m", 0.01, "tracked point beside the reference", *ends),
            parameter("heading_rad", "rad", 0.03, "tracked minus true heading", -math.pi, math.pi),
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that replace the simulated pose and velocity by those of the tracked point."""
        along, across, angle = (float(v) for v in values)
        first, second, heading = model.planar_pose
        # Add the difference to the unrotated velocity, so that a zero angle changes nothing.
        offset, turn = complex(along, across), np.exp(-1j * angle) - 1.0

        def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            place = offset * np.exp(1j * channels[heading])
            moved = {
                first: channels[first] + (place - place[0]).real,
                second: channels[second] + (place - place[0]).imag,
                heading: channels[heading] + angle,
            }
            if model.body is not None:
                ahead, beside, rate = model.body.velocity
                velocity = channels[ahead] + 1j * channels[beside] + 1j * offset * channels[rate]
                velocity = velocity + turn * velocity
                moved |= {ahead: velocity.real, beside: velocity.imag}
            return {**channels, **moved}

        return Hooks(output=(observe,))


#: Maximum offset of the clock of a log, s.
LARGEST_S = 2.0


class TimeOffset(base.ClockError):
    """Constant offset of the clock: the log shows events earlier, and a timed course takes longer.

    If a log contains turn rates or joint angles in addition to poses, only the clock of the camera may be
    late relative to the clock of the robot.
    """

    name = "time-offset"
    meaning = "The clock of the measurement has a constant offset from the clock of the command."
    sources = (
        "boxfish, section 3.4 (time read from a video to 0.1 s)",
        "sea lion, section II (time zero is the frame of release)",
    )
    scatters = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the form for the clock of the log, unless the model estimates the offset of this clock.

        If the camera has its own clock, there is also a form for this clock only.
        """
        if model.timed_runs:
            return [self]
        if model.estimates("clock_offset"):
            return []
        return super().variants(model, trials)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as a parameter the time by which the clock of the log is late, s."""
        name, size = f"{self.camera * 'camera_'}offset_s", max(0.03, 0.1 * model.timed_runs)
        return (parameter(name, "s", size, "time by which the log is late", -LARGEST_S, LARGEST_S),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that delay the clock of the log, or lengthen the durations of timed cruising."""
        offset = float(values[0])
        if self.camera and offset:
            return base.shift_poses(trial, lambda time_s: time_s - offset)
        if not model.timed_runs:
            return Hooks(clock_s=offset)
        distance = trial.inputs["distance_m"]

        def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            speed = channels[MEAN_SPEED]
            with np.errstate(divide="ignore"):
                # Limit the measured duration to at least a tenth of the true duration.
                longer = np.maximum(1.0 + offset * speed / distance, 0.1)
            return {**channels, MEAN_SPEED: speed / longer}

        return Hooks(output=(observe,))
