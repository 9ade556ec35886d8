"""Worked studies of public recordings: the named figures that the pages in docs/ state."""
