"""A sweep of training runs: ``python scripts/train.py -m launcher=joblib seed=0,1,2 ...``.

Hydra's launchers start the runs. Each has its own folder, named by its overrides, below ``out``; so the same command
again finds what is done, continues what is not, and ends with the table of all runs. A run that fails leaves the
reason in its folder and stops no other.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from filelock import FileLock
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from phnn.errors import InputRefused, PhnnError
from phnn.parallel import end_with
from phnn.report.formatting import ratio
from phnn.results import Place

# Why a run has failed, in its folder: the first line for the table, a traceback below it where there is one.
ERROR = "error.txt"
# The process of a sweep, for those it starts.
_PARENT = "PHNN_SWEEP"
_LOCK = ".lock"
_PLACES = ("folder", "manifest", "base")


class Sweep(Callback):
    """What is done before the first run, where the sweep was started."""

    running: ClassVar[Path | None] = None  # the folder of the sweep at work

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Refuse what the runs could not share."""
        # Hydra turns errors in here into warnings: only an exit ends the sweep.
        try:
            _check(config)
        except InputRefused as error:
            print(f"train: {error}", file=sys.stderr)
            sys.exit(error.exit_status)
        Sweep.running = Path(config.hydra.sweep.dir)
        os.environ[_PARENT] = str(os.getpid())


@contextmanager
def concluded(tell: Callable[[Path], bool]) -> Iterator[None]:
    """End a sweep that was started inside with its table, whatever became of it; status 1 where a run failed. ``tell``
    prints the table of the runs in a folder, and returns whether one has failed."""
    try:
        yield
    except KeyboardInterrupt:
        print("train: interrupted; the same command continues", file=sys.stderr)
        sys.exit(130)
    finally:
        folder, Sweep.running = Sweep.running, None
        try:
            failed = folder is not None and tell(folder)
        except PhnnError as error:
            print(f"train: {error}", file=sys.stderr)
            failed = True
    if failed:
        sys.exit(1)


def is_sweep() -> bool:
    """Return whether the present job is one of a sweep."""
    return HydraConfig.get().mode == RunMode.MULTIRUN


def run(config: DictConfig) -> None:
    """One run of a sweep, in the folder that hydra has made for it."""
    if os.environ.get(_PARENT) == str(os.getppid()):
        # A worker of the sweep's own; jobs of a queue live on without it.
        end_with(os.getppid())
    runtime = HydraConfig.get().runtime
    home = Path(runtime.output_dir)
    settings = {str(key): value for key, value in OmegaConf.to_container(config, resolve=True).items()}  # type: ignore[union-attr]
    # The process may have been started elsewhere.
    places = {key: str(Path(runtime.cwd, settings[key])) for key in _PLACES if settings.get(key) is not None}
    # Jobs of a sweep that was killed may live on, and end what the same command has begun again.
    with FileLock(home / _LOCK):
        _train(settings | places | {"out": str(home)}, home)


def _train(settings: Mapping[str, Any], home: Path) -> None:
    """Train; what goes wrong is written into the run's folder."""
    from phnn.learn import Settings, train_folder

    failure = Place(home.resolve()) / ERROR
    failure.remove()
    try:
        content = train_folder(Settings.from_config(settings))
    except Exception as error:
        known = isinstance(error, PhnnError)
        failure.write((str(error) if known else f"{error!r}\n{traceback.format_exc()}").encode())
        print(f"{home.name}: failed: {error if known else repr(error)}", file=sys.stderr, flush=True)
        return
    print(f"{home.name}: held-out residual {ratio(content['held_out_over_noise'])} × noise", flush=True)


def _check(config: DictConfig) -> None:
    """Refuse sweeps without recordings, or over what is no part of a run's name."""
    unnamed = config.hydra.job.config.override_dirname.exclude_keys
    for override in OverridesParser.create().parse_overrides(list(config.hydra.overrides.task)):
        if override.is_sweep_override() and (key := override.key_or_group) in unnamed:
            raise InputRefused(
                f"{override.input_line}: runs are not named by {key}: make one sweep for each value, with its own out"
            )
    if OmegaConf.is_missing(config, "folder"):
        raise InputRefused("setting folder is missing: write folder=...")
