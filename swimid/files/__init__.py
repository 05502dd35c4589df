"""Reading and writing of files, whatever is in them.

- ``atomic`` writes files whole or not at all, and groups of files together.
- ``mark`` recognises files that swimid wrote; ``lock`` gives an output to one run at a time.
- ``names`` makes file names of ids; ``checkpoint`` keeps what a long run has computed.
- ``delimited`` reads the heads of CSV files, ``yamlio`` YAML with line numbers, ``video`` writes films.
- ``provenance`` says where a result comes from.
"""
