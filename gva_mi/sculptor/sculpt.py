"""Sculpts the puppet and writes it: ``python -m gva_mi.sculptor.sculpt``.

    figure (solids) → left half by marching cubes → decimated → mirrored → weights, regressor,
    shapes → puppet.npz

The left half is modelled alone, its border held on the plane x = 0, so that the body is symmetric
to the bit. The grid is finer at fingers, face and toes, and these keep more triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.body.puppet import PUPPET
from gva_mi.sculptor.figure import EYE, EYE_RADIUS, left_half
from gva_mi.sculptor.rig import joint_regressor, skinning_weights
from gva_mi.sculptor.shapes import correctives, expressions, shapes
from gva_mi.sculptor.solids import surface

_EYE_FACES = 350  # of one eyeball, as far as it shows


@dataclass(frozen=True)
class SculptOptions:
    """How fine the puppet is."""

    faces: int = 22_000  # of the whole body
    grid: float = 1.0  # spacing of the grid, 1 is the usual one


def half_surface(options: SculptOptions) -> tuple[np.ndarray, np.ndarray]:
    """The left half at full resolution, open at x = 0."""
    axes = [
        _planes(
            [(0, 0.0010), (0.018, 0.0007), (0.048, 0.0013), (0.10, 0.0050), (0.69, 0.0015),
             (0.935, 0)], options.grid,
        ),
        _planes(
            [(-1.0, 0.0020), (-0.93, 0.0050), (0.395, 0.0015), (0.470, 0.0040), (0.56, 0.0015),
             (0.598, 0.0006), (0.616, 0.0012), (0.658, 0.0007), (0.686, 0.0015),
             (0.700, 0.0030), (0.82, 0)], options.grid,
        ),
        _planes([(-0.18, 0.0050), (-0.065, 0.0014), (0.068, 0.0009), (0.092, 0.0014), (0.175, 0)],
                options.grid),
    ]  # fmt: skip
    return surface(left_half(), axes)


def decimate(vertices: np.ndarray, faces: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Fewer triangles by quadric errors, with most detail kept at hands, face and toes.

    The open border stays in its plane.
    """
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
    # An eyeball is as round as a finger and much smaller: its share is set, and not by its error.
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


def border_of(faces: np.ndarray) -> np.ndarray:
    """The vertices of a half's open border in their order, once around."""
    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    inner = set(map(tuple, sides[:, ::-1].tolist()))
    after = {a: b for a, b in sides.tolist() if (a, b) not in inner}
    loop = [min(after)]
    while (following := after[loop[-1]]) != loop[0]:
        loop.append(following)
    if len(loop) != len(after):
        raise ValueError("border_of(): the half must have one border, without a pinch")
    return np.array(loop)


