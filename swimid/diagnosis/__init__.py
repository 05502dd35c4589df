"""Find the cause of the gap between trials and a model: ``swimid diagnose``.

``diagnose`` is the command, ``options`` has its options, ``diagnosed`` its result (with ``gap_file``,
``evidence`` and ``words``). ``nominal`` selects the refitted coefficients and their priors, ``readings`` the
other readings of the robot. ``noise_model`` whitens residuals, ``random_effects`` estimates the between-trial
variation, ``weighting`` estimates both. ``context`` fits a hypothesis, ``candidates`` screens effects,
``search`` fits effects and sets of effects, ``posterior`` computes their probabilities. ``folds``,
``crossval``, ``shrinkage`` and ``refutation`` evaluate held-out data, ``floor`` the noise floor. ``generic``
and ``remainder`` describe the remaining residuals, ``dropouts`` and ``dropout_cause`` failed samples,
``places`` where the gap is. ``judgement`` and ``answer`` give the verdict, ``advice`` the next experiment.
``power`` and ``power_file`` say what the trials could show.
"""
