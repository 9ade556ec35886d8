"""The intake of everything that a user names: readable files, limits, plain yaml and json."""
