"""Results, the evidence they rest on, and the page they become. Nothing is computed again here.

``result`` is the base of all results, and one that is a text; ``fitted`` that of every fit;
``evidence`` holds verdict, checks, tables and figures as data, ``parameters`` the parameter file,
``numbers`` how numbers and units are written. ``reader`` finds the module ``section`` of each room, which
turns a result file into the blocks of ``sections``; ``report`` (with ``options``) puts them together,
``page`` as HTML, ``documents`` as Markdown and JSON. Drawing: ``figures`` and ``sheet`` (matplotlib),
``looks`` (how traces differ), ``heat`` (shaded tables), ``svg``.
"""
