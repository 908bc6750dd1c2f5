"""Read and check body files of SMPL-X, SMPL+H and SMPL, .npz or .pkl.

==================  ===================================  ======================================
Key                 Shape                                Meaning
==================  ===================================  ======================================
v_template          (V, 3)                               the mean person in the T-pose, metres
f                   (F, 3)                               triangles
shapedirs           (V, 3, B + E)                        shape, then expression directions
posedirs            (V, 3, 9 (J − 1))                    pose correctives
J_regressor         (J, V)                               joints from the rest vertices
weights             (V, J)                               skinning weights
kintree_table       (2, J)                               parents; joints
hands_meanl, -r     (45,)                                mean hand relative to flat, axis-angle
lmk_faces_idx       (51,)                                triangles with landmarks of the face, and
lmk_bary_coords     (51, 3)                              where on them; optional
==================  ===================================  ======================================

J is 55, 52 or 24; SMPL has no hands. Only the readers of other programs' files use mean hands
(:mod:`gva_mi.readers.track`), because poses here are relative to the flat hand.

SMPL-X files with 400 directions or more hold 300 betas, then expressions (version 1.1); with fewer,
10 betas and up to 10 expressions (1.0). In the older formats all directions are betas.

**The older formats** share the first 22 joints with SMPL-X:

========  ======  ==========================================================================
Format    Joints  Beyond these 22
========  ======  ==========================================================================
SMPL      24      one joint per hand, at the knuckles (a mitten)
SMPL+H    52      15 joints per hand, in SMPL-X's order
SMPL-X    55      jaw, two eyes, 15 joints per hand
========  ======  ==========================================================================

A file is *lifted* to 55 joints: missing joints get no skinning weights, and the mitten becomes the
middle finger's first knuckle. The lifted body is exactly the old one.

Poses of these formats are converted by :mod:`gva_mi.readers`.

**The built-in body**, ``built_in.npz``, is under the licence of this package. It is generated from
scratch, as a smooth union of simple solids, by ``python -m tools.body_generator``.

* 11,000 vertices, watertight, connected, symmetric; denser at hands, face and toes.
* 1.77 m tall; the pelvis at the origin, y up, facing +z, the left hand toward +x.
* Separate fingers, a mouth that opens with the jaw, eyes that turn, pose correctives.

Sources of the formats: SMPL (Loper et al., 2015), SMPL+H (Romero, Tzionas and Black, "Embodied
Hands", 2017), SMPL-X (Pavlakos et al., 2019), as the package ``smplx`` reads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, PARENTS, RIGHT_HAND
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_arrays, require_array, require_file, require_keys
from gva_mi.core.options import Within
from gva_mi.core.pickles import read_objects

BUILT_IN_BODY = Path(__file__).with_name("built_in.npz")
# Coefficients of the built-in body; one unit is a clear but common deviation (height: 4 %).
SHAPES = (
    "height", "weight", "leg length", "arm length", "shoulder width", "hip width", "chest", "belly",
    "muscles", "size of the head",
)  # fmt: skip
EXPRESSIONS = (
    "mouth open", "smile", "corners of the mouth down", "lips pushed out", "brows up", "brows down",
    "blink", "cheeks blown", "upper lip up", "mouth to the left",
)  # fmt: skip
SMPLX_SITE = "https://smpl-x.is.tue.mpg.de"
# Largest absolute value in a body file. Chosen: far beyond any body, and its square is finite.
LARGEST_NUMBER = 1e9
# Metres, longest side of the box around the mean person. Chosen: it refuses files in millimetres.
PERSON_SIZES = Within(0.01, 100)
# Fraction of edges that belong to two triangles. Chosen: a body's borders, as at eyes, are few.
LEAST_SHARED_EDGES = 0.8
WEIGHTS_SUM_TOLERANCE = 1e-2  # of a vertex's skinning weights; chosen: files may be rounded
_ROOT = 4294967295  # the root's parent in the files: -1 as an unsigned 32-bit integer
_SKIN = (
    "v_template", "f", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table",
)  # fmt: skip
_HANDS = ("hands_meanl", "hands_meanr")
_WHOLE = ("f", "kintree_table")
_MARKS = ("lmk_faces_idx", "lmk_bary_coords")
_OPTIONAL = ("joint_names", *_MARKS)
_MITTENS = (JOINTS.index("left_middle1"), JOINTS.index("right_middle1"))


@dataclass(frozen=True)
class BodyFormat:
    """A body format, defined by its joints.

    Example:
        >>> SMPL.parents[:4], len(SMPLH.joints), len(SMPLX.joints)
        ((-1, 0, 0, 0), 52, 55)
    """

    name: str
    joints: tuple[int, ...]  # their indices among SMPL-X's 55

    @property
    def parents(self) -> tuple[int, ...]:
        """Parents of its joints, -1 for the root."""
        among_55 = [PARENTS[j] for j in self.joints]
        return tuple(self.joints.index(p) if p >= 0 else -1 for p in among_55)


_SHARED = range(BODY.stop)  # root and body, in the same order in all formats
SMPL = BodyFormat("SMPL", (*_SHARED, *_MITTENS))
SMPLH = BodyFormat("SMPL+H", (*_SHARED, *range(LEFT_HAND.start, RIGHT_HAND.stop)))
SMPLX = BodyFormat("SMPL-X", tuple(range(len(JOINTS))))
FORMATS = {len(f.joints): f for f in (SMPL, SMPLH, SMPLX)}


def read_body(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a body file, on SMPL-X's 55 joints.

    ``num_betas`` and ``num_expressions`` are added: how many shape directions are betas, and how
    many are expressions.

    The built-in body is read and checked once a process. Its arrays are shared: do not change them.

    Raises:
        InputError: naming the file, the key, and the shape that was found.

    Example:
        >>> arrays = read_body(BUILT_IN_BODY)
        >>> arrays["v_template"].shape, arrays["f"].shape, arrays["weights"].shape
        ((10989, 3), (21974, 3), (10989, 55))
        >>> int(arrays["num_betas"]), int(arrays["num_expressions"])
        (10, 10)
    """
    return dict(_built_in() if path == BUILT_IN_BODY else _read_and_check(path))


