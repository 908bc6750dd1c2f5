"""The lock of Dr.Jit: threads take turns in the order in which they came."""

import _thread
import signal
import threading
import time

import pytest

from gva_mi.jit.frozen import Exclusive


def until(condition):
    """Wait for another thread; the test's result does not depend on how long."""
    for _ in range(10_000):
        if condition():
            return
        time.sleep(0.001)
    raise AssertionError("the other thread never came")


def test_a_thread_that_comes_back_at_once_stands_behind_those_that_wait():
    lock, order = Exclusive(), []

    def enter(name, times):
        for _ in range(times):
            with lock:
                order.append(name)
                until(lambda: len(lock._queue) == min(4, 12 - len(order) + 1))

    threads = [threading.Thread(target=enter, args=(name, 3)) for name in "abcd"]
    with lock:
        for count, thread in enumerate(threads, 2):
            thread.start()
            until(lambda count=count: len(lock._queue) == count)
    for thread in threads:
        thread.join()
    assert "".join(order) == "abcd" * 3


def test_a_thread_enters_again_inside_and_errors_leave():
    lock = Exclusive()

    @lock
    def again(depth):
        if depth:
            again(depth - 1)
        else:
            raise KeyError

    with pytest.raises(KeyError), lock:
        again(3)
    assert lock._inside is None and not lock._queue
    entered = threading.Thread(target=lambda: lock.__enter__())
    entered.start()
    entered.join(10)
    assert not entered.is_alive()


def to_main_thread():
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)


@pytest.mark.parametrize("ctrl_c", [to_main_thread, _thread.interrupt_main])
def test_ctrl_c_while_waiting_gives_the_turn_up(ctrl_c):
    """The second sets Python's flag and wakes nobody: as a signal just before the wait does."""
    lock, inside, leave, after = Exclusive(), threading.Event(), threading.Event(), []

    def hold():
        with lock:
            inside.set()
            leave.wait()

    def behind():
        until(lambda: len(lock._queue) == 2)
        with lock:
            after.append("in")

    def interrupt():
        until(lambda: len(lock._queue) == 3)
        ctrl_c()

    threads = [threading.Thread(target=target) for target in (hold, behind, interrupt)]
    threads[0].start()
    inside.wait()
    for thread in threads[1:]:
        thread.start()
    with pytest.raises(KeyboardInterrupt), lock:
        pass
    assert not after
    leave.set()
    for thread in threads:
        thread.join(10)
    assert after == ["in"] and not lock._queue
