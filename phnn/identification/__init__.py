"""Identification: the base model of a campaign, fits with covariance, numerical error, scores."""
