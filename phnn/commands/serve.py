"""``phnn serve``."""

from __future__ import annotations

from pathlib import Path

from phnn.serve import serve as serve_runs


def serve(folder: Path, port: int = 0) -> None:
    """Show the runs below a folder to browsers of this machine; writes nothing."""
    serve_runs(folder, port)
