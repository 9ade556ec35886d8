"""The report room: figures, one offline page and a console summary, from a finished diagnosis."""
