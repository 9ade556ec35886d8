"""How everything that a user names comes in: files that may be read, limits, plain yaml and json, names that print."""
