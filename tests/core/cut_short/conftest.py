"""Run commands that are interrupted, and compare what they leave with an undisturbed run."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.fit.options import FitOptions
from gva_mi.fit.train import fit
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import write_video
from gva_mi.synthetic import SynthOptions, make_subject

TIMES = re.compile(r"seconds|s a frame$")  # names of measured times
GROWING = ("new/refine.json", "new/avatar.json")  # grow case by case
ABOUT = {  # files, and the poses beside them that they describe
    **dict.fromkeys(("refinement.json", "refinement.png", "uncertainty.npz"), "poses_refined.npz"),
    "photometric.json": "poses_photometric.npz",
}


@pytest.fixture(scope="session")
def children():
    """The process that runs commands, see children.py."""
    program = [sys.executable, str(Path(__file__).with_name("children.py"))]
    process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    yield process
    process.stdin.close()
    process.wait()


@dataclass(frozen=True)
class Ended:
    """The end of a command."""

    code: int  # the exit code; that of a signal below 0
    out: str
    err: str
    changes: int | None  # to the disk; None: it was killed

    @property
    def sentence(self):
        """The one sentence beside the progress bars."""
        assert "Traceback" not in self.err, self.err
        lines = self.err.replace("\r", "\n").split("\n")
        said = [line for line in lines if line.strip() and not re.search(r"\d+% ", line)]
        assert len(said) == 1 and said[0].startswith("gva-mi: "), self.err
        return said[0]


class Workplace:
    """A folder that is restored for every run, always at the same path."""

    def __init__(self, folder, prepared, children):
        self.folder, self._prepared, self._children = folder, prepared, children

    def set_up(self):
        """Restore the folder; return all files."""
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(self._prepared, self.folder)
        return self.contents()

    def run(self, command, last=None, room=None, named=""):
        """Run a command, in which {} is the folder.

        Args:
            command: its words.
            last: kill it before this change to the disk; None: not at all.
            room: largest size of a file, bytes.
            named: count only changes to files whose path contains it.
        """
        words = command.replace("{}", str(self.folder)).split()
        task = {"words": words, "folder": str(self.folder), "last": last}
        task |= {"room": room, "named": named}
        self._children.stdin.write(json.dumps(task) + "\n")
        self._children.stdin.flush()
        found = json.loads(self._children.stdout.readline())
        return Ended(**found | {"changes": int(found["changes"]) if found["changes"] else None})

    def whole(self, command):
        """Return what an undisturbed run leaves, and its end."""
        self.set_up()
        ended = self.run(command)
        assert ended.code == 0, ended.err
        return self.contents(), ended

    def contents(self):
        """Return the content of all files but locks, without measured times."""
        return {
            str(path.relative_to(self.folder)): _content(path)
            for path in sorted(self.folder.rglob("*"))
            if path.is_file() and path.suffix != ".lock"
        }

    def require_whole(self, before, wanted):
        """Check that each file of a finished command is the old one or the finished one."""
        found = self.contents()
        for file, content in found.items():
            if file in wanted and not file.endswith(GROWING):
                assert content in (before.get(file), wanted[file]), f"{file} is half-written"
            path = Path(file)
            if path.name in ABOUT and not path.parent.name.startswith("."):
                main = str(path.with_name(ABOUT[path.name]))
                there = wanted if found.get(main) == wanted[main] else before
                assert content == there.get(file), f"{file} does not describe the {main} beside it"

    def finish(self, command, allowed):
        """Run a command again, with the option that it asks for."""
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
            return {k: file[k].tobytes() for k in file.files if not TIMES.search(k)}
    if path.suffix == ".html":  # holds times
        return path.read_text().count("<h2>")
    return path.read_bytes()


def _timeless(value):
    if isinstance(value, dict):
        if TIMES.search(value.get("metric", "")):  # a row of the long table
            return value | {"value": None}
        return {k: _timeless(v) for k, v in value.items() if not TIMES.search(k)}
    return [_timeless(v) for v in value] if isinstance(value, list) else value


@pytest.fixture(scope="session")
def prepared(request, tmp_path_factory, subject, video, built_in_body):
    """The commands' inputs; synthetic subjects only if slow tests run, which use them."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(subject, folder / "subject")
    seeded = AvatarOptions(seed=SeedOptions(count=300))
    fit(video, built_in_body, FitOptions(steps=3, window=16, avatar=seeded), folder / "run")
    if not any(item.get_closest_marker("slow") for item in request.session.items):
        return folder
    (folder / "made").mkdir()
    (folder / "made/synth.json").write_text("{}")
    shutil.copytree(folder / "subject", folder / "refined")  # as if with other results
    for name, main in ABOUT.items():
        shutil.copy(folder / "refined/poses.npz", folder / "refined" / main)
        (folder / "refined" / name).write_text('{"test_frames": "held out", "figures": {}}')
    few = {"frames": 5, "size": 192, "samples": 4, "novel_poses": 0, "novel_views": 0}
    bare = SynthOptions(seed=151, bare=True, **few)
    make_subject(folder / "taken", bare, built_in_body)
    frames = load_video(folder / "taken").frames()
    images = [np.round(255 * frame.image).astype(np.uint8) for frame in frames]
    write_video(folder / "video.mp4", images, fps=10, way="playable")
    return folder


@pytest.fixture
def stage(tmp_path, prepared, children):
    return Workplace(tmp_path / "stage", prepared, children)