@cache
def _built_in() -> dict[str, np.ndarray]:
    return _read_and_check(BUILT_IN_BODY)


def _read_and_check(path: Path) -> dict[str, np.ndarray]:
    require_file(
        path, f"a body in SMPL-X's format, .npz or .pkl. SMPL-X is licensed at {SMPLX_SITE}; "
        "without a body file the built-in body is used"
    )  # fmt: skip
    arrays = _read(path)
    form = _check(path, arrays)
    betas, expressions = _split(arrays["shapedirs"].shape[2], form)
    if not _has_marks(arrays):
        arrays = {key: array for key, array in arrays.items() if key not in _MARKS}
    counts = {"num_betas": np.array(betas), "num_expressions": np.array(expressions)}
    return lift(arrays, form) | counts


def kintree_table() -> np.ndarray:
    """Return the tree of the 55 joints as in files, (2, 55) int64: parents, and joints.

    Example:
        >>> kintree_table()[:, :4]
        array([[4294967295,          0,          0,          0],
               [         0,          1,          2,          3]])
    """
    return np.stack([np.array([_ROOT, *PARENTS[1:]], dtype=np.int64), np.arange(len(JOINTS))])


def _read(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of the format from a file; pickles may hold sparse and chumpy's arrays."""
    expected, keys = f"a body in SMPL-X's format: {', '.join(_SKIN)}", (*_SKIN, *_HANDS, *_OPTIONAL)
    if path.suffix.lower() not in (".pkl", ".pickle"):
        arrays = read_arrays(path, expected, keys)
        require_keys(path, arrays, _SKIN)
        return arrays
    found = read_objects(path, expected)
    if not isinstance(found, dict):
        raise InputError(f"{path}: expected a dictionary with {', '.join(_SKIN)}")
    found = {str(key): value for key, value in found.items()}
    require_keys(path, found, _SKIN)
    return {key: np.asarray(found[key]) for key in keys if key in found}


def _has_marks(arrays: dict[str, np.ndarray]) -> bool:
    """Return whether a file marks the 51 landmarks of the face; other marks are ignored."""
    where, shares = (np.asarray(arrays.get(key, ())) for key in _MARKS)
    usual = where.shape == (51,) and shares.shape == (51, 3) and where.dtype.kind in "iu"
    return usual and bool((where < len(arrays["f"])).all() and np.isfinite(shares).all())


def _check(path: Path, arrays: dict[str, np.ndarray]) -> BodyFormat:
    """Check shapes and values of all arrays, and return the format."""
    form = _format(path, arrays)
    require_keys(path, arrays, () if form is SMPL else _HANDS)
    template = arrays["v_template"]
    require_array(path, "v_template", template, (None, 3), largest=LARGEST_NUMBER)
    vertices, joints = len(template), len(form.joints)
    shapes = {
        "v_template": (vertices, 3), "f": (None, 3), "shapedirs": (vertices, 3, None),
        "posedirs": (vertices, 3, 9 * (joints - 1)), "J_regressor": (joints, vertices),
        "weights": (vertices, joints), "kintree_table": (2, joints),
        "hands_meanl": (45,), "hands_meanr": (45,),
    }  # fmt: skip
    for key, shape in shapes.items():
        if key in arrays:
            numbers = {"kind": "iu"} if key in _WHOLE else {"largest": LARGEST_NUMBER}
            arrays[key] = require_array(path, key, arrays[key], shape, **numbers)
            if arrays[key].size == 0:
                raise InputError(f"{path}: '{key}' is empty")
    sides = np.ptp(arrays["v_template"], axis=0)
    if max(sides) not in PERSON_SIZES:
        found = " x ".join(f"{side:.3g}" for side in sides)
        raise InputError(f"{path}: 'v_template' is {found} metres in size; expected a person")
    if arrays["f"].max() >= vertices or arrays["f"].min() < 0:
        raise InputError(f"{path}: 'f' names vertex {arrays['f'].max()}, but there are {vertices}")
    _check_surface(path, arrays["f"])
    if not np.allclose(arrays["weights"].sum(1, dtype=np.float64), 1, atol=WEIGHTS_SUM_TOLERANCE):
        raise InputError(f"{path}: 'weights' must have rows that sum to 1")
    return form


def _check_surface(path: Path, faces: np.ndarray) -> None:
    """Refuse disconnected triangles, on which mesh decimation would not terminate."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    shared = float(((count == 2) & (edges[:, 0] != edges[:, 1])).mean())
    if shared < LEAST_SHARED_EDGES:
        raise InputError(
            f"{path}: 'f' is no surface, {shared:.0%} of its edges belong to two triangles; "
            f"expected {LEAST_SHARED_EDGES:.0%} or more"
        )


def _format(path: Path, arrays: dict[str, np.ndarray]) -> BodyFormat:
    """Return the format of a file, identified by its tree."""
    tree = arrays["kintree_table"]
    form = FORMATS.get(tree.shape[-1]) if tree.ndim == 2 else None
    if form is None:
        known = ", ".join(f"(2, {n}) {f.name}" for n, f in sorted(FORMATS.items()))
        raise InputError(f"{path}: 'kintree_table' must be one of {known}; found {tree.shape}")
    parents = [-1 if p in (-1, _ROOT) else int(p) for p in tree[0].tolist()]
    names = arrays["joint_names"].tolist() if form is SMPLX and "joint_names" in arrays else None
    if tuple(parents) != form.parents:
        key = "kintree_table"
    elif names is not None and tuple(names) != JOINTS:
        key = "joint_names"
    else:
        return form
    raise InputError(
        f"{path}: '{key}' is not the tree of {form.name}'s {len(form.joints)} joints, in which the "
        "root comes first, then 21 body joints, then in SMPL-X jaw and eyes, then the hands, left "
        "before right"
    )


def _split(directions: int, form: BodyFormat) -> tuple[int, int]:
    """Return how many shape directions are betas and how many are expressions."""
    if form is not SMPLX:
        return directions, 0
    betas = 300 if directions >= 400 else min(10, directions)  # versions 1.1 and 1.0 of SMPL-X
    return betas, directions - betas if directions >= 400 else min(10, directions - betas)


def lift(arrays: dict[str, np.ndarray], form: BodyFormat) -> dict[str, np.ndarray]:
    """Lift the arrays of an SMPL or SMPL+H file to SMPL-X's 55 joints.

    Missing joints are regressed at their nearest relative: jaw and eyes at the head, all fingers of
    a mitten at its knuckle.

    Example:
        A body of 100 vertices on SMPL's 24 joints.

        >>> arrays = {
        ...     "v_template": np.zeros((100, 3)), "weights": np.full((100, 24), 1 / 24),
        ...     "posedirs": np.zeros((100, 3, 207)), "J_regressor": np.zeros((24, 100)),
        ... }
        >>> lifted = lift(arrays, SMPL)
        >>> lifted["weights"].shape, lifted["posedirs"].shape, lifted["J_regressor"].shape
        ((100, 55), (100, 3, 486), (55, 100))
    """
    if form is SMPLX:
        return arrays
    of_file = {joint: k for k, joint in enumerate(form.joints)}
    nearest = [of_file[_relative(joint, of_file)] for joint in range(len(JOINTS))]
    vertices = len(arrays["v_template"])
    weights = np.zeros((vertices, len(JOINTS)), arrays["weights"].dtype)
    weights[:, form.joints] = arrays["weights"]
    posedirs = np.zeros((vertices, 3, len(JOINTS) - 1, 9), arrays["posedirs"].dtype)
    posedirs[:, :, np.array(form.joints[1:]) - 1] = arrays["posedirs"].reshape(vertices, 3, -1, 9)
    lifted = {
        "weights": weights,
        "posedirs": posedirs.reshape(vertices, 3, -1),
        "J_regressor": arrays["J_regressor"][nearest],
    }
    return arrays | lifted


def _relative(joint: int, known: dict[int, int]) -> int:
    """Return the joint if known, else its mitten, else its nearest known ancestor."""
    for hand, mitten in zip((LEFT_HAND, RIGHT_HAND), _MITTENS, strict=True):
        if hand.start <= joint < hand.stop and joint not in known:
            return mitten
    while joint not in known:
        joint = PARENTS[joint]
    return joint
