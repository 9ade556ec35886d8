"""Sealed cases that are diagnosed: one runner, one log with a row for each case, and one grading of the answers."""
