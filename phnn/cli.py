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
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FrameType

from phnn.configuration import compose, compose_groups, config_folder
from phnn.errors import PhnnError

# Commands with settings, and the file under configs/ that holds them.
_SETTINGS = {n: n for n in ("identify", "diagnose", "compare", "modes", "prove")} | {"demo": "diagnose"}
# The command whose settings are composed from groups of files.
_TRAIN = "train"
_DEBUG = "PHNN_DEBUG"


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from phnn import __version__

        print(f"phnn {__version__}")
        parser.exit(0)


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


_seed.__name__ = "whole number, 0 or more"


def _add_command(commands: argparse._SubParsersAction, name: str, text: str) -> argparse.ArgumentParser:
    epilog = ""
    if name in _SETTINGS:
        path = config_folder() / f"{_SETTINGS[name]}.yaml"
        epilog = "settings, given as key=value after the options (with their defaults):\n" + "".join(
            f"  {line}\n" for line in path.read_text(encoding="utf-8").splitlines()
        )
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    return command


def _training_settings() -> str:
    """What ``phnn train`` accepts: its own file, and the choices of the groups in it."""
    folder = config_folder()
    lines = [f"settings, given as key=value (with their defaults), from {folder / 'train.yaml'}:"]
    for group in ("model", "solver"):
        names = ", ".join(sorted(path.stem for path in (folder / group).glob("*.yaml")))
        lines.append(f"  {group}: {names}")
    text = (folder / "train.yaml").read_text(encoding="utf-8").partition("  - _self_")[2].partition("hydra:")[0]
    return "\n".join([*lines, *(f"  {line}" for line in text.strip().splitlines())])


@cache
def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="phnn",
        description="Models of piezoelectric actuators from recordings, and the physics they leave out.",
        epilog="phnn COMMAND --help tells more. Exit status: 0 done, 1 the work failed, 2 the input was refused.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    check = _add_command(commands, "check", "say what is understood of a folder of recordings")
    template = _add_command(commands, "template", "write a first recordings.yaml for a folder of unknown layout")
    identify = _add_command(commands, "identify", "fit the base model")
    diagnose = _add_command(commands, "diagnose", "find out what the base model leaves out")
    predict = _add_command(commands, "predict", "simulate recordings with a model that was written earlier")
    compare = _add_command(commands, "compare", "fit several kinds of model and compare them")
    modes = _add_command(commands, "modes", "find the modes of a structure, and what moves them with amplitude")
    train = _add_command(commands, "train", "train a neural or parametric model: phnn train folder=DIR out=DIR ...")
    train.epilog, train.formatter_class = _training_settings(), argparse.RawDescriptionHelpFormatter
    demo = _add_command(commands, "demo", "conceal an effect in simulated recordings, seal it, diagnose it")
    prove = _add_command(commands, "prove", "conceal many effects, seal them, diagnose them all, and count")
    predict.add_argument("model", type=Path, metavar="MODEL", help="model/ or base/ of an earlier result")
    for command in (check, identify, diagnose, predict, compare, modes):
        command.add_argument("folder", type=Path, metavar="FOLDER", help="folder of recordings")
        command.add_argument("--manifest", type=Path, metavar="FILE", help="recordings.yaml that lies elsewhere")
    template.add_argument("folder", type=Path, metavar="FOLDER", help="folder of recordings")
    template.add_argument("--out", type=Path, metavar="FILE", help="a new file to write; printed if left out")
    for command in (check, template, identify, diagnose, predict, compare, modes):
        command.add_argument(
            "--allow-outside",
            dest="outside",
            action="store_true",
            help="read files outside FOLDER that it names, links or refers to",
        )
    for command in (identify, diagnose, predict, compare, modes, prove):
        command.add_argument("--out", type=Path, metavar="DIR", required=True, help="where the results go")
    check.add_argument("--out", type=Path, metavar="DIR", help="write check.json there, too")
    for command in (check, identify, diagnose, predict, compare, modes, prove, demo):
        command.add_argument(
            "--overwrite", action="store_true", help="replace results of phnn in DIR even where they were changed since"
        )
    demo.add_argument(
        "--seed", type=_seed, metavar="N", help="which effect, how strong, what noise (drawn if left out)"
    )
    demo.add_argument("--out", type=Path, metavar="DIR", default=Path("out/demo"), help="default: %(default)s")
    return parser


def _parse(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[str]]:
    parser = _parser()
    # Settings may stand before, between and after the options, which argparse's own lists do not allow.
    arguments, settings = parser.parse_known_args(argv)
    strangers = [s for s in settings if s.startswith("-") or arguments.command not in (*_SETTINGS, _TRAIN)]
    if strangers:
        parser.error(f"phnn {arguments.command} does not know {' '.join(strangers)}")
    return arguments, settings


def _run(arguments: argparse.Namespace, settings: Sequence[str]) -> None:
    from phnn.ensemble.processes import ONE_THREAD

    name = arguments.command
    # Settings are refused before torch and numba are loaded.
    config = compose(_SETTINGS[name], settings) if name in _SETTINGS else {}
    if name == _TRAIN:
        config = compose_groups(_TRAIN, settings)
    # Sums over several threads round otherwise, so that a result would depend on the number of cores; recordings are
    # simulated in threads already.
    for variable, count in ONE_THREAD.items():
        os.environ.setdefault(variable, count)
    command = getattr(import_module(f"phnn.commands.{name}"), name)
    taken = inspect.signature(command).parameters
    command(**{key: value for key, value in {**vars(arguments), "config": config}.items() if key in taken})


def _say(text: str) -> None:
    # Not before there is something to say: the help must come at once.
    from phnn.intake.names import message

    print(f"phnn: {message(text)}", file=sys.stderr)


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
        arguments, settings = _parse(argv)
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
