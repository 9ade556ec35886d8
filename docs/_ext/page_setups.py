"""What the code of a page finds when it is run: simulated recordings, stored models and names, by page.

A reader has recordings of his own in ``recordings/``; here `studies.generator` makes them and conceals a quadratic
drag in a simulated actuator.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from docstrings import examples

Names = dict[str, object]
ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
# Seed and effect of the simulated recordings.
SEED, EFFECT = 7, "quadratic_drag"


def recordings(folder: Path) -> Names:
    """Four recordings of an actuator with an effect that the base model lacks, in ``recordings/``."""
    sys.path.insert(0, str(ROOT))  # studies/ is not installed
    from studies.generator import generate

    generate(SEED, folder / "recordings", EFFECT, "short")
    return {}


def diagnosed(folder: Path) -> Names:
    """The same recordings, their diagnosis, and its results in ``out/mine``."""
    import phnn

    recordings(folder)
    diagnosis = phnn.diagnose(phnn.read(folder / "recordings"), phnn.Options(starts=1))
    diagnosis.write(folder / "out" / "mine")
    return {"diagnosis": diagnosis}


def guided_rig(folder: Path) -> Names:
    """Recordings of a stage whose guide brakes with the square of the displacement."""
    sys.path.insert(0, str(TESTS))
    from guided_rig import write_rig

    (folder / "recordings").mkdir()
    write_rig(folder / "recordings", power=2.0)
    return {}


def structure(folder: Path, recorded: str = "FOLDER", out: str = "out/steering-mirror") -> Names:
    """Periodic recordings of a structure with slow springs, and the models that ``phnn modes`` makes of them."""
    sys.path.insert(0, str(TESTS / "modal"))
    from structure import write_folder

    from phnn.cli import main

    (folder / recorded).mkdir()
    write_folder(folder / recorded, "slow", SEED)
    with contextlib.redirect_stdout(io.StringIO()):
        main(["modes", str(folder / recorded), "--out", str(folder / out)])
    return {}


def equilibrium(folder: Path) -> Names:
    """The network of Table 1 with a constant input, and charges inside its dead zones."""
    import torch

    import phnn

    network = phnn.models.from_paper()
    x = torch.tensor([1e-7, 2e-7, 1e-5, 0.0], dtype=torch.float64)
    u = torch.tensor([40.0, 0.0], dtype=torch.float64)
    charges = torch.tensor([1e-7, 1e-7], dtype=torch.float64)
    return {"network": network, "u": u, "x": x, "charges": charges, "system": phnn.PortHamiltonianSystem(network)}


def documented(folder: Path) -> Names:
    """All that the examples in docstrings refer to: recordings, results, a time axis with a voltage, a state."""
    import torch

    import phnn

    recordings(folder)
    structure(folder, "periodic", "out/modes")
    (folder / "other").symlink_to(folder / "recordings")
    campaign = phnn.read("recordings/")
    phnn.diagnose(campaign, phnn.Options(starts=1)).write("out")
    frame, other = (pd.read_csv(path) for path in sorted((folder / "recordings").glob("*.csv"))[:2])
    t = np.linspace(0.0, 0.1, 1001)
    zero = torch.zeros(4, dtype=torch.float64)
    return {
        "np": np, "torch": torch, "phnn": phnn, "campaign": campaign, "t": t,
        "voltage": 75.0 * np.sin(2.0 * np.pi * 20.0 * t), "frame": frame, "other": other, "x": zero, "u": zero[:2],
        "reference": 2e-5 * (1.0 - np.cos(2.0 * np.pi * 10.0 * t)),
    }  # fmt: skip


def reference(folder: Path) -> Names:
    """A stored model of the paper's actuator, a time axis, and a displacement that it is to follow."""
    import phnn

    phnn.Model(phnn.Setup(phnn.models.from_paper())).save(folder / "out" / "mine" / "model")
    t = np.linspace(0.0, 0.1, 1001)
    return {"t": t, "reference": 2e-5 * (1.0 - np.cos(2.0 * np.pi * 10.0 * t))}


_SETUPS: dict[str, Callable[[Path], Names]] = {
    "README": recordings,
    "cluster": recordings,
    "comparison": recordings,
    "diagnose": recordings,
    "what-phnn-can-say": recordings,
    "coming-from-matlab": recordings,
    "recording-an-actuator": recordings,
    "write-your-own-effect": guided_rig,
    "steering-mirror": structure,
    "feedforward": reference,
    "plots": diagnosed,
    "theory": equilibrium,
    "docstrings": documented,
}


def prepared(page: str, folder: Path) -> Names:
    """Fill the folder in which a page's code runs; returns names that the code may use."""
    return _SETUPS[page](folder) if page in _SETUPS else {}


def docstring_examples() -> Iterator[str]:
    """The examples in the docstrings of all public names and their public methods."""
    import phnn

    for name in phnn.__all__:
        found = getattr(phnn, name)
        members = (m for n, m in vars(found).items() if not n.startswith("_")) if inspect.isclass(found) else ()
        for thing in (found, *members):
            if not inspect.ismodule(thing):
                yield from examples(inspect.getdoc(thing) or "")
