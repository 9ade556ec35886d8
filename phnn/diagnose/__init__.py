"""The diagnosis: one search, one table of visited models, one number for each of them.

| file | what it does |
|---|---|
| `screen` | predicts the fall of χ² for every candidate, from one linearisation |
| `refit` | fits a model with one more element: short, further, to the end |
| `search` | grows models until nothing material is left to add |
| `number` | weighs all models that were visited |
| `verdict` | turns the weights into a word and the status of every element |
| `diagnosis` | the whole way, as one value |
| `locations` | whose local variables predict what a model leaves |
| `lines` | lines and drifts, in the spectrum of a residual |
| `formula` | a formula for a learned element |
| `proposal` | the next recording, from a menu |
| `words` | what is told of a learned element |
"""
