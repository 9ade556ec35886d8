"""Shared parts of the commands on a terminal: the status line, and a console for tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from phnn.check.quality import doubts
from phnn.errors import PhnnError
from phnn.recordings import Campaign
from phnn.results import printable

Config = Mapping[str, Any]
# A pipe has no width of its own: whole tables fit there.
_PIPE = 200


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A status line on a terminal; silence in a pipe."""
    terminal = Console(stderr=True)
    if not terminal.is_terminal:
        yield lambda message: None
        return
    with terminal.status("reading") as status:
        yield status.update


@contextmanager
def refusals(name: str) -> Iterator[None]:
    """End a script with one line and the exit status of what went wrong."""
    try:
        yield
    except PhnnError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(error.exit_status)


def doubt(campaign: Campaign) -> None:
    """Warn of wrong units and of outputs that are noise, before time is spent on them."""
    for sentence in doubts(campaign):
        print(f"warning: {printable(sentence)}", file=sys.stderr, flush=True)


def console(pipe: int = _PIPE) -> Console:
    """A console as wide as the terminal, or ``pipe`` letters where there is none."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=pipe)
