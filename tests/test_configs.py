"""Every file under configs/ is used by what it is written for; one that no test knows how to use fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, asdict, fields
from functools import cache, partial
from pathlib import Path

import campaigns
import hydra
import numpy as np
import pytest
import torch
import yaml
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from scripts_example import script

from phnn import commands
from phnn.comparison import models as comparison
from phnn.configuration import compose, compose_groups, config_folder
from phnn.errors import InputRefused
from phnn.identification.plan import Options
from phnn.learn import Settings
from phnn.learn.objective import Objective
from phnn.learn.solvers import solver_for
from phnn.learn.starts import plant_for
from phnn.learn.trainer import METHODS
from phnn.modal.study import Settings as ModalSettings
from phnn.models.actuator import hrc
from phnn.models.network_file import load_network
from phnn.recordings.manifest import load_manifest
from phnn.recordings.recording import Campaign
from phnn.setup import Setup
from studies.proof.cases import STRATA, tasks
from studies.proof.cases import Settings as ProofSettings
from studies.recordings import Conditions
from studies.trainers import Case, Way

HOME = config_folder()
FILES = sorted(path.relative_to(HOME).as_posix() for path in HOME.rglob("*.y*ml"))


@cache
def campaign() -> Campaign:
    """Two short recordings of a gentle actuator."""
    true = Setup(hrc(1, campaigns.GENTLE))
    t = np.linspace(0.0, 0.02, 41)
    waves = {f: 75.0 * np.sin(2 * np.pi * f * t) for f in (50.0, 100.0)}
    found = tuple(campaigns.recorded(true, f"sine_{f:g}", t, u, 60e-9) for f, u in waves.items())
    return Campaign(found, {"model": "piezo_actuator", "hysterons": 1}, {}, "command", (), False, "made")


def trains(*overrides: str) -> None:
    """The plant and the solver of the settings march the recordings."""
    settings = Settings.from_config(compose_groups("train", ["folder=a", "out=b", *overrides]))
    plant = plant_for(settings.model, campaign(), settings.seed)
    objective = Objective(plant, solver_for(settings.solver, plant), campaign().recordings)
    with torch.no_grad():
        assert 0.0 < float(objective()) < np.inf


def command(name: str) -> None:
    if name == "train":
        trains("model.start=none")
        return
    given = compose(name)
    if name == "compare":
        settings = comparison.Settings.from_config(given)
        assert settings.options == Options.from_config(given)
        for recipe in settings.recipes.values():
            for stage in recipe.stages.values():
                Settings(folder="a", out="b", model=recipe.model, solver=recipe.solver, **stage)
        return
    if name == "prove":
        proof = ProofSettings.from_config(given)
        assert len(tasks(proof)) == sum(given[n] for n in (*STRATA, "fast_none", "fast_weak", "few"))
        return
    if name == "modes":
        assert asdict(ModalSettings.from_config(given)) == given
        return
    assert set(given) <= set(Options.__dataclass_fields__)
    assert {n: getattr(Options.from_config(given), n) for n in given} == given | {
        n: tuple(v) for n, v in given.items() if isinstance(v, list)
    }


def model(name: str) -> None:
    start = ["model.start=none"] if "hrc" in name else []
    # The black box has no structure that the power-preserving step could use.
    trains(f"model={name}", *start, *(["solver=torchdiffeq", "solver.method=rk4"] if name == "neural_ode" else []))


def solver(name: str) -> None:
    trains(f"solver={name}", "model=hrc", "model.hysterons=1", "model.start=none")


def network(name: str) -> None:
    """Every network of the folder is marched, compared between solvers and trained in tests/integrate and beside it."""
    assert load_network(HOME / "network" / f"{name}.yaml").ports


def experiment(name: str) -> None:
    alone = {"prove": [], "slice": [], "trainers": [], "studies": ["folder=recordings"]}
    with hydra.initialize_config_dir(str(HOME), version_base=None):
        config = hydra.compose(f"experiment/{name}", alone.get(name, ["folder=recordings", "out=out"]))
    if name in ("prove", "slice"):
        assert tasks(ProofSettings.from_config(config if name == "prove" else config.prove))
        assert name == "prove" or config.study in STUDIES
        return
    if name == "studies":
        assert set(config.studies) == set(STUDIES)
        for study_, some in config.studies.items():
            for verb, *further in (command.split() for command in some):
                assert callable(getattr(commands, verb))
                assert all("=" in w or f"recordings/{study_}/{w}.yaml" in FILES for w in further)
        return
    if name == "trainers":
        ways = {label: Way(**given) for label, given in config.ways.items()}
        used = {way for case in config.cases.values() for way in Case(**case).ways}
        assert used == set(ways)
        assert {way.method for way in ways.values()} <= set(METHODS)
        return
    groups = [config[key] for key in ("fit", "compare", "diagnose") if key in config]
    assert groups
    for group in groups:
        assert Options.from_config(group).starts >= 1
    if "recordings" in config:
        assert Conditions(**config.recordings).seed == 0


def launcher(name: str) -> None:
    with hydra.initialize_config_dir(str(HOME), version_base=None):
        config = GlobalHydra.instance().hydra.compose_config(
            config_name="train",
            overrides=[f"launcher={name}", "folder=recordings", "hydra.mode=MULTIRUN"],
            run_mode=RunMode.MULTIRUN,
            from_shell=False,
        )
        context = HydraContext(config_loader=GlobalHydra.instance().config_loader(), callbacks=None)  # type: ignore[arg-type]
        found = Plugins.instance().instantiate_launcher(context, lambda config: None, config)
        sweeper = Plugins.instance().instantiate_sweeper(
            config=config, hydra_context=context, task_function=lambda config: None
        )
    assert name in type(found).__module__
    assert sweeper.max_batch_size == config.hydra.sweeper.max_batch_size
    assert config.hydra.sweep.dir == "out/sweep"


def study(group: str, name: str) -> None:
    """A manifest names the network beside it, if any, and its recordings; a network builds."""
    path = HOME / group / f"{name}.yaml"
    if "recordings:" in path.read_text(encoding="utf-8").splitlines():
        manifest = load_manifest(path.parent, path)
        assert Path(manifest.setup.get("network", path)).parent == path.parent
        assert manifest.entries
    else:
        network_ = load_network(path)
        assert network_.output in network_.storage_names


STUDIES = ("emps", "piezo-stack", "silverbox", "steering-mirror")
# Folders with a manifest and no page in the documentation.
FOLDERS = ("bouc-wen", "mr-damper", "shaking-table", "tanks")
USES: dict[str, Callable[[str], None]] = {
    "": command, "model": model, "solver": solver, "network": network, "experiment": experiment, "launcher": launcher,
    **{f"recordings/{name}": partial(study, f"recordings/{name}") for name in (*STUDIES, *FOLDERS)},
}  # fmt: skip


@pytest.mark.parametrize("file", FILES)
def test_the_file_is_used(file: str) -> None:
    group, _, name = file.removesuffix(".yaml").rpartition("/")
    assert group in USES, f"configs/{file}: no test uses the files of {group}: add its consumer to USES"
    USES[group](name)


def test_no_group_is_empty() -> None:
    assert {file.rpartition("/")[0] for file in FILES} == set(USES)


OWNERS = {"identify": Options, "diagnose": Options, "modes": ModalSettings, "prove": ProofSettings, "train": Settings}


@pytest.mark.parametrize("command", OWNERS)
def test_files_repeat_the_defaults_of_the_dataclasses(command: str) -> None:
    owner = OWNERS[command]
    said = compose_groups(command, ["folder=a", "out=b"]) if command == "train" else compose(command)
    own = {f.name: f.default for f in fields(owner) if f.name in said and f.default is not MISSING}
    assert {n: tuple(v) if isinstance(v, list) else v for n, v in said.items() if n in own} == own


WRONG = {
    "diagnose": ("starts=0", "starts=-1", "starts=1.5", "starts=100000", "seed=-1", "max_effects=1.5"),
    "identify": ("workers=0", "error_bound_sigma=0"),
    "modes": ("iterations=0",), "prove": ("same=-1",), "train": ("patience=0",),
}  # fmt: skip


@pytest.mark.parametrize(("command", "wrong"), [(c, w) for c, some in WRONG.items() for w in some])
def test_the_command_line_and_python_refuse_the_same_values_with_the_same_words(command: str, wrong: str) -> None:
    name, _, value = wrong.partition("=")
    needed = {"folder": "a", "out": "b"} if command == "train" else {}
    with pytest.raises(InputRefused) as typed:
        given = [wrong, *(f"{n}={v}" for n, v in needed.items())]
        OWNERS[command].from_config((compose_groups if command == "train" else compose)(command, given))
    with pytest.raises(InputRefused) as called:
        OWNERS[command](**needed | {name: yaml.safe_load(value)})
    assert str(typed.value) == str(called.value)


def test_options_take_numbers_of_numpy_and_no_others() -> None:
    assert Options.from_config({"starts": np.int64(3)}).starts == 3
    for wrong in ({"starts": 2.9}, {"workers": True}):
        with pytest.raises(InputRefused, match="whole number"):
            Options.from_config(wrong)


@pytest.mark.parametrize(
    ("name", "settings", "needle"),
    [
        ("experiment", "recordings.effect=gravity", "gravity"), ("experiment", "recordings.noise_um=much", "noise_um"),
        ("experiment", "folder=nowhere", "nowhere"), ("experiment", "fit.starts=0", "starts"),
        ("compare", "folder=nowhere", "nowhere"), ("compare", "folder=null", "folder=DIR"),
        ("rivals", "sets=[gravity]", "gravity"), ("rivals", "noise_um=much", "noise_um"),
        ("rivals", "compare.starts=0", "starts"), ("rivals", "compare.models=[phs,transformer]", "transformer"),
        ("trainers", "only=[gravity]", "no case 'gravity'"),
        ("trainers", "only=[slow] cases.slow.ways=[magic]", "no trainer 'magic'"),
    ],
)  # fmt: skip
def test_what_does_not_exist_is_refused_in_one_line(
    name: str, settings: str, needle: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        script(name, f"out={tmp_path / 'out'}", *settings.split())
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert needle in error
    assert error.count("\n") == 1
