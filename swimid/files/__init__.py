"""Functions that read and write files of any content.

- ``atomic`` writes files completely or not at all, locks an output while a command writes it, and stores the
intermediate results of a long computation.
- ``tabular`` reads CSV files, ``yamlio`` reads and writes YAML, ``video`` writes videos.
- ``memory`` checks that the content of a file fits in memory, before it is read.
- ``isolated`` reads files of other programs in a child process, and limits the memory that files may take.
- ``download`` copies public files of a stated repository and commit, and checks their SHA-256.
- ``user_code`` runs Python files of a user that extend swimid.
- ``provenance`` records the origin of a result, and recognises files that swimid wrote.
"""
