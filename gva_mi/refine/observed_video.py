"""What is observed of one video before its refinement: the evidence of each frame, and stage 1.

The person is cropped from every frame (:mod:`gva_mi.refine.evidence`). Stage 1 gets the known
height, and its swapped limbs are fixed (:mod:`gva_mi.observe.swaps`).

Some estimators see a person through another lens in each frame. Such poses jump by metres from
frame to frame while the person stands still (:mod:`gva_mi.readers.track`), and the prior
would take that for errors and for motion. So the person is placed before the median lens, where the
pictures show the same (:func:`before_one_lens`), refined there, and placed back
(:func:`as_filmed`). The lenses differ by some percent: nothing else in the pictures changes
visibly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.rotations import composed, shortest
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import one_thread
from gva_mi.core.spill_cache import SpillCache
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.surface import CoarseBody
from gva_mi.observe.rig import SeenLandmarks
from gva_mi.observe.swaps import fix_swaps
from gva_mi.prior.error_model import STAGE1_FPS, Stage1ErrorModel, stage1_errors
from gva_mi.prior.stage1_poses import Stage1
from gva_mi.prior.stature import with_height
from gva_mi.refine.evidence import (
    FinePicture,
    MaskAndNormals,
    close_up_scale,
    common_scale,
    frame_loss,
    parts_of,
)
from gva_mi.refine.sequence import LANDMARK_WEIGHT, ObservedClip, SequenceOptions, Solution
from gva_mi.refine.single_frame import SingleFrameOptions
from gva_mi.splat import Camera
from gva_mi.subject.crop import gather
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.lens import is_one_lens, seen_alike
from gva_mi.subject.video import Outline, Video

RefineOptions = SequenceOptions | SingleFrameOptions  # the type chooses the method


@dataclass(frozen=True)
class ObservedVideo:
    """A video with its evidence."""

    coarse: CoarseBody
    pose: Pose  # stage 1 at the known height, with swapped limbs fixed
    shape: Shape
    options: RefineOptions
    evidence: SpillCache[MaskAndNormals]
    pictures: SpillCache[FinePicture]  # of the frames that have evidence, if there are close-ups
    kept: dict[int, str]  # frames without evidence, and why
    held_out: Sequence[int]  # test frames that are not used
    seconds: float  # time to gather the evidence
    landmarks: SeenLandmarks | None = None
    errors: Mapping[str, Stage1ErrorModel] | None = None  # of the estimator, if they are known
    # Limbs that were fixed, and in which frames.
    swapped: Mapping[str, Sequence[int]] = field(default_factory=dict)

    @staticmethod
    def of(
        video: Video, simplified: Callable[[int, bool], CoarseBody], options: RefineOptions
    ) -> ObservedVideo:
        """Gather the evidence of all frames.

        Args:
            video: before one lens.
            simplified: :func:`simplified_body` of the fitted body.
            options: of the refinement.
        """
        begin = time.perf_counter()
        in_sequence = isinstance(options, SequenceOptions)
        held_out = list(video.splits.test) if in_sequence and options.hold_out_test else []
        coarse, of_video = simplified(options.faces, in_sequence), video.kind == VIDEO_KIND
        evidence, pictures = SpillCache(video.folder), SpillCache(video.folder)

        def body_at(outline: Outline) -> Tensor:
            return coarse.body(outline.pose, video.shape).vertices[0]

        def look(outline: Outline) -> MaskAndNormals:
            points = body_at(outline)
            whole = MaskAndNormals.of(outline, scale, points)
            if fine is not None:
                pictures[outline.index] = FinePicture.of(outline, fine, points, of_video)
            return whole

        frames = [k for k in range(len(video)) if k not in held_out]
        with one_thread(), torch.no_grad():
            scale = common_scale(video, frames, options.size, body_at)
            person = coarse.body, video.pose, video.shape, video.cameras
            fine = close_up_scale(*person, scale) if in_sequence else None
            kept = gather(frames, video.absent, video.outlines, look, evidence)
        # Without close-ups, hands and feet need no more triangles than the rest.
        compared = coarse if pictures else simplified(options.faces, False)
        pose, shape = video.pose.to(torch.float32), Shape(video.shape.betas.to(torch.float32))
        if in_sequence and options.height is not None:
            pose, shape = with_height(coarse.body, pose, shape, video.cameras, options.height)
        seen = evidence, pictures, kept, held_out, 0.0
        found = ObservedVideo(compared, pose, shape, options, *seen)
        if in_sequence:
            found = found._with_stage1(video)
        return replace(found, seconds=time.perf_counter() - begin)

    def _with_stage1(self, video: Video) -> ObservedVideo:
        """Return it with what stage 1 saw and how it errs, and with swapped limbs fixed."""
        fps, found = video.fps or STAGE1_FPS, self
        if video.landmarks is not None:
            stage1 = self.pose, self.shape
            seen = video.landmarks, self.coarse.body, video.cameras, fps, stage1
            found = replace(self, landmarks=SeenLandmarks.of(*seen))
        errors = stage1_errors(fps) if video.kind == VIDEO_KIND else None
        stage1_person = Solution(
            self.pose, self.shape, torch.zeros_like(self.coarse.body.v_template)
        )
        stage1 = Stage1.of(self.pose, range(len(self.pose)), video.cameras[0])
        losses = lambda pose: found.losses(pose, stage1_person)
        pose, swapped = fix_swaps(stage1, losses, self.options.prior_weight)
        return replace(found, pose=pose, errors=errors, swapped=swapped)

    def clip(
        self, frames: Sequence[int], first: int, pose: Pose, known: Solution | None = None
    ) -> ObservedClip:
        """Return what was observed of some frames, numbered from ``first`` on, as in ``pose``.

        ``known`` is the solution of a first round.
        """
        numbers = range(first, first + len(pose))
        return ObservedClip(
            self.evidence.part(frames, first),
            self.coarse.body,
            pose,
            self.shape,
            known,
            fine=self.pictures.part(frames, first),
            following=[k - first for k in frames if k in self.held_out],
            landmarks=self.landmarks and self.landmarks.part(numbers),
            errors=self.errors,
        )

    @torch.no_grad()
    def losses(self, pose: Pose, person: Solution) -> Tensor:
        """Return the evidence's loss (T,) in T poses, without close-ups; NaN where there is none.

        ``person`` gives the shape, the clothes and the landmarks' offsets.
        """
        losses = torch.full((len(pose),), torch.nan)
        body, transforms = self.coarse.body, []
        scene = MeshScene(body.faces, body.v_template)
        with one_thread():
            for k, seen in self.evidence.items():
                posed = body(pose[k], person.shape, person.offsets)
                views, weight = [(1.0, seen)], self.options.silhouette
                losses[k], _ = frame_loss(scene, posed.vertices[0], views, weight, False)
                transforms.append(posed.T_world_rest)
            if self.landmarks is not None and transforms:
                offsets = person.landmark_offsets
                if offsets is None:
                    offsets = torch.zeros_like(self.landmarks.rig.rest)
                frames = list(self.evidence)
                where = torch.cat(transforms), person.shape, offsets
                losses[frames] += LANDMARK_WEIGHT * self.landmarks.losses(frames, *where)
        return losses


def simplified_body(body: BodyModel, faces: int, close_ups: bool) -> CoarseBody:
    """Return the body that is compared, finer at hands and feet if there are close-ups."""
    finer = torch.cat([part.vertices for part in parts_of(body)]) if close_ups else None
    return CoarseBody(body, faces, finer)


def before_one_lens(video: Video, body: BodyModel) -> Video:
    """Return the video with one lens in all frames, and with poses that look the same through it.

    A video of one lens is returned as it is. So is one whose person moves no less before one lens:
    its lenses are real, as of a camera that zooms.
    """
    K = np.stack([camera.K for camera in video.cameras])
    if is_one_lens(K):
        return video
    fx, fy, cx, cy = np.median(K[:, [0, 1, 0, 1], [0, 1, 2, 2]], axis=0).tolist()
    cameras = [replace(camera, fx=fx, fy=fy, cx=cx, cy=cy) for camera in video.cameras]
    pose = as_filmed(video.pose, video.shape, body, video.cameras, cameras).to(torch.float32)
    if _usual_step(pose) >= _usual_step(video.pose):
        return video
    return replace(video, cameras=cameras, pose=pose)


def as_filmed(
    pose: Pose,
    shape: Shape,
    body: BodyModel,
    cameras: Sequence[Camera],
    others: Sequence[Camera],
) -> Pose:
    """Return the poses that ``others``, at the same places, see as ``cameras`` see these.

    The person turns with the ray on which the pelvis is seen.
    """
    pelvis = body.rest(shape).joints[0].detach().double().numpy()
    T = np.stack([camera.T_camera_world for camera in cameras])
    R, t = T[:, :3, :3], T[:, :3, 3]
    K, K_others = (np.stack([camera.K for camera in some]) for some in (cameras, others))
    places = np.einsum("nij,nj->ni", R, pose.transl.double().numpy() + pelvis) + t
    moved = seen_alike(places, K, K_others)
    back = lambda x: np.einsum("nji,nj->ni", R, x)
    rotations = pose.rotations.double().numpy().copy()
    rotations[:, 0] = composed(back(shortest(places, moved)), rotations[:, 0])
    tensor = lambda x: torch.from_numpy(x).to(pose.transl)
    return Pose(tensor(rotations), tensor(back(moved - t) - pelvis), pose.expression)


def _usual_step(pose: Pose) -> float:
    """Return the median way of the root from frame to frame, metres; 0 for a single frame."""
    steps = pose.transl.diff(dim=0).norm(dim=1)
    return float(steps.median()) if len(steps) else 0.0
