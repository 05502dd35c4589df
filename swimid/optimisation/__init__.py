"""An identified model put to work: maps over gaits, stiffness rules, best gaits.

``performance`` simulates gaits side by side, ``study`` has what the results of all commands share.
``performance_map`` is the command map, with its file, its evidence and recorded trials beside it. A
``problem`` is what the searches minimise, by differences or NSGA-II, also in draws of the coefficients.
``optimise_stiffness`` finds a ``rule``, ``optimise_gait`` a gait; ``options`` are those of every command.
"""
