"""The lock that every entry point takes before it uses Dr.Jit: one thread at a time.

``dr.freeze`` of Dr.Jit 1.5.0 is not made for threads: two that record or replay at once end the
process (``jit_var(r14): unknown variable!``). So every pass, forward, adjoint or tangent, holds
:data:`exclusive` from its first array to its last. Nothing is lost, because the kernels use all
cores themselves. (frozen.py says what another thread must not do even outside of a pass.)

The lock covers this library. A program that freezes functions of its own, or runs Dr.Jit's autodiff
or Mitsuba in another thread than the one that renders, holds it there too::

    with exclusive:
        image = mi.render(scene)

A process forked from one that had imported Dr.Jit lacks Dr.Jit's threads and would wait for them
forever. A ``DataLoader``'s workers may be forked as long as they do not render.
"""

from __future__ import annotations

import os
import threading
from contextlib import ContextDecorator


class Exclusive(ContextDecorator):
    """A reentrant lock, as a context manager and as a decorator."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._forked = False
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._note_fork)

    def __enter__(self) -> None:
        if self._forked:
            raise RuntimeError(
                "render(): this process was forked from one that had imported Dr.Jit, whose "
                "threads stayed there: render in that one, or start workers with "
                "multiprocessing's 'spawn'"
            )
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def _note_fork(self) -> None:
        self._forked = True


exclusive = Exclusive()
