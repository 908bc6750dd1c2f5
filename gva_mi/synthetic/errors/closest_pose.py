"""The poses and betas of the fitted body that come closest to a person with another body.

They are the ground truth of stage 1 for such a person, to which errors are added: rotations of the
*fitted* body's joints. With the rest joints J of the fitted body and J* of the true one, at true
rotations W*_j (world):

    1. C_j    turns the fitted body's bones at j into the true ones: C_j (J_c − J_j) ∥ J*_c − J*_j
    2. R_j    = C_pᵀ R*_j C_j,  so that W_j = W*_j C_j: every bone has the true bone's direction
    3. betas  least squares of limbs' joints and surface (point to plane), both in the rest pose
    4. Gauss-Newton steps on rotations and translation match the limbs' joints; a rotation by
       ``TURN_SCALE`` costs as much as a distance of ``DISTANCE_SCALE``

Only joints of the limbs are matched, because spines of different bodies have their joints at
arbitrary, invisible places. The remaining distances are a lower bound for any refinement with the
fitted body. A person within its span is found exactly: all C are 1 and no distance remains.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.body import so3
from gva_mi.body.kinematics import joint_places, joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.rotations import nearest_rotations, shortest, to_matrices
from gva_mi.body.smplx import BodyModel, Rest
from gva_mi.core.cpu import one_torch_thread
from gva_mi.synthetic.person.level_sets import vertex_normals

DISTANCE_SCALE, TURN_SCALE = 0.01, 0.1  # m, rad of eq. 4; chosen: places matter more than turns
POSE_STEPS = 4  # of eq. 4; chosen: they start close, with the true bones' directions
SHAPE_ROUNDS = 8  # of eq. 3, each with new pairs of points; chosen: pairs settle
VERTEX_STRIDE = 5  # eq. 3 uses every fifth vertex; chosen: thousands of points for tens of unknowns
PAIR_DISTANCE = 0.04  # m, largest distance of paired points; chosen: leaves out wrong pairs
LARGEST_BETA = 3.0  # standard deviations; chosen: keeps the body plausible
RIDGE = 1e-9  # m², on squared betas; chosen: only keeps undetermined betas at zero
# Joints with the same orientation in every rest pose: level soles, an upright head.
LEVEL = tuple(
    JOINTS.index(name)
    for name in ("left_ankle", "right_ankle", "left_foot", "right_foot", "head", "jaw",
                 "left_eye_smplhf", "right_eye_smplhf")
)  # fmt: skip
LIMBS = tuple(
    k for k, name in enumerate(JOINTS)
    if name.endswith(("knee", "ankle", "foot", "shoulder", "elbow", "wrist", "1", "2", "3"))
    and not name.startswith("spine")
)  # fmt: skip


@dataclass(frozen=True)
class Closest:
    """The fitted body in the poses and shape closest to the true person."""

    pose: Pose  # T frames
    shape: Shape
    joint_mm: float  # remaining distance, mean over frames and all joints
    limb_mm: float  # mean over frames and the joints of the limbs


@one_torch_thread()  # bit-identical for any number of threads
def closest(body: BodyModel, true: BodyModel, pose: Pose, shape: Shape) -> Closest:
    """Find poses and betas of the fitted ``body`` that come closest to a person on ``true``.

    If both bodies are the same object, the given pose and shape are returned. The expression is
    kept if both bodies have the same faces, and neutral otherwise.
    """
    if true is body:
        return Closest(pose, shape, 0.0, 0.0)
    fitted, true = deepcopy(body).double(), deepcopy(true).double()
    pose, shape = pose.to(torch.float64), Shape(shape.betas.double())
    goal = true.rest(shape)
    nearest = _closest_shape(fitted, goal, true.faces)
    same = body.faces.shape == true.faces.shape and bool((body.faces == true.faces).all())
    expression = pose.expression if same else torch.zeros_like(pose.expression)
    joints = fitted.rest(nearest).joints
    C = _bones(joints, goal.joints)
    R = so3.to_matrix(pose.rotations)
    above = torch.cat([torch.eye(3, dtype=C.dtype)[None], C[list(PARENTS[1:])]])
    rotations = so3.to_rotvec(above.mT @ R @ C)
    T_true = joint_transforms(pose.rotations, goal.joints, PARENTS, pose.transl)
    targets = joint_places(T_true, goal.joints)
    transl = pose.transl.clone()
    for _ in range(POSE_STEPS):
        rotations, transl = _step(rotations, transl, joints, targets)
    reached = joint_places(joint_transforms(rotations, joints, PARENTS, transl), joints)
    left = 1000 * (reached - targets).norm(dim=-1).mean(0)
    nearest = Shape(nearest.betas.to(body.v_template.dtype))
    near = Pose(rotations, transl, expression).to(torch.float32)
    return Closest(near, nearest, float(left.mean()), float(left[list(LIMBS)].mean()))


def _bones(joints: Tensor, goal: Tensor) -> Tensor:
    """Return C of eq. 1, (55, 3, 3), for rest joints (55, 3) of both bodies."""
    C = torch.eye(3, dtype=joints.dtype).repeat(len(JOINTS), 1, 1)
    for joint in range(len(JOINTS)):
        children = [k for k, parent in enumerate(PARENTS) if parent == joint]
        if joint in LEVEL:
            continue
        if not children:  # a fingertip keeps the direction of its bone
            C[joint] = C[PARENTS[joint]]
            continue
        a, b = ((x[children] - x[joint]).numpy() for x in (joints, goal))
        several = len(children) > 1
        turn = nearest_rotations(b.T @ a) if several else to_matrices(shortest(a[0], b[0]))
        C[joint] = torch.from_numpy(turn)
    return C


def _closest_shape(body: BodyModel, goal: Rest, faces: Tensor) -> Shape:
    """Solve eq. 3 for the betas.

    For fixed bone directions, vertices and joints are linear in betas and translation, so every
    round is a bounded linear least-squares problem.
    """
    from scipy.optimize import lsq_linear
    from scipy.spatial import cKDTree

    tree, normals = cKDTree(goal.vertices), vertex_normals(goal.vertices.numpy(), faces.numpy())
    sampled = torch.arange(0, len(body.v_template), VERTEX_STRIDE)
    area = torch.from_numpy(_areas(body.v_template.numpy(), body.faces.numpy()))[sampled]
    body, count = body.on(sampled, body.faces[:0]), body.num_betas
    solution = np.zeros(count + 3)
    bound = np.array([LARGEST_BETA] * count + [np.inf] * 3)
    for round_ in range(SHAPE_ROUNDS):
        C = _bones(body.rest(Shape(torch.from_numpy(solution[:count]))).joints, goal.joints)
        surface, joints = _linear(body, C)
        distance, index = tree.query(surface[0] + np.tensordot(solution, surface[1:], axes=1))
        # First joints alone, because the bodies are still apart.
        weight = area.numpy() * (distance < PAIR_DISTANCE) if round_ else np.zeros(len(sampled))
        weight = np.sqrt(weight / max(weight.sum(), 1e-12))
        n, apart = normals[index] * weight[:, None], goal.vertices.numpy()[index] - surface[0]
        rows = [
            np.einsum("kvc,vc->vk", surface[1:], n),
            joints[1:, LIMBS].reshape(count + 3, -1).T / np.sqrt(len(LIMBS)),
            np.sqrt(RIDGE) * np.eye(count, count + 3),
        ]
        right = [
            (apart * n).sum(1),
            (goal.joints.numpy() - joints[0])[LIMBS, :].ravel() / np.sqrt(len(LIMBS)),
            np.zeros(count),
        ]
        solution = lsq_linear(
            np.concatenate(rows), np.concatenate(right), bounds=(-bound, bound), method="bvls"
        ).x
    return Shape(torch.from_numpy(solution[:count]))


def _linear(body: BodyModel, C: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and joints, bones turned by C, as linear functions of betas and translation.

    Returns:
        two arrays (1 + B + 3, V or 55, 3): the value at zero, then the derivatives.
    """
    above = torch.cat([torch.eye(3, dtype=C.dtype)[None], C[list(PARENTS[1:])]])
    pose = Pose.rest(1, 0, C.dtype)
    pose = Pose(so3.to_rotvec(above.mT @ C)[None], pose.transl, pose.expression)
    basis = torch.eye(body.num_betas, dtype=C.dtype)
    bodies = [body(pose, Shape(betas)) for betas in (0 * basis[0], *basis)]
    found = []
    for part in ("vertices", "joints"):
        states = np.stack([getattr(posed, part)[0].numpy() for posed in bodies])
        axes = np.broadcast_to(np.eye(3)[:, None], (3, *states.shape[1:]))
        found.append(np.concatenate([states[:1], states[1:] - states[:1], axes]))
    return found[0], found[1]


