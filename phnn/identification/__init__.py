"""Identification: the base model of a campaign, fits with covariance, numerical error, scores."""

from phnn.identification.base import identify_base
from phnn.identification.options import Options

__all__ = ["Options", "identify_base"]
