"""The camera, and all conventions about axes and pixels.

* World: right-handed, y up, metres.
* Camera: OpenCV axes, x right, y down, z forward. ``x_cam = T_camera_world · x_world``.
* Pixel (column i, row j) covers [i, i+1) x [j, j+1); its centre lies at (i + 0.5, j + 0.5).
* Pinhole: ``u = fx · x/z + cx``, ``v = fy · y/z + cy``.
* Ortho: ``u = fx · x + cx``: parallel rays, the focal lengths are pixels per metre.
* Fisheye: ``u = fx · x · s + cx`` with ``s = atan2(r, z)/r``, ``r`` the distance from the axis: the
  equidistant lens, without distortion; focal lengths are pixels per radian.
* Transforms are named target first: ``T_camera_world`` takes world to camera.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from torch import Tensor


class ArgumentError(ValueError):
    """``function: name[index] problem``: which argument is wrong, where in it, and why.

    Example:
        >>> print(ArgumentError("render()", "means", "is nan, must be finite", "[0, 2]"))
        render(): means[0, 2] is nan, must be finite
    """

    def __init__(self, function: str, name: str, problem: str, index: str = "") -> None:
        super().__init__(function, name, problem, index)  # all of args: errors are pickled by them

    def __str__(self) -> str:
        function, name, problem, index = self.args
        return f"{function}: {name}{index} {problem}"

    def renamed(self, function: str, names: dict[str, str]) -> ArgumentError:
        """Return the error of another function, whose arguments have other names."""
        _, name, problem, index = self.args
        return ArgumentError(function, names.get(name, name), problem, index)


CACHED_CAMERAS = 1024  # cameras that need no second check; chosen: the views of a large capture
MAX_PIXELS = 1 << 28  # of an image; chosen: its five channels take 5 GiB
CameraModel = Literal["pinhole", "ortho", "fisheye"]

_UNIT = np.eye(3)
_SKEW_TOLERANCE = 1e-4  # over fx. Chosen: it moves the border of a 2K picture by a tenth of a pixel
_RIGID_TOLERANCE = 1e-4 + 1e-5 * _UNIT  # of R R^T: chosen, a rotation in float32 passes


class CameraTensors(NamedTuple):
    """Differentiable matrices of a camera, torch's or Dr.Jit's; None for a constant.

    Example:
        >>> CameraTensors()
        CameraTensors(T_camera_world=None, K=None)
    """

    T_camera_world: Tensor | dr.ArrayBase | None = None  # (4, 4)
    K: Tensor | dr.ArrayBase | None = None  # (3, 3)


@dataclass(frozen=True, eq=False)
class Camera:
    """One view: intrinsics in pixels, a rigid pose, and the size of the image.

    A camera that :meth:`from_matrices` made from tensors also keeps the tensors, and renderers
    differentiate with respect to them. Cameras with the same numbers are equal. The axes follow
    OpenCV, the models gsplat's ``camera_model``.

    Example:
        >>> camera = Camera(100.0, 100.0, 32.0, 24.0, look_at((0, 0, 2), (0, 0, 0)), 64, 48)
        >>> camera.project(np.array([0.0, 0.1, 0.0])).round(3).tolist()  # up is a smaller v
        [32.0, 19.0]
        >>> camera.resized(32, 24).fx
        50.0
    """

    fx: float  # focal length in x, pixels
    fy: float  # focal length in y, pixels
    cx: float  # principal point, pixels from the left border
    cy: float  # principal point, pixels from the top border
    # (4, 4) float64, takes world to camera: rigid, or also mirrored, as behind a mirror
    T_camera_world: np.ndarray
    width: int  # pixels
    height: int  # pixels
    model: CameraModel = "pinhole"
    tensors: CameraTensors = field(default=CameraTensors(), repr=False)

    def __post_init__(self) -> None:
        T = np.array(self.T_camera_world, dtype=np.float64)
        if T.shape != (4, 4):
            raise _refusal("T_camera_world", f"must be (4, 4), got {T.shape}")
        if not np.isfinite(T).all() or not _is_rotation(T[:3, :3]):
            problem = "must be rigid: finite, with a rotation in [:3, :3]"
            raise _refusal("T_camera_world", problem)
        if self.model not in get_args(CameraModel):
            known = ", ".join(get_args(CameraModel))
            raise _refusal("model", f"must be one of {known}, got {self.model!r}")
        if not all(math.isfinite(x) for x in (self.fx, self.fy, self.cx, self.cy)):
            found = f"{self.fx}, {self.fy}, {self.cx}, {self.cy}"
            raise _refusal("fx, fy, cx, cy", f"must be finite, got {found}")
        if min(self.width, self.height) < 1 or self.width * self.height > MAX_PIXELS:
            found = f"{self.width}x{self.height}"
            raise _refusal("size", f"must be 1x1 to {MAX_PIXELS:,} pixels, got {found}")
        if not (self.fx > 0 and self.fy > 0):
            raise _refusal("focal lengths", f"must be positive, got {self.fx}, {self.fy}")
        T.setflags(write=False)
        object.__setattr__(self, "T_camera_world", T)
        for name, tensor in self.tensors._asdict().items():
            number = getattr(self, name)
            if tensor is None:
                continue
            given = _numbers(tensor)
            if not (  # in this order: allclose takes as long as everything else here
                np.array_equal(given, number) or np.allclose(given, number, 1e-4, 1e-3)
            ):
                raise _refusal(name, "differs from its tensor; use with_matrices")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        """All numbers, without the tensors."""
        pose = tuple(self.T_camera_world.ravel().tolist())
        lens = (self.fx, self.fy, self.cx, self.cy, self.width, self.height, self.model)
        return (*lens, pose)

    @staticmethod
    def from_matrices(
        K: ArrayLike | Tensor | dr.ArrayBase,
        T_camera_world: ArrayLike | Tensor | dr.ArrayBase,
        width: int,
        height: int,
        model: CameraModel = "pinhole",
    ) -> Camera:
        """Make a camera from its intrinsics and its pose.

        Args:
            K: (3, 3) intrinsics, px; numbers, or a differentiable torch or Dr.Jit tensor.
            T_camera_world: (4, 4), rigid; numbers, or a tensor of the same kind.
            width, height: of the image, px.
            model: of the lens.
        """
        k = _numbers(K)
        if k.shape != (3, 3):
            raise _refusal("K", f"must be (3, 3), got {k.shape}")
        T, size = _numbers(T_camera_world), (int(width), int(height))
        make = _checked if isinstance(model, str) else _checked.__wrapped__  # not hashable
        checked = make(k.tobytes(), T.tobytes(), T.shape, *size, model)
        # the numbers come from the tensors: no need to compare them
        tensors = CameraTensors(*(x if _is_tensor(x) else None for x in (T_camera_world, K)))
        camera = object.__new__(Camera)
        vars(camera).update(vars(checked), tensors=tensors)
        return camera

    def with_matrices(
        self,
        T_camera_world: ArrayLike | Tensor | dr.ArrayBase | None = None,
        K: ArrayLike | Tensor | dr.ArrayBase | None = None,
    ) -> Camera:
        """Replace the pose (4, 4) or the intrinsics (3, 3); None keeps its own."""
        given = lambda *matrices: next(matrix for matrix in matrices if matrix is not None)
        T = given(T_camera_world, self.tensors.T_camera_world, self.T_camera_world)
        K = given(K, self.tensors.K, self.K)
        return Camera.from_matrices(K, T, self.width, self.height, self.model)

    @property
    def K(self) -> np.ndarray:
        """Intrinsics as a matrix, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def position(self) -> np.ndarray:
        """Position of the camera in the world, (3,)."""
        R, t = self.T_camera_world[:3, :3], self.T_camera_world[:3, 3]
        return -np.linalg.solve(R, t)

    def resized(self, width: int, height: int) -> Camera:
        """Return the same view on another grid of pixels."""
        x, y = width / self.width, height / self.height
        return self._adapted([x, x, x, y, y, y], [0] * 6, width, height)

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the part of the view that starts at pixel (left, top)."""
        return self._adapted([1] * 6, [0, 0, -left, 0, 0, -top], width, height)

    def zoomed(self, factor: float) -> Camera:
        """Return the view through a lens with ``factor`` times the focal lengths."""
        return self._adapted([factor, 1, 1, 1, factor, 1], [0] * 6, self.width, self.height)

    def _adapted(self, scale: list[float], shift: list[float], width: int, height: int) -> Camera:
        """Scale and shift the upper two rows of K, and set the size."""
        K = self.tensors.K
        if K is not None:
            rows = lambda numbers, last: np.reshape([*numbers, *last], (3, 3)).tolist()
            K = K * _like(K, rows(scale, [1] * 3)) + _like(K, rows(shift, [0] * 3))
        fx, fy = self.fx * scale[0], self.fy * scale[4]
        cx, cy = self.cx * scale[2] + shift[2], self.cy * scale[5] + shift[5]
        tensors = self.tensors._replace(K=K)
        return replace(
            self, fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height, tensors=tensors
        )

    def depths(self, points: np.ndarray) -> np.ndarray:
        """Return the depths (...), metres, of world points (..., 3): negative behind the camera."""
        return points @ self.T_camera_world[2, :3] + self.T_camera_world[2, 3]

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project world points (..., 3) to pixels (..., 2); meaningless behind the camera."""
        x = points @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]
        if self.model == "pinhole":
            scale = 1 / x[..., 2]
        elif self.model == "ortho":
            scale = np.ones_like(x[..., 2])
        elif self.model == "fisheye":
            r = np.maximum(np.hypot(x[..., 0], x[..., 1]), 1e-12)
            scale = np.arctan2(r, x[..., 2]) / r
        else:
            raise ValueError(f"Camera.project: unknown camera model {self.model!r}")
        u = self.fx * x[..., 0] * scale + self.cx
        v = self.fy * x[..., 1] * scale + self.cy
        return np.stack([u, v], axis=-1)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> np.ndarray:
    """Return ``T_camera_world`` (4, 4) of a camera at ``eye`` that looks at ``target``.

    ``up`` points upwards in the picture. The function is OpenGL's ``gluLookAt``, for OpenCV's axes.

    Example:
        >>> (look_at((0, 0, 3), (0, 0, 0)) @ [0, 0, 0, 1]).tolist()  # the target lies 3 m ahead
        [0.0, 0.0, 3.0, 1.0]
    """
    eye, target, up = (np.asarray(x, dtype=np.float64) for x in (eye, target, up))
    unit = lambda v: v / np.sqrt((v * v).sum())  # no BLAS: its bits depend on the CPU
    forward = unit(target - eye)
    right = unit(np.cross(forward, up))
    R = np.stack([right, np.cross(forward, right), forward])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -(R * eye).sum(1)
    return T


