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
from typing import Any, NoReturn

from phnn.configuration import compose, compose_groups, config_folder
from phnn.errors import PhnnError, meant

# Commands with settings, and the file under configs/ that holds them.
SETTINGS = {n: n for n in ("identify", "diagnose", "compare", "modes")} | {"demo": "diagnose"}
# The command whose settings are composed from groups of files.
TRAIN = "train"

_COMMANDS = {
    "check": "say what is understood of a folder of recordings",
    "template": "write a first recordings.yaml for a folder of unknown layout",
    "open": "load a folder on a page of this computer: columns, units, check and diagnosis",
    "identify": "fit the base model",
    "diagnose": "find out what the base model leaves out",
    "predict": "simulate recordings with a model that was written earlier",
    "invert": "find the voltage with which a model's displacement follows a reference",
    "export": "write a model as a program: C, FMU, Python or MATLAB",
    "plot": "draw a model or a diagnosis as a figure, with its data as a table",
    "compare": "fit several kinds of model and compare them",
    "modes": "find the modes of a structure, and how they move with amplitude",
    TRAIN: "train a neural or parametric model: phnn train folder=DIR out=DIR ...",
    "demo": "conceal an effect in simulated recordings, seal it, diagnose it",
}
# Kinds of plots, as functions of phnn.plot.
_PLOTS = ("compare", "residuals", "loops", "bode", "energy")
# Which commands take which of the common arguments.
_FOLDER = ("check", "template", "open", "identify", "diagnose", "predict", "compare", "modes")
_MODEL = ("predict", "invert", "export", "plot")
_MANIFEST = ("check", "open", "identify", "diagnose", "predict", "compare", "modes", "plot")
_OUT = ("identify", "diagnose", "predict", "invert", "export", "plot", "compare", "modes")
_OUTSIDE = (*_FOLDER, "invert", "export", "plot")
_OVERWRITE = (*_OUT, "check", "demo")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from phnn import __version__

        print(f"phnn {__version__}")
        parser.exit(0)


