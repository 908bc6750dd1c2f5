"""The face of a video's person, after the body is solved: head, jaw and expression.

The solved body gives the head's rotation ``A`` and place ``a`` in every frame. Landmark ``p`` is at
``x_p`` relative to the head's joint (:class:`FacePoints`). Unknown are ``δ``, ``τ``, ``ρ`` and
``ψ`` in every frame, and ``o`` in the whole video:

1. ``X_p = A exp(δ) y_p + a + τ``,   ``y_p = x_p + o_p + ρ b_p + Σ_e ψ_e d_pe``
2. ``E = n/m Σ f_p t_2((π(X_p) - u_p) / σ_p) + Σ |o_p|² / 2 σ_o²``
3. ``E(q) = q_0² / 2 s² + Σ_t (q_t+1 - e q_t)² / 2 s² (1 - e²)``,   ``e = exp(-dt / c)``

The head turns by ``δ``. The jaw opens by ``ρ``, which moves the landmark along ``b``, and the
expression ``ψ`` moves it along ``d``. ``τ`` absorbs errors of the head's place, and is not kept.
A jaw that does not open the mouth stays as it is.
The constant ``o`` absorbs how this person's face differs from the average body's. The points err
together and count as few (``n``), and so do frames (``m``). ``f`` is low if the face is turned away
(:func:`gva_mi.observe.rig.face_weights`).

Every unknown ``q`` of a frame is an Ornstein-Uhlenbeck process of standard deviation ``s`` and
correlation time ``c``. So a frame without a face returns to the body's solution and to a face at
rest, without jumps.

A constant part may be the shape of the face as well as an expression. So the expression is relative
to the video's median, and the mouth is assumed to be closed in some of the frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import compose, to_matrix
from gva_mi.core.cpu import one_torch_thread
from gva_mi.observe.face_points import (
    INDEPENDENT_POINTS,
    OFFSET_SIGMA,
    FacePoints,
    seen_face,
)
from gva_mi.observe.landmark_noise import LANDMARK_CORRELATION_SECONDS
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.stage1.normal_equations import FRAMES_AT_ONCE, NormalEquations
from gva_mi.stage1.solver import Stage1Solution
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

NO_FACE = (
    "this body model has no movable face: head, jaw and expression follow the body landmarks alone"
)
# Of the mouth, metres per radian of the jaw; chosen: a fifth of the built-in body's.
SMALLEST_OPENING = 0.01
CLOSED_SHARE = 0.05  # of the frames with a face, in which the mouth is closed; chosen by eye
GAUSS_NEWTON_STEPS = 6  # chosen by eye


class FaceProcess(NamedTuple):
    """How an unknown of the face varies (eq. 3)."""

    sigma: float  # s
    seconds: float  # c


# Of δ (radians), τ (metres), ρ (radians) and ψ (standard deviations); chosen by eye.
HEAD_TURN, HEAD_PLACE = FaceProcess(0.15, 0.5), FaceProcess(0.03, 1.0)
JAW_OPEN, EXPRESSION = FaceProcess(0.2, 0.3), FaceProcess(1.0, 0.4)
_LIPS = (
    FACE_LANDMARKS.index("face_62"),
    FACE_LANDMARKS.index("face_66"),
)  # middle of the upper and of the lower lip
_HEAD, _JAW = JOINTS.index("head"), JOINTS.index("jaw")


def with_face(
    solved: Stage1Solution, landmarks: Landmarks, body: BodyModel, fps: float
) -> tuple[Stage1Solution, list[str]]:
    """Add head, jaw and expression to the solution of stage 1; return it, and notes.

    Args:
        solved: T frames of the body.
        landmarks: of the same frames; without the points of :data:`FACE_LANDMARKS` nothing changes.
        body: of the poses.
        fps: frames a second.
    """
    if not set(FACE_LANDMARKS) <= set(landmarks.names):
        return solved, []
    if not bool((landmarks.confidence[:, landmarks.indices(FACE_LANDMARKS)] > 0).any()):
        return solved, []
    points = FacePoints.of(body)
    if points is None:
        return solved, [NO_FACE]
    with one_torch_thread(), torch.no_grad():
        problem = _FaceProblem.of(solved, landmarks, body, points, 1 / fps)
        if not bool(problem.precision.any()):  # every face is turned away
            return solved, []
        return replace(solved, pose=problem.solve(solved.pose)), []


@dataclass(frozen=True)
class _FaceProblem:
    """The data of eq. 2: T frames and P landmarks, in the camera's axes; float64.

    Attributes:
        A: (T, 3, 3) rotations of the head.
        a: (T, 3) places of the head, metres.
        x: (P, 3) landmarks relative to the head's joint, metres.
        b: (P, 3) their change with the jaw, metres a radian.
        d: (E, P, 3) their change with the expression, metres a standard deviation.
        pixels: (T, P, 2) landmarks in the picture.
        precision: (T, P) ``f / σ²``; zero without a landmark.
        K: (3, 3) of the camera.
        dt: seconds between frames.
    """

    A: Tensor
    a: Tensor
    x: Tensor
    b: Tensor
    d: Tensor
    pixels: Tensor
    precision: Tensor
    K: Tensor
    dt: float

    @staticmethod
    def of(
        solved: Stage1Solution, landmarks: Landmarks, body: BodyModel, points: FacePoints, dt: float
    ) -> _FaceProblem:
        """Take the head of each frame from the solution, and the landmarks of its face."""
        joints = body.rest(solved.shape).joints.double()
        rotations, transl = solved.pose.rotations.double(), solved.pose.transl.double()
        head = joint_transforms(rotations, joints, PARENTS, transl)[:, _HEAD]
        head = torch.tensor(solved.camera.T_camera_world) @ head
        A, a = head[:, :3, :3], head[:, :3, :3] @ joints[_HEAD] + head[:, :3, 3]
        x = points.at_rest(solved.shape.betas.double())
        right = torch.tensor([1.0, 0, 0], dtype=x.dtype).expand_as(x)
        b = points.jaw[:, None] * torch.linalg.cross(right, x - joints[_JAW])

        K = torch.tensor(solved.camera.K)
        pixels, precision = seen_face(landmarks, A, a, K[0, 0])
        return _FaceProblem(
            A, a, x - joints[_HEAD], b, points.expressions, pixels, precision, K, dt
        )

    def solve(self, pose: Pose) -> Pose:
        """Return the pose with the fitted head, jaw and expression."""
        q = self.A.new_zeros(len(self.A), 7 + len(self.d))
        o = torch.zeros_like(self.x)
        for _ in range(GAUSS_NEWTON_STEPS):
            step, shared = self._equations(q, o).solve(0.0)
            q = torch.cat([compose(q[:, :3], step[:, :3]), (q + step)[:, 3:]], dim=1)
            o = o + shared.view(-1, 3)
        seen = self.precision.any(1)
        expression = q[:, 7:] - q[seen, 7:].median(0).values
        by_jaw, *by_expression = (
            part[_LIPS[0], 1] - part[_LIPS[1], 1] for part in (self.b, *self.d)
        )
        rotations = pose.rotations.clone()
        rotations[:, _HEAD] = compose(rotations[:, _HEAD].double(), q[:, :3]).float()
        if by_jaw > SMALLEST_OPENING:
            # The opening of the mouth, expressed as a rotation of the jaw.
            parted = q[:, 6] + expression @ torch.stack(by_expression) / by_jaw
            opened = (q[:, 6] - torch.quantile(parted[seen], CLOSED_SHARE)).clamp_min(0)
            rotations[:, _JAW, 0] = opened.float()
        return replace(pose, rotations=rotations, expression=expression.float())

    def _equations(self, q: Tensor, o: Tensor) -> NormalEquations:
        """Return the normal equations around unknowns (T, 7 + E) and offsets (P, 3)."""
        equations = NormalEquations.zero(*q.shape, o.numel())
        for start in range(0, len(q), FRAMES_AT_ONCE):
            some = slice(start, start + FRAMES_AT_ONCE)
            self._add_pixels(some, q[some], o, equations)
        self._add_processes(q, equations)
        equations.shared.diagonal().add_(OFFSET_SIGMA**-2)
        equations.shared_pull -= o.flatten() / OFFSET_SIGMA**2
        return equations

    def _add_pixels(self, some: slice, q: Tensor, o: Tensor, equations: NormalEquations) -> None:
        """Add eq. 2 for some frames."""
        turn, place, opened, expression = q.split([3, 3, 1, len(self.d)], dim=1)
        moved = torch.einsum("te,epc->tpc", expression, self.d)
        y = self.x + o + opened[..., None] * self.b + moved
        A = self.A[some] @ to_matrix(turn)
        X = y @ A.mT + (self.a[some] + place)[:, None]
        n, P = X.shape[:2]
        D = X.new_zeros(n, P, 3, q.shape[1])
        axes = torch.eye(3, dtype=X.dtype)
        turned = torch.linalg.cross(axes[:, None, None].expand(3, n, P, 3), y.expand(3, n, P, 3))
        D[..., :3] = (turned @ A.mT).permute(1, 2, 3, 0)
        D[..., 3:6] = axes
        D[..., 6] = self.b @ A.mT
        D[..., 7:] = (self.d @ A[:, None].mT).permute(0, 2, 3, 1)

        focal, z = torch.stack([self.K[0, 0], self.K[1, 1]]), X[..., 2:]
        rays, precision = X[..., :2] / z, self.precision[some]
        r = focal * rays + self.K[:2, 2] - self.pixels[some]
        square = r.square().sum(-1) * precision / STUDENT_DOF
        weights = (STUDENT_DOF + 2) / (STUDENT_DOF * (1 + square)) * precision * self._count
        weights = weights[..., None].expand(-1, -1, 2).flatten(1)
        in_picture = lambda J: (
            (J[..., :2, :] - rays[..., None] * J[..., 2:, :]) * (focal / z)[..., None]
        )
        by_offset = in_picture(A[:, None])  # (n, P, 2, 3)
        by_shared, every = X.new_zeros(n, P, 2, P, 3), torch.arange(P)
        by_shared[:, every, :, every] = by_offset.transpose(0, 1)
        by_shared = by_shared.flatten(3).flatten(1, 2)
        equations.add(some, r.flatten(1), weights, in_picture(D).flatten(1, 2), by_shared)

    @property
    def _count(self) -> float:
        """``n / m`` of one point."""
        return (
            INDEPENDENT_POINTS
            / len(FACE_LANDMARKS)
            / max(1.0, LANDMARK_CORRELATION_SECONDS / self.dt)
        )

    def _add_processes(self, q: Tensor, equations: NormalEquations) -> None:
        """Add eq. 3 for all unknowns of frames."""
        kinds = [HEAD_TURN] * 3 + [HEAD_PLACE] * 3 + [JAW_OPEN] + [EXPRESSION] * len(self.d)
        s, c = q.new_tensor(kinds).unbind(1)
        e = torch.exp(-self.dt / c)
        level, end, slope = (x / (s**2 * (1 + e)) for x in (1 - e, e, e / (1 - e)))
        diagonal = equations.frames.diagonal(dim1=1, dim2=2)
        equations.pull -= level * q
        diagonal += level
        for k in (0, -1):
            equations.pull[k] -= end * q[k]
            diagonal[k] += end
        equations.add_steps(q.diff(dim=0), slope)
