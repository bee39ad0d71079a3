"""JAX's settings, to be made before JAX is imported: one core, and the same numbers in every run on a machine."""

from __future__ import annotations

import os

_FLAG = "--xla_cpu_multi_thread_eigen=false"


def configure() -> None:
    """Sets the environment; values that are there already stay in force.

    NPROC sizes XLA's thread pool; the flag alone leaves it at all cores. One thread: the arm has the other core, and
    sums keep their order.
    """
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("NPROC", "1")
    flags = os.environ.get("XLA_FLAGS", "").split()
    os.environ["XLA_FLAGS"] = " ".join(flags if _FLAG in flags else [*flags, _FLAG])
