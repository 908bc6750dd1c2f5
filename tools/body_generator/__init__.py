"""Generate the built-in body; ``python -m tools.body_generator`` rebuilds its file bit by bit.

    anatomy (solids) → left half by marching cubes → decimated → mirrored → weights, regressor,
    shapes → built_in.npz

Only the left half is modelled, with its border on the plane x = 0, so the body is exactly
symmetric. Grid and triangles are finer at fingers, face and toes.
"""

from __future__ import annotations

import numpy as np

from gva_mi.body.body_file import kintree_table
from gva_mi.body.pose import JOINTS, LEFT_HAND
from tools.body_generator.anatomy import EYE, EYE_RADIUS, left_half
from tools.body_generator.rig import joint_regressor, skinning_weights
from tools.body_generator.shapes import correctives, expressions, shapes
from tools.body_generator.solids import border_of, mirrored, onto_border, surface, without_chords

BODY_FACES = 22_000  # of the whole body; chosen: about as many as SMPL-X has
_EYE_FACES = 350  # of the visible part of one eyeball; chosen: it looks round


def generate() -> dict[str, np.ndarray]:
    """Return the built-in body as the arrays of an SMPL-X file."""
    import trimesh

    vertices, faces = _half_surface()
    outline = vertices[border_of(faces)]
    vertices, faces = without_chords(*_decimate(vertices, faces, BODY_FACES // 2))
    vertices, faces, image = mirrored(onto_border(vertices, faces, outline), faces)
    # The rest is exact on the float32 vertices of the file.
    vertices = vertices.astype(np.float32).astype(np.float64)
    weights = skinning_weights(vertices, faces, image)
    fields, moves = shapes(vertices, weights)
    fields = np.concatenate([fields, expressions(vertices, weights)], axis=2).astype(np.float16)
    moves = np.concatenate([moves, np.zeros((55, 3, 10))], axis=2)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    hand = _relaxed_hand()
    return {
        "v_template": vertices.astype(np.float32),
        "f": faces.astype(np.uint32),
        "shapedirs": fields,
        "posedirs": correctives(vertices, normals, weights).astype(np.float16),
        "J_regressor": joint_regressor(vertices, fields.astype(np.float64), moves, image),
        "weights": weights.astype(np.float32),
        "kintree_table": kintree_table(),
        "hands_meanl": hand,
        "hands_meanr": (hand.reshape(15, 3) * (1, -1, -1)).ravel().astype(np.float32),
        "hands_componentsl": np.eye(45, dtype=np.float32),
        "hands_componentsr": np.eye(45, dtype=np.float32),
        "joint_names": np.array(JOINTS),
    }


def _relaxed_hand() -> np.ndarray:
    """Return a relaxed left hand, axis-angle (45,): curled fingers, the little one most."""
    curl = {"index": 0.25, "middle": 0.32, "ring": 0.38, "pinky": 0.42}
    hand = np.zeros((15, 3), np.float32)
    for k, name in enumerate(JOINTS[LEFT_HAND]):
        finger, knuckle = name.removeprefix("left_")[:-1], int(name[-1])
        if finger in curl:
            hand[k, 2] = -curl[finger] * (1.0, 1.2, 0.7)[knuckle - 1]
        else:
            hand[k] = (0.1, 0.12, -0.05)
    return hand.ravel()


def _half_surface() -> tuple[np.ndarray, np.ndarray]:
    """Return the left half at full resolution, open at x = 0."""
    axes = [
        [(0, 0.0010), (0.018, 0.0007), (0.048, 0.0013), (0.10, 0.0050), (0.69, 0.0015), (0.935, 0)],
        [(-1.0, 0.0020), (-0.93, 0.0050), (0.395, 0.0015), (0.470, 0.0040), (0.56, 0.0015),
         (0.598, 0.0006), (0.616, 0.0012), (0.658, 0.0007), (0.686, 0.0015), (0.700, 0.0030),
         (0.82, 0)],
        [(-0.18, 0.0050), (-0.065, 0.0014), (0.068, 0.0009), (0.092, 0.0014), (0.175, 0)],
    ]  # fmt: skip
    return surface(left_half(), [_planes(knots) for knots in axes])


def _decimate(
    vertices: np.ndarray, faces: np.ndarray, target: int
) -> tuple[np.ndarray, np.ndarray]:
    """Decimate by quadric errors, with most detail kept at hands, face and toes."""
    import pymeshlab

    x, y, z = vertices.T
    detail = np.ones(len(vertices))
    detail[y < -0.87] = 8.0
    detail[x > 0.70] = 24.0
    detail[x > 0.785] = 36.0  # fingers
    detail[(y > 0.56) & (y < 0.72) & (z > 0.0)] = 8.0
    detail[(y > 0.62) & (y < 0.695) & (z < 0.02) & (x > 0.060)] = 16.0  # ear
    detail[(y > 0.59) & (y < 0.70) & (z > 0.07) & (x < 0.055)] = 24.0  # eyes, nose, mouth
    detail[(y > 0.661) & (y < 0.684) & (z > 0.07) & (x > 0.016) & (x < 0.05)] = 40.0  # eye
    mesh = pymeshlab.MeshSet()
    mesh.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32), v_scalar_array=detail))
    # Eyeballs are small and round, so their number of faces is set instead of their error.
    centre = "".join(f"+({axis}-({c}))^2" for axis, c in zip("xyz", EYE, strict=True))
    mesh.compute_selection_by_condition_per_vertex(
        condselect=f"(0{centre} < {(EYE_RADIUS + 0.0006) ** 2}) && (z > {EYE[2]})"
    )
    mesh.compute_selection_transfer_vertex_to_face()
    for count in (_EYE_FACES, target - _EYE_FACES):
        mesh.meshing_decimation_quadric_edge_collapse(
            targetfacenum=count, qualitythr=0.6, boundaryweight=30.0,
            preservenormal=True, preservetopology=True, optimalplacement=True, planarquadric=True,
            planarweight=0.0006, qualityweight=True, selected=True,
        )  # fmt: skip
        mesh.apply_selection_inverse(invfaces=True)
    result = mesh.current_mesh()
    return result.vertex_matrix(), result.face_matrix().astype(np.int64)


def _planes(knots: list[tuple[float, float]]) -> np.ndarray:
    """Return grid planes from (start, spacing) of consecutive stretches; the last is the end."""
    stretches = [
        np.linspace(a, b, max(2, round((b - a) / step)), endpoint=False)
        for (a, step), (b, _) in zip(knots[:-1], knots[1:], strict=True)
    ]
    return np.concatenate([*stretches, [knots[-1][0]]])
