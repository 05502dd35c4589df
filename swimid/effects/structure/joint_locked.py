"""A joint that does not move, or less than it should."""

from typing import Any

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials

#: The most a joint may be locked, and how much stiffer than its own spring half a lock makes it.
MOST, STIFFER = 0.97, 10.0
#: Largest ``omega h`` of a locked joint, well inside the stability of the integration.
STABLE = 1.0


class JointLocked(Effect):
    """One joint is held: a driven one moves by ``1 - lock`` of its way, a passive one is stiffened.

    A passive joint gains the stiffness ``K lock / (1 - lock)``, K ten times its own, or less where the
    integration step could not follow.

    Parameters
    ----------
    column : str
        The joint's column in a log, ``joint1_rad`` say.
    """

    name = "joint-locked"
    meaning = "a joint that is held fast, wholly or in part"
    sources = ("dolphin paper, section 4.2.1",)
    needs = frozenset({"command", "tables"})

    def __init__(self, column: str = "joint1_rad") -> None:
        self.column = column

    def variants(self, model: Model, trials: Trials) -> Effects:
        """One for each passive joint, and each driven one that is told to move and not measured."""
        if model.body is None:
            return []
        columns = [axis.column for axis in model.body.passive]
        given = any(t.swim.commanded for t in trials)
        beaten = any(t.swim.joints is None for t in trials)
        for axis in model.body.driven:
            law = axis.driven
            assert law is not None
            if given or (beaten and (law.gain != 0.0 or law.bias_gain)):
                columns.append(axis.column)
        return [JointLocked(column) for column in sorted(columns)]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """How far it is locked, 0 to nearly 1."""
        name = f"locked_{self.column.removesuffix('_rad')}"
        words = f"share to which {self.column} is held"
        return (common.parameter(name, "1", 0.3, words, lower=0.0, upper=MOST),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Holds the joint."""
        body = common.links(model)
        lock = float(values[0])
        driven = [axis.column for axis in body.driven]
        if self.column in driven:
            number = driven.index(self.column)

            def hold(time_s: Array, angle: Array, joint: int) -> Array:
                return angle[0] + (1.0 - lock) * (angle - angle[0]) if joint == number else angle

            return Hooks(command=(hold,))
        number = [axis.column for axis in body.passive].index(self.column)

        def stiffen(tables: dict[str, Any]) -> None:
            own = max(body.stiffness(tables, number), 0.0)
            limit = (STABLE / body.step_s) ** 2 * body.joint_inertia(tables, number) * (1.0 - MOST) / MOST
            gain = min(STIFFER * own, limit) if own > 0 else limit
            body.stiffen(tables, number, stiffness=gain * lock / (1.0 - lock))

        return Hooks(tables=(stiffen,))
