"""Results and the page they become: parameter files, evidence, report blocks. Nothing is computed again."""
