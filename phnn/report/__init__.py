"""The report room: figures, one offline page and a console summary, from a finished diagnosis."""

from __future__ import annotations

from phnn.report.evidence import CandidateRow, Curve, Evidence, LedgerRow, ParameterRow, Trace
from phnn.report.write import console_summary, write_report

__all__ = [
    "CandidateRow",
    "Curve",
    "Evidence",
    "LedgerRow",
    "ParameterRow",
    "Trace",
    "console_summary",
    "write_report",
]
