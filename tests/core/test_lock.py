"""One process writes into a folder; a second one reports which; no lock outlives its process."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from gva_mi.core.atomic import folder_lock
from gva_mi.core.errors import InputError

HOLDS = """
import sys, time
from gva_mi.core.atomic import folder_lock
with folder_lock(sys.argv[1], "gva-mi fit"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that writes into the folder ``run``."""
    program = [sys.executable, "-c", HOLDS, str(tmp_path / "run")]
    with subprocess.Popen(program, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_a_second_process_is_told_and_the_lock_dies_with_the_first(holder, tmp_path, end):
    told = rf"run: gva-mi fit \(process {holder.pid} on \S+, since \d{{4}}-[-\d: ]+\) writes there"
    with pytest.raises(InputError, match=told), folder_lock(tmp_path / "run", "gva-mi evaluate"):
        pass
    with folder_lock(tmp_path / "another", "gva-mi fit"):
        pass
    holder.send_signal(end)
    holder.wait()
    with folder_lock(tmp_path / "run", "gva-mi fit"):
        assert str(os.getpid()) in (tmp_path / ".run.lock").read_text()
    assert not list(tmp_path.iterdir())


def test_the_folder_may_be_replaced_meanwhile(tmp_path):
    (tmp_path / "run").mkdir()
    with folder_lock(tmp_path / "run", "gva-mi fit"):
        (tmp_path / "run").rmdir()
        (tmp_path / "run").mkdir()
        with (
            pytest.raises(InputError, match="writes there"),
            folder_lock(tmp_path / "run", "another"),
        ):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize("code, call", [(errno.ENOSPC, "os.write"), (errno.ENOLCK, "fcntl.flock")])
def test_a_full_disk_and_a_disk_without_locks_stop_nobody(code, call, tmp_path, monkeypatch):
    def fails(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(f"gva_mi.core.atomic.{call}", fails)
    with folder_lock(tmp_path / "run", "gva-mi fit"):
        pass
    assert not list(tmp_path.iterdir())
