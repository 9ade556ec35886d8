"""What is to be said about recordings before any model is fitted to them."""

from phnn.check.checked import Checked, check

__all__ = ["Checked", "check"]
