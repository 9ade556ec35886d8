"""All kinds of model on the same recordings: training, scores and results."""
