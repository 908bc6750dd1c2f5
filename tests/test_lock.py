"""One process writes into a folder; a second is told which, and none has to clean up after one."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from gva_mi.errors import InputError
from gva_mi.lock import alone_in

HOLDS = """
import sys, time
from gva_mi.lock import alone_in
with alone_in(sys.argv[1], "gva-mi fit"):
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


def test_a_second_process_is_told_who_holds_the_folder(holder, tmp_path):
    told = rf"run: gva-mi fit \(process {holder.pid} on \S+, since \d{{4}}-[-\d: ]+\) writes there"
    with pytest.raises(InputError, match=told), alone_in(tmp_path / "run", "gva-mi evaluate"):
        pass
    with alone_in(tmp_path / "another", "gva-mi fit"):
        pass


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_a_lock_dies_with_its_process(holder, tmp_path, end):
    holder.send_signal(end)
    holder.wait()
    with alone_in(tmp_path / "run", "gva-mi fit"):
        assert str(os.getpid()) in (tmp_path / ".run.lock").read_text()
    assert not list(tmp_path.iterdir())


def test_the_folder_may_be_replaced_meanwhile(tmp_path):
    (tmp_path / "run").mkdir()
    with alone_in(tmp_path / "run", "gva-mi fit"):
        (tmp_path / "run").rmdir()
        (tmp_path / "run").mkdir()
        with pytest.raises(InputError, match="writes there"), alone_in(tmp_path / "run", "another"):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_full_disk_keeps_nobody_from_a_lock(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gva_mi.lock.os.write", full)
    with alone_in(tmp_path / "run", "gva-mi fit") as locked:
        assert locked
        with pytest.raises(InputError, match="another process writes there"):
            with alone_in(tmp_path / "run", "another"):
                pass


def test_a_file_that_says_nothing_of_its_holder_is_no_lock(tmp_path):
    (tmp_path / ".run.lock").write_text("{")
    with alone_in(tmp_path / "run", "gva-mi fit"):
        pass
