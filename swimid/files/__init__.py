"""Reading and writing of files, whatever is in them.

- ``atomic`` writes files whole or not at all, and groups of files together; one run at a time.
- ``checkpoint`` keeps what a long run has computed.
- ``tabular`` reads the heads of CSV files, ``yamlio`` YAML with line numbers, ``video`` writes films.
- ``provenance`` says where a result comes from, and recognises files that swimid wrote.
"""
