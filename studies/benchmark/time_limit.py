"""A limit to the processor time of one case."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from phnn.errors import InputRefused, SolverFailed

_AGAIN = 1.0  # processor seconds


class _OutOfTime(BaseException):
    """Passes every handler that goes on after an error."""


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Give up what is inside after so many seconds of this process's processor time; None sets no limit.

    Compiled code is interrupted when it returns.

    Raises:
        SolverFailed: the time is over.
        InputRefused: this is a thread, or a system without such a clock (``setitimer``).
    """
    if seconds is None:
        yield
        return
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        raise InputRefused(f"limit {seconds:g} s: needs processes of their own on Linux or macOS: --executor processes")
    before = signal.signal(signal.SIGPROF, _raise)
    # An exception is lost where Python cannot pass it on, in a destructor for one: it comes again.
    signal.setitimer(signal.ITIMER_PROF, seconds, _AGAIN)
    try:
        yield
    except _OutOfTime:
        raise SolverFailed(f"stopped after {seconds:g} processor seconds, the limit of a case") from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _raise(signum: int, frame: FrameType | None) -> None:
    raise _OutOfTime
