"""Tools that answer the cases of a benchmark: phnn itself, and rivals.

A tool is a function from the folder of a case and a seed to an `Answer`. It sees the recordings and the inputs of the
examination, never the seal.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

from phnn.errors import InputRefused, meant
from studies.benchmark.answer import Answer

Tool = Callable[[Path, int], Answer]

# By name: the module in which its function ``answer`` stands, or the module and another function of it.
_MODULES = {
    "phnn": "diagnosis",
    "base": "nothing",
    "harmonics": "harmonics",
    "stepwise": "stepwise",
    "fingerprints": "fingerprints",
    "nearest": "nearest",
    "sindy": "sindy",
    "gp_force": "gp_force",
    "symbolic": "symbolic",
    "lisdd": "lisdd",
    "lfr": "lfr",
    "phnn_without_veto": "ablations:without_veto",
    "phnn_without_racing": "ablations:without_racing",
    "phnn_without_learned": "ablations:without_learned",
    "phnn_scores_only": "ablations:scores_only",
}
TOOLS = tuple(_MODULES)
# Tools that need the folder of a training.
TRAINED = ("fingerprints", "nearest")


def tool(name: str, training: Path | None = None) -> Tool:
    """The tool of a name.

    Args:
        training: the folder that ``phnn bench train`` has written, for the tools that need one.

    Raises:
        InputRefused: there is none, or it needs a training, or takes none.
    """
    if name not in _MODULES:
        raise InputRefused(f"tool: nothing is called {name!r}{meant(name, TOOLS)}: there are {', '.join(TOOLS)}")
    if (name in TRAINED) is (training is None):
        remedy = "give the folder that phnn bench train has written"
        raise InputRefused(
            f"tool {name} {f'needs --training: {remedy}' if training is None else 'takes no --training'}"
        )
    module, _, function = _MODULES[name].partition(":")
    found = getattr(import_module(f"studies.benchmark.tools.{module}"), function or "answer")
    known: Tool = found if training is None else partial(found, training=training)
    return known
