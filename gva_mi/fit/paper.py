"""The fit and the refinement as the paper prints them: ``--preset paper``.

``docs/paper.md`` compares each with the defaults, and says what the paper leaves open. Rates that
it does not print are from GART (Lei et al. 2023), whose code it builds on.
"""

from __future__ import annotations

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.reinit import ReinitOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.rig import SkinningOptions
from gva_mi.fit.options import FitOptions, Rates
from gva_mi.fit.poses import PoseOptions
from gva_mi.refine.single_frame import SingleFrameOptions

SKINNING = SkinningOptions(spread=0.0, neighbours=1, joints=4)  # Eq. 5
REINIT = ReinitOptions(  # Sec. 4.3; steps of the filter and sizes are not printed
    surface="alpha", smoothing=3, face_gain=0.0, random=True, scale_jitter=0.5
)
RATES = Rates(means=1.6e-4, means_end=1.6e-6, sh=2.5e-3)
AVATAR = AvatarOptions(
    residual=ResidualOptions(enabled=True), stretch=False, color="view", skinning=SKINNING
)
FIT = FitOptions(
    naked=True,
    min_scale=0.0,
    avatar=AVATAR,
    rates=RATES,
    reinit=REINIT,
    poses=PoseOptions(trained=False),
)
REFINE = SingleFrameOptions(silhouette=5.0, prior=0.5)  # Eq. 8: λ1, λ2
