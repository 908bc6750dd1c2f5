"""Fixtures that several folders of tests share."""

import json
import os
import shutil
import signal
import sys

import pytest

import gva_mi  # noqa: F401  chooses the libLLVM before a test imports Dr.Jit
from gva_mi.core.cpu import pin_cpu_features

# As the command line does: idle threads of torch leave the cores to Dr.Jit's threads, and libraries
# compute the same bits on every CPU, in this process and in those that tests start.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
pin_cpu_features()
# A shell's background job ignores Ctrl-C, and so would the processes that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config):
    """Give each worker of pytest-xdist one thread, as there are as many workers as cores."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        import drjit as dr
        import torch

        torch.set_num_threads(1)
        dr.set_thread_count(1)


class CommandLine:
    """Runs ``gva-mi`` in this process."""

    def __init__(self, capsys, monkeypatch):
        self._capsys, self._monkeypatch = capsys, monkeypatch

    def __call__(self, *arguments):
        """Return exit code, standard output and standard error."""
        from gva_mi.__main__ import main

        self._monkeypatch.setattr(sys, "argv", ["gva-mi", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code
        captured = self._capsys.readouterr()
        return code, captured.out, captured.err

    def works(self, *arguments):
        """Return the standard output of a command that succeeds."""
        code, out, err = self(*arguments)
        assert code == 0, err
        return out

    def fails(self, *arguments):
        """Return the standard error of a command that refuses its input."""
        code, out, err = self(*arguments)
        assert code == 2, (out, err)
        return err

    def refuses(self, sentence, *arguments):
        """Assert that a command fails with one line that holds a sentence."""
        err = self.fails(*arguments)
        assert sentence in err and err.count("\n") == 1, err


@pytest.fixture
def cli(capsys, monkeypatch):
    return CommandLine(capsys, monkeypatch)


@pytest.fixture(scope="session")
def one_thread():
    """Limit torch to one thread: with busy cores OpenMP's threads would wait for each other."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


# The built-in body before a camera, 96 pixels wide, in three poses.


@pytest.fixture(scope="session")
def body_scene(built_in_body):
    from gva_mi.mesh.mesh_scene import MeshScene

    return MeshScene(built_in_body.faces, built_in_body.v_template)


def _before(body, size, share, away):
    """A camera of so many pixels, some 3 m away, in which a body fills a share of the picture."""
    from gva_mi.splat import Camera, look_at

    low, high = body.v_template.amin(0), body.v_template.amax(0)
    centre = ((low + high) / 2).numpy()
    focal = share * size * 3 / float((high - low).max())
    return Camera(focal, focal, size / 2, size / 2, look_at(centre + away, centre), size, size)


@pytest.fixture(scope="session")
def body_camera(built_in_body):
    return _before(built_in_body, 96, 0.8, (0.2, 0.1, 3))


@pytest.fixture(scope="session")
def true_pose():
    """Three frames in which the arms sink and the trunk turns."""
    import torch

    from gva_mi.body.pose import JOINTS, Pose

    pose, time = Pose.rest(3), torch.tensor([0.0, 1.0, 2.0])
    pose.rotations[:, 0, 1] = 0.15 * time
    pose.rotations[:, JOINTS.index("left_shoulder"), 2] = -0.5 - 0.1 * time
    pose.rotations[:, JOINTS.index("right_shoulder"), 2] = 0.5 + 0.1 * time
    return pose


# A tiny subject rendered from a known avatar: the built-in body in colours, turning before a
# camera. It is made where a test asks for it, so that tests of lower layers import no higher one.


@pytest.fixture(scope="session")
def built_in_body():
    """The built-in body. A folder may override ``body``; session fixtures use this one."""
    from gva_mi.body.smplx import load_body

    return load_body()


@pytest.fixture(scope="session")
def body(built_in_body):
    return built_in_body


@pytest.fixture(scope="session")
def known(built_in_body):
    """The avatar from which the frames of ``subject`` are rendered."""
    import torch

    from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
    from gva_mi.avatar.canonical import SeedOptions
    from gva_mi.body.pose import Shape

    x = built_in_body.v_template
    stripes = 0.5 + 0.4 * torch.sin(torch.stack([9 * x[:, 0], 11 * x[:, 1], 7 * x.sum(1)], dim=1))
    options = AvatarOptions(seed=SeedOptions(count=600, sh_degree=1))
    generator = torch.Generator().manual_seed(5)
    return seed_avatar(built_in_body, Shape(torch.zeros(10)), None, options, generator, stripes)


@pytest.fixture(scope="session")
def camera(built_in_body):
    """A camera of 48 pixels, 3 m before the body."""
    return _before(built_in_body, 48, 0.9, (0, 0, 3))


@pytest.fixture(scope="session")
def turning():
    """Return a function: n frames to a motion of one turn with moving arms, and a shape."""

    import torch

    from gva_mi.body.pose import Pose, Shape

    def motion(frames, start=0.0):
        pose, turn = Pose.rest(frames), torch.arange(frames) / frames
        pose.rotations[:, 0, 1] = start + 2 * torch.pi * turn
        pose.rotations[:, 16, 2] = -0.6 + 0.3 * torch.sin(7 * turn)
        pose.rotations[:, 17, 2] = 0.6 + 0.3 * torch.sin(5 * turn)
        return pose, Shape(torch.zeros(10))

    return motion


@pytest.fixture(scope="session")
def subject(tmp_path_factory, known, camera, turning):
    """A folder of 6 frames with a grey background, alpha as masks; frame 3 is the test frame."""
    from samples.subjects import write_subject

    folder = write_subject(tmp_path_factory.mktemp("subject"), known, camera, *turning(6))
    (folder / "splits.json").write_text(json.dumps({"train": [0, 1, 2, 4, 5], "test": [3]}))
    return folder


@pytest.fixture(scope="session")
def video(subject):
    from gva_mi.subject.video import load_video

    return load_video(subject)


@pytest.fixture(scope="session")
def doubled(subject, tmp_path_factory):
    """The video whose pictures have each pixel four times."""
    from gva_mi.subject.cameras import save_cameras
    from gva_mi.subject.folder import CAMERAS
    from gva_mi.subject.pictures import read_image, write_image
    from gva_mi.subject.video import load_video

    folder = shutil.copytree(subject, tmp_path_factory.mktemp("doubled") / "subject")
    for part, channels in (("frames", 3), ("masks", 1)):
        for file in (folder / part).glob("*.png"):
            write_image(file, read_image(file, channels).repeat(2, 0).repeat(2, 1))
    cameras = [c.resized(2 * c.width, 2 * c.height) for c in load_video(subject).cameras]
    save_cameras(folder / CAMERAS, cameras)
    return load_video(folder)
