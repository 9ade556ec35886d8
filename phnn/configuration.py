"""Settings of a command: ``configs/<command>.yaml`` with the user's ``key=value`` overrides.

A dataclass of settings declares its numbers with their bounds, which are refused alike wherever they come from:

    @dataclass(frozen=True)
    class Options:
        starts: int = whole(4, least=1)
        error_bound_sigma: float = positive(1.0)

        def __post_init__(self) -> None:
            check(self)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field, fields
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused, meant
from phnn.intake import LIMITS
from phnn.results import message

_LEAST = "least"
_FORMER_CRITERIA = ("material", "material_share")


def whole(default: int, least: int = 0) -> Any:
    """Return a setting that is a whole number, ``least`` or more; at most what `phnn.intake` accepts."""
    return field(default=default, metadata={_LEAST: least})


def positive(default: float) -> Any:
    """Return a setting that is a positive number."""
    return field(default=default, metadata={_LEAST: 0.0})


def check(settings: Any) -> None:
    """Refuse a dataclass of settings with a value of the wrong kind or out of range; InputRefused names it."""
    for f in fields(settings):
        if _LEAST in f.metadata:
            number(f.name, getattr(settings, f.name), f.metadata[_LEAST])


def number(name: str, value: Any, least: float) -> float:
    """Return the value of a setting, as a float where ``least`` is one. Raises InputRefused where it has the wrong kind
    or is out of range."""
    if isinstance(least, float):
        if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
            raise InputRefused(f"setting {name}={value} must be a positive number")
        return float(value)
    most = LIMITS.most(name.rpartition(".")[2])
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InputRefused(f"setting {name}={value} must be a whole number, {least} or more")
    if value > most:
        raise InputRefused(f"setting {name} must be a whole number, {most} or less")
    return int(value)


@cache
def config_folder() -> Path:
    """Return where the yaml files lie: inside an installed package, beside ``phnn/`` in a source tree."""
    package = Path(__file__).resolve().parent
    for candidate in (package / "configs", package.parent / "configs"):
        if candidate.is_dir():
            return candidate
    raise InputRefused(f"no configs folder in {package} or beside it: install phnn again")


def compose(command: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the settings of a command.

    Args:
        command: name of the yaml file.
        overrides: ``key=value``, the value in yaml; ``key.inner=value`` for one of several settings together.

    Raises:
        InputRefused: an override without ``=``, an unknown key, a value of the wrong kind or out of range; whole
            numbers are for the dataclass of the command to check.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    content: Any = OmegaConf.load(config_folder() / f"{command}.yaml")
    OmegaConf.set_struct(content, True)
    if "criteria" in content:
        # Criteria stand in no file, for their class owns the defaults; two of them had names of their own before.
        OmegaConf.set_struct(content.criteria, False)
        overrides = [f"criteria.{o}" if o.partition("=")[0] in _FORMER_CRITERIA else o for o in overrides]
    accepted = ", ".join(map(str, content))
    for override in overrides:
        key, equals, _ = override.partition("=")
        if not equals:
            raise InputRefused(f"{override!r} is no setting: write key=value with a key out of {accepted}")
        if key.partition(".")[0] not in content:
            hint = meant(key, map(str, content))
            raise InputRefused(f"unknown setting {key!r} in {override!r}{hint}: phnn {command} accepts {accepted}")
    try:
        chosen = OmegaConf.merge(content, OmegaConf.from_dotlist(list(overrides)))
        given: Any = OmegaConf.to_container(chosen, resolve=True, throw_on_missing=True)
    # Python refuses to convert thousands of digits.
    except (OmegaConfBaseException, YAMLError, ValueError) as error:
        raise _refused(overrides, error, "write key=value") from error
    return checked(command, {str(key): value for key, value in given.items()})


def _refused(overrides: Sequence[str], error: Exception, remedy: str) -> InputRefused:
    """Return the refusal of overrides that no settings come from, for the reason that a library gives."""
    reason = str(error).strip().splitlines()[0]
    shown = message(" ".join(overrides), LIMITS.name_characters)
    return InputRefused(f"settings {shown} cannot be used ({reason}): {remedy}")


def checked(command: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that were composed elsewhere, held against the defaults of a command. Raises InputRefused for
    a value of the wrong kind or out of range."""
    from omegaconf import OmegaConf

    defaults = dict(OmegaConf.load(config_folder() / f"{command}.yaml"))
    return {key: _checked(key, value, defaults[key]) for key, value in given.items()}


def compose_groups(command: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Return the settings of a command whose file chooses others by a defaults list; their values are for it to check.

    The override ``configs=DIR`` adds a folder of the user's own, in whose ``model/`` and ``solver/`` files are sought.

    Raises:
        InputRefused: an override that hydra cannot apply: an unknown key, file or grammar, or a value that is missing.
    """
    # A third of a second: not before it is needed.
    import hydra
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    folders = [o.partition("=")[2] for o in overrides if o.startswith("configs=")]
    for folder in folders:
        if not Path(folder).is_dir():
            raise InputRefused(f"configs={folder}: there is no such folder: give one with model/NAME.yaml")
    search = [f"hydra.searchpath=[{', '.join(f'file://{Path(f).resolve()}' for f in folders)}]"] if folders else []
    others = [*search, *(o for o in overrides if not o.startswith("configs="))]
    try:
        with hydra.initialize_config_dir(str(config_folder()), version_base=None, job_name=f"phnn_{command}"):
            given: Any = OmegaConf.to_container(hydra.compose(command, others), resolve=True, throw_on_missing=True)
    # Python refuses to convert thousands of digits.
    except (OmegaConfBaseException, HydraException, ValueError, OverflowError) as error:
        raise _refused(others, error, f"see phnn {command} --help") from error
    return {str(key): value for key, value in given.items()}


def _checked(key: str, value: Any, default: Any) -> Any:
    """Return the value, as a float where the default is one; refused as in `checked`."""
    if key == "criteria":
        from phnn.criteria import Criteria

        if not isinstance(value, Mapping):
            raise InputRefused(f"setting {key}={value} must name criteria: write criteria.NAME=value")
        return Criteria().with_values(value).changed()
    if isinstance(default, Mapping) and isinstance(value, Mapping):
        return {str(k): _checked(f"{key}.{k}", v, default[k]) for k, v in value.items()}
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise InputRefused(f"setting {key}={value} must be true or false")
        return value
    if isinstance(default, int) and "." not in key:
        # The dataclass of the command knows how small it may be.
        return value
    if isinstance(default, int | float):
        return number(key, value, 0.0 if isinstance(default, float) else 0)
    return value
