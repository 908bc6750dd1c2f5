"""``prepare`` with networks that people bring: Segment Anything's masks, a network's normals."""

import json

import numpy as np
import pytest
import torch
from samples.networks import onnx_file

from gva_mi.body.pose import Shape
from gva_mi.body.smplx import load_body
from gva_mi.networks.segment_anything import MaskGuess, SegmentAnything
from gva_mi.readers.people import prompts_of
from gva_mi.readers.track import Track
from gva_mi.subject.lens import centred
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

WIDTH, HEIGHT, FRAMES = 192, 144, 5
SMPL = np.array([-0.0018, -0.2233, 0.0282])  # the pelvis
FOCAL = np.hypot(WIDTH, HEIGHT)  # what WHAM assumes


@pytest.fixture
def people(seen):
    """The person of ``seen``, and somebody else 1.2 m to their left, as tracks."""
    rotations, transl = seen
    both = []
    for name, aside in (("0", 0.0), ("1", -1.2)):
        both.append(Track(
            name, np.arange(FRAMES), rotations, transl + SMPL + (aside, 0.0, 0.0), None,
            np.tile(centred(FOCAL, (WIDTH, HEIGHT)), (FRAMES, 1, 1)), "SMPL", False,
        ))  # fmt: skip
    return both


@pytest.fixture
def joints():
    return load_body().rest(Shape(torch.zeros(0))).joints.double().numpy()


def test_boxes_and_points_are_where_the_person_is(people, joints):
    person, other = people
    prompts = prompts_of(person, [other], joints, (WIDTH, HEIGHT))
    pelvis = person.places
    wanted = FOCAL * pelvis[:, :2] / pelvis[:, 2:] + (WIDTH / 2, HEIGHT / 2)
    for prompt, place in zip(prompts, wanted, strict=True):
        own = prompt.points[prompt.labels == 1]
        assert np.abs(own[0] - place).max() < 1e-6 and len(own) == 6
        left, top, right, bottom = prompt.box
        assert ((own >= prompt.box[:2]) & (own <= prompt.box[2:])).all()
        # From head to toe: 1.5 to 2 metres, at this distance.
        assert 1.4 < (bottom - top) * pelvis[0, 2] / FOCAL < 2.1
        theirs = prompt.points[prompt.labels == 0]
        assert len(theirs) == 6 and (theirs[:, 0] < own[:, 0].min()).all()
    near = prompts_of(person, [person], joints, (WIDTH, HEIGHT))
    assert all((prompt.labels == 1).all() for prompt in near)
    away = Track(**{**vars(person), "places": person.places + (50.0, 0, 0)})
    behind = Track(**{**vars(person), "places": person.places * (1, 1, -1)})
    assert prompts_of(away, [], joints, (WIDTH, HEIGHT)) == [None] * FRAMES
    assert prompts_of(behind, [], joints, (WIDTH, HEIGHT)) == [None] * FRAMES


def draw(folder, prompts):
    """Frames with a bright ellipse in each box, and what it covers."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    random, masks = np.random.default_rng(0), []
    for k, prompt in enumerate(prompts):
        (left, top), (right, bottom) = prompt.box.reshape(2, 2)
        inside = (2 * x - left - right) ** 2 / (right - left) ** 2
        inside = inside + (2 * y - top - bottom) ** 2 / (bottom - top) ** 2 < 1
        image = random.integers(60, 90, (HEIGHT, WIDTH, 3)).astype(np.uint8)
        image[inside] = (225, 215 - 10 * k, 240)
        write_image(folder / f"shot_{k}.png", image)
        masks.append(inside)
    return masks


@pytest.fixture
def wham_file(wham, people):
    return wham(**{f"_{track.person}": (track.rotations, track.places - SMPL) for track in people})


class Bright:
    """A network that finds what is bright, and in the last frame nobody."""

    def find(self, image, prompt, before):
        mask = image.min(axis=-1) > 150
        assert mask[tuple(np.floor(prompt.points[0, ::-1]).astype(int))]
        return MaskGuess(mask & (image.max() != 240 or image[mask].min() > 180), None, None)


def test_masks_by_segment_anything(tmp_path, cli, monkeypatch, people, joints, wham_file):
    monkeypatch.setattr(SegmentAnything, "load", staticmethod(lambda path: Bright()))
    drawn = draw(tmp_path / "shots", prompts_of(people[0], [], joints, (WIDTH, HEIGHT)))
    out = tmp_path / "subject"
    (tmp_path / "sam").mkdir()
    (tmp_path / "sam/config.json").write_text("{}")
    given = ["--body", "built-in", "--frames", tmp_path / "shots", "--person", "0"]
    said = cli.works("prepare", "auto", wham_file, out, *given, "--masks", tmp_path / "sam")
    assert "frames where the network found nobody: 4" in said
    video = load_video(out)
    assert set(video.absent) == {4}
    for frame, inside in zip(video.frames(range(4)), drawn, strict=False):
        assert np.array_equal(frame.mask > 0.5, inside)
    about = json.loads((out / "prepare.json").read_text())["source"]
    assert about["masks"] == str(tmp_path / "sam")


def test_normals_by_a_network(tmp_path, cli, people, joints, wham_file):
    prompts = prompts_of(people[0], [], joints, (WIDTH, HEIGHT))
    drawn = draw(tmp_path / "shots", prompts)
    np.save(tmp_path / "masks.npy", np.stack(drawn) & (np.arange(FRAMES) != 2)[:, None, None])
    onnx_file(tmp_path / "normals.onnx")
    given = [
        "--body", "built-in", "--frames", tmp_path / "shots", "--masks", tmp_path / "masks.npy",
        "--person", "0", "--normals", tmp_path / "normals.onnx",
    ]  # fmt: skip
    out = tmp_path / "subject"
    err = cli.fails("prepare", "wham", wham_file, out, *given)
    assert "--normals needs --normals-convention" in err
    said = cli.works("prepare", "wham", wham_file, out, *given,
                          "--normals-convention", "opengl")  # fmt: skip
    assert "normals of 4 frames by normals.onnx, opengl" in said
    video = load_video(out)
    assert set(video.absent) == {2} and not (out / "normals/000002.png").exists()
    for k in (0, 1, 3, 4):
        frame = video[k]
        normals = frame.normals[frame.mask > 0.5]
        assert (np.linalg.norm(normals, axis=1) > 0.99).mean() > 0.98
        middle = np.median(normals, axis=0)
        y = min(0.6, (215 - 10 * k) / 127.5 - 1)  # of green; red gives the greatest x
        assert np.abs(middle - (0.6, -y, -np.sqrt(1 - 0.36 - y * y))).max() < 0.02
