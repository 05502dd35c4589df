"""What several effects ask of a model."""

from __future__ import annotations

from swimid.fitting.body import Body
from swimid.fitting.model import Model


def rotates(model: Model) -> bool:
    """Whether it has one coordinate, and that is an angle."""
    return model.rig is not None and model.rig.rotation


def pulled(model: Model) -> bool:
    """Whether it is a body on a rig that is pulled from place to place."""
    return model.rig is not None and not model.rig.swings


def free_body(model: Model) -> Body | None:
    """Its links where the base moves."""
    return model.body if model.body is not None and model.body.free else None


def links(model: Model) -> Body:
    """Its links, for an effect that applies to nothing else."""
    assert model.body is not None
    return model.body
