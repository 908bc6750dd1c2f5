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
from gva_mi.body.smplx import BodyModel, columns_of
from gva_mi.body.so3 import compose, to_matrix
from gva_mi.core.cpu import one_torch_thread
from gva_mi.observe.landmark_noise import LANDMARK_CORRELATION_SECONDS
from gva_mi.observe.rig import face_weights
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.stage1.normal_equations import FRAMES_AT_ONCE, NormalEquations
from gva_mi.stage1.solver import Stage1Solution
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

NO_FACE = (
    "this body model has no movable face: head, jaw and expression follow the body landmarks alone"
)
# σ of eq. 2: on the face (metres) and in the picture (pixels), which add up; by eye.
POINT_SIGMA_METRES, POINT_SIGMA_PIXELS = 0.003, 0.8
INDEPENDENT_POINTS = 6.0  # n: all 51 points count as so many independent ones; by eye
OFFSET_SIGMA = 0.006  # σ_o, metres; chosen by eye
# Of the mouth, metres per radian of the jaw; chosen: a fifth of the built-in body's.
SMALLEST_OPENING = 0.01
CLOSED_SHARE = 0.05  # of the frames with a face, in which the mouth is closed; chosen by eye
GAUSS_NEWTON_STEPS = 6  # chosen by eye
FITTED_EXPRESSIONS = 10  # coefficients that are fitted, at most: SMPL-X's usual number


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
_HEAD, _JAW, _LEFT, _RIGHT = (
    JOINTS.index(n) for n in ("head", "jaw", "left_eye_smplhf", "right_eye_smplhf")
)
# Places in an average face, x to the person's left and y upward, in distances between the eyes;
# chosen. Of two symmetric points only the right one is given, which has the lower number.
_FROM_EYES = {  # from the middle of the eyes
    17: (-0.83, 0.32), 18: (-0.74, 0.37), 19: (-0.60, 0.40), 20: (-0.45, 0.41), 21: (-0.23, 0.37),
    27: (0, 0.12), 28: (0, -0.02), 29: (0, -0.23), 30: (0, -0.42), 31: (-0.26, -0.58),
    32: (-0.13, -0.60), 33: (0, -0.62), 36: (-0.69, 0.03), 37: (-0.60, 0.10), 38: (-0.43, 0.12),
    39: (-0.29, 0.0), 40: (-0.41, -0.08), 41: (-0.56, -0.08),
}  # fmt: skip
_FROM_MOUTH = {  # from the middle of the mouth
    48: (-0.37, 0.02), 49: (-0.23, 0.17), 50: (-0.09, 0.20), 51: (0, 0.19), 57: (0, -0.22),
    58: (-0.09, -0.22), 59: (-0.22, -0.16), 60: (-0.30, 0.02), 61: (-0.09, 0.03), 62: (0, 0.03),
    66: (0, -0.03), 67: (-0.09, -0.03),
}  # fmt: skip
_MIRROR = {
    17: 26, 18: 25, 19: 24, 20: 23, 21: 22, 31: 35, 32: 34, 36: 45, 37: 44, 38: 43, 39: 42, 40: 47,
    41: 46, 48: 54, 49: 53, 50: 52, 58: 56, 59: 55, 60: 64, 61: 63, 67: 65,
}  # fmt: skip
_ON_JAW = {55, 56, 57, 58, 59, 65, 66, 67}


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
        at = landmarks.indices(FACE_LANDMARKS)
        pixels, confidence, spread = (
            torch.from_numpy(getattr(landmarks, name)[:, at]).double()
            for name in ("pixels", "confidence", "spread")
        )
        square = (POINT_SIGMA_METRES * K[0, 0] / a[:, 2:]) ** 2 + POINT_SIGMA_PIXELS**2 + spread**2
        seen = pixels.isfinite().all(2)
        precision = torch.where(seen, face_weights(A, a)[:, None] * confidence / square, 0.0)
        pixels = torch.where(seen[..., None], pixels, 0.0)
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


@dataclass(frozen=True)
class FacePoints:
    """The 51 landmarks of :data:`gva_mi.subject.landmarks.FACE_LANDMARKS` on a body; float64.

    SMPL-X's files mark them. On another body they follow from the shape of the head: the joints of
    the eyes give the middle, the width and the height of the face, and the mouth is where the skin
    of the jaw begins. A landmark is the vertex at the front that is nearest to its place in an
    average face.

    Attributes:
        rest: (51, 3) metres, in the T-pose of the mean person.
        betas: (B, 51, 3) change per standard deviation of each beta, metres.
        expressions: (E, 51, 3) change per standard deviation of the expression, metres.
        jaw: (51,) share of the jaw in their skinning weights; the rest is the head's.
    """

    rest: Tensor
    betas: Tensor
    expressions: Tensor
    jaw: Tensor

    @staticmethod
    def of(body: BodyModel) -> FacePoints | None:
        """Find the landmarks; None if the body has no eyes, no jaw or no expression."""
        corners, shares = body.mark_corners, body.mark_shares
        if corners is None:
            at = _vertices(body)
            if at is None:
                return None
            corners, shares = at[:, None], body.v_template.new_ones(len(at), 1)
        if not body.num_expressions:
            return None

        def moves(rows: Tensor) -> Tensor:
            some = columns_of(rows, corners.flatten(), len(body.v_template))
            some = some[:, : 3 * corners.numel()].unflatten(1, (3, *corners.shape))
            return (some * shares).sum(-1).mT.double()

        return FacePoints(
            (body.v_template[corners] * shares[..., None]).sum(1).double(),
            moves(body.shape_directions),
            moves(body.expression_directions[:FITTED_EXPRESSIONS]),
            (body.weights[corners, _JAW] * shares).sum(1).double(),
        )

    def at_rest(self, betas: Tensor) -> Tensor:
        """Return the landmarks (51, 3) of a shape (B,), metres; missing betas count as zero."""
        betas = betas[: len(self.betas)]
        return self.rest + torch.einsum("b,bpc->pc", betas, self.betas[: len(betas)])


def _vertices(body: BodyModel) -> Tensor | None:
    """Return the vertex (51,) of each landmark; None without eyes or jaw."""
    v, eyes = body.v_template, body.j_template[[_LEFT, _RIGHT]]
    middle, wide = eyes.mean(0), (eyes[0] - eyes[1]).norm()
    jaw = body.weights[:, _JAW]
    front = (body.weights[:, _HEAD] + jaw > 0.5) & (v[:, 2] > middle[2] - 0.3 * wide)
    hangs = front & (jaw > 0.5)
    across = hangs & ((v[:, 0] - middle[0]).abs() < 0.15 * wide)
    if float(wide) < 0.02 or not bool(across.any()):
        return None
    mouth = torch.stack([middle[0], v[across, 1].max()])

    def nearest(number: int, goal: Tensor) -> int:
        among = front & (jaw > 0.5 if number in _ON_JAW else jaw < 0.5 if number > 47 else jaw < 2)
        apart = (v[:, :2] - goal).norm(dim=1) - 0.2 * v[:, 2]  # of equally near ones, the foremost
        return int(torch.where(among, apart, torch.inf).argmin())

    found = {}
    for places, origin in ((_FROM_EYES, middle[:2]), (_FROM_MOUTH, mouth)):
        for number, (x, y) in places.items():
            found[number] = nearest(number, origin + wide * v.new_tensor([x, y]))
            if number in _MIRROR:
                other = _MIRROR[number]
                found[other] = nearest(other, origin + wide * v.new_tensor([-x, y]))
    return torch.tensor([found[number] for number in sorted(found)])