class _Parser(argparse.ArgumentParser):
    """A parser that says what a misspelt command or option was probably meant to be."""

    _given: Sequence[str] = ()

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse as argparse; remember the words for `error`."""
        self._given = sys.argv[1:] if args is None else list(args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """As argparse, with a hint."""
        options = [name for action in self._actions for name in action.option_strings]
        choices = [str(c) for action in self._actions if not action.option_strings for c in action.choices or ()]
        words = [w.partition("=")[0] for w in self._given]
        strange = [(w, options) for w in words if w.startswith("--") and w not in options]
        strange += [(w, choices) for w in words[:1] if not w.startswith("-") and w not in choices]
        super().error(next((f"{message}: {w}{hint}" for w, known in strange if (hint := meant(w, known))), message))


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


_seed.__name__ = "whole number, 0 or more"


def parse(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[str]]:
    """Return the arguments of a command line, ``command`` among them, and its settings ``key=value``, which may stand
    anywhere; None stands for the command line of the process."""
    parser, commands = _parser()
    # Settings may stand before, between and after the options, which argparse's own lists do not allow.
    arguments, settings = parser.parse_known_args(argv)
    # As it was typed, for the report of a run.
    arguments.typed = tuple(sys.argv[1:] if argv is None else argv)
    strangers = [s for s in settings if s.startswith("-") or arguments.command not in (*SETTINGS, TRAIN)]
    if strangers:
        dashes = arguments.command in SETTINGS and any(s.startswith("-") and "=" in s for s in strangers)
        hint = "; settings have no dashes, such as seed=1" if dashes else ""
        commands[arguments.command].error(f"phnn {arguments.command} does not know {' '.join(strangers)}{hint}")
    return arguments, settings


@cache
def _parser() -> tuple[_Parser, dict[str, argparse.ArgumentParser]]:
    """Return the parser, and that of each command by name."""
    parser = _Parser(
        prog="phnn",
        description="Models of piezoelectric actuators from recordings, and the physics they leave out.",
        epilog="phnn COMMAND --help tells more. Exit status: 0 done, 1 the work failed, 2 the input was refused.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    group = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    commands = {name: _add(group, name, text) for name, text in _COMMANDS.items()}
    commands["plot"].add_argument("kind", choices=_PLOTS, metavar="KIND", help=", ".join(_PLOTS))
    for name in _MODEL:
        text = "model/ or base/ of an earlier result, or the folder of a diagnosis"
        commands[name].add_argument("model", type=Path, metavar="MODEL", help=text)
    for name in _FOLDER:
        commands[name].add_argument("folder", type=Path, metavar="FOLDER", help="folder of recordings")
    for name in _MANIFEST:
        text = "recordings.yaml that lies elsewhere"
        commands[name].add_argument("--manifest", type=Path, metavar="FILE", help=text)
    _add_own(commands)
    for name in _OUT:
        commands[name].add_argument("--out", type=Path, metavar="DIR", required=True, help="where the results go")
    for name in _OUTSIDE:
        text = "read files outside FOLDER that it names, links or refers to"
        commands[name].add_argument("--allow-outside", dest="outside", action="store_true", help=text)
    for name in _OVERWRITE:
        text = "replace results of phnn in DIR even where they were changed since"
        commands[name].add_argument("--overwrite", action="store_true", help=text)
    return parser, commands


def _add(group: argparse._SubParsersAction, name: str, text: str) -> argparse.ArgumentParser:
    epilog = _training_settings() if name == TRAIN else ""
    if name in SETTINGS:
        path = config_folder() / f"{SETTINGS[name]}.yaml"
        epilog = "settings, given as key=value after the options (with their defaults):\n" + "".join(
            f"  {line}\n" for line in path.read_text(encoding="utf-8").splitlines()
        )
    command: argparse.ArgumentParser = group.add_parser(
        name, help=text, description=text, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    return command


def _training_settings() -> str:
    """Return what ``phnn train`` accepts: its own file, and the choices of the groups in it."""
    folder = config_folder()
    lines = [f"settings, given as key=value (with their defaults), from {folder / 'train.yaml'}:"]
    for group in ("model", "solver"):
        names = ", ".join(sorted(path.stem for path in (folder / group).glob("*.yaml")))
        lines.append(f"  {group}: {names}")
    text = (folder / "train.yaml").read_text(encoding="utf-8").partition("  - _self_")[2].partition("hydra:")[0]
    return "\n".join([*lines, *(f"  {line}" for line in text.strip().splitlines())])


def _add_own(commands: dict[str, argparse.ArgumentParser]) -> None:
    """Arguments that one command alone takes."""
    commands["template"].add_argument("--out", type=Path, metavar="FILE", help="a new file; printed if left out")
    commands["check"].add_argument("--out", type=Path, metavar="DIR", help="write check.json there, too")
    opened = commands["open"].add_argument
    opened("--out", type=Path, metavar="DIR", help="where the diagnosis goes; default: out/ and the name of FOLDER")
    opened("--port", type=int, default=0, metavar="N", help="of the page; a free one if left out")
    opened("--no-browser", dest="browser", action="store_false", help="print the address only")
    text = "end the search after so many seconds, with the best so far"
    commands["diagnose"].add_argument("--budget", type=_number, metavar="SECONDS", help=text)
    demo = commands["demo"]
    demo.add_argument(
        "--seed", type=_seed, metavar="N", help="which effect, how strong, what noise (drawn if left out)"
    )
    demo.add_argument("--out", type=Path, metavar="DIR", default=Path("out/demo"), help="default: %(default)s")
    add = commands["export"].add_argument
    add("--to", required=True, metavar="TARGET", help="c, fmu, python or matlab")
    add("--dt", type=_number, default=1e-4, metavar="S", help="sample time in seconds; default: %(default)s")
    add("--substeps", type=int, metavar="N", help="integration steps in a sample time; default: those of the model")
    add("--input", dest="hold", default="linear", metavar="HOLD", help="between samples: linear (default), zero_order")
    add("--name", default="", metavar="NAME", help="prefix of functions and files; default: that of the model")
    text = "a further port that is an input; may be repeated"
    add("--port", dest="ports", action="append", default=[], metavar="PORT", help=text)
    add("--no-sensor", dest="sensor", action="store_false", help="leave the sensor out: the output is what it senses")
    add("--initial-input", type=_number, default=0.0, metavar="U", help="begin at rest under it, where rest is stored")
    add = commands["invert"].add_argument
    add("reference", type=Path, metavar="FILE", help="time_s, displacement_um: what is to be followed")
    add("--smooth", type=_number, metavar="HZ", help="low-pass without phase for the reference: its corner")
    add("--slew", type=_number, metavar="V/s", help="largest rate of the voltage")
    add("--lead-in", type=_number, metavar="S", help="time for a start from rest, before the first sample")
    add("--tolerance", type=_number, metavar="M", help="error that counts as none, in the SI unit of the output")
    add("--limits", type=_number, nargs=2, metavar=("LOW", "HIGH"), help="lowest and highest voltage, V")
    text = "the voltage between its samples; zero_order for a converter"
    add("--hold", choices=("cubic", "zero_order"), help=text)
    add = commands["plot"].add_argument
    add("folder", type=Path, metavar="FOLDER", nargs="?", help="folder of recordings")
    add("--recording", metavar="NAME", action="append", help="draw this recording; may be repeated")
    add("--frequencies", type=_number, nargs=2, metavar=("LOW", "HIGH"), help="bode: lowest and highest [Hz]")
    add("--amplitude", type=_number, metavar="A", help="bode: amplitude of the input, SI")


def _number(text: str) -> float:
    """Return a number of the command line."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number: give it without a unit, such as 1e-4") from None


