"""The table of the training runs below a folder: ``python scripts/gather.py out/sweep``; writes runs.csv there."""

from __future__ import annotations

import argparse
from pathlib import Path

from phnn.commands.gather import gather
from phnn.commands.terminal import refusals


def main() -> None:
    """Gather, and refuse bad input in one line."""
    parser = argparse.ArgumentParser(description="Print and write the table of the training runs below a folder.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/sweep"), help="default: %(default)s")
    with refusals("gather"):
        gather(parser.parse_args().folder)


if __name__ == "__main__":
    main()
