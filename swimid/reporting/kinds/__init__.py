"""One module per kind of result; :func:`swimid.reporting.results.reader` registers each."""
