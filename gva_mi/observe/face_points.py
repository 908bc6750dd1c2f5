"""The 51 landmarks of a face: where they sit on the body, and how well a video shows them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS
from gva_mi.body.smplx import BodyModel, columns_of
from gva_mi.observe.rig import LandmarkRig, face_weights
from gva_mi.subject.landmarks import FACE_LANDMARKS, Landmarks

# σ on the face (metres) and in the picture (pixels), which add up; by eye.
POINT_SIGMA_METRES, POINT_SIGMA_PIXELS = 0.003, 0.8
INDEPENDENT_POINTS = 6.0  # all 51 points count as so many independent ones; by eye
OFFSET_SIGMA = 0.006  # metres, of a person's face from the average body's; chosen by eye
NOSE_AND_EYES = [FACE_LANDMARKS.index(f"face_{number}") for number in range(27, 48)]
FITTED_EXPRESSIONS = 10  # coefficients that are fitted, at most: SMPL-X's usual number
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

    def nose_and_eyes(self) -> LandmarkRig:
        """Return nose and eyes, which move with the head alone; float32."""
        return LandmarkRig(
            tuple(FACE_LANDMARKS[k] for k in NOSE_AND_EYES),
            torch.full((len(NOSE_AND_EYES),), _HEAD),
            self.rest[NOSE_AND_EYES].float(),
            self.betas[:, NOSE_AND_EYES].float(),
            torch.full((len(NOSE_AND_EYES),), OFFSET_SIGMA),
        )


def seen_face(
    landmarks: Landmarks, A: Tensor, a: Tensor, focal: Tensor
) -> tuple[Tensor, Tensor] | None:
    """Return the landmarks of the face in T frames; None if the network did not look for faces.

    Args:
        landmarks: of the T frames.
        A: (T, 3, 3) rotations of the head in the camera's axes.
        a: (T, 3) places of the head in the camera's axes, metres.
        focal: (T,) focal lengths, or one for all frames, pixels.

    Returns:
        pixels (T, 51, 2), and their precision (T, 51) ``f / σ²``, zero without a landmark: ``f`` is
        low if the face is turned away (:func:`gva_mi.observe.rig.face_weights`).
    """
    if not set(FACE_LANDMARKS) <= set(landmarks.names):
        return None
    at = landmarks.indices(FACE_LANDMARKS)
    pixels, confidence, spread = (
        torch.from_numpy(getattr(landmarks, name)[:, at]).to(a)
        for name in ("pixels", "confidence", "spread")
    )
    on_face = POINT_SIGMA_METRES * focal / a[:, 2]
    square = on_face[:, None] ** 2 + POINT_SIGMA_PIXELS**2 + spread**2
    seen = pixels.isfinite().all(2)
    precision = torch.where(seen, face_weights(A, a)[:, None] * confidence / square, 0.0)
    return torch.where(seen[..., None], pixels, 0.0), precision


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
