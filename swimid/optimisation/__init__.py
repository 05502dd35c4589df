"""An identified model put to work: maps over gaits, stiffness rules, best gaits.

``performance`` simulates gaits side by side and says what a study rests on. ``performance_map`` is the
command map, with ``measured`` (recorded trials beside it), ``map_file`` and ``map_evidence``. A ``problem``
is what the searches minimise, by ``descent`` or NSGA-II, also in ``draws`` of the coefficients.
``optimise_stiffness`` finds a ``rule`` and has ``rule_evidence``; ``optimise_gait`` has ``gait_file`` and
``gait_evidence``. ``trust`` has the checks that all share, ``options`` the options of every command here.
"""
