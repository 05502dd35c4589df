"""What the trials command, for the scales of the actuation effects."""

import math
from abc import ABC
from collections.abc import Callable, Iterator
from dataclasses import replace

import numba
import numpy as np

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Trial, Trials
from swimid.fitting.hooks import Command, Stroke

#: Where no command says how large: an angle a servo turns, rad.
USUAL_ANGLE = 0.3


class Actuation(Effect, ABC):
    """An effect of the actuator; it applies where a command, not a measured joint angle, drives the model.

    Of one parameter, the same for every driven joint, an effect says what it makes of a command and, where it
    ``needs`` the stroke, of a steady beat's amplitude.
    """

    needs = frozenset({"command", "stroke"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where some trial is driven by a command."""
        return [self] if self.needs & model.offers and any(model.commanded(t) for t in trials) else []

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """What a joint does on a command, shape (n,), without missing samples."""
        raise NotImplementedError

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """What is left of the amplitude of a steady beat, rad."""
        raise NotImplementedError

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """What becomes of the commands, and of a steady beat."""
        value = float(values[0])

        def command(time_s: Array, angle: Array) -> Array:
            return bridged(lambda time, whole: self.followed(value, time, whole), time_s, angle)

        def beaten(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=self.amplitude(value, stroke))

        return Hooks(
            command=(every_joint(command),) if model.commanded(trial) else (),
            stroke=(beaten,) if "stroke" in self.needs else (),
        )


def every_joint(change: Callable[[Array, Array], Array]) -> Command:
    """A hook that does the same to every joint: joints that are told the same cost it once."""
    last: tuple[Array, Array, Array] | None = None

    def command(time_s: Array, angle: Array, joint: int) -> Array:
        nonlocal last
        known = last
        if known is None or known[0] is not time_s or known[1] is not angle:
            known = last = time_s, angle, change(time_s, angle)
            known[2].flags.writeable = False
        return known[2]

    return command


def held_back(signal: Array, half: Array) -> Array:
    """What follows a signal only where it is farther away than friction holds: the play operator.

    A position servo of stiffness k against a dry friction T stands still while ``k |command - angle| < T``.

    Parameters
    ----------
    signal : ndarray, shape (n,)
    half : ndarray, shape (n,)
        The distance ``T / k``; it may change in time.

    Returns
    -------
    ndarray, shape (n,)
        It starts on the signal.
    """
    return np.asarray(_play(signal, half))


@numba.njit(cache=True, nogil=True)
def _play(signal, half):  # type: ignore[no-untyped-def]
    output = signal.copy()
    for i in range(1, len(signal)):
        output[i] = min(max(output[i - 1], signal[i] - half[i]), signal[i] + half[i])
    return output


def bridged(change: Callable[[Array, Array], Array], time_s: Array, signal: Array) -> Array:
    """``change`` of a signal whose missing samples are bridged by straight lines, and missing again after."""
    there = np.isfinite(signal)
    if there.all():
        return change(time_s, signal)
    if not there.any():
        return signal
    filled = np.interp(time_s, time_s[there], signal[there])
    return np.where(there, change(time_s, filled), np.nan)


def _signals(model: Model, trials: Trials) -> Iterator[tuple[Array, Array, float]]:
    """Time, command and its fastest known rate, of each driven joint of each trial."""
    for trial in trials:
        if model.commanded(trial):
            yield from model.commands(trial)


def _strokes(trials: Trials) -> tuple[Array, Array]:
    """Frequency (Hz) and amplitude (rad) of every steady beat."""
    beats = [np.zeros((2, 0)), *(np.stack(trial.steady) for trial in trials)]
    frequency, amplitude = np.concatenate(beats, axis=1)
    there = np.isfinite(frequency) & np.isfinite(amplitude) & (frequency > 0) & (amplitude > 0)
    return frequency[there], amplitude[there]


def amplitude(model: Model, trials: Trials) -> float:
    """Typical amplitude of a driven joint, rad (or the unit of a black box's input)."""
    sizes = [0.5 * float(np.ptp(s)) for _, s, _ in _signals(model, trials) if len(s) and np.ptp(s) > 0]
    if not sizes:
        sizes = list(_strokes(trials)[1])
    return float(np.median(sizes)) if sizes else USUAL_ANGLE


def fastest(model: Model, trials: Trials) -> float:
    """Largest commanded rate, rad/s (or the unit of a black box's input, per second)."""
    rates = [r for _, _, r in _signals(model, trials)]
    for time, signal, _ in _signals(model, trials):
        if len(time) > 1:
            rates.append(float(np.max(np.abs(np.diff(signal) / np.diff(time)))))
    frequency, amplitude_rad = _strokes(trials)
    rates.extend(2 * math.pi * frequency * amplitude_rad)
    return float(max(rates, default=0.0)) or 1.0


def period(model: Model, trials: Trials) -> float:
    """Typical period of the beat, s; one second where none is known."""
    beats = [f for f in (*model.beats(trials), *_strokes(trials)[0]) if f > 0]
    return 1.0 / float(np.median(beats)) if beats else 1.0
