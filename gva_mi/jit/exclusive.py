"""The lock that every entry point takes before it uses Dr.Jit: one thread at a time.

``dr.freeze`` of Dr.Jit 1.5.0 is not made for threads: two that record or replay at once end the
process (``jit_var(r14): unknown variable!``). So every pass, forward, adjoint or tangent, holds
:data:`exclusive` from its first array to its last. Nothing is lost, because the kernels use all
cores themselves. (frozen.py says what another thread must not do even outside of a pass.)

Threads enter in the order in which they came, so that a viewer that draws all the time leaves a
training beside it every other turn. Python's own locks let the thread that just left in again.

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
from collections import deque
from contextlib import ContextDecorator

# Seconds after which a waiting thread looks for a Ctrl-C: Python does not notice one that comes
# just before a lock starts to wait.
SIGNALS_EVERY = 0.5


class Exclusive(ContextDecorator):
    """A reentrant lock, first come, first served, as a context manager and as a decorator."""

    def __init__(self) -> None:
        self._guard = threading.Lock()  # of the queue
        self._queue: deque[threading.Lock] = deque()  # the turn of the thread inside, then others'
        self._inside: int | None = None  # the thread
        self._depth = 0  # how often it entered
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
        if self._inside == threading.get_ident():
            self._depth += 1
            return
        turn = threading.Lock()
        try:
            with self._guard:
                if self._queue:
                    turn.acquire()  # the thread before releases it
                self._queue.append(turn)
            while not turn.acquire(timeout=SIGNALS_EVERY):
                pass
            self._inside, self._depth = threading.get_ident(), 1
        except BaseException:  # Ctrl-C while waiting
            self._leave(turn)
            raise

    def __exit__(self, *_: object) -> None:
        if self._depth > 1:
            self._depth -= 1
            return
        self._inside = None
        self._leave(self._queue[0])

    def _leave(self, turn: threading.Lock) -> None:
        """Leave the queue, and let the next thread in if this one was the first."""
        with self._guard:
            first = bool(self._queue) and self._queue[0] is turn
            if turn in self._queue:
                self._queue.remove(turn)
            if first and self._queue:
                self._queue[0].release()

    def _note_fork(self) -> None:
        self._forked = True


exclusive = Exclusive()
