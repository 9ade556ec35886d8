"""The console command ``phnn``: parses its arguments, loads the rest of the package only when a command runs.

Exit status: 0 done, 1 the work failed, 2 the input was refused, 130 interrupted, 143 terminated.
"""

from __future__ import annotations

import argparse
import inspect
import io
import os
import signal
import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from types import FrameType

from phnn.arguments import SETTINGS, TRAIN, parse
from phnn.configuration import compose, compose_groups
from phnn.errors import PhnnError

_DEBUG = "PHNN_DEBUG"


def _run(arguments: argparse.Namespace, settings: Sequence[str]) -> None:
    from phnn.threads import ONE_THREAD

    name = arguments.command
    # Settings are refused before torch and numba are loaded.
    config = compose(SETTINGS[name], settings) if name in SETTINGS else {}
    if name == TRAIN:
        config = compose_groups(TRAIN, settings)
    # Sums over several threads round otherwise, so that a result would depend on the number of cores; recordings are
    # simulated in threads already.
    for variable, count in ONE_THREAD.items():
        os.environ.setdefault(variable, count)
    command = getattr(import_module(f"phnn.commands.{name}"), name)
    offered = {**vars(arguments), "config": config, "options": vars(arguments)}
    taken = inspect.signature(command).parameters
    command(**{key: value for key, value in offered.items() if key in taken})


def _say(text: str) -> None:
    # Not before there is something to say: the help must come at once.
    from phnn.intake.limits import LIMITS
    from phnn.results import message

    print(f"phnn: {message(text, LIMITS.message_characters)}", file=sys.stderr)


class _Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM): it ends as after Ctrl-C, so that workers and marks are in order."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


def _prepare() -> None:
    """Signals end a command tidily, and a terminal that knows few letters gets question marks for the others."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments after the program's name; those of the process if left out.

    Returns:
        The exit status.
    """
    arguments = None
    try:
        _prepare()
        arguments, settings = parse(argv)
        _run(arguments, settings)
        if sys.stdout is not None:
            sys.stdout.flush()
    except PhnnError as error:
        _say(str(error))
        return error.exit_status
    except KeyboardInterrupt as stop:
        out = getattr(arguments, "out", None)
        ended = isinstance(stop, _Terminated)
        _say(("terminated" if ended else "interrupted") + (f"; what was finished is in {out}" if out else ""))
        return 143 if ended else 130
    except BrokenPipeError:
        # The reader has gone (phnn check ... | head): nothing to say, and nobody to say it to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 1
    except Exception as error:
        if os.environ.get(_DEBUG):
            raise
        if isinstance(error, OSError) and error.filename is not None:
            _say(f"cannot use {error.filename}: {error.strerror}")
        elif isinstance(error, OSError) and error.errno is not None:
            _say(f"a file cannot be written or read: {error.strerror}")
        else:
            _say(f"internal error, {type(error).__name__}: {error}; set {_DEBUG}=1 to see the traceback")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
