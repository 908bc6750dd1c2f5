"""The face of a film's person, after the body is solved: head, jaw and expression.

With the head's rotation ``A`` and place ``a`` in the solved body, and with the landmark ``p`` of
:mod:`gva_mi.pose.film.face_points` at ``x_p`` relative to the head's joint, a frame has the
unknowns ``δ``, ``τ``, ``ρ`` and ``ψ``, and the film has ``o``:

1. ``X_p = A exp(δ) y_p + a + τ``,   ``y_p = x_p + o_p + ρ b_p + Σ_e ψ_e d_pe``
2. ``E = n/m Σ f_p t_2((π(X_p) - u_p) / σ_p) + Σ |o_p|² / 2 loose²``
3. ``E(q) = q_0² / 2 s² + Σ_t (q_t+1 - e q_t)² / 2 s² (1 - e²)``,   ``e = exp(-dt / c)``

The head turns by ``δ``. The jaw opens by ``ρ``, which moves the landmark along ``b``, and the
expression ``ψ`` moves it along ``d``. ``τ`` stands for errors of the head's place, and is not kept.
A person's nose and lips are not where the average body has them: ``o`` is constant. The points err
together and count as few, and so do frames (``n``, ``m``). A face seen aslant is read badly:
``f = cos(angle to the camera)^8``.

Every unknown ``q`` of a frame is an Ornstein-Uhlenbeck process of standard deviation ``s`` and
memory ``c``. A frame without a face leads back to the body's solution and to a face at rest, and
nothing jumps.

What is constant in a film is the person's own face as much as their expression. So the expression
is relative to the film's median, and the mouth is taken to be closed in some of the frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import compose, to_matrix
from gva_mi.core.cpu import one_torch_thread
from gva_mi.data.landmarks import FACE, Landmarks
from gva_mi.pose.film.face_points import FacePoints
from gva_mi.pose.film.landmark_noise import MEMORY
from gva_mi.pose.film.normal_equations import CHUNK, NormalEquations
from gva_mi.pose.film.solver import SolvedFilm
from gva_mi.pose.prior.error_model import FREEDOM

NO_FACE = "the body has no face that moves: head, jaw and expression stay as the body's points say"
METRES, PIXELS = 0.003, 0.8  # σ of a point on the face, and in the picture: both together
TOGETHER = 6.0  # as many independent points count all of the face
LOOSE = 0.006  # metres
# s and c (seconds) of δ, τ, ρ and ψ: radians, metres, radians, standard deviations.
TURN, PLACE, OPEN, EXPRESSION = (0.15, 0.5), (0.03, 1.0), (0.2, 0.3), (1.0, 0.4)
CLOSED = 0.05  # share of the frames with a face in which the mouth is closed
STEPS = 6
_LIPS = FACE.index("face_62"), FACE.index("face_66")  # the middle of the upper and the lower one
_HEAD, _JAW = JOINTS.index("head"), JOINTS.index("jaw")


def with_face(
    solved: SolvedFilm, landmarks: Landmarks, body: BodyModel, fps: float
) -> tuple[SolvedFilm, list[str]]:
    """Return stage 1 of a film with the face in it, and notes.

    Args:
        solved: T frames of the body.
        landmarks: of the same frames; without those of :data:`FACE` nothing changes.
        body: of the poses.
        fps: frames a second.
    """
    if not set(FACE) <= set(landmarks.names):
        return solved, []
    if not bool((landmarks.confidence[:, landmarks.indices(FACE)] > 0).any()):
        return solved, []
    points = FacePoints.of(body)
    if points is None:
        return solved, [NO_FACE]
    with one_torch_thread(), torch.no_grad():
        problem = _FaceProblem.of(solved, landmarks, body, points, 1 / fps)
        return replace(solved, pose=problem.solve(solved.pose)), []


def facing(A: Tensor, a: Tensor) -> Tensor:
    """Return ``f`` (T,) of a head's rotations (T, 3, 3) and places (T, 3) in the camera's axes."""
    return (-(A[:, :, 2] * normalize(a, dim=1)).sum(1)).clamp_min(0) ** 8


@dataclass(frozen=True)
class _FaceProblem:
    """T frames and P landmarks, in the camera's axes; float64.

    Attributes:
        A: (T, 3, 3), ``a`` (T, 3) metres.
        x, b: (P, 3), ``d`` (E, P, 3): metres, metres a radian, metres a standard deviation.
        pixels: (T, P, 2) landmarks.
        precision: (T, P) ``f / σ²``; zero without a landmark.
        K: (3, 3) of the camera.
        dt: seconds.
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
        solved: SolvedFilm, landmarks: Landmarks, body: BodyModel, points: FacePoints, dt: float
    ) -> _FaceProblem:
        """Take the head of each frame, and what was seen of its face."""
        joints = body.rest(solved.shape).joints.double()
        rotations, transl = solved.pose.rotations.double(), solved.pose.transl.double()
        head = joint_transforms(rotations, joints, PARENTS, transl)[:, _HEAD]
        head = torch.tensor(solved.camera.T_camera_world) @ head
        A, a = head[:, :3, :3], head[:, :3, :3] @ joints[_HEAD] + head[:, :3, 3]
        x = points.at_rest(solved.shape.betas.double())
        right = torch.tensor([1.0, 0, 0], dtype=x.dtype).expand_as(x)
        b = points.jaw[:, None] * torch.linalg.cross(right, x - joints[_JAW])

        K = torch.tensor(solved.camera.K)
        at = landmarks.indices(FACE)
        pixels, confidence, spread = (
            torch.from_numpy(getattr(landmarks, name)[:, at]).double()
            for name in ("pixels", "confidence", "spread")
        )
        square = (METRES * K[0, 0] / a[:, 2:]) ** 2 + PIXELS**2 + spread**2
        seen = pixels.isfinite().all(2)
        precision = torch.where(seen, facing(A, a)[:, None] * confidence / square, 0.0)
        pixels = torch.where(seen[..., None], pixels, 0.0)
        return _FaceProblem(
            A, a, x - joints[_HEAD], b, points.expressions, pixels, precision, K, dt
        )

    def solve(self, pose: Pose) -> Pose:
        """Return the pose with the face in it."""
        q = self.A.new_zeros(len(self.A), 7 + len(self.d))
        o = torch.zeros_like(self.x)
        for _ in range(STEPS):
            step, shared = self._equations(q, o).solve(0.0)
            q = torch.cat([compose(q[:, :3], step[:, :3]), (q + step)[:, 3:]], dim=1)
            o = o + shared.view(-1, 3)
        seen = self.precision.any(1)
        expression = q[:, 7:] - q[seen, 7:].median(0).values
        by_jaw, *by_expression = (
            part[_LIPS[0], 1] - part[_LIPS[1], 1] for part in (self.b, *self.d)
        )
        # The mouth's opening, as if by the jaw alone.
        parted = q[:, 6] + expression @ torch.stack(by_expression) / by_jaw
        opened = (q[:, 6] - torch.quantile(parted[seen], CLOSED)).clamp_min(0)
        rotations = pose.rotations.clone()
        rotations[:, _HEAD] = compose(rotations[:, _HEAD].double(), q[:, :3]).float()
        rotations[:, _JAW, 0] = opened.float()
        return replace(pose, rotations=rotations, expression=expression.float())

    def _equations(self, q: Tensor, o: Tensor) -> NormalEquations:
        """Return the normal equations around unknowns (T, 7 + E) and offsets (P, 3)."""
        equations = NormalEquations.zero(*q.shape, o.numel())
        for start in range(0, len(q), CHUNK):
            some = slice(start, start + CHUNK)
            self._add_pixels(some, q[some], o, equations)
        self._add_processes(q, equations)
        equations.shared.diagonal().add_(LOOSE**-2)
        equations.shared_pull -= o.flatten() / LOOSE**2
        return equations

    def _add_pixels(self, some: slice, q: Tensor, o: Tensor, equations: NormalEquations) -> None:
        """Add the landmarks of some frames."""
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
        square = r.square().sum(-1) * precision / FREEDOM
        weights = (FREEDOM + 2) / (FREEDOM * (1 + square)) * precision * self._count
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
        """``n / m``."""
        return TOGETHER / len(FACE) / max(1.0, MEMORY / self.dt)

    def _add_processes(self, q: Tensor, equations: NormalEquations) -> None:
        """Add eq. 3."""
        kinds = [TURN] * 3 + [PLACE] * 3 + [OPEN] + [EXPRESSION] * len(self.d)
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
