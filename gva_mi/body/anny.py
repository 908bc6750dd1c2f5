"""Anny as a body in SMPL-X's format: free and realistic (code Apache-2.0, data CC0), cached.

    phenotypes → rest surfaces of 64 people → T-pose → PCA → 10 betas
    52 facial actions → PCA → 10 expressions;    163 bones → 55 joints

Only Anny's own topology is used, because the topologies named after SMPL and SMPL-X would download
data under a non-commercial licence. There are no pose correctives. Anny's z axis is up; here y is
up.

Anny's rest pose has the arms obliquely down. :func:`_t_pose` rotates the bones of arms and hands
until the arms point sideways, palms down, fingers straight and nearly parallel, and skins the
surface, so that the zero pose means the same as in SMPL-X.

Source: Brégier et al., "Human Mesh Modeling for Anny Body", 2026, and its package ``anny``. The
shape space, the regressor and the T-pose are made here.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.body.body_file import kintree_table
from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import about, shortest, to_matrices
from gva_mi.core.errors import InputError
from gva_mi.core.files import write_arrays

if TYPE_CHECKING:
    from anny import Anny

FILE = "anny_0.6_v1.npz"  # change the name when the result changes
# People in the shape space, and their seed. Chosen: several times as many as there are betas.
_SAMPLED_PEOPLE, _SEED = 64, 0
_COEFFICIENTS = 10  # betas, and expressions: as in SMPL-X's files of version 1.0
_REGRESSING_VERTICES = 120  # the nearest to a joint, which regress it; chosen: all around a limb
_RIDGE = 1e-3  # m², ridge weight of this regression; chosen: weights stay small
_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_DIGITS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}
# Fraction of the fingers' spread that is kept in the T-pose. Chosen: nearly parallel, as in SMPL-X.
_KEPT_SPREAD = 0.35


def anny_body(cache: Path | None = None) -> Path:
    """Return the body's file in a cache folder; the first call builds it, in about a minute.

    Raises:
        InputError: the file is not built yet, and the package is not installed.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> body = load_body(anny_body())  # doctest: +SKIP
    """
    if cache is None:
        cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "gva_mi"
    path = cache / FILE
    if not path.exists():
        arrays = _build_anny()
        part = path.with_name(f"{path.stem}.{os.getpid()}.npz")  # another process may build it, too
        write_arrays(part, **arrays)
        part.replace(path)
    return path


def _build_anny() -> dict[str, np.ndarray]:
    """Build Anny as the arrays of an SMPL-X file; :func:`anny_body` keeps them in a file."""
    try:
        import anny
    except ImportError as error:
        raise InputError(
            f"the body 'anny' needs the package anny, which is not installed ({error}); "
            "pip install 'gva_mi[anny]' (0.6 GB), or use the built-in body: --source built-in"
        ) from None
    source = _Source(anny.Anny(rig="makehuman", topology="anny", facial_actions="all").float())
    people = [source.person(phenotype) for phenotype in (source.average, *source.people())]
    surfaces, joints = (np.stack(parts) for parts in zip(*people, strict=True))
    template = surfaces[0]
    shapes = _components(surfaces[1:] - template)
    directions = shapes, _components(source.expressions(), centred=True)
    return {
        "v_template": template.astype(np.float32),
        "f": source.faces,
        "shapedirs": np.concatenate(directions, axis=2).astype(np.float32),
        "posedirs": np.zeros((len(template), 3, 486), np.float32),
        "J_regressor": _regressor(surfaces, joints),
        "weights": source.weights_of_joints(),
        "kintree_table": kintree_table(),
        "hands_meanl": np.zeros(45, np.float32),
        "hands_meanr": np.zeros(45, np.float32),
        "joint_names": np.array(JOINTS),
    }


class _Source:
    """Anny's people, surfaces and weights, with y up."""

    def __init__(self, model: Anny) -> None:
        self._model = model
        self._bones = {name: k for k, name in enumerate(model.bone_labels)}
        self._parents = [-1 if p is None else p for p in model.bone_parents]
        weights = torch.zeros(len(model.template_vertices), model.bone_count)
        weights.scatter_add_(1, model.vertex_bone_indices, model.vertex_bone_weights)
        self._weights = weights.numpy().astype(np.float64)
        self.faces = model.get_triangular_faces().numpy().astype(np.uint32)
        self.average = dict.fromkeys(model.phenotype_labels, 0.5) | {"age": 2 / 3}  # an adult

    def people(self) -> list[dict[str, float]]:
        """Draw the phenotypes of the adults of the shape space."""
        rng = np.random.default_rng(_SEED)
        found = []
        for _ in range(_SAMPLED_PEOPLE):
            person = {k: float(rng.uniform(0.15, 0.85)) for k in self._model.phenotype_labels}
            person["age"], person["gender"] = float(rng.uniform(0.6, 0.8)), float(rng.uniform(0, 1))
            found.append(person)
        return found

    def person(self, phenotype: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return surface (V, 3) and joints (55, 3) in the T-pose, the pelvis at the origin."""
        vertices, heads = self._t_pose(*self._rest(phenotype))
        joints = heads[[self._bones[bone] for bone in _bone_of_joint().values()]]
        # SMPL-X's pelvis lies a little above the middle of the hips, Anny's root far below.
        joints[0] = joints[[1, 2]].mean(0) + (0, 0.05, 0)
        return vertices - joints[0], joints - joints[0]

    def expressions(self) -> np.ndarray:
        """Return the displacement of the average person by each facial action, (A, V, 3)."""
        neutral, _ = self._rest(self.average)
        actions = self._model.facial_action_labels
        return np.stack([self._rest(self.average, {a: 1.0})[0] - neutral for a in actions])

    def weights_of_joints(self) -> np.ndarray:
        """Return skinning weights (V, 55), each bone counted for its nearest ancestor joint."""
        joint_of = {self._bones[bone]: k for k, bone in enumerate(_bone_of_joint().values())}
        for side, letter in (("left", "L"), ("right", "R")):
            joint_of[self._bones[f"pelvis.{letter}"]] = 0
            for name, bone in self._bones.items():
                if name.startswith("toe") and name.endswith(letter):
                    joint_of[bone] = JOINTS.index(f"{side}_foot")
        weights = np.zeros((len(self._weights), len(JOINTS)))
        for bone in self._bones.values():
            above = bone
            while above not in joint_of:
                above = self._parents[above]
            weights[:, joint_of[above]] += self._weights[:, bone]
        return (weights / weights.sum(1, keepdims=True)).astype(np.float32)

    def _rest(
        self, phenotype: dict[str, float], face: dict[str, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the surface (V, 3) and the heads of the bones (bones, 3)."""
        still = torch.eye(4).repeat(1, len(self._bones), 1, 1)
        with torch.no_grad():
            found = self._model(
                pose_parameters=still, phenotype_kwargs=phenotype, facial_actions=face or {}
            )
        keys = ("rest_vertices", "rest_bone_heads")
        return tuple(found[key][0].numpy().astype(np.float64) @ _Y_UP.T for key in keys)

    def _t_pose(self, vertices: np.ndarray, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return surface and bone heads with the arms sideways, palms down."""
        turned = {}
        for letter, sign in (("L", 1.0), ("R", -1.0)):
            turned |= self._arm(vertices, heads, letter, np.array([sign, 0, 0]))
        R, moved = np.zeros((len(heads), 3, 3)), np.zeros_like(heads)
        for name, k in self._bones.items():  # parents come first
            parent = self._parents[k]
            R[k] = turned.get(name, R[parent] if parent >= 0 else np.eye(3))
            offset = R[parent] @ (heads[k] - heads[parent]) if parent >= 0 else heads[k]
            moved[k] = moved[parent] + offset if parent >= 0 else offset
        blended = np.einsum("vb,bij->vij", self._weights, R)
        shift = self._weights @ (moved - np.einsum("bij,bj->bi", R, heads))
        return np.einsum("vij,vj->vi", blended, vertices) + shift, moved

    def _arm(
        self, vertices: np.ndarray, heads: np.ndarray, letter: str, side: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return rotations (3, 3) from rest to T-pose for arm and hand of one side."""
        at = lambda bone: heads[self._bones[f"{bone}.{letter}"]]
        upper = _between(at("lowerarm01") - at("upperarm01"), side)
        lower = _between(upper @ (at("wrist") - at("lowerarm01")), side) @ upper
        hand = _between(lower @ (at("finger3-1") - at("wrist")), side) @ lower
        # Palm down: the knuckles, from index to little finger, run straight back.
        across = hand @ (at("finger5-1") - at("finger2-1"))
        twist = np.arctan2(across[1], -across[2])
        palm = about(0, twist) @ hand
        raised = np.arccos(np.clip(np.trace(upper) / 2 - 0.5, -1, 1))
        turned = {
            "shoulder01": about(2, 0.2 * side[0] * raised),
            "upperarm01": upper,
            # The twist is spread over the forearm.
            "lowerarm01": about(0, 0.25 * twist) @ lower,
            "lowerarm02": about(0, 0.70 * twist) @ lower,
            "wrist": palm,
        }
        for digit in (2, 3, 4, 5):
            chain = [at(f"finger{digit}-{k}") for k in (1, 2, 3)]
            last = self._weights[:, self._bones[f"finger{digit}-3.{letter}"]] > 0.9
            chain.append(vertices[last].mean(0))  # approximates the tip
            fan = palm @ (chain[0] - at("wrist"))
            straight, above = np.array([fan[0], 0, _KEPT_SPREAD * fan[2]]), palm
            for k in range(3):
                above = _between(above @ (chain[k + 1] - chain[k]), straight) @ above
                turned[f"finger{digit}-{k + 1}"] = above
        return {f"{bone}.{letter}": R for bone, R in turned.items()}


def _bone_of_joint() -> dict[str, str]:
    """Return the bone at each of SMPL-X's joints, in their order."""
    bones = {
        "pelvis": "root", "spine1": "spine04", "spine2": "spine03", "spine3": "spine02",
        "neck": "neck01", "head": "head", "jaw": "jaw",
    }  # fmt: skip
    limbs = {
        "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "foot": "toe2-1",
        "collar": "clavicle", "shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist",
        "eye_smplhf": "eye",
    }  # fmt: skip
    limbs |= {f"{n}{k}": f"finger{digit}-{k}" for n, digit in _DIGITS.items() for k in (1, 2, 3)}
    for side, letter in (("left", "L"), ("right", "R")):
        bones |= {f"{side}_{joint}": f"{bone}.{letter}" for joint, bone in limbs.items()}
    return {joint: bones[joint] for joint in JOINTS}


def _components(samples: np.ndarray, *, centred: bool = False) -> np.ndarray:
    """Return principal directions (V, 3, 10) of samples (N, V, 3), as standard deviations."""
    flat = samples.reshape(len(samples), -1)
    _, s, rows = np.linalg.svd(flat if centred else flat - flat.mean(0), full_matrices=False)
    rows = rows[:_COEFFICIENTS] * (s[:_COEFFICIENTS, None] / np.sqrt(len(flat)))
    directions = rows.reshape(_COEFFICIENTS, -1, 3).transpose(1, 2, 0)
    # The sign is arbitrary: positive is taller.
    return directions * np.where(directions[:, 1].sum(0) < 0, -1, 1)


def _regressor(surfaces: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Fit sparse rows (55, V) with sum 1 that regress joints (N, 55, 3) from (N, V, 3)."""
    regressor = np.zeros((len(JOINTS), surfaces.shape[1]))
    for j in range(len(JOINTS)):
        distance = ((surfaces[0] - joints[0, j]) ** 2).sum(1)
        near = np.argsort(distance, kind="stable")[:_REGRESSING_VERTICES]
        A = surfaces[:, near].transpose(0, 2, 1).reshape(-1, _REGRESSING_VERTICES)
        mean = A.mean(1, keepdims=True)
        A = A - mean  # solve for differences from equal weights, so that rows sum to 1
        normal = A.T @ A + _RIDGE * np.eye(_REGRESSING_VERTICES)
        change = np.linalg.solve(normal, A.T @ (joints[:, j].reshape(-1) - mean[:, 0]))
        regressor[j, near] = 1 / _REGRESSING_VERTICES + change - change.mean()
    return regressor


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) from direction a to b."""
    return to_matrices(shortest(a, b))
