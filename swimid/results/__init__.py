"""What every command returns, and the one renderer of each form it takes: terminal, page, picture.

``result`` is the base of all results, ``fitted`` that of every fit; ``kinds`` lists those that can be read
again. ``evidence`` holds verdict, checks, tables and figures as data, ``parameters`` the parameter file.
``terminal`` prints a result, ``page`` makes HTML and Markdown of results, ``compared`` sets several fits of
one model side by side, ``drawing`` draws figures with matplotlib; ``report`` (with ``options``) is the command.
``blocks`` has tables and figures that several packages need, ``numbers`` writes numbers and units.
"""
