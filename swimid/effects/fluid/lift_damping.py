"""Lift of the links that the drag model leaves out."""

from swimid.effects import common
from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameters, Trial, Trials


class LiftDamping(Effect):
    """``-k V w`` across each link, V its speed through the water and w that across.

    A normal force ``rho / 2 S C_N V^2`` with ``C_N = C_Na sin(a)``, linear in the angle of attack a where
    that is small; it takes energy as a damping does. k is shared among the points at which the model's drag
    acts across its links, in proportion to that drag, since both go with the area seen from the side.
    """

    name = "lift-damping"
    meaning = "lift of the links in proportion to speed and angle of attack"
    sources = (
        "Hoerner and Borst 1985, Fluid-Dynamic Lift (streamline bodies)",
        "Prestero 2001, MIT (simulation of the REMUS vehicle: body lift)",
    )
    needs = frozenset({"tables"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers whose model has drag across a link."""
        body = common.free_body(model)
        return [self] if body is not None and len(body.normal_drag(body.tables())[0]) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """k of all links, ``rho / 2 S C_Na``, N s2/m2.

        A tenth of what the model's drag across all links has for a gain: a body of low aspect ratio has a
        slope of about 1 per rad, as large as a drag coefficient across it, of which one sees a tenth.
        """
        body = common.links(model)
        size = 0.1 * float(body.normal_drag(body.tables())[1][:, 2].sum())
        words = "force across the links per speed and speed across"
        return (common.parameter("lift_N_s2_m2", "N s^2/m^2", size, words, lower=0.0, upper=100.0 * size),)

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds lifting points."""
        body = common.links(model)
        links, points = body.normal_drag(body.tables())
        points[:, 2] *= float(values[0]) / points[:, 2].sum()
        return Hooks(tables=(lambda tables: body.lift(tables, links, points),))
