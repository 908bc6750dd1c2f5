"""Options that make the documented commands quick, and commands that no test runs."""

import shlex

# By the first words of a command, the longest match. Of a repeated option the last one counts.
SMALLER = {
    "synth": "--size 48 --frames 4",
    "refine": "--passes 1 --size 32 --overwrite",
    "fit": "--steps 20 --checkpoint-every 8",
    "track": "--passes 1",
    "evaluate": "",
    "render --path": "--size 32 48",
    "render run --poses walk.npz": "--size 32 48",
    "render run --poses dance.npz": "--size 32 48",
    "prepare": "--overwrite",
    "export": "--overwrite",
    "check": "--overwrite",
    "view": "--port 0",
    "gradcheck": "--window 8 --count 1 --scene scene.npz",
    "gradcheck avatar": "--count 1",
    "gradcheck normals": "--count 1",
    "bench": "--repeats 1",
    "bench splat": "--repeats 1 --scene scene.npz",
    # Seed 16 wears nothing and is bald, which is quick.
    "study refine": "--subjects 16 --frames 3 --size 48",
    "study refine --cases": "--subjects dalia --frames 3 --size 48",
    "study refine --held-out-set": "--subjects 609 --error-models lean --frames 3 --size 48",
    "study avatar": "--subjects 16 --error-models lean --rows full --frames 3 --size 48 --steps 10",
    "study avatar --held-out-set": "--subjects 809 --error-models lean --rows full --frames 3 "
    "--size 48 --steps 10",
}

# Placeholders.
NAMED = {
    "BODY": "puppet",
    "FILE": "scene.npz", "DIR": "figures",
}  # fmt: skip
WRITTEN = {"--json": "figures.json"}  # where FILE is one that a command writes

FILMED = "needs a film of a person, and minutes: tests/cli/test_avatar.py makes one"
DEMO = "needs the demo's folder: tests/cli/test_cli.py makes a small one"
NOT_RUN = {
    "gva-mi refine out/demo/subject --height 1.74 --overwrite": DEMO,
    "gva-mi avatar film.mp4 --height 1.75 --out me": FILMED,
    "gva-mi prepare film film.mp4 me/subject --height 1.75": FILMED,
    "gva-mi check me/subject": FILMED,
    "gva-mi refine me/subject --height 1.75": FILMED,
    "gva-mi fit me/subject --out me/run --preset film": FILMED,
    "gva-mi evaluate me/run me/subject --fit-poses": FILMED,
    "gva-mi motion dance.mp4 dance.npz": FILMED,
    "gva-mi render me/run --poses dance.npz --video --out dance": FILMED,
    "gva-mi study refine --held-out-set 25 --error-models film --out films": (
        "an hour; tests/study/test_filmed.py renders and watches one film"
    ),
    "gva-mi study refine --cases limits --stage 1 --out limits": (
        "an hour; tests/study/test_filmed.py renders and watches one film"
    ),
    "gva-mi study avatar --held-out-set 23 --error-models film --steps 2000 --rows full "
    "--out film-avatars": ("an hour; tests/study/test_filmed.py renders and watches one film"),
    "gva-mi study avatar --held-out-set 24 --error-models film --steps 2000 --rows full "
    "--no-lens --out any-lens": (
        "an hour; tests/study/test_filmed.py renders and watches one film"
    ),
    "gva-mi study multiview Demo_SinglePerson/videos "
    "Demo_SinglePerson/calibration/Calib_qualisys.toml --height 1.72": (
        "needs the films of Pose2Sim: tests/study/test_multiview.py"
    ),
    "gva-mi body --source anny": "needs the package anny, 0.6 GB: tests/body/test_anny.py",
    "gva-mi COMMAND --help": "any: tests/cli",
}


def named(command):
    """Return a command's words without ``gva-mi``, placeholders replaced by file names."""
    words = shlex.split(command)[1:]
    for k, word in enumerate(words):
        if word in NAMED:
            words[k] = WRITTEN.get(words[k - 1], NAMED[word])
    return words


def smaller(command):
    """Return options (a list of words) that make a command quick."""
    words = shlex.split(command)[1:]
    fitting = [
        key for key in SMALLER
        if key.split()[0] == words[0] and all(word in words for word in key.split())
    ]  # fmt: skip
    return shlex.split(SMALLER[max(fitting, key=len)]) if fitting else []
