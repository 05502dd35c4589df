"""Discrete-time ARX and ARMAX models: records, recursive least squares, orders, prediction, result."""
