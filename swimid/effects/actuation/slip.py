"""A drive that slips from some moment on."""

import numpy as np

from swimid.effects import common
from swimid.effects.base import Array, Hooks, Model, Parameters, Trial, Trials
from swimid.fitting.drives import eased

#: The loss comes on over this share of a beat, and over so many samples at least. A beat does not tell to
#: better than a quarter when its amplitude has changed; a jump between two samples would have no derivative.
RAMP, SAMPLES = 0.25, 4.0
#: Shares of a trial at which the loss is tried: from a quarter of the trial away a refit finds the moment.
MOMENTS = (0.125, 0.375, 0.625, 0.875)


class Slip(common.Actuation):
    """``1 - loss s(t)`` times the command, ``s`` a quintic step from 0 to 1 about the moment it sets in.

    A tendon that slips on its pulley, a horn on its shaft: the joints move by less of their command from that
    moment on, counted from the first sample, in every trial. An average over beats does not show when
    its amplitude was lost: models of steady beats have ``amplitude-loss`` only.
    """

    name = "slip"
    meaning = "From some moment of a trial on the joints turn by less than their command."
    sources = (
        "Zhong, Li and Du 2017, IEEE/ASME Trans. Mechatronics 22:1633 (a fish driven by wires)",
        "Firbank 1970, Int. J. Mech. Sci. 12:1053 (belts that creep and slip)",
    )
    needs = frozenset({"command"})

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """The share lost, and when half of that is lost, s after the first sample.

        A tenth is twice what one begins to see when it is lost throughout (``amplitude-loss``), since it is
        lost for a part of each trial.
        """
        lasting = model.scales(trials).duration
        longest = max(float(t.time_s[-1] - t.time_s[0]) for t in trials) or lasting
        when = "time after the first sample at which half of it is lost"
        return (
            common.parameter("loss", "1", 0.1, "share of the command lost", lower=0.0, upper=0.95),
            common.parameter(
                "begin_s", "s", 0.1 * lasting, when, lower=0.0, upper=longest, start=0.5 * lasting
            ),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """A loss, to which the change is nearly proportional, from several moments on."""
        loss, begin = parameters
        return [np.array([2.0 * loss.scale, 2.0 * share * begin.start]) for share in MOMENTS]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """The commands less what is lost by then."""
        loss, begin = (float(v) for v in values)
        samples = np.diff(trial.time_s)
        ramp = RAMP * common.period(model, [trial])
        if len(samples):
            ramp = max(ramp, SAMPLES * float(np.median(samples)))
        first = float(trial.time_s[0]) + begin - 0.5 * ramp

        def command(time_s: Array, angle: Array) -> Array:
            return angle * (1.0 - loss * eased(time_s - first, ramp))

        return Hooks(command=(common.every_joint(command),) if model.commanded(trial) else ())