_DEBUG = "PHNN_DEBUG"
# Environment under which a process does its linear algebra in one thread, read when numerical libraries are loaded.
_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR", "NUMBA")
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in _LIBRARIES}


def _run(arguments: argparse.Namespace, settings: Sequence[str]) -> None:
    name = arguments.command
    # Settings are refused before torch and numba are loaded.
    config = compose(SETTINGS[name], settings) if name in SETTINGS else {}
    if name == TRAIN:
        config = compose_groups(TRAIN, settings)
    # Sums over several threads round otherwise, so that a result would depend on the number of cores; recordings are
    # simulated in threads already.
    for variable, count in ONE_THREAD.items():
        os.environ.setdefault(variable, count)
    command = getattr(import_module("phnn.commands"), name)
    offered = {**vars(arguments), "config": config, "options": vars(arguments)}
    command(**{key: offered[key] for key in inspect.signature(command).parameters if key in offered})


def _say(text: str) -> None:
    # Not before there is something to say: the help must come at once.
    from phnn.intake import LIMITS
    from phnn.results import message

    print(f"phnn: {message(text, LIMITS.message_characters)}", file=sys.stderr)


class _Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM): it ends as after Ctrl-C, so that workers and marks are in order."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


def _interrupt_again(ignored: sys.UnraisableHookArgs) -> None:
    """Repeat an interruption that fell into a callback of compiled code, which passes no exception on."""
    if isinstance(ignored.exc_value, KeyboardInterrupt):
        number = signal.SIGTERM if isinstance(ignored.exc_value, _Terminated) else signal.SIGINT
        threading.Timer(0.05, os.kill, (os.getpid(), number)).start()
    else:
        sys.__unraisablehook__(ignored)


def _prepare() -> None:
    """Signals end a command tidily, and a terminal that knows few letters gets question marks for the others."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, _terminate)
        sys.unraisablehook = _interrupt_again
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command, that of the process if no arguments are given; returns the exit status."""
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
