"""After kill -9 or a full disk nothing is half-written, and the next run goes on."""

import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

SYNTH = "--frames 2 --size 32"
FIT = "--steps 5 --checkpoint-every 2 --avatar.seed.count 300"
OVERWRITE, RESUME = ("--overwrite",), ("--resume", "--overwrite")


@dataclass(frozen=True)
class Command:
    """A command, and the options that its error may ask for in the next call."""

    line: str
    options: tuple[str, ...] = ()
    quick: bool = False
    at_last: int = 1  # kill it before each of so many changes to the disk, counted from the end
    tries: int | None = None  # number of moments, for slow commands


COMMANDS = {  # one for each way to write
    "synth": Command(f"synth {{}}/new {SYNTH}", OVERWRITE),
    "synth, in the place of another": Command(f"synth {{}}/made {SYNTH} --overwrite"),
    "refine": Command("refine {}/subject --passes 1 --size 48", OVERWRITE, at_last=8),
    "a run": Command(f"fit {{}}/subject --out {{}}/new {FIT}", RESUME, quick=True, tries=1),
    "fit": Command(f"fit {{}}/subject --out {{}}/new {FIT}", RESUME),
    "track, in the place of another": Command(
        "track {}/run/avatar.npz {}/refined --passes 1 --overwrite", at_last=8
    ),
    "render": Command(
        "render {}/run --path static --size 32 32 --video --out {}/new", OVERWRITE
    ),
    "a file": Command("export {}/run --out {}/new.splat", OVERWRITE, quick=True),
    "study refine": Command(
        "study refine --out {}/new --frames 2 --cases tuning --subjects 3 --size 48"
    ),
    "avatar": Command(
        "avatar {}/video.mp4 --height 1.7 --quality draft --steps 12 --out {}/new", tries=8
    ),
}  # fmt: skip
MOMENTS = 3  # of a command, beside the first and the last
FULL = -1  # in the place of a moment: no file can grow


def moments(count, command):
    """Return some of a command's changes to the disk, among them the first and the last."""
    drawn = np.random.default_rng(count).integers(0, count, command.tries or MOMENTS).tolist()
    if command.tries:
        return sorted(set(drawn))
    return sorted({0, *drawn, *range(max(0, count - command.at_last), count)})


@pytest.mark.parametrize("name", [
    name if command.quick else pytest.param(name, marks=pytest.mark.slow)
    for name, command in COMMANDS.items()
])  # fmt: skip
def test_after_kill_9_or_a_full_disk_the_next_run_ends_with_the_same_bits(name, stage):
    """One command for each kind of output is quick."""
    command, options = COMMANDS[name].line, COMMANDS[name].options
    wanted, undisturbed = stage.whole(command)
    for moment in (FULL, *moments(undisturbed.changes, COMMANDS[name])):
        before = stage.set_up()
        if moment == FULL:
            full = stage.run(command, room=0)
            assert full.code == 2 and "File too large" in full.sentence, full.err
        else:
            killed = stage.run(command, last=moment)
            assert killed.code == -signal.SIGKILL
        stage.require_whole(before, wanted)
        stage.finish(command, options)
        found = stage.contents()
        assert found.keys() == wanted.keys(), moment
        assert not [file for file in wanted if found[file] != wanted[file]], moment


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_printing_to_a_full_disk_is_one_sentence():
    with Path("/dev/full").open("w") as full:
        program = [sys.executable, "-m", "gva_mi", "--help"]
        ended = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1, ended.stderr
    assert ended.stderr.startswith("gva-mi: the output: No space left on device; ")
