"""Folders of recordings: read, checked, in SI units, with a noise floor and a use for every sample.

Whatever cannot be read or understood is refused with `phnn.errors.InputRefused`: one message that names file, column,
row, value, cause and remedy.
"""

from phnn.recordings.reader import campaign_of, describe, read
from phnn.recordings.recording import Anchor, Campaign, Part, Recording, Start

__all__ = ["Anchor", "Campaign", "Part", "Recording", "Start", "campaign_of", "describe", "read"]
