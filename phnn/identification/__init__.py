"""Identification: the base model of a campaign, fits with covariance, numerical error, scores."""

from phnn.identification.base import Options, identify_base

__all__ = ["Options", "identify_base"]
