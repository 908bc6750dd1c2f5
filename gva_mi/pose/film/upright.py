"""What is above what in a person who stands: the axes of trunk and balance.

1. ``trunk = X_neck - X_pelvis``
2. ``balance = Σ_j m_j X_j - X_feet``,   ``X_feet = (X_left + X_right) / 2 + s (X_left - X_right)``

The body's mass is above the feet, of people who crouch or bend as well; ``s`` is the share of the
weight that the left foot carries beyond a half. Of all shares between zero and one, as likely as
each other, it is the one that fits best. With ``u`` the direction up, an axis leans by

3. ``off = (axis - (u · axis) u) / length``

where ``length`` is that of the trunk, and that of ``balance`` with s = 0.

At rest ``X_neck`` is straight above the pelvis, and the feet below the mass, because the ankles of
a person who stands are behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# Shares m_j of the body's mass: each segment's, on the joints at its ends as its centre of mass
# lies between them (Winter, Biomechanics and Motor Control of Human Movement, table 4.1).
_OF_SIDES = {
    "shoulder": 0.016, "elbow": 0.021, "wrist": 0.013, "hip": 0.0567, "knee": 0.0697,
    "ankle": 0.0346,
}  # fmt: skip
MASSES = {"head": 0.081, "neck": 0.2486, "pelvis": 0.2484} | {
    f"{side}_{name}": mass for name, mass in _OF_SIDES.items() for side in ("left", "right")
}
FEET = ("left_ankle", "right_ankle")
SHARE = 12**-0.5  # standard deviation of s


def _axes() -> Tensor:
    trunk, balance, feet = ({name: 0.0 for name in MASSES} for _ in range(3))
    trunk |= {"neck": 1.0, "pelvis": -1.0}
    balance |= {name: mass - (name in FEET) / len(FEET) for name, mass in MASSES.items()}
    feet |= {"left_ankle": 1.0, "right_ankle": -1.0}
    axes = [list(axis.values()) for axis in (trunk, balance, feet)]
    return torch.tensor(axes, dtype=torch.float64)


AXES = _axes()  # (3, 15) factors of the joints of MASSES, whose sums are trunk, balance and feet


@dataclass(frozen=True)
class Leaning:
    """How trunk and balance of n frames lean.

    Attributes:
        off: (n, 2, 3) of eq. 3.
        share: (n, 1) s.
    """

    off: Tensor
    share: Tensor
    axes: Tensor  # (n, 2, 3) metres
    length: Tensor  # (n, 2, 1) metres
    along: Tensor  # (n, 2, 3) slope of the length by the axis with s = 0
    up: Tensor  # (3,) u

    @staticmethod
    def of(X: Tensor, up: Tensor, sigma: float) -> Leaning:
        """Measure it at joints X (n, 15, 3), metres; ``sigma`` is the spread of ``off``."""
        trunk, balance, feet = torch.einsum("ap,npc->anc", AXES.to(up), X)
        level = torch.eye(3).to(up) - up[:, None] * up
        axes = torch.stack([trunk, balance], 1)
        length = axes.norm(dim=2, keepdim=True)
        off, aside = axes @ level / length, feet @ level / length[:, 1]
        share = (off[:, 1] * aside).sum(1, keepdim=True)
        share = share / (aside.square().sum(1, keepdim=True) + (sigma / SHARE) ** 2)
        share = share.clamp(-0.5, 0.5)
        carried = torch.stack([trunk, balance - share * feet], 1)
        return Leaning(carried @ level / length, share, carried, length, axes / length, up)

    def slopes(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``off`` (n, 2, 3, U) from those of the joints (n, 15, 3, U).

        The share stays: it is the best one, and its change changes no energy.
        """
        trunk, balance, feet = torch.einsum("ap,npcu->ancu", AXES.to(by), by)
        longer = torch.einsum("nac,nacu->nau", self.along, torch.stack([trunk, balance], 1))
        by = torch.stack([trunk, balance - self.share[..., None] * feet], 1)
        level = torch.eye(3).to(by) - self.up[:, None] * self.up
        return (level @ by - self.off[..., None] * longer[:, :, None]) / self.length[..., None]

    def slopes_by_up(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``off`` (n, 2, 3, U) from those of u (3, U)."""
        turned = (self.axes @ self.up)[..., None, None] * by
        turned = turned + self.up[:, None] * (self.axes @ by)[:, :, None]
        return -turned / self.length[..., None]


def above_one_another(places: Tensor) -> Tensor:
    """Move the neck above the pelvis, and the feet below the mass: joints (..., 15, 3) at rest.

    They move in z only, and linearly, so that what betas add to places moves in the same way.
    """
    names, z = list(MASSES), places[..., 2].clone()
    mass = z.new_tensor(list(MASSES.values()))
    z[..., names.index("neck")] = z[..., names.index("pelvis")]
    feet = [names.index(name) for name in FEET]
    mass[feet] = 0
    z[..., feet] = ((z @ mass) / mass.sum())[..., None]
    return torch.stack([*places[..., :2].unbind(-1), z], -1)
