"""One thread at a time: what every door to the kernels takes before it touches Dr.Jit.

Dr.Jit 1.5.0 has one queue of kernels for all Python threads, and ``dr.freeze`` takes what another
thread does meanwhile for its own: two threads that record or replay at once abort the process, or
wait for each other for ever. So a pass from its first array to its last holds :data:`exclusive`,
forward, adjoint and tangent alike. The kernels use all cores by themselves: nothing is lost.

It covers this library. A program that also runs Dr.Jit or Mitsuba itself, in another thread than
the one that renders, holds the same lock there, or may wait for ever::

    with exclusive:
        image = mi.render(scene)

A process forked from one that had imported Dr.Jit is without its threads, and would wait for them
for ever. A ``DataLoader``'s workers may be forked, as long as they do not render.
"""

from __future__ import annotations

import os
import threading
from contextlib import ContextDecorator


class Exclusive(ContextDecorator):
    """A lock that the thread which has it may take again; a context, and a decorator."""

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