def onto_border(vertices: np.ndarray, faces: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Bring the border of a decimated half back onto the outline that it had.

    Decimation slides vertices along straight stretches, past each other too, and the faces between
    them fold. So they take their places on the outline in the order of the border.

    Args:
        vertices: (V, 3) decimated.
        faces: (F, 3)
        outline: (S, 3) closed, the border of the full half in its order.

    Returns:
        vertices, (V, 3).
    """
    moved = border_of(faces)
    start, along = outline, np.roll(outline, -1, axis=0) - outline
    t = ((vertices[moved, None] - start) * along).sum(-1) / ((along * along).sum(-1) + 1e-18)
    t = np.clip(t, 0, 1)
    gap = np.linalg.norm(vertices[moved, None] - start - t[..., None] * along, axis=-1)
    nearest = gap.argmin(1)
    length = np.linalg.norm(along, axis=1)
    before = np.concatenate([[0], np.cumsum(length)])
    place = before[nearest] + (t * length)[np.arange(len(moved)), nearest]
    # Begin where the outline does, but for vertices that were slid past that point.
    turn = int(np.argmin(place))
    place = np.sort(np.roll(place, -turn))
    closed = np.concatenate([outline, outline[:1]])
    vertices = vertices.copy()
    vertices[np.roll(moved, -turn)] = np.stack(
        [np.interp(place, before, closed[:, k]) for k in range(3)], axis=1
    )
    return vertices


def without_chords(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make the border of a half ready to be welded to its mirror image.

    A chord is an inner edge between two border vertices: its mirror image would be the same edge.
    Faces with all three corners on the border go, other chords get a vertex in their middle.
    """
    while True:
        edges, count = _edges(faces)
        on_border = np.isin(np.arange(len(vertices)), edges[count == 1])
        flat = on_border[faces].all(1)
        if not flat.any():
            break
        faces = faces[~flat]
    for a, b in edges[(count == 2) & on_border[edges].all(1)]:
        both = np.flatnonzero((faces == a).any(1) & (faces == b).any(1))
        middle, corners = len(vertices), np.unique(faces[both])
        vertices = np.concatenate([vertices, vertices[corners].mean(0, keepdims=True)])
        halves = [np.where(faces[both] == end, middle, faces[both]) for end in (a, b)]
        faces = np.concatenate([np.delete(faces, both, axis=0), *halves])
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def mirrored(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both halves, welded along the border: vertices, faces, and the twin of each vertex (V,)."""
    edges, count = _edges(faces)
    border = np.unique(edges[count == 1])
    inner = np.setdiff1d(np.arange(len(vertices)), border)
    vertices = vertices.copy()
    vertices[border, 0] = 0
    vertices[inner, 0] = np.maximum(vertices[inner, 0], 1e-5)
    image = np.arange(len(vertices))
    image[inner] = len(vertices) + np.arange(len(inner))
    both = np.concatenate([vertices, vertices[inner] * (-1, 1, 1)])
    return both, np.concatenate([faces, image[faces][:, ::-1]]), np.concatenate([image, inner])


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (E, 2) without direction, and how many faces each has (E,)."""
    sides = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)


def sculpt(options: SculptOptions | None = None) -> dict[str, np.ndarray]:
    """The puppet as the arrays of an SMPL-X file."""
    import trimesh

    options = options or SculptOptions()
    vertices, faces = half_surface(options)
    outline = vertices[border_of(faces)]
    vertices, faces = without_chords(*decimate(vertices, faces, options.faces // 2))
    vertices, faces, twin = mirrored(onto_border(vertices, faces, outline), faces)
    vertices = vertices.astype(np.float32).astype(
        np.float64
    )  # what follows is exact on what is stored
    weights = skinning_weights(vertices, faces, twin)
    fields, moves = shapes(vertices, weights)
    fields = np.concatenate([fields, expressions(vertices, weights)], axis=2).astype(np.float16)
    moves = np.concatenate([moves, np.zeros((55, 3, 10))], axis=2)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    parents = np.array([4294967295, *PARENTS[1:]], dtype=np.int64)
    hand = relaxed_hand()
    return {
        "v_template": vertices.astype(np.float32),
        "f": faces.astype(np.uint32),
        "shapedirs": fields,
        "posedirs": correctives(vertices, normals, weights).astype(np.float16),
        "J_regressor": joint_regressor(vertices, fields.astype(np.float64), moves, twin),
        "weights": weights.astype(np.float32),
        "kintree_table": np.stack([parents, np.arange(55)]),
        "hands_meanl": hand,
        "hands_meanr": (hand.reshape(15, 3) * (1, -1, -1)).ravel().astype(np.float32),
        "hands_componentsl": np.eye(45, dtype=np.float32),
        "hands_componentsr": np.eye(45, dtype=np.float32),
        "joint_names": np.array(JOINTS),
    }


def relaxed_hand() -> np.ndarray:
    """The left hand as it hangs, axis-angle (45,): fingers half curled, more toward the little
    one."""
    curl = {"index": 0.25, "middle": 0.32, "ring": 0.38, "pinky": 0.42}
    hand = np.zeros((15, 3), np.float32)
    for k, name in enumerate(JOINTS[25:40]):
        finger, knuckle = name.removeprefix("left_")[:-1], int(name[-1])
        if finger in curl:
            hand[k, 2] = -curl[finger] * (1.0, 1.2, 0.7)[knuckle - 1]
        else:
            hand[k] = (0.1, 0.12, -0.05)
    return hand.ravel()


def _planes(knots: list[tuple[float, float]], factor: float) -> np.ndarray:
    """Grid planes from (start, spacing) of consecutive stretches; the last one only ends."""
    stretches = [
        np.linspace(a, b, max(2, round((b - a) / (step * factor))), endpoint=False)
        for (a, step), (b, _) in zip(knots[:-1], knots[1:], strict=True)
    ]
    return np.concatenate([*stretches, [knots[-1][0]]])


def main(out: Path = PUPPET) -> None:
    """Write the puppet's file."""
    part = out.with_suffix(".part.npz")  # never half a body in its place
    np.savez_compressed(part, **sculpt())
    part.replace(out)


if __name__ == "__main__":
    main()
