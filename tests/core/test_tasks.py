"""Tasks run in order, here or in workers, which end with their parent, however that ends."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from gva_mi import InputError
from gva_mi.core.tasks import Helpers, helper_processes, in_order, local_executor, run

HOLDS = """
import os, time
from gva_mi.core.tasks import worker_processes

def work(number):
    print("at work", os.getpid(), flush=True)
    time.sleep(600)

if __name__ == "__main__":
    with worker_processes(2, print) as pool:
        for future in [pool.submit(work, k) for k in range(5)]:
            future.result()
"""


@pytest.fixture
def holder(tmp_path):
    """A process with two busy workers, in one process group as under a terminal."""
    (tmp_path / "holds.py").write_text(HOLDS)
    process = subprocess.Popen([sys.executable, tmp_path / "holds.py"], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True)  # fmt: skip
    with process:
        lines = iter(process.stdout.readline, "")
        at_work = (line for line in lines if line.startswith("at work"))
        process.workers = [int(next(at_work).split()[-1]) for _ in range(2)]
        yield process
        process.kill()


def is_there(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def none_is_left(pids):
    """Wait for processes to end; return whether they did."""
    until = time.monotonic() + 60
    while any(map(is_there, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    return not any(map(is_there, pids))


needs_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")


@needs_proc
@pytest.mark.parametrize("whom", ["the first", "all"])  # kill -INT, and Ctrl-C in a terminal
def test_ctrl_c_ends_workers(holder, whom):
    (os.killpg if whom == "all" else os.kill)(holder.pid, signal.SIGINT)
    out, err = holder.communicate(timeout=60)
    assert holder.returncode == -signal.SIGINT and none_is_left(holder.workers)
    assert "at work" not in out
    assert err.count("Traceback") == 1 and "KeyboardInterrupt" in err  # the holder's own


@needs_proc
def test_workers_do_not_outlive_a_killed_parent(holder):
    """They would write where the next run of the same command writes."""
    holder.kill()
    assert none_is_left(holder.workers)


class Waits:
    """Work that ends its own process."""

    steps = 1

    def __init__(self, sign):
        self.sign = sign

    def solve(self, progress=None):
        os.kill(os.getpid(), self.sign)
        time.sleep(600)


@pytest.mark.slow
@needs_proc
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_worker_is_one_sentence(sign):
    with pytest.raises(InputError, match="a worker process died"), local_executor(2) as pool:
        list(run([Waits(sign)], pool))


def test_one_worker_is_this_process():
    with local_executor(1) as executor:
        assert executor is None


class Failing:
    """An executor whose tasks end with an error."""

    def __init__(self, error):
        self.error = error

    def submit(self, function, task):
        future = Future()
        future.set_exception(self.error)
        return future


def test_cancelled_work_is_one_sentence():
    with pytest.raises(InputError, match="a worker process died"):
        list(run([Waits(0)], Failing(CancelledError())))


def test_an_error_of_the_task_itself_is_raised_as_it_is():
    with pytest.raises(ValueError, match="a bug"):
        list(run([Waits(0)], Failing(ValueError("a bug"))))


def test_results_come_in_order_and_few_items_are_taken_ahead():
    taken, first = [], threading.Event()

    def items():
        for k in range(40):
            taken.append(k)
            yield k

    def work(k):
        if k == 0:
            first.wait(10)  # the first is the last to finish
        if k == 30:
            raise ValueError("thirty")
        return k

    found = in_order(pool := ThreadPoolExecutor(4), work, items(), ahead=5)
    threading.Timer(0.05, first.set).start()
    assert next(found) == 0 and len(taken) == 6
    assert [next(found) for _ in range(29)] == list(range(1, 30))
    with pytest.raises(ValueError, match="thirty"):
        next(found)
    pool.shutdown()


class Inline:
    """An executor that works at once, in this process, once it has started."""

    def __init__(self, started=True):
        self.started, self.given = started, []

    def submit(self, function, *given):
        self.given.append(given)
        future = Future()
        if self.started:
            future.set_result(function(*given))
        return future


def make_squares():
    return lambda items: [k * k for k in items]


@pytest.mark.parametrize("count", [1, 3])
def test_shared_items_keep_their_order(count):
    """With fewer items than processes, as many, and more; not with one that has not started."""
    pools, late = [Inline() for _ in range(count)], Inline(started=False)
    shared = Helpers([late, *pools]).share(make_squares)
    for length in (1, 2, count + 1, 7):
        for pool in pools:
            pool.given = []
        items = list(range(5, 5 + length))
        assert shared(items) == [k * k for k in items]
        shares = [pool.given[0][0] for pool in pools if pool.given]
        assert len(shares) == min(count, length - 1) and all(shares)
    assert len(late.given) == 1


def test_helpers_alone_yield_results_in_order():
    """Each takes items by turns."""
    pools = [Inline() for _ in range(2)]
    squares = Helpers(pools).in_order(make_squares)
    assert list(squares(range(5))) == [k * k for k in range(5)]
    assert [[given for (given,) in pool.given[1:]] for pool in pools] == [
        [[0], [2], [4]],
        [[1], [3]],
    ]


def test_a_helper_that_died_is_one_sentence():
    """No result is made up for the lost item."""
    pool = Inline()
    shared = Helpers([pool]).share(make_squares)
    lost = Future()
    lost.set_exception(BrokenExecutor("a process ended"))
    pool.submit = lambda *given: lost
    with pytest.raises(InputError, match="a worker process died"):
        shared([0, 1])


def make_pairs_with(name):
    return lambda items: [(name, os.getpid(), k) for k in items]


@pytest.mark.slow
def test_a_helper_process_makes_the_function_and_takes_its_share():
    with helper_processes(2, pays=True) as helpers:
        shared = helpers.share(make_pairs_with, "a")
        until, found = time.monotonic() + 120, shared(range(4))
        while len({process for _, process, _ in found}) == 1 and time.monotonic() < until:
            time.sleep(0.1)
            found = shared(range(4))
    assert [(name, k) for name, _, k in found] == [("a", k) for k in range(4)]
    assert [process == os.getpid() for _, process, _ in found] == [True, False] * 2
