"""Training of neural and parametric models on recordings of several frequencies."""

from phnn.learn.run import train
from phnn.learn.settings import Settings

__all__ = ["Settings", "train"]
