"""The report: result files and their evidence become one page. Nothing is computed again."""
