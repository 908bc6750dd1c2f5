"""Commands that are cut short, what they leave behind, and what an undisturbed run leaves."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.data.pictures import read_image, write_movie
from gva_mi.data.synthetic import SynthOptions, make_subject
from gva_mi.fit.options import FitOptions
from gva_mi.fit.train import fit
from gva_mi.splat.scene import random_scene

NEVER_ALIKE = re.compile(r"seconds|^s a frame$")  # keys of what is measured in time
GROWING = ("new/refine.json", "new/avatar.json")  # case by case: they need not be finished
ABOUT = {  # names of files, and of the poses beside them that they are about
    **dict.fromkeys(("refinement.json", "refinement.png", "refinement.html"), "poses_refined.npz"),
    "photometric.json": "poses_photometric.npz",
}


@pytest.fixture(scope="session")
def children():
    """Where commands run: see children.py."""
    program = [sys.executable, str(Path(__file__).with_name("children.py"))]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    yield process
    process.stdin.close()
    process.wait()


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int  # the exit code; that of a signal below 0
    out: str
    err: str
    changes: int | None  # that it made to the disk; None: it was killed

    @property
    def sentence(self):
        """The one that a person reads, if all the rest is progress."""
        assert "Traceback" not in self.err, self.err
        lines = self.err.replace("\r", "\n").split("\n")
        said = [line for line in lines if line.strip() and not re.search(r"\d+% ", line)]
        assert len(said) == 1 and said[0].startswith("gva-mi: "), self.err
        return said[0]


class Stage:
    """A folder that is set up anew for every run, always in the same place."""

    def __init__(self, folder, prepared, children):
        self.folder, self._prepared, self._children = folder, prepared, children

    def set_up(self):
        """Put everything back to how it was before any run; returns all files."""
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(self._prepared, self.folder)
        return self.contents()

    def run(self, command, last=None, room=None):
        """Run a command, in which {} is the stage.

        Args:
            command: its words.
            last: it is killed before it makes this change to the disk; None: not at all.
            room: bytes beyond which no file can grow.
        """
        words = command.replace("{}", str(self.folder)).split()
        task = {"words": words, "folder": str(self.folder), "last": last, "room": room}
        self._children.stdin.write(json.dumps(task) + "\n")
        self._children.stdin.flush()
        found = json.loads(self._children.stdout.readline())
        return Ended(**found | {"changes": int(found["changes"]) if found["changes"] else None})

    def whole(self, command):
        """What an undisturbed run leaves, and how it ended."""
        self.set_up()
        ended = self.run(command)
        assert ended.code == 0, ended.err
        return self.contents(), ended

    def contents(self):
        """All files by their names, without what is measured in time, and the files of locks, which
        mean nothing once their process is gone."""
        return {
            str(path.relative_to(self.folder)): _content(path)
            for path in sorted(self.folder.rglob("*"))
            if path.is_file() and path.suffix != ".lock"
        }

    def sizes(self):
        """Bytes of all files by their names."""
        files = [path for path in sorted(self.folder.rglob("*")) if path.is_file()]
        return {str(path.relative_to(self.folder)): path.stat().st_size for path in files}

    def require_whole(self, before, wanted):
        """Check that each file that a finished command leaves is as it was before, or finished."""
        found = self.contents()
        for file, content in found.items():
            if file in wanted and not file.endswith(GROWING):
                assert content in (before.get(file), wanted[file]), f"{file} is half-written"
            path = Path(file)
            if path.name in ABOUT and not path.parent.name.startswith("."):
                main = str(path.with_name(ABOUT[path.name]))
                there = wanted if found.get(main) == wanted[main] else before
                assert content == there.get(file), f"{file} is not about the {main} that is there"

    def finish(self, command, allowed):
        """Run a command once more, with the option that it asks for; returns what was said."""
        ended = self.run(command)
        if ended.code == 0:
            return ended
        said, option = ended.sentence, next((o for o in allowed if o in ended.sentence), None)
        assert ended.code == 2 and option, said
        ended = self.run(f"{command} {option}")
        assert ended.code == 0, ended.err
        return ended


def _content(path):
    if path.suffix == ".json":
        return _timeless(json.loads(path.read_text()))
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {k: file[k].tobytes() for k in file.files if not NEVER_ALIKE.search(k)}
    if path.suffix == ".html":  # of which times are a part
        return path.read_text().count("<h2>")
    return path.read_bytes()


def _timeless(value):
    if isinstance(value, dict):
        return {k: _timeless(v) for k, v in value.items() if not NEVER_ALIKE.search(k)}
    return [_timeless(v) for v in value] if isinstance(value, list) else value


@pytest.fixture(scope="session")
def prepared(tmp_path_factory, subject, video, built_in_body):
    """What commands are given: a subject, an avatar, a motion, and what an estimator wrote."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(subject, folder / "subject")
    seeded = AvatarOptions(seed=SeedOptions(count=300))
    fit(video, built_in_body, FitOptions(steps=3, window=16, avatar=seeded), folder / "run")
    (folder / "made").mkdir()
    (folder / "made/synth.json").write_text("{}")
    (folder / "made/frames.txt").write_text("of another subject")
    frames = _as_a_film(folder, subject)
    s = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=20, height=16)
    seen_by = {"viewmat": s.camera.T_camera_world, "K": s.camera.K, "width": 20, "height": 16}
    np.savez(folder / "scene.npz", **{k: v.numpy() for k, v in s.inputs().items()}, **seen_by)
    bare = SynthOptions(
        frames=2, size=32, samples=4, clothes=False, hair=False, novel_poses=0, novel_views=0
    )
    make_subject(folder / "like", bare, built_in_body)
    shutil.copytree(folder / "like", folder / "bare")
    _refined_before(folder / "like", folder / "refined")
    np.savez(
        folder / "estimate.npz", global_orient=np.tile([np.pi, 0, 0], (frames, 1)),
        body_pose=np.zeros((frames, 63)), transl=np.tile([0, 0.2, 3.5], (frames, 1)),
        betas=np.zeros((1, 10)), focal=np.array(60.0),
    )  # fmt: skip
    return folder


def _as_a_film(folder, subject):
    """The subject's footage as one film and one array; returns the number of its frames."""
    pictures, masks = (sorted((subject / kind).iterdir()) for kind in ("frames", "masks"))
    write_movie(folder / "film.mp4", [read_image(path, 3) for path in pictures])
    np.save(folder / "masks.npy", np.stack([read_image(path, 1) for path in masks]))
    return len(pictures)


def _refined_before(subject, refined):
    """The same subject, refined and tracked before, with other results."""
    shutil.copytree(subject, refined)
    for main in set(ABOUT.values()):
        shutil.copy(subject / "poses.npz", refined / main)
    for name in ABOUT:
        (refined / name).write_text('{"test_frames": "held out", "figures": {}}')


@pytest.fixture
def stage(tmp_path, prepared, children):
    return Stage(tmp_path / "stage", prepared, children)
