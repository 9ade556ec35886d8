"""The progress of a run on disk, so that others can watch it: ``progress.json`` beside the results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime

from phnn.errors import InputRefused, PhnnError
from phnn.output.place import Place

PROGRESS = "progress.json"
_SCHEMA = "phnn.progress/1"
# Steps that are kept, the last ones: a diagnosis has some twenty.
_KEPT = 200


@contextmanager
def watched(place: Place, command: str, tell: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Pass on every line of progress, and write it to ``progress.json`` with its time.

    The file goes when the run has come to its end, and where its input was refused. After a failure, or a kill, it says
    where the run stopped. A disk that is full stops no run here: its results will say so.

    Args:
        place: the claimed folder; tell: where the lines go besides.
    """
    began, steps = _now(), []

    def progress(text: str) -> None:
        tell(text)
        steps.append({"at": _now(), "text": text})
        content = {"schema": _SCHEMA, "command": command, "began": began, "steps": steps[-_KEPT:]}
        with suppress(PhnnError):
            (place / PROGRESS).write_json(content)

    try:
        yield progress
    except InputRefused:
        (place / PROGRESS).remove()
        raise
    (place / PROGRESS).remove()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
