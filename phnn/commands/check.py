"""``phnn check``."""

from __future__ import annotations

from pathlib import Path

from phnn.check import check as check_recordings
from phnn.identification.prepare import is_ready, prepare
from phnn.recordings import read
from phnn.results import claim, printable


def check(
    folder: Path, manifest: Path | None, out: Path | None = None, outside: bool = False, overwrite: bool = False
) -> None:
    """Print what was understood of a folder of recordings, what was noticed, and what they can show.

    Raises:
        InputRefused: what `identify` would refuse, with the same message. Several inputs or outputs without a network
            are for `modes` and pass.
    """
    campaign = read(folder, manifest, allow_outside=outside)
    described = "network" in campaign.setup or is_ready(campaign)
    if described or not any(r.further or r.measures for r in campaign.recordings):
        prepare(campaign)
    checked = check_recordings(campaign)
    print(printable(checked.text(), lines=True))
    if out is not None:
        # Imported here: figures take longer to import than the check takes.
        from phnn.report.pages import write_check

        with claim(out, "check", [folder], ("check.json", "check.html"), overwrite=overwrite) as place:
            write_check(checked, place)
