"""What every file shares: written whole or not at all, line-numbered YAML, provenance, resumption."""
