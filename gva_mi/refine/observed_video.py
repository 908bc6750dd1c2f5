"""What is observed of one video before its refinement: the evidence of each frame, and stage 1.

The person is cropped from every frame (:mod:`gva_mi.refine.image_evidence`). Stage-1 poses get the
known height, and their swapped limbs are fixed (:mod:`gva_mi.observe.swaps`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import one_thread
from gva_mi.core.spill_cache import SpillCache
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.surface import CoarseBody
from gva_mi.observe.swaps import fix_swaps
from gva_mi.prior.body_height import with_height
from gva_mi.prior.error_model import DEFAULT_FPS, Stage1ErrorModel, stage1_errors
from gva_mi.prior.stage1_poses import Stage1Poses
from gva_mi.refine.close_ups import FinePicture, WeightedView, close_up_scale, parts_of
from gva_mi.refine.frame_losses import frame_loss
from gva_mi.refine.image_evidence import MaskAndNormals, common_scale
from gva_mi.refine.landmark_evidence import SeenLandmarks
from gva_mi.refine.sequence import LANDMARK_WEIGHT, ObservedClip, SequenceOptions, Solution
from gva_mi.refine.single_frame import SingleFrameOptions
from gva_mi.subject.crop import gather
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.video import FrameWithoutPicture, Video

RefineOptions = SequenceOptions | SingleFrameOptions  # the type chooses the method


@dataclass(frozen=True)
class ObservedVideo:
    """A video with its evidence.

    Attributes:
        coarse: the body that is compared.
        pose: stage 1 at the known height, with swapped limbs fixed.
        shape: of the person.
        options: of the refinement.
        evidence: masks and normals, by frame.
        pictures: for close-ups, of the frames that have evidence; empty: no close-ups.
        kept: frames without evidence, and why.
        held_out: test frames that are not used.
        seconds: time to gather the evidence.
        landmarks: of all frames.
        known_errors: of the estimator, by group of joints; None: inferred.
        swapped: "legs" or "arms" that were fixed, and in which frames.
    """

    coarse: CoarseBody
    pose: Pose
    shape: Shape
    options: RefineOptions
    evidence: SpillCache[MaskAndNormals]
    pictures: SpillCache[FinePicture]
    kept: dict[int, str]
    held_out: Sequence[int]
    seconds: float
    landmarks: SeenLandmarks | None = None
    known_errors: Mapping[str, Stage1ErrorModel] | None = None
    swapped: Mapping[str, Sequence[int]] = field(default_factory=dict)

    @staticmethod
    def of(
        video: Video, simplified: Callable[[int, bool], CoarseBody], options: RefineOptions
    ) -> ObservedVideo:
        """Gather the evidence of all frames.

        Args:
            video: with one lens (:mod:`gva_mi.refine.refine`).
            simplified: :func:`simplified_body` of the body that poses move.
            options: of the refinement.
        """
        begin = time.perf_counter()
        in_sequence = isinstance(options, SequenceOptions)
        held_out = list(video.splits.test) if in_sequence and options.hold_out_test else []
        coarse, of_video = simplified(options.faces, in_sequence), video.kind == VIDEO_KIND
        evidence, pictures = SpillCache(video.folder), SpillCache(video.folder)

        def body_at(outline: FrameWithoutPicture) -> Tensor:
            return coarse.body(outline.pose, video.shape).vertices[0]

        def look(outline: FrameWithoutPicture) -> MaskAndNormals:
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
        found = ObservedVideo(
            coarse=compared,
            pose=pose,
            shape=shape,
            options=options,
            evidence=evidence,
            pictures=pictures,
            kept=kept,
            held_out=held_out,
            seconds=0.0,
        )
        if in_sequence:
            found = found._with_landmarks(video)._with_swaps_fixed(video)
        return replace(found, seconds=time.perf_counter() - begin)

    def _with_landmarks(self, video: Video) -> ObservedVideo:
        """Add landmarks, if any, and the known errors of a video that our stage 1 solved."""
        of_stage1 = video.kind == VIDEO_KIND
        errors = stage1_errors(video.fps or DEFAULT_FPS) if of_stage1 else None
        if video.landmarks is None:
            return replace(self, known_errors=errors)
        person = self.coarse.whole, video.cameras, self.pose, self.shape
        seen = SeenLandmarks.of(video.landmarks, *person)
        return replace(self, landmarks=seen, known_errors=errors)

    def _with_swaps_fixed(self, video: Video) -> ObservedVideo:
        """Exchange limbs that stage 1 swapped, by the evidence."""
        bare = torch.zeros_like(self.coarse.body.v_template)
        person = Solution(self.pose, self.shape, bare)
        stage1 = Stage1Poses.of(self.pose, range(len(self.pose)), video.cameras[0])
        losses = lambda pose: self.losses(pose, person)
        pose, swapped = fix_swaps(stage1, losses, self.options.prior_weight)
        return replace(self, pose=pose, swapped=swapped)

    def clip(
        self, frames: Sequence[int], first: int, pose: Pose, first_round: Solution | None = None
    ) -> ObservedClip:
        """Return what was observed of the given frames.

        Args:
            frames: their numbers.
            first: number of the first frame of ``pose``.
            pose: stage 1 of consecutive frames, of which ``frames`` are some.
            first_round: solution whose shared unknowns are kept; None: they are to be found.
        """
        numbers = range(first, first + len(pose))
        return ObservedClip(
            evidence=self.evidence.part(frames, first),
            body=self.coarse.body,
            pose=pose,
            shape=self.shape,
            first_round=first_round,
            fine=self.pictures.part(frames, first),
            filled_in=[k - first for k in frames if k in self.held_out],
            landmarks=self.landmarks and self.landmarks.part(numbers),
            known_errors=self.known_errors,
        )

    @torch.no_grad()
    def losses(self, pose: Pose, person: Solution) -> Tensor:
        """Return the loss of the evidence (T,) in T poses, without close-ups; NaN without evidence.

        ``person`` gives the shape, the clothes and the landmarks' offsets.
        """
        losses = torch.full((len(pose),), torch.nan)
        body, transforms = self.coarse.body, []
        scene = MeshScene(body.faces, body.v_template)
        with one_thread():
            for k, seen in self.evidence.items():
                posed = body(pose[k], person.shape, person.offsets)
                views, weight = [WeightedView(1.0, seen)], self.options.silhouette
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
