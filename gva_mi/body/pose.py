"""``Pose`` and ``Shape`` of a body on SMPL-X's joints, and their files under SMPL-X's names.

Source of the joints' names, their order and the tree: SMPL-X (Pavlakos et al., "Expressive Body
Capture", 2019), as its package ``smplx`` writes them (``joint_names.py``, ``kintree_table``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.errors import InputError
from gva_mi.core.files import Form, read_arrays, require_array, require_keys, write_arrays

_FINGERS_OF_SMPLX = ("index", "middle", "pinky", "ring", "thumb")
_HAND = lambda side: [f"{side}_{finger}{k}" for finger in _FINGERS_OF_SMPLX for k in (1, 2, 3)]

JOINTS: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "jaw", "left_eye_smplhf", "right_eye_smplhf",
    *_HAND("left"), *_HAND("right"),
)  # fmt: skip
PARENTS: tuple[int, ...] = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
    20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38,
    21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50, 21, 52, 53,
)  # fmt: skip

# The fields of SMPL-X as slices of JOINTS.
ROOT, BODY, ROOT_AND_BODY = slice(0, 1), slice(1, 22), slice(0, 22)
JAW, EYES, JAW_AND_EYES = slice(22, 23), slice(23, 25), slice(22, 25)
WRISTS = [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]
LEFT_HAND, RIGHT_HAND = slice(25, 40), slice(40, 55)  # joints of the fingers
SIDES = ("left", "right")
HANDS: Mapping[str, slice] = {"left": LEFT_HAND, "right": RIGHT_HAND}
SMPLX_FIELDS: Mapping[str, slice] = {
    "global_orient": ROOT, "body_pose": BODY, "jaw_pose": JAW, "leye_pose": slice(23, 24),
    "reye_pose": slice(24, 25), "left_hand_pose": LEFT_HAND, "right_hand_pose": RIGHT_HAND,
}  # fmt: skip
SMPLX_EXPRESSIONS = 10  # expression coefficients of SMPL-X version 1.0, the default
# Largest absolute values of valid files: metres, and standard deviations of coefficients. Chosen:
# far beyond any person, and small enough that nothing overflows in float32.
LARGEST_IN_FILES = {"transl": 1e6, "expression": 1e4, "betas": 1e4, "offsets": 10.0}
LARGEST_ANGLE = 1e3  # radians; chosen: estimators add up whole turns, but not hundreds of them
_WIDTHS = {name: 3 * (part.stop - part.start) for name, part in SMPLX_FIELDS.items()}


def mirrored_name(name: str) -> str:
    """Exchange left and right in a name.

    Example:
        >>> mirrored_name("left_wrist"), mirrored_name("pelvis")
        ('right_wrist', 'pelvis')
    """
    other = {"left": "right", "right": "left"}
    return "_".join(other.get(word, word) for word in name.split("_"))


@dataclass(frozen=True)
class Pose:
    """T frames of joint rotations, root translation and facial expression.

    Rotations are relative to the parent joint, those of the root to the world; hands are relative
    to the flat hand. One group of joints is a slice, such as ``pose.rotations[:, LEFT_HAND]``.

    Example:
        >>> pose = Pose.rest(frames=3)
        >>> pose.rotations[:, JOINTS.index("left_elbow"), 1] = -1  # bend the elbow by a radian
        >>> len(pose), pose[1].rotations.shape, pose.rotations[:, LEFT_HAND].shape
        (3, torch.Size([1, 55, 3]), torch.Size([3, 15, 3]))
    """

    rotations: Tensor  # (T, 55, 3) axis-angle in radians, in the order of JOINTS
    transl: Tensor  # (T, 3) metres, world
    expression: Tensor  # (T, E) coefficients

    def __post_init__(self) -> None:
        if self.rotations.ndim != 3 or self.rotations.shape[1:] != (len(JOINTS), 3):
            raise ValueError(
                f"Pose: rotations must be (T, {len(JOINTS)}, 3), got {tuple(self.rotations.shape)}"
            )

    @staticmethod
    def rest(
        frames: int = 1, expressions: int = SMPLX_EXPRESSIONS, dtype: torch.dtype = torch.float32
    ) -> Pose:
        """Return the T-pose at the world's origin.

        Example:
            >>> Pose.rest(frames=2, expressions=5).expression.shape
            torch.Size([2, 5])
        """
        zero = lambda *shape: torch.zeros(frames, *shape, dtype=dtype)
        return Pose(zero(len(JOINTS), 3), zero(3), zero(expressions))

    @staticmethod
    def of_arrays(rotations: np.ndarray, transl: np.ndarray, expression: np.ndarray) -> Pose:
        """Build a float32 pose from arrays of its fields.

        Example:
            >>> Pose.of_arrays(np.zeros((2, 55, 3)), np.zeros((2, 3)), np.zeros((2, 10))).transl
            tensor([[0., 0., 0.],
                    [0., 0., 0.]])
        """
        tensor = lambda x: torch.from_numpy(np.ascontiguousarray(x, np.float32))
        return Pose(tensor(rotations), tensor(transl), tensor(expression))

    @staticmethod
    def from_smplx(named: Mapping[str, Tensor]) -> Pose:
        """Build a pose from tensors under SMPL-X's names, as of :meth:`to_smplx`.

        They are ``global_orient`` (T, 3), ``body_pose`` (T, 63), ``jaw_pose``, ``leye_pose``,
        ``reye_pose`` (T, 3), ``left_hand_pose``, ``right_hand_pose`` (T, 45), ``transl`` (T, 3)
        and ``expression`` (T, E).

        Example:
            >>> Pose.from_smplx(Pose.rest(frames=2).to_smplx()).rotations.shape
            torch.Size([2, 55, 3])
        """
        columns = torch.cat([named[name] for name in SMPLX_FIELDS], dim=1)
        return Pose(columns.unflatten(1, (-1, 3)), named["transl"], named["expression"])

    def to_smplx(self) -> dict[str, Tensor]:
        """Return the pose under SMPL-X's names, in the order of files.

        Example:
            >>> {name: tuple(x.shape) for name, x in Pose.rest().to_smplx().items()}
            {'global_orient': (1, 3), 'body_pose': (1, 63), 'jaw_pose': (1, 3),
             'leye_pose': (1, 3), 'reye_pose': (1, 3), 'left_hand_pose': (1, 45),
             'right_hand_pose': (1, 45), 'transl': (1, 3), 'expression': (1, 10)}
        """
        joints = {name: self.rotations[:, part].flatten(1) for name, part in SMPLX_FIELDS.items()}
        return joints | {"transl": self.transl, "expression": self.expression}

    @staticmethod
    def cat(poses: Sequence[Pose]) -> Pose:
        """Join poses one after the other in time.

        Example:
            >>> len(Pose.cat([Pose.rest(2), Pose.rest(3)]))
            5
        """
        fields = ((pose.rotations, pose.transl, pose.expression) for pose in poses)
        return Pose(*map(torch.cat, zip(*fields, strict=True)))

    def __len__(self) -> int:
        return self.transl.shape[0]

    def __getitem__(self, frames: int | slice | list[int] | Tensor) -> Pose:
        """Select frames; an int gives a Pose of one frame."""
        if isinstance(frames, int):
            frames = [frames]
        return self.map(lambda x: x[frames])

    def with_frames(self, frames: Sequence[int], found: Pose) -> Pose:
        """Replace the frames with these n numbers by the n frames of ``found``.

        Example:
            >>> raised = Pose.rest().map(lambda x: x + 1)
            >>> Pose.rest(3).with_frames([2], raised).transl[:, 0]
            tensor([0., 0., 1.])
        """
        frames, taken = list(frames), self.map(torch.clone)
        taken.rotations[frames], taken.transl[frames] = found.rotations, found.transl
        taken.expression[frames] = found.expression
        return taken

    def map(self, function: Callable[[Tensor], Tensor]) -> Pose:
        """Apply a function to rotations, translation and expression."""
        return Pose(function(self.rotations), function(self.transl), function(self.expression))

    def to(self, dtype: torch.dtype) -> Pose:
        """Convert to another precision."""
        return self.map(lambda x: x.to(dtype))


@dataclass(frozen=True)
class Shape:
    """Shape coefficients of one person, the same for a whole video.

    Example:
        >>> average = Shape(torch.zeros(10))
    """

    betas: Tensor  # (B,)


@dataclass(frozen=True)
class PoseFile:
    """Content of a file of poses, from :func:`read_pose_file`.

    Example:
        >>> refined = PoseFile(Pose.rest(frames=4), Shape(torch.zeros(10)), stage=2, offsets=None)
        >>> len(refined.pose), len(refined.shape.betas)
        (4, 10)
    """

    pose: Pose
    shape: Shape
    stage: int  # source of the poses: 0 ground truth, 1 an estimator, 2 refinement or training
    offsets: Tensor | None  # (V, 3) displacement of the rest surface that refinement found, metres


_EXPECTED = "poses under SMPL-X's names (.npz)"
_REQUIRED = ("global_orient", "body_pose", "transl", "betas")


def read_pose_file(path: Path, count: int | None = None) -> PoseFile:
    """Read ``poses.npz``: SMPL-X's names, each (T, ...), and ``betas`` (B,).

    Face and hands may be missing: they are then zero. So may ``stage`` (1) and
    ``offsets``. Other keys are ignored.

    Args:
        path: the file.
        count: number of frames of the video that the poses belong to; None: any number.

    Raises:
        InputError: a missing key, a wrong shape or dtype, or a number that is not finite.

    Example:
        >>> import tempfile
        >>> folder = tempfile.TemporaryDirectory()
        >>> path = Path(folder.name) / "poses.npz"
        >>> save_poses(path, Pose.rest(frames=4), Shape(torch.zeros(10)), stage=1)
        >>> found = read_pose_file(path)
        >>> len(found.pose), found.stage, found.offsets
        (4, 1, None)
    """
    data = read_arrays(path, _EXPECTED)
    require_keys(path, data, _REQUIRED)
    frames = len(_numbers(path, "transl", data["transl"], (None, 3)))
    if frames == 0:
        raise InputError(f"{path}: 'transl' holds no frame; expected (T, 3) with T of at least 1")
    if count not in (None, frames):
        raise InputError(f"{path}: holds {frames} frames, but the video has {count}")
    data.setdefault("expression", np.zeros((frames, SMPLX_EXPRESSIONS)))
    widths = _WIDTHS | {"transl": 3, "expression": None}
    named = {
        name: _numbers(path, name, data.get(name, np.zeros((frames, width or 0))), (frames, width))
        for name, width in widths.items()
    }
    betas = _numbers(path, "betas", data["betas"], (None,), (None, None))
    if betas.ndim == 2 and len(betas) and (betas == betas[:1]).all():
        betas = betas[0]  # repeated per frame, as some estimators write it
    if betas.ndim != 1:
        expected = "must be (B,), one person for all frames"
        raise InputError(f"{path}: 'betas' {expected}; got {tuple(betas.shape)}")
    stage = data.get("stage", np.array(1))
    if stage.shape != () or stage.dtype.kind not in "iuf" or stage.item() not in (0, 1, 2):
        raise InputError(f"{path}: 'stage' must be 0, 1 or 2, got {stage}")
    offsets = data.get("offsets")
    if offsets is not None:
        offsets = _numbers(path, "offsets", offsets, (None, 3))
    return PoseFile(Pose.from_smplx(named), Shape(betas), int(stage), offsets)


def is_pose_file(path: Path) -> bool:
    """Return whether a file holds poses for :func:`read_pose_file`, not another program's motion.

    A missing file counts too, because that reader reports it.

    Example:
        >>> is_pose_file(Path("no_such_file.npz"))
        True
    """
    if not path.exists():
        return True
    try:
        arrays = read_arrays(path, _EXPECTED)
    except InputError:
        return False
    if "stage" in arrays:  # written by this program, even if damaged since
        return True
    return set(_REQUIRED) <= set(arrays) and all(
        arrays[name].ndim == 2 and arrays[name].shape[1] == width
        for name, width in _WIDTHS.items()
        if name in arrays
    )


def load_poses(path: Path, count: int | None = None) -> tuple[Pose, Shape]:
    """Read only the poses and the shape of a file; see :func:`read_pose_file`.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "poses.npz"
        >>> save_poses(path, Pose.rest(frames=4), Shape(torch.ones(10)), stage=1)
        >>> pose, shape = load_poses(path, count=4)
        >>> len(pose), float(shape.betas.sum())
        (4, 10.0)
    """
    found = read_pose_file(path, count)
    return found.pose, found.shape


def save_poses(
    path: Path, pose: Pose, shape: Shape, *, stage: int, offsets: Tensor | None = None
) -> None:
    """Write ``poses.npz``; the arguments are the fields of :class:`PoseFile`.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "poses.npz"
        >>> save_poses(path, Pose.rest(frames=4), Shape(torch.zeros(10)), stage=1)
        >>> with np.load(path) as file:
        ...     file["body_pose"].shape, file["betas"].shape, int(file["stage"])
        ((4, 63), (10,), 1)
    """
    data = {name: value.detach().numpy() for name, value in pose.to_smplx().items()}
    if offsets is not None:
        data["offsets"] = offsets.detach().numpy()
    write_arrays(path, **data, betas=shape.betas.detach().numpy(), stage=np.array(stage))


def _numbers(path: Path, name: str, value: np.ndarray, *forms: Form) -> Tensor:
    """Check an array of a file and convert it to float32."""
    largest = LARGEST_IN_FILES.get(name, LARGEST_ANGLE)
    value = require_array(path, name, value, *forms, largest=largest)
    return torch.from_numpy(np.ascontiguousarray(value, dtype=np.float32))
