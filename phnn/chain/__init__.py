"""The measuring chain: blocks before and behind the network, and what acts on it beside the recorded input.

Blocks take complex parameters and signals, so that complex steps through them are their derivatives.
"""

from phnn.chain.amplifiers import AMPLIFIERS, MEMORYLESS
from phnn.chain.sensors import LINEAR, REMEMBERING, SENSORS, SOURCES

__all__ = ["AMPLIFIERS", "LINEAR", "MEMORYLESS", "REMEMBERING", "SENSORS", "SOURCES"]
