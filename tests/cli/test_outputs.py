"""Outputs are tried before the work, and a full disk or Ctrl-C costs nothing that was finished."""

import errno
import json
import resource
import shutil
import subprocess
import sys
from contextlib import contextmanager
from fractions import Fraction

import numpy as np
import pytest
import torch

from gva_mi.avatar.export import save_amass, save_gltf
from gva_mi.body.pose import Pose, Shape
from gva_mi.core.atomic import folder_lock
from gva_mi.core.errors import InputError
from gva_mi.core.files import write_arrays, write_json
from gva_mi.evaluate.page import write_page
from gva_mi.fit.run_folder import save_state
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.formats.spz import save_splat, save_spz
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video_file import write_video
from gva_mi.synthetic.pictures.cameras import write_phone_video

NOISE = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)


@contextmanager
def full_disk(room=100):
    """Let no file grow beyond so many bytes, as on a full disk or beyond a quota."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


WRITERS = {
    "a.npz": lambda path, known: write_arrays(path, a=NOISE),
    "a.json": lambda path, known: write_json(path, {"a": "x" * 1000}),
    "a.png": lambda path, known: write_image(path, NOISE),
    "a.mp4": lambda path, known: write_video(path, [NOISE] * 3),
    "phone.mp4": lambda path, known: write_phone_video(
        path, [NOISE] * 3, Fraction(8), np.random.default_rng(0)
    ),
    "a.html": lambda path, known: write_page(
        path, title="x" * 1000, subtitle="", sections=[], settings={}
    ),
    "amass.npz": lambda path, known: save_amass(path, Pose.rest(9), Shape(torch.zeros(10)), 30),
    "a.ply": lambda path, known: save_ply(path, known(Pose.rest())),
    "a.splat": lambda path, known: save_splat(path, known(Pose.rest())),
    "a.spz": lambda path, known: save_spz(path, known(Pose.rest())),
    "a.glb": lambda path, known: save_gltf(path, known),
    "checkpoint.pt": lambda path, known: save_state(path.parent, {"a": "x" * 1000}),
}


def test_a_full_disk_leaves_the_old_file(tmp_path, known):
    for name, write in WRITERS.items():
        path = tmp_path / name
        path.write_text("hours of work")
        with full_disk(), pytest.raises(OSError) as error:
            write(path, known)
        assert error.value.errno == errno.EFBIG and error.value.filename == str(path)
        assert path.read_text() == "hours of work" and list(tmp_path.iterdir()) == [path]
        write(path, known)
        assert path.read_bytes() != b"hours of work"
        path.unlink()


def test_a_full_disk_is_one_sentence(tmp_path, cli, known):
    known.save(tmp_path / "avatar.npz")
    out = tmp_path / "a.glb"
    with full_disk(1000):
        code, _, err = cli("export", tmp_path / "avatar.npz", "--out", out)
    assert code == 2 and err.endswith("a.glb: File too large; all files on disk are complete\n")
    assert not out.exists() and not list(tmp_path.glob("*.part"))


def test_a_disk_that_fills_while_a_folder_is_copied_is_one_sentence(tmp_path, cli, monkeypatch):
    (tmp_path / "from").mkdir()
    (tmp_path / "from/large.bin").write_bytes(NOISE.tobytes())

    def copied():
        shutil.copytree(tmp_path / "from", tmp_path / "to", copy_function=shutil.copyfile)

    monkeypatch.setattr("gva_mi.__main__.load", lambda verb: copied)
    with full_disk():
        code, _, err = cli("study")
    assert code == 2 and "to/large.bin" in err and "File too large" in err and err.count("\n") == 1


COMMANDS = {  # {} is the folder that output goes to
    "avatar": "avatar {subject}/frames --out {}/new",
    "demo": "demo --out {}/new",
    "synth": "synth {}/new",
    "refine": "refine {subject}",
    "fit": "fit {subject} --out {}/new",
    "evaluate": "evaluate {run} {subject}",
    "track": "track {run} {subject}",
    "render": "render {run} --path turntable --poses {subject}/poses.npz --out {}/new",
    "export": "export {run} --out {}/a.ply",
    "motion": "motion {subject}/poses.npz {}/a.npz",
    "study": "study refine --out {}/new",
    "body": "body --out {}/a.npz",
    "check": "check {subject} --sheet {}/a.png",
    "prepare": "prepare auto {subject}/poses.npz {}/new --body built-in",
}
LOCKED = ("avatar", "demo", "refine", "fit", "evaluate", "track", "render", "study")


@pytest.fixture
def run(known, tmp_path):
    """A run's folder with an avatar."""
    known.save(tmp_path / "run/avatar.npz")
    (tmp_path / "run/options.json").write_text(json.dumps({"options": {"seed": 0}}))
    return tmp_path / "run"


