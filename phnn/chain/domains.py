"""The admissible values of the parameters of blocks and sources, in the order of each kind."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.domain import ANY, NONNEGATIVE, POSITIVE, Domain

DOMAINS: Mapping[str, tuple[Domain, ...]] = {
    "lowpass": (POSITIVE,),
    "second_order_lowpass": (POSITIVE, POSITIVE),
    "saturation": (POSITIVE,),
    "soft_saturation": (POSITIVE, POSITIVE),
    "bouc_wen": (POSITIVE, ANY, ANY, ANY),
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
    "clock": (ANY, POSITIVE),
    "drifting_gain": (ANY, ANY, POSITIVE),
    "tone": (ANY, ANY, NONNEGATIVE),
}