def _areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return vertex areas (V,), m²: a third of the adjacent faces' area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return sum(np.bincount(faces[:, k], area, len(vertices)) for k in range(3))


def _step(
    rotations: Tensor, transl: Tensor, joints: Tensor, targets: Tensor
) -> tuple[Tensor, Tensor]:
    """Move rotations (T, 55, 3) and translations (T, 3) one step of eq. 4 to targets (T, 55, 3).

    A rotation vector ω of joint k in the world moves a descendant j by ω × (p_j − p_k).
    """
    T_world_rest = joint_transforms(rotations, joints, PARENTS, transl)
    places = joint_places(T_world_rest, joints)
    limbs = list(LIMBS)
    hangs = _descends()[limbs].to(places.dtype)  # (j, k)
    arm = (places[:, limbs, None] - places[:, None]) * hangs[..., None]  # (T, j, k, 3)
    # ω × a = [a]×ᵀ ω
    zero = torch.zeros_like(arm[..., 0])
    x, y, z = arm.unbind(-1)
    moved = torch.stack([zero, z, -y, -z, zero, x, y, -x, zero], dim=-1).unflatten(-1, (3, 3))
    moved = moved.permute(0, 1, 3, 2, 4).flatten(3).flatten(1, 2)  # (T, 3 j, 3 k)
    shift = torch.eye(3, dtype=moved.dtype).repeat(len(limbs), 1)
    J = torch.cat([moved, shift.expand(len(moved), -1, -1)], dim=2) / DISTANCE_SCALE
    r = (targets - places)[:, limbs].flatten(1) / DISTANCE_SCALE
    damping = torch.full((J.shape[2],), TURN_SCALE**-2, dtype=J.dtype)
    damping[-3:] = 0
    factor = torch.linalg.cholesky(J.mT @ J + torch.diag(damping))
    change = torch.cholesky_solve(J.mT @ r[..., None], factor)[..., 0]
    turn = so3.to_matrix(change[:, :-3].unflatten(1, (-1, 3)))
    above = torch.eye(3, dtype=J.dtype).repeat(len(J), len(JOINTS), 1, 1)
    above[:, 1:] = T_world_rest[:, list(PARENTS[1:]), :3, :3]
    R = above.mT @ turn @ above @ so3.to_matrix(rotations)
    return so3.to_rotvec(R), transl + change[:, -3:]


def _descends() -> Tensor:
    """Return (55, 55) with 1 where joint j (row) is a descendant of joint k (column)."""
    hangs = torch.zeros(len(JOINTS), len(JOINTS))
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            hangs[joint] = hangs[parent]
            hangs[joint, parent] = 1
    return hangs
