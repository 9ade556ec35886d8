"""Tracking: the inverse of an identified model makes other actuators follow a reference."""
