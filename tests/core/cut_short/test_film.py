"""``gva-mi avatar``, the longest command: killed in every step, it ends with the same bits."""

import signal

import numpy as np
import pytest

from gva_mi.data.film import write_film
from gva_mi.data.video import load_video
from gva_mi.synthetic import SynthOptions, make_subject

AVATAR = "avatar {}/film.mp4 --height 1.7 --quality draft --steps 12 --out {}/new"
# Files of all steps: the next run is killed before it first changes one whose path contains this.
BEFORE = (
    "frames/000003", "masks/000001", "landmarks.npz", "film_check", "poses_refined", "refinement",
    "run/options", "run/history", "run/avatar", "metrics.json", "walk.mp4", "new/report.html",
)  # fmt: skip


@pytest.fixture(scope="module")
def prepared(tmp_path_factory, built_in_body):
    """A film of five frames."""
    folder, taken = tmp_path_factory.mktemp("film"), tmp_path_factory.mktemp("taken") / "subject"
    bare = SynthOptions(
        seed=151, frames=5, size=192, samples=4, bare=True, novel_poses=0,
        novel_views=0,
    )  # fmt: skip
    make_subject(taken, bare, built_in_body)
    images = [np.round(255 * frame.image).astype(np.uint8) for frame in load_video(taken).frames()]
    write_film(folder / "film.mp4", images, fps=10, way="playable")
    return folder


@pytest.mark.slow
def test_a_film_becomes_the_same_avatar_however_often_it_is_killed(stage):
    wanted, _ = stage.whole(AVATAR)
    stage.set_up()
    full = stage.run(AVATAR, room=0)
    assert full.code == 2 and "File too large" in full.sentence, full.err
    for named in BEFORE:
        assert stage.run(AVATAR, last=0, named=named).code == -signal.SIGKILL, named
    ended = stage.run(AVATAR)
    assert ended.code == 0 and ended.out.count("was finished before") == 6, ended.err
    found = stage.contents()
    assert found.keys() == wanted.keys()
    for steps in (contents["new/avatar.json"]["finished"] for contents in (found, wanted)):
        del steps["report"]  # reads measured times
    assert not [file for file in wanted if found[file] != wanted[file]]
