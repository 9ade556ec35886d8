"""The start of the console command: until it can end tidily, an interruption ends it at once and without a message."""

from __future__ import annotations

import signal

# Before anything is imported: an interruption in the middle of an import would print a traceback.
signal.signal(signal.SIGINT, signal.SIG_DFL)


def main() -> int:
    """Run ``phnn`` with the arguments of the process; returns the exit status."""
    from phnn.cli import main as run

    return run()
