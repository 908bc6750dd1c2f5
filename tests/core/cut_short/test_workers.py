"""Workers end with their parent, however that ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gva_mi import InputError
from gva_mi.core.tasks import run
from gva_mi.core.workers import local_executor

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")

HOLDS = """
import os, sys, time
from gva_mi.core.workers import worker_processes

def begin(*_):
    pass

def work(number):
    try:
        print("at work", os.getpid(), flush=True)
        while True:
            time.sleep(0.01)
    finally:
        print("cleared up", flush=True)

if __name__ == "__main__":
    with worker_processes(2, begin) as pool:
        for future in [pool.submit(work, k) for k in range(5)]:
            future.result()
"""


@pytest.fixture
def holder(tmp_path):
    """A process with two endless workers, in one process group as under a terminal."""
    (tmp_path / "holds.py").write_text(HOLDS)
    process = subprocess.Popen(
        [sys.executable, tmp_path / "holds.py"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    with process:
        process.workers = [int(process.stdout.readline().split()[-1]) for _ in range(2)]
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


@pytest.mark.parametrize("whom", ["the first", "all"])  # kill -INT, and Ctrl-C in a terminal
def test_ctrl_c_ends_workers_and_lets_them_clean_up(holder, whom):
    (os.killpg if whom == "all" else os.kill)(holder.pid, signal.SIGINT)
    out, err = holder.communicate(timeout=60)
    assert holder.returncode == -signal.SIGINT and none_is_left(holder.workers)
    assert out.count("cleared up") == 2 and "at work" not in out
    assert err.count("Traceback") == 1 and "KeyboardInterrupt" in err  # the holder's own


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
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_worker_is_one_sentence(sign):
    with pytest.raises(InputError) as error, local_executor(2) as pool:
        list(run([Waits(sign)], pool))
    assert "a worker process is gone" in str(error.value)
    assert "\n" not in str(error.value)


def test_one_worker_is_this_process():
    with local_executor(1) as executor:
        assert executor is None
