"""A lens a frame: stage 2 sees the person before one of them, and its poses are for them all."""

from dataclasses import dataclass, field, make_dataclass, replace

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.refine import SequenceOptions, refine
from gva_mi.refine.refine import before_one_lens, moved_between_lenses
from gva_mi.splat import Camera

SHORT = SequenceOptions(size=48, faces=2000, passes=1, learn=0)
DOWN = np.diag([1.0, -1, -1, 1])


@dataclass
class Filmed:
    """The parts of a ``Video`` that are looked at."""

    cameras: list
    pose: Pose
    shape: Shape = field(default_factory=lambda: Shape(torch.zeros(10)))


def test_who_stands_still_does_not_move_before_one_lens(body, true_pose):
    """Lenses of SMPLer-X: without it the pelvis jumps by metres. Pictures stay as they are."""
    lens = lambda f, cx, cy: Camera(f, f, cx, cy, DOWN, 900, 900)
    cameras = [lens(9700, 470, 410), lens(10600, 420, 390), lens(9400, 480, 420)]
    at = torch.tensor([[0.2, -0.1, -42.0], [0.4, -0.15, -45.9], [0.16, -0.06, -40.7]])
    video = Filmed(cameras, Pose(true_pose.rotations, at, true_pose.expression))
    steps = lambda pose: pose.transl.diff(dim=0).norm(dim=1)
    assert steps(video.pose).min() > 3
    one = before_one_lens(video, body)
    assert steps(one.pose).max() < 0.3 and len({c.fx for c in one.cameras}) == 1
    for k in range(3):
        seen = [v.cameras[k].project(body(v.pose[k], v.shape).vertices[0].double().numpy())
                for v in (video, one)]  # fmt: skip
        assert np.abs(seen[0] - seen[1]).max() < 1
    back = moved_between_lenses(one.pose, video.shape, body, one.cameras, cameras)
    assert torch.allclose(back.transl, video.pose.transl, atol=1e-4)
    assert torch.allclose(back.rotations, video.pose.rotations, atol=1e-5)
    assert before_one_lens(one, body) is one


def test_a_camera_that_zooms_keeps_its_lenses(body, true_pose):
    """Who stands still through the lenses as they are would move before one lens."""
    cameras = [Camera(f, f, 450, 400, DOWN, 900, 900) for f in (900, 1100, 1300)]
    still = torch.tensor([[0.2, -0.1, -4.0]]).expand(3, 3)
    video = Filmed(cameras, Pose(true_pose.rotations, still, true_pose.expression))
    assert before_one_lens(video, body) is video


def test_stage_2_finds_what_it_finds_through_one_lens(clip, coarse):
    """Of three lenses, the one in between is that of the clip."""
    focal = [0.8, 1.0, 1.25]
    cameras = [replace(c, fx=c.fx * s, fy=c.fy * s)
               for c, s in zip(clip.cameras, focal, strict=True)]  # fmt: skip

    def outlines(self, indices):
        plain = super(kind, self).outlines(indices)
        return (replace(outline, camera=self.cameras[outline.index]) for outline in plain)

    fields = [("cameras", list, None)]
    kind = make_dataclass(
        "Breathing", fields, bases=(type(clip),), namespace={"outlines": outlines}
    )
    breathing = kind(**vars(clip), cameras=cameras)
    # In float64 the way there and back changes no bit of float32, which a descent would amplify.
    exact = clip.pose.to(torch.float64)
    breathing.pose = moved_between_lenses(exact, clip.shape, coarse, clip.cameras, cameras)
    assert (breathing.pose.transl - clip.pose.transl).norm(dim=1)[::2].min() > 0.3
    wanted = refine(clip, coarse, SHORT)
    refined = refine(breathing, coarse, SHORT)
    again = before_one_lens(Filmed(cameras, refined.pose, refined.shape), coarse).pose
    assert (again.transl - wanted.pose.transl).abs().max() < 1e-5
    assert (again.rotations - wanted.pose.rotations).abs().max() < 1e-5
