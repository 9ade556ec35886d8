"""Checks of recordings before any model is fitted to them."""

from phnn.check.checked import Checked, check

__all__ = ["Checked", "check"]
