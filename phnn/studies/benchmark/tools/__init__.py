"""Tools that answer the cases of a benchmark: phnn itself, and rivals.

A tool is a function from the folder of a case and a seed to an `Answer`. It sees the recordings and the inputs of the
examination, never the seal.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from phnn.errors import InputRefused, meant
from phnn.studies.benchmark.answer import Answer

Tool = Callable[[Path, int], Answer]

# By name: the module in which its function ``answer`` stands.
_MODULES = {
    "phnn": "diagnosis",
    "base": "nothing",
    "harmonics": "harmonics",
    "stepwise": "stepwise",
    "lisdd": "lisdd",
    "lfr": "lfr",
    "aphynity": "aphynity",
}
TOOLS = tuple(_MODULES)


def tool(name: str) -> Tool:
    """The tool of a name.

    Raises:
        InputRefused: there is none.
    """
    if name not in _MODULES:
        raise InputRefused(f"tool: nothing is called {name!r}{meant(name, TOOLS)}: there are {', '.join(TOOLS)}")
    found: Tool = import_module(f"phnn.studies.benchmark.tools.{_MODULES[name]}").answer
    return found
