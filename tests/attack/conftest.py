"""What every attack of this folder is given."""

from attack_tools import attack, compiled  # noqa: F401
