"""What every file of swimid shares, whatever is in it.

``atomic`` writes whole files or none, ``delimited`` reads the heads of CSV files, ``yamlio`` YAML with line
numbers and every bit of a float, ``video`` writes films; ``provenance`` says where a result comes from
(command, version, SHA-256 of the inputs), ``checkpoint`` keeps what a long run found so far.
"""
