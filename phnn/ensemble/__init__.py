"""Many pieces of work at once: in threads, in processes or on a cluster, with the same results.

`phnn.ensemble.many` simulates; it is not loaded here, so that worker processes start quickly.
"""

from phnn.ensemble.executor import executor
from phnn.ensemble.local import SERIAL, Executor

__all__ = ["SERIAL", "Executor", "executor"]
