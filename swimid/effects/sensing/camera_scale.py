"""A length scale that is off."""

from __future__ import annotations

from typing import Any

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Effects, Hooks, Model, Parameters, Trial, Trials

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
        return (
            common.parameter(
                "scale_error", "1", 0.03, "relative error of the lengths", lower=-0.5, upper=1.0
            ),
        )

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
            common.parameter(
                "distortion_1_m2", "1/m^2", 0.03 / reach**2, "radial distortion of the picture",
                lower=-0.2 / reach**2, upper=0.5 / reach**2,
            ),
            *(
                common.parameter(
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
