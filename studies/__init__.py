"""The studies behind the pages in docs/: each goes from recordings to a page, tables and figures in a folder."""