def test_a_read_only_folder_is_reported_before_the_work(tmp_path, cli, subject, run, monkeypatch):
    """Without permissions, which would not stop a test run by root."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("gva_mi.core.atomic.tempfile.TemporaryFile", refuse)
    monkeypatch.setattr("gva_mi.core.atomic.tempfile.mkdtemp", refuse)
    for name, line in COMMANDS.items():
        out = tmp_path / name
        out.mkdir()
        cli.refuses("Read-only file system",
            *line.replace("{}", str(out)).format(subject=subject, run=run).split())  # fmt: skip
        assert not list(out.rglob("*.*")), name


def test_a_folder_that_another_process_writes_is_left_alone(tmp_path, cli, subject, run):
    folders = {"refine": subject, "track": subject, "evaluate": run}
    for name in LOCKED:
        folder = folders.get(name, tmp_path / "new")
        command = COMMANDS[name].replace("{}", str(tmp_path)).format(subject=subject, run=run)
        with folder_lock(folder, "gva-mi of somebody"):
            code, _, err = cli(*command.split())
        assert code == 2 and f"{folder}: gva-mi of somebody (process " in err, (name, err)
        assert err.count("\n") == 1
        assert not (tmp_path / "new").exists()


def test_overwriting_a_folder_does_not_cost_an_input_that_lies_in_it(tmp_path, cli, subject):
    out = shutil.copytree(subject, tmp_path / "out")
    for words in (
        f"fit {subject} --out {out} --poses {out}/poses.npz",
        f"prepare video {out} {out}",
    ):
        err = cli.fails(*words.split(), "--overwrite")
        assert f"lies in {out}, which --overwrite would remove" in err
    assert (out / "poses.npz").read_bytes() == (subject / "poses.npz").read_bytes()


@pytest.mark.parametrize("verb, told", [("fit", "--resume to continue"), ("synth", "are complete")])
def test_ctrl_c_tells_how_to_continue(verb, told, cli, monkeypatch):
    def stopped():
        raise KeyboardInterrupt

    monkeypatch.setattr("gva_mi.__main__.load", lambda verb: stopped)
    code, _, err = cli(verb)
    assert code == 130 and err.startswith("\ngva-mi: stopped; ") and err.endswith(f"{told}\n")


@pytest.mark.parametrize("cause, code, told", [
    (KeyboardInterrupt(), 130, "stopped; all files"), (InputError("x.npz: cut"), 2, "x.npz: cut"),
    (MemoryError(), 2, "not enough memory"), (OSError(28, "No space left", "x"), 2, "No space"),
])  # fmt: skip
def test_what_happens_while_dr_jit_records_is_told_alike(cause, code, told, cli, monkeypatch):
    """Dr.Jit makes a RuntimeError of what a function raises that it records."""
    import drjit as dr
    from drjit.llvm import Float

    @dr.freeze
    def recorded(x):
        raise cause

    monkeypatch.setattr("gva_mi.__main__.load", lambda verb: lambda: recorded(Float(1.0)))
    found, _, err = cli("synth")
    assert found == code and told in err, err


def test_a_working_folder_that_is_gone_is_one_sentence(tmp_path):
    program = "import os; os.rmdir(os.getcwd()); from gva_mi.__main__ import run; run()"
    words = [sys.executable, "-c", program, "check", str(tmp_path)]
    (tmp_path / "gone").mkdir()
    ended = subprocess.run(words, cwd=tmp_path / "gone", capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr == "gva-mi: the working folder does not exist any more; cd to another one\n"


INTERRUPTED = """
import os, signal, sys, threading
from gva_mi.__main__ import run
from gva_mi.cli import load

load("{verb}")  # imported before the signal
sys.argv = ["gva-mi", *sys.argv[1:]]
threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
run()
"""


@pytest.mark.slow
@pytest.mark.parametrize("command", [
    "refine {subject} --passes 5000 --size 64", "fit {subject} --out {out}/new --steps 100000",
    "synth {out}/new --frames 600", "track {run} {subject} --passes 5000",
])  # fmt: skip
def test_ctrl_c_in_the_middle_of_the_work_is_one_sentence(command, subject, run, tmp_path):
    folder = shutil.copytree(subject, tmp_path / "subject")
    words = command.format(subject=folder, run=run / "avatar.npz", out=tmp_path).split()
    program = [sys.executable, "-c", INTERRUPTED.format(verb=words[0]), *words]
    ended = subprocess.run(program, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 130 and "Traceback" not in ended.stderr, ended.stderr
    assert "gva-mi: stopped; " in ended.stderr and not list(tmp_path.rglob("*.part"))
    assert not list(tmp_path.glob(".*.lock")) and not (tmp_path / "new/avatar.npz").exists()


def test_a_picture_of_another_kind_is_refused_at_once(tmp_path, cli):
    err = cli.fails("check", "nowhere", "--sheet", tmp_path / "sheet.gif")
    assert "a picture's name ends in .png" in err and not list(tmp_path.iterdir())
