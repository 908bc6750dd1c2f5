"""kill -9 at any moment: the next run goes on, or says what to do; and ends with the same bits."""

import json
import signal

import numpy as np
import pytest

MOMENTS = 6  # of a command, beside the first and the last
SYNTH = "--frames 2 --size 32 --samples 4 --no-clothes --no-hair --novel-poses 1 --novel-views 1"
SEEN = "--cases tuning --people 3 --size 48 --refine.passes 1 --refine.size 48"
AVATAR = "--fit.steps 5 --fit.checkpoint-every 2 --fit.window 16 --fit.avatar.seed.count 300"
FIT = "--steps 5 --checkpoint-every 2 --window 16 --avatar.seed.count 300"
OVERWRITE = ("--overwrite",)
COMMANDS = {  # and with which options a sentence may ask to be called again
    "synth": (f"synth {{}}/new {SYNTH}", OVERWRITE),
    "synth, in the place of another": (f"synth {{}}/made {SYNTH} --overwrite", ()),
    "prepare": (
        "prepare parameters {}/estimate.npz {}/new --body puppet --frames {}/subject/frames "
        "--masks {}/subject/masks", OVERWRITE
    ),
    "refine": ("refine {}/subject --passes 1 --size 48", OVERWRITE),
    "fit": (f"fit {{}}/subject --out {{}}/new {FIT}", ("--resume", *OVERWRITE)),
    "evaluate": ("evaluate {}/run {}/subject", ()),
    "track": ("track {}/run/avatar.npz {}/subject --passes 1", OVERWRITE),
    "render": (
        "render {}/run --path turntable --frames 4 --size 32 32 --video --out {}/new",
        OVERWRITE,
    ),
    "a surface": ("export {}/run --out {}/new.glb", OVERWRITE),
    "a film": ("export {}/run --size 32 32 --out {}/new.mp4", OVERWRITE),
    "a folder": ("export {}/run --out {}/new", OVERWRITE),
    "study refine": (f"study refine --out {{}}/new --frames 2 {SEEN}", ()),
    "study avatar": (
        f"study avatar --out {{}}/new --frames 8 --novel 1 {SEEN} {AVATAR} --rows full", ()
    ),
}  # fmt: skip
QUICK = ("a surface", "a folder")


def moments(count):
    """Some of the changes that a command makes to the disk, the first and the last among them."""
    drawn = np.random.default_rng(count).integers(0, count, MOMENTS)
    return sorted({0, *drawn.tolist(), count - 1})


@pytest.mark.parametrize(
    "name", [x if x in QUICK else pytest.param(x, marks=pytest.mark.slow) for x in COMMANDS]
)
def test_a_killed_command_is_run_again_and_ends_with_the_same_bits(name, stage):
    command, options = COMMANDS[name]
    wanted, undisturbed = stage.whole(command)
    for moment in moments(undisturbed.changes):
        before = stage.set_up()
        killed = stage.run(command, last=moment)
        assert killed.code == -signal.SIGKILL
        stage.require_whole(before, wanted)
        stage.finish(command, options)
        found = stage.contents()
        assert found.keys() == wanted.keys(), moment
        assert not [file for file in wanted if found[file] != wanted[file]], moment


@pytest.mark.slow
def test_what_a_killed_study_had_found_is_not_computed_again(stage):
    command = f"{COMMANDS['study refine'][0]} --noise 1 0.5"
    _, undisturbed = stage.whole(command)
    stage.set_up()
    # After that there are three changes: the second result's file is named, its part and the lock
    # are removed.
    stage.run(command, last=undisturbed.changes - 3)
    figures = stage.folder / "new/refine.json"
    (first,) = json.loads(figures.read_text())["cases"]
    ended = stage.run(command)
    assert ended.code == 0 and "1 cases are in" in ended.out
    cases = json.loads(figures.read_text())["cases"]
    assert len(cases) == 2 and first in cases  # with the seconds that it took
