"""A full disk, in every step: one sentence, no half-written file, and the next run goes on."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SYNTH = "--frames 2 --size 32 --samples 4 --no-clothes --no-hair --novel-poses 1 --novel-views 1"
SEEN = "--cases tuning --people 3 --size 48 --refine.passes 1 --refine.size 48"
AVATAR = "--fit.steps 5 --fit.checkpoint-every 2 --fit.window 16 --fit.avatar.seed.count 300"
FIT = "--steps 5 --checkpoint-every 2 --window 16 --avatar.seed.count 300"
OVERWRITE = ("--overwrite",)
COMMANDS = {  # and with which options a sentence may ask to be called again
    "synth": (f"synth {{}}/new {SYNTH}", ()),
    "synth, another figure": (f"synth {{}}/new {SYNTH} --figure stretched", ()),
    "another noise": ("synth {}/new --like {}/like --family white", ()),
    "prepare": (
        "prepare parameters {}/estimate.npz {}/new --body puppet --frames {}/subject/frames "
        "--masks {}/subject/masks", ()
    ),
    "check": ("check {}/subject --json {}/a.json --sheet {}/b.png", OVERWRITE),
    "refine": ("refine {}/subject --passes 1 --size 48", OVERWRITE),
    "fit": (f"fit {{}}/subject --out {{}}/new {FIT}", ("--resume", *OVERWRITE)),
    "evaluate": ("evaluate {}/run {}/subject", ()),
    "track": ("track {}/run/avatar.npz {}/subject --passes 1", OVERWRITE),
    "render": (
        "render {}/run --path turntable --frames 4 --size 32 32 --video --out {}/new", OVERWRITE
    ),
    "a surface": ("export {}/run --out {}/new.glb", OVERWRITE),
    "Gaussians": ("export {}/run --out {}/new.spz", OVERWRITE),
    "poses": ("export {}/run --out {}/new.npz", OVERWRITE),
    "an avatar": ("export {}/run --no-rig --out {}/new.npz", OVERWRITE),
    "a film": ("export {}/run --size 32 32 --out {}/new.mp4", OVERWRITE),
    "a folder": ("export {}/run --out {}/new", OVERWRITE),
    "motion": ("motion {}/subject/poses.npz {}/new.npz --source-fps 30", OVERWRITE),
    "body": ("body --out {}/new.npz", OVERWRITE),
    "gradcheck": ("gradcheck --scene {}/scene.npz --window 8 --count 1 --out {}/new", ()),
    "bench": ("bench body --repeats 1 --json {}/new.json", ()),
    "study refine": (f"study refine --out {{}}/new --frames 2 {SEEN}", ()),
    "study avatar": (
        f"study avatar --out {{}}/new --frames 8 --novel 1 {SEEN} {AVATAR} --rows full", ()
    ),
}  # fmt: skip
QUICK = ("a surface", "Gaussians", "poses", "an avatar", "a folder", "motion")
NEVER_ALIKE = {"bench": "new.json"}  # times
ROOMS = 3  # between nothing and enough


def rooms(before, wanted):
    """Bytes beyond which no file can grow: nothing, and too little for the largest files."""
    sizes = sorted(size for file, size in wanted.items() if before.get(file) != size)
    some = np.linspace(0, len(sizes) - 1, ROOMS).round().astype(int)
    return sorted({0, *(sizes[k] - 1 for k in some)})


@pytest.mark.parametrize(
    "name", [x if x in QUICK else pytest.param(x, marks=pytest.mark.slow) for x in COMMANDS]
)
def test_a_full_disk_is_one_sentence_and_the_next_run_goes_on(name, stage):
    command, options = COMMANDS[name]
    stage.set_up()
    sizes = stage.sizes()
    wanted, _ = stage.whole(command)
    for room in rooms(sizes, stage.sizes()):
        before = stage.set_up()
        full = stage.run(command, room=room)
        if room == 0 or full.code != 0:  # links to large files need no room
            assert full.code == 2 and "File too large" in full.sentence, (room, full.err)
            stage.require_whole(before, wanted)
            left = stage.contents().keys() - before.keys() - wanted.keys()
            assert all(file.endswith("checkpoint.pt") for file in left), (room, left)
            stage.finish(command, options)
        found = stage.contents()
        assert found.keys() == wanted.keys(), room
        other = [file for file in wanted if found[file] != wanted[file]]
        assert other in ([], [NEVER_ALIKE.get(name)]), room


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_what_is_printed_onto_a_full_disk_is_one_sentence():
    with Path("/dev/full").open("w") as full:
        program = [sys.executable, "-m", "gva_mi", "--help"]
        ended = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1, ended.stderr
    assert ended.stderr.startswith("gva-mi: the output: No space left on device; ")
