"""The measuring chain: blocks before and behind the network, and what acts on it beside the recorded input.

Blocks take complex parameters and signals, so that complex steps through them are their derivatives.
"""

from phnn.chain import sensors  # noqa: F401  each block registers itself
from phnn.chain.amplifiers import AMPLIFIERS, SENSORS, SOURCES, BlockKind

__all__ = ["AMPLIFIERS", "SENSORS", "SOURCES", "BlockKind"]
