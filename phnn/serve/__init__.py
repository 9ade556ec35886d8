"""Look at the runs below a folder in a browser of the same machine: their reports, what goes on, two runs compared."""

from phnn.serve.server import serve, server

__all__ = ["serve", "server"]
