"""Identified coefficients in the formats of simulators: ``swimid export``.

``source`` is what is exported, with every quantity evaluated, and what the targets share. One module per
target turns it into text and names everything it cannot carry: ``mjcf``, ``gazebo``, ``plain`` (JSON).
``export`` is the verb and lists the targets, with ``options``. A new target is a module with
``export(source, options)`` and a line in that list.
"""
