"""Find the cause of the gap between trials and a model: ``swimid diagnose``.

``diagnose`` is the command, ``options`` has its options, ``gap_file`` the format of its file, ``evidence``
its result with checks, tables, figures and texts. ``nominal`` selects the refitted coefficients and their
priors, ``readings`` the other readings of the robot, ``settings`` the settings, repeats and folds.
``noise_model`` whitens residuals, ``random_effects`` estimates the between-trial variation, ``weighting``
estimates both. ``context`` fits a hypothesis, ``candidates`` screens effects, ``search`` fits effects and
sets of effects, ``posterior`` computes their probabilities. ``crossval`` and ``shrinkage`` evaluate
held-out data, ``floor`` the noise floor. ``remainder`` describes the remaining residuals, ``dropouts``
failed samples, ``places`` where the gap is. ``facts`` collects the facts from which ``verdict`` decides.
``answer`` assembles the gap file. ``proposals`` lists trials that could be run next, and ``advice`` selects
the best one. ``repaired`` writes the model with the causes. ``power`` computes what the trials could show.
"""
