"""All kinds of model on the same recordings: what each is fitted with, how it is judged, and what is written of it."""
