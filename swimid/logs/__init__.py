"""Logs of trials: reading, import from other programs, cleaning, and examination without a model.

The module ``log`` reads and writes the log of one trial. ``trials`` reads the file that lists the trials.
``experiments`` has the base class of experiments and finds all of them.
``plot`` draws logs. ``options`` defines the options of the commands of this package.

Modules for the import: ``import_log`` is the command. ``foreign`` has the readers of file formats, and units.
``mapping`` drafts a mapping, assigns the columns of a file to those of a log, and computes the sample times.
``averaging`` averages successive rows of a long recording, and computes the statistics of all its rows.
``consistency`` finds columns that contradict each other, and faulty channels.

Modules for tracked points: ``points`` computes pose and joint angles. ``point_files`` reads files, ``bundle``
estimates states, noise and faults of a film, ``linkage`` has the least squares, ``wave`` the body wave, and
``point_evidence`` the evidence. ``scale`` describes the scale and the calibration of a camera in YAML files,
and ``plane`` maps its picture to metres.

Modules for samples and motion: ``sampling`` estimates the rate, gaps, repeated samples, rounding, noise and
derivatives. ``tracks`` finds jumps, computes the mean speed, and defines the result of commands that write a
log. ``beat`` finds the frequency of one channel, and the stroke from all channels. ``kinematics`` computes
attitudes, quantities over whole cycles, and steady swimming.
"""
