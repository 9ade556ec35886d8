"""What every attack of this folder is given."""

from attack_tools import attack, compiled, good, model, pytest_terminal_summary

__all__ = ["attack", "compiled", "good", "model", "pytest_terminal_summary"]
