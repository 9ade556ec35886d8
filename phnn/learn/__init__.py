"""Training of neural and parametric models on recordings of several frequencies."""

from phnn.learn.run import Trained, train, train_folder
from phnn.learn.settings import Settings

__all__ = ["Settings", "Trained", "train", "train_folder"]
