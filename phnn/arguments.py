"""The arguments of the console command ``phnn``, one command after the other; nothing heavy is imported here."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

from phnn.configuration import config_folder
from phnn.errors import meant

# Commands with settings, and the file under configs/ that holds them.
SETTINGS = {n: n for n in ("identify", "diagnose", "compare", "modes", "prove", "bench")} | {"demo": "diagnose"}
# The command whose settings are composed from groups of files.
TRAIN = "train"

_COMMANDS = {
    "check": "say what is understood of a folder of recordings",
    "template": "write a first recordings.yaml for a folder of unknown layout",
    "identify": "fit the base model",
    "diagnose": "find out what the base model leaves out",
    "predict": "simulate recordings with a model that was written earlier",
    "invert": "find the voltage with which a model's displacement follows a reference",
    "export": "write a model as a program: C, FMU, Python or MATLAB",
    "plot": "draw a model or a diagnosis as a figure, with its data as a table",
    "compare": "fit several kinds of model and compare them",
    "modes": "find the modes of a structure, and what moves them with amplitude",
    TRAIN: "train a neural or parametric model: phnn train folder=DIR out=DIR ...",
    "demo": "conceal an effect in simulated recordings, seal it, diagnose it",
    "prove": "conceal many effects, seal them, diagnose them all, and count",
    "bench": "make sealed cases for any tool, let a tool answer them, score answers",
}
# Kinds of plots, as functions of phnn.plot.
_PLOTS = ("compare", "residuals", "loops", "bode", "location", "energy")
# Which commands take which of the common arguments.
_FOLDER = ("check", "template", "identify", "diagnose", "predict", "compare", "modes")
_MODEL = ("predict", "invert", "export", "plot")
_MANIFEST = ("check", "identify", "diagnose", "predict", "compare", "modes", "plot")
_OUT = ("identify", "diagnose", "predict", "invert", "export", "plot", "compare", "modes", "prove", "bench")
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
        """As argparse; remembers the words for `error`."""
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
    """Parse a command line.

    Args:
        argv: arguments after the program's name; those of the process if None.

    Returns:
        The arguments, ``command`` among them, and the settings ``key=value``, which may stand anywhere.
    """
    parser, commands = _parser()
    # Settings may stand before, between and after the options, which argparse's own lists do not allow.
    arguments, settings = parser.parse_known_args(argv)
    # As it was typed, for the report of a run.
    arguments.typed = tuple(sys.argv[1:] if argv is None else argv)
    strangers = [s for s in settings if s.startswith("-") or arguments.command not in (*SETTINGS, TRAIN)]
    if strangers:
        commands[arguments.command].error(
            f"phnn {arguments.command} does not know {' '.join(strangers)}{_dashes(arguments.command, strangers)}"
        )
    return arguments, settings


def _dashes(command: str, strangers: Sequence[str]) -> str:
    """Says how settings are written, where one has the dashes of an option."""
    named = any(s.startswith("-") and "=" in s for s in strangers)
    return "; settings have no dashes, such as seed=1" if named and command in SETTINGS else ""


@cache
def _parser() -> tuple[_Parser, dict[str, argparse.ArgumentParser]]:
    """The parser, and that of each command by name."""
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
    """What ``phnn train`` accepts: its own file, and the choices of the groups in it."""
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
    text = "end the search after so many seconds, with the best so far"
    commands["diagnose"].add_argument("--budget", type=_number, metavar="SECONDS", help=text)
    demo = commands["demo"]
    demo.add_argument(
        "--seed", type=_seed, metavar="N", help="which effect, how strong, what noise (drawn if left out)"
    )
    demo.add_argument("--out", type=Path, metavar="DIR", default=Path("out/demo"), help="default: %(default)s")
    _add_export(commands["export"])
    _add_invert(commands["invert"])
    _add_plot(commands["plot"])
    _add_bench(commands["bench"])


def _number(text: str) -> float:
    """A number of the command line."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number: give it without a unit, such as 1e-4") from None


def _add_export(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("--to", required=True, metavar="TARGET", help="c, fmu, python or matlab")
    add("--dt", type=_number, default=1e-4, metavar="S", help="sample time in seconds; default: %(default)s")
    add("--substeps", type=int, metavar="N", help="integration steps in a sample time; default: those of the model")
    add("--input", dest="hold", default="linear", metavar="HOLD", help="between samples: linear (default), zero_order")
    add("--name", default="", metavar="NAME", help="prefix of functions and files; default: that of the model")
    text = "a further port that is an input; may be repeated"
    add("--port", dest="ports", action="append", default=[], metavar="PORT", help=text)
    add("--no-sensor", dest="sensor", action="store_false", help="leave the sensor out: the output is what it senses")
    add("--initial-input", type=_number, default=0.0, metavar="U", help="begin at rest under it, where rest is stored")


def _add_invert(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("reference", type=Path, metavar="FILE", help="time_s, displacement_um: what is to be followed")
    add("--smooth", type=_number, metavar="HZ", help="low-pass without phase for the reference: its corner")
    add("--slew", type=_number, metavar="V/s", help="largest rate of the voltage")
    add("--lead-in", type=_number, metavar="S", help="time for a start from rest, before the first sample")
    add("--tolerance", type=_number, metavar="M", help="error that counts as none, in the SI unit of the output")
    add("--limits", type=_number, nargs=2, metavar=("LOW", "HIGH"), help="lowest and highest voltage, V")
    text = "the voltage between its samples; zero_order for a converter"
    add("--hold", choices=("cubic", "zero_order"), help=text)


def _add_bench(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("step", choices=("write", "train", "answer", "score"), metavar="STEP", help="write, train, answer or score")
    add("--cases", type=Path, metavar="DIR", help="answer, score: the folder that write has written")
    add("--tool", metavar="NAME", help="answer: the name of a tool; docs/bench.md lists them")
    text = "answer: the folder that train has written, for fingerprints and nearest"
    add("--training", type=Path, metavar="DIR", help=text)
    add("--answers", type=Path, metavar="DIR", action="append", help="score: answers of a tool; may be repeated")
    add("--first", type=int, metavar="N", help="answer, score: the first N cases alone; their order is drawn")
    add("--limit", type=_number, metavar="S", help="answer: processor seconds of a case, then it has no answer")
    add(
        "--executor",
        default="processes",
        metavar="WHERE",
        help="write, train, answer: see phnn diagnose; default: %(default)s",
    )


def _add_plot(command: argparse.ArgumentParser) -> None:
    add = command.add_argument
    add("folder", type=Path, metavar="FOLDER", nargs="?", help="folder of recordings")
    add("--recording", metavar="NAME", action="append", help="draw this recording; may be repeated")
    add("--frequencies", type=_number, nargs=2, metavar=("LOW", "HIGH"), help="bode: lowest and highest [Hz]")
    add("--amplitude", type=_number, metavar="A", help="bode: amplitude of the input, SI")
