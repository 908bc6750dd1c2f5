"""Cut-offs of splatting, read by the kernels and the reference implementation alike."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Annotated

from gva_mi.core.errors import InputError
from gva_mi.core.options import PythonOnly, Share, Within, options_of

# Metres; the upper bound is chosen: far beyond any scene, and finite in float32.
Distance = Annotated[float, Within(0, 1e12, "low")]


@options_of("SplatOptions")
class SplatOptions:
    """Cut-offs of the image formation. The defaults are those of gsplat 1.5.3.

    ``antialiased`` is the 2D filter of Mip-Splatting (Yu et al. 2024) as gsplat has it.

    Example:
        >>> like_3dgs = SplatOptions(alpha_max=0.99, near=0.2)
        >>> like_3dgs.blur
        0.3
        >>> SplatOptions(near=2.0, far=1.0)
        Traceback (most recent call last):
        ...
        gva_mi.core.errors.InputError: SplatOptions: near < far is needed, got 2.0, 1.0
    """

    # A Gaussian is skipped in pixels where its alpha is below; 0: of the reference alone.
    alpha_min: PythonOnly[Annotated[float, Within(0, 1, "high")]] = 1 / 255
    # Alpha is clamped to it; 1: of the reference alone.
    alpha_max: PythonOnly[Annotated[float, Within(0, 1, "low")]] = 0.999
    # A pixel stops before its transmittance falls to this.
    transmittance_min: PythonOnly[Share] = 1e-4
    # Added to the diagonal of the 2D covariance, square pixels.
    blur: Annotated[float, Within(0, 1e6)] = 0.3
    near: PythonOnly[Distance] = 0.01  # metres; nearer Gaussians are not drawn
    far: PythonOnly[Distance] = 1e10  # metres
    # Pixels; a Gaussian that reaches no further in x and y is not drawn.
    radius_min: PythonOnly[Annotated[float, Within(0, 1e6)]] = 0.0
    # A pinhole's Jacobian follows the mean up to 15 % of the picture beyond its border, as in 3DGS
    # and gsplat; False: everywhere, as EWA splatting is written.
    hold_jacobian: PythonOnly[bool] = True
    antialiased: bool = False  # reduce the opacity by the area that the blur adds
    depth: PythonOnly[bool] = True  # make the depth image too; pictures without it are faster

    def __post_init__(self) -> None:
        if not self.alpha_min < self.alpha_max:
            found = f"{self.alpha_min}, {self.alpha_max}"
            raise InputError(f"SplatOptions: alpha_min < alpha_max is needed, got {found}")
        if not self.near < self.far:
            raise InputError(f"SplatOptions: near < far is needed, got {self.near}, {self.far}")

    def kernel_constants(self) -> SplatOptions:
        """Return the options that are constants in the kernels' code; the rest are arguments.

        Raises:
            InputError: the kernels have no picture without a cut-off or a clamp of alpha.
        """
        if self.alpha_min == 0 or self.alpha_max == 1:
            found = f"{self.alpha_min}, {self.alpha_max}"
            raise InputError(
                "splat: alpha_min must be above 0 and alpha_max below 1, but in the reference "
                f"(gva_mi.splat.reference); got {found}"
            )
        return _kernel_constants(self)


@functools.lru_cache  # every picture needs it, and construction checks all ranges
def _kernel_constants(options: SplatOptions) -> SplatOptions:
    return replace(
        options,
        blur=SplatOptions.blur,
        near=SplatOptions.near,
        far=SplatOptions.far,
        radius_min=SplatOptions.radius_min,
        hold_jacobian=SplatOptions.hold_jacobian,
    )
