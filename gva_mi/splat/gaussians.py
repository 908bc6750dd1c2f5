"""``Gaussians``, the input of splatting, and ``Image``, its output.

Both hold arrays of one kind (Dr.Jit, torch or numpy). Quaternions are wxyz and need not be
normalised; scales are metres, not logarithms; opacities lie in [0, 1], not logits; colours are
linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

Array = TypeVar("Array")  # one kind of array

MAX_DEGREE = 4  # of the spherical harmonics, as in gsplat


@dataclass(frozen=True)
class Gaussians(Generic[Array]):
    """N anisotropic 3D Gaussians, each with a plain colour or one in spherical harmonics.

    The parameters are those of 3D Gaussian Splatting (Kerbl et al. 2023) after its activations.

    Example:
        >>> import numpy as np
        >>> one = Gaussians(
        ...     means=np.zeros((1, 3)),
        ...     quats=np.array([[1.0, 0, 0, 0]]),
        ...     scales=np.full((1, 3), 0.1),
        ...     opacities=np.array([0.5]),
        ...     colors=np.array([[1.0, 0.5, 0]]),
        ... )
        >>> len(one), one.channels
        (1, 3)
    """

    means: Array  # (N, 3) metres, world
    quats: Array | None  # (N, 4) wxyz, normalised inside
    scales: Array | None  # (N, 3) metres, standard deviations along the axes of quats
    opacities: Array  # (N,) in [0, 1]
    colors: Array | None = None  # (N, D), any number of channels
    # (N, K, 3) coefficients, K = (degree + 1)^2; colour = max(0, sum + 0.5)
    sh: Array | None = None
    # (N, 6) square metres: xx, xy, xz, yy, yz, zz; quats and scales are None
    covars: Array | None = None

    def __post_init__(self) -> None:
        if (self.colors is None) == (self.sh is None):
            raise ValueError("Gaussians: give either colors (N, D) or sh (N, K, 3)")
        if {self.quats is None, self.scales is None} != {self.covars is not None}:
            raise ValueError("Gaussians: give either quats (N, 4) and scales (N, 3), or covars")

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def channels(self) -> int:
        """D, the number of channels of the colour."""
        return 3 if self.colors is None else int(self.colors.shape[1])

    def arrays(self) -> dict[str, Array]:
        """Return the arrays that are set, by name."""
        form = ("quats", "scales") if self.covars is None else ("covars",)
        named = {name: getattr(self, name) for name in ("means", *form, "opacities")}
        return named | ({"sh": self.sh} if self.colors is None else {"colors": self.colors})

    def check_shapes(self) -> None:
        """Check that the arrays fit each other.

        Raises:
            ValueError: an array does not fit; the message names the first.
        """
        shapes = {name: tuple(array.shape) for name, array in self.arrays().items()}
        n = shapes["means"][0] if shapes["means"] else 0
        expected = {"means": (n, 3), "quats": (n, 4), "scales": (n, 3), "covars": (n, 6)}
        for name, shape in (expected | {"opacities": (n,)}).items():
            if name in shapes and shapes[name] != shape:
                form = "(N,)" if len(shape) == 1 else f"(N, {shape[1]})"
                found = f"{shapes[name]} where N is {n}"
                raise ValueError(f"Gaussians: {name} must be {form}, got {found}")
        if "colors" in shapes:
            shape = shapes["colors"]
            if len(shape) != 2 or shape[0] != n or shape[1] < 1:
                raise ValueError(f"Gaussians: colors must be (N, D), got {shape} where N is {n}")
            return
        shape = shapes["sh"]
        if len(shape) != 3 or shape[0] != n or shape[2] != 3:
            raise ValueError(f"Gaussians: sh must be (N, K, 3), got {shape} where N is {n}")
        degree_of(shape[1])


@dataclass(frozen=True)
class Image(Generic[Array]):
    """Result of ``render`` (paper, Eq. 3); all images are differentiable.

    Example:
        >>> import numpy as np
        >>> Image(color=np.ones((4, 6, 3)), alpha=np.ones((4, 6))).depth is None
        True
    """

    color: Array  # (H, W, D), background blended in
    alpha: Array  # (H, W) in [0, 1]
    # (H, W) m along the camera's z, accumulated like a colour: the sum of T_i alpha_i z_i; None
    # where SplatOptions.depth is off
    depth: Array | None = None


def degree_of(coefficients: int) -> int:
    """Return the degree of spherical harmonics whose basis has that many functions.

    Raises:
        ValueError: no degree up to :data:`MAX_DEGREE` has.

    Example:
        >>> degree_of(16)
        3
    """
    for degree in range(MAX_DEGREE + 1):
        if (degree + 1) ** 2 == coefficients:
            return degree
    raise ValueError(f"Gaussians: sh must hold 1, 4, 9, 16 or 25 coefficients, got {coefficients}")
