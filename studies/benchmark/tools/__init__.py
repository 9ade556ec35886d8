"""Tools that answer the cases of a benchmark: phnn itself, and rivals.

A tool is a function from the folder of a case and a seed to an `Answer`. It sees the recordings and the inputs of the
examination, never the seal.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from phnn.errors import InputRefused, meant

if TYPE_CHECKING:
    from studies.benchmark.bench import Answer

Tool = Callable[[Path, int], "Answer"]

# By name: the module in which the tool stands, and its function.
_FUNCTIONS = {
    "phnn": "diagnosis:answer",
    "base": "diagnosis:nothing",
    "sindy": "selection:sindy",
    "lisdd": "lisdd:answer",
    "lfr": "lfr:answer",
    "phnn_without_veto": "diagnosis:without_veto",
    "phnn_without_racing": "diagnosis:without_racing",
    "phnn_without_learned": "diagnosis:without_learned",
    "phnn_scores_only": "diagnosis:scores_only",
}
TOOLS = tuple(_FUNCTIONS)


def tool(name: str) -> Tool:
    """Return the tool of a name. Raises InputRefused where there is none."""
    if name not in _FUNCTIONS:
        raise InputRefused(f"tool: nothing is called {name!r}{meant(name, TOOLS)}: there are {', '.join(TOOLS)}")
    module, _, function = _FUNCTIONS[name].partition(":")
    loaded: Tool = getattr(import_module(f"studies.benchmark.tools.{module}"), function)
    return loaded
