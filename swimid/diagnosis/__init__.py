"""From trials and a model to the cause of what is left between them: ``swimid diagnose``.

``noise_model`` whitens residuals, ``random_effects`` are what differs between trials, ``context`` fits,
``nominal`` says which numbers are refitted, ``readings`` how the robot's source could be read otherwise,
``folds`` what is held out together; ``candidates`` tries effects, ``crossval`` compares them on held-out
trials, ``weighting`` learns the noise from what is left, ``search`` fits every effect and sets of them,
``posterior`` says how likely each is, ``remainder`` and ``generic`` find what no effect explains, ``floor``
says how large the noise is, ``dropouts`` which samples are none, ``places`` where the gap is, ``shrinkage``
how far it closes, ``refutation`` whether held-out data contradict the causes, ``advice`` names the next
experiment; ``power`` and ``power_file`` what trials could show.
``judgement`` and ``answer`` say what was found, as a ``gap_file``. ``diagnose`` is the verb,
``options`` what it can be told, ``diagnosed`` its result, with ``evidence`` and ``words``.
"""
