"""``gva-mi batch``: avatars of many videos; one that fails stops no other."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from gva_mi.app import AvatarEffort
from gva_mi.cli.batch import MARKER, PAGE, TABLE, Made, _arguments, make, write_table
from gva_mi.stage1.prepare import PrepareVideoOptions


def rows(out):
    with (out / TABLE).open() as file:
        return {row["video"]: row for row in csv.DictReader(file)}


def test_options_become_arguments():
    options = PrepareVideoOptions(height=1.7), AvatarEffort("draft", test_frames=False)
    arguments = [x for one in options for x in _arguments(one)]
    assert arguments == ["--height", "1.7", "--quality", "draft", "--no-test-frames"]


def test_two_videos_of_one_name_are_refused(cli, tmp_path):
    complaint = cli.fails("batch", tmp_path / "a/x.mp4", tmp_path / "b/x.mp4", "--out", tmp_path)
    assert "several videos have the name x" in complaint


def test_a_failure_is_a_sentence_in_the_table(tmp_path):
    (tmp_path / "broken.mp4").write_text("no video")
    (tmp_path / MARKER).write_text("{}")
    found = make(tmp_path / "broken.mp4", tmp_path / "broken", [])
    assert "broken.mp4: " in found.failure and "\n" not in found.failure
    assert (tmp_path / "broken.log").read_text().startswith("gva-mi avatar ")
    write_table(tmp_path, [found, Made("lost", 0, "the worker died")])
    table = rows(tmp_path)
    assert table["broken"]["failure"] == found.failure and table["lost"]["PSNR, dB"] == ""
    page = (tmp_path / PAGE).read_text()
    assert "the worker died" in page and "0 avatars; 2 videos failed" in page


def test_a_command_ends_with_the_process_that_started_it():
    """Its input ends then; otherwise it would go on writing where the next worker writes."""
    program = "import time; from gva_mi.core.tasks import end_with_input as end; end()"
    program += "; time.sleep(60)"
    child = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE)
    child.stdin.close()
    assert child.wait(30) == 1


def test_a_missing_scheduler_is_one_sentence(cli, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("gva_mi.core.tasks.CONNECT", 0.2)
    given = "batch", tmp_path / "x.mp4", "--out", tmp_path / "out"
    complaint = cli.fails(*given, "--scheduler", "tcp://127.0.0.1:9")
    assert "tcp://127.0.0.1:9: no scheduler answers" in complaint


@pytest.mark.slow
def test_a_broken_video_and_a_killed_worker_cost_no_avatar(filmed, tmp_path):
    psutil = pytest.importorskip("psutil")
    recording, height = filmed
    for name in ("a.mp4", "b.mp4"):
        shutil.copy(recording, tmp_path / name)
    (tmp_path / "broken.mp4").write_text("no video")
    videos = [tmp_path / f"{name}.mp4" for name in ("a", "broken", "b")]
    options = "--height", height, "--quality", "draft", "--steps", 20, "--workers", 2
    command = [sys.executable, "-m", "gva_mi", "batch", *videos, "--out", tmp_path / "out",
        *options]  # fmt: skip
    with (tmp_path / "said.txt").open("w") as said:
        running = subprocess.Popen(list(map(str, [*command, *options])), stdout=said, stderr=said)
        avatars = lambda: [
            child for child in psutil.Process(running.pid).children(recursive=True)
            if str(videos[0]) in child.cmdline()
        ]  # fmt: skip
        marker = tmp_path / "out/a/avatar.json"
        while not (marker.exists() and "prepare" in json.loads(marker.read_text())["steps"]):
            assert running.poll() is None, (tmp_path / "said.txt").read_text()
            time.sleep(0.5)
        (avatar,) = avatars()
        os.kill(avatar.ppid(), signal.SIGKILL)
        assert running.wait() == 1, (tmp_path / "said.txt").read_text()
    assert not avatar.is_running()
    table = rows(tmp_path / "out")
    assert list(table) == ["a", "broken", "b"]
    assert table["broken"]["failure"] and not table["a"]["failure"] + table["b"]["failure"]
    a, b = (tmp_path / "out" / name / "run/avatar.npz" for name in "ab")
    assert a.read_bytes() == b.read_bytes()
    assert (tmp_path / "out" / PAGE).read_text().count("data:image/webp") == 2
