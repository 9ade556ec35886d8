"""From a fitted base model to what it leaves out: locate, name, judge, learn, propose."""

from phnn.diagnosis.diagnosis import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]
