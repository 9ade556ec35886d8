"""What every attack of this folder is given."""

from attack_tools import attack, compiled, pytest_terminal_summary  # noqa: F401
