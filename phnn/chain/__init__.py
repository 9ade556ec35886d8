"""The measuring chain: blocks before and behind the network, and what acts on it beside the recorded input.

Blocks take complex parameters and signals, so that complex steps through them are their derivatives.
"""

from collections.abc import Mapping

from phnn.chain.amplifiers import AMPLIFIERS, MEMORYLESS
from phnn.chain.sensors import LINEAR, REMEMBERING, SENSORS, SOURCES
from phnn.parameters import ANY, NONNEGATIVE, POSITIVE, Domain

__all__ = ["AMPLIFIERS", "DOMAINS", "LINEAR", "MEMORYLESS", "REMEMBERING", "SENSORS", "SOURCES"]

DOMAINS: Mapping[str, tuple[Domain, ...]] = {
    "lowpass": (POSITIVE,),
    "second_order_lowpass": (POSITIVE, POSITIVE),
    "fading": (ANY, POSITIVE),
    "saturation": (POSITIVE,),
    "soft_saturation": (POSITIVE, POSITIVE),
    "bouc_wen": (POSITIVE, ANY, ANY, ANY),
    "slipping": (ANY, POSITIVE, POSITIVE, NONNEGATIVE, ANY),
    "delay": (NONNEGATIVE,),
    "slew_limit": (POSITIVE,),
    "offset": (ANY,),
    "drift": (ANY,),
    "lag": (POSITIVE,),
    "polynomial": (ANY, ANY),
    "rectification": (),
    "rate": (),
    "zero": (ANY,),
    "gain": (POSITIVE,),
    "play": (NONNEGATIVE,),
    "knee": (ANY, ANY),
    "dead_band": (ANY, NONNEGATIVE),
    "cubic": (ANY, ANY, POSITIVE),
    "wave": (ANY, ANY, POSITIVE),
    "clock": (ANY, POSITIVE),
    "drifting_gain": (ANY, ANY, ANY, POSITIVE),
    "tone": (ANY, ANY, NONNEGATIVE),
}
"""Admissible values of the parameters of every kind of block and source, in the order of its function."""
