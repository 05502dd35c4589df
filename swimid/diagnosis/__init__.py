"""Find the cause of the gap between trials and a model: ``swimid diagnose``.

``diagnose`` is the command, ``options`` has its options, ``gap_file`` the format of its file,
``evidence`` its result with checks, tables, figures and texts. ``nominal`` selects the refitted
coefficients, ``readings`` the other readings of the robot, ``settings`` the settings, repeats and folds.
``study`` has the unknowns of a hypothesis with their priors, and fits it. ``noise`` estimates measurement
noise and random effects, ``crossval`` computes the predictive density of held-out data. ``screening``
predicts what an effect closes, ``pool`` fits effects and sets of effects, ``posterior`` computes their
probabilities, ``search`` chooses noise and causes, ``odd`` finds a trial with parameters of its own.
``held_out`` compares held-out errors with their expectation, and ``verdict`` decides from these facts.
``remainder`` describes the remaining residuals, ``dropouts`` failed samples, ``places`` where the gap is.
``answer`` assembles the gap file. ``proposals`` lists trials that could be run next, and selects the best
one. ``repaired`` writes the model with the causes. ``power`` computes what the trials could show.
"""
