"""Putting an identified model to work: maps over gaits, stiffness rules, best gaits.

``performance`` simulates gaits side by side, ``grid`` a grid of them, resumable; ``study`` is what their
files share. ``performance_map`` is the verb map, with ``measured`` (recorded trials beside it),
``map_file`` and ``map_evidence``; ``optimise_stiffness`` finds a ``rule``, tries it in a ``sweep`` and has
``rule_evidence``; ``optimise_gait`` finds a gait by ``descent`` and in ``draws`` of the coefficients, with
``gait_file`` and ``gait_evidence``. Robots without links have their own answers: ``fins`` by the recoil
law, a ``controller`` by a discrete-time model. ``section`` are the files' places in a report, ``options``
the options of every verb here.
"""