def _refusal(name: str, problem: str) -> ArgumentError:
    return ArgumentError("Camera", name, problem)


@functools.lru_cache(CACHED_CAMERAS)
def _checked(
    K: bytes, T: bytes, shape: tuple[int, ...], width: int, height: int, model: CameraModel
) -> Camera:
    """Make a camera from float64 memory, cached: training renders the same views repeatedly."""
    fx, skew, cx, other, fy, cy, *last = np.frombuffer(K).tolist()
    camera = Camera(fx, fy, cx, cy, np.frombuffer(T).reshape(shape), width, height, model)
    if not sum(map(abs, (skew, other, *last[:2]))) <= _SKEW_TOLERANCE * fx:
        got = np.frombuffer(K).round(4).tolist()
        raise _refusal("K", f"must be fx, 0, cx, 0, fy, cy, 0, 0, 1 by rows, got {got}")
    return camera


def _is_rotation(R: np.ndarray) -> bool:
    """Whether R R^T is 1 within float32 digits; np.allclose takes six times as long."""
    return bool((np.abs(R @ R.T - _UNIT) <= _RIGID_TOLERANCE).all())


def _is_tensor(matrix: Any) -> bool:  # noqa: ANN401
    """Whether a matrix is a tensor, by its methods, because this module does not import torch."""
    return hasattr(matrix, "new_tensor") or isinstance(matrix, dr.ArrayBase)


def _numbers(matrix: Any) -> np.ndarray:  # noqa: ANN401
    """Return a matrix of any kind in float64, detached."""
    if hasattr(matrix, "new_tensor"):
        matrix = matrix.detach().tolist()  # .numpy() fails under torch.func
    elif isinstance(matrix, dr.ArrayBase):
        matrix = dr.detach(matrix).numpy()
    return np.asarray(matrix, dtype=np.float64)


def _like(tensor: Any, numbers: list[list[float]]) -> Any:  # noqa: ANN401
    """Return constants of the kind and precision of a tensor."""
    if isinstance(tensor, dr.ArrayBase):
        return type(tensor)(np.array(numbers, dtype=np.float64))
    return tensor.new_tensor(numbers)
