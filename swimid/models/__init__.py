"""Models: what a robot or a rig does, as functions of parameters; nothing here is fitted."""
