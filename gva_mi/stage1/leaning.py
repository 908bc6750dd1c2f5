"""How a person leans: a standing person has an upright trunk, and the mass above the feet."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# Shares m_j of the body's mass. The mass of each segment is divided between the joints at its ends,
# by where its centre of mass lies (Winter, Biomechanics and Motor Control of Human Movement, table
# 4.1).
_OF_SIDES = {
    "shoulder": 0.016, "elbow": 0.021, "wrist": 0.013, "hip": 0.0567, "knee": 0.0697,
    "ankle": 0.0346,
}  # fmt: skip
MASS_SHARES = {"head": 0.081, "neck": 0.2486, "pelvis": 0.2484} | {
    f"{side}_{name}": mass for name, mass in _OF_SIDES.items() for side in ("left", "right")
}
FEET = ("left_ankle", "right_ankle")
SHARE_SIGMA = 12**-0.5  # standard deviation of s: of a uniform distribution of width 1


def _axis_factors() -> Tensor:
    trunk, balance, feet = ({name: 0.0 for name in MASS_SHARES} for _ in range(3))
    trunk |= {"neck": 1.0, "pelvis": -1.0}
    balance |= {name: mass - (name in FEET) / len(FEET) for name, mass in MASS_SHARES.items()}
    feet |= {"left_ankle": 1.0, "right_ankle": -1.0}
    axes = [list(axis.values()) for axis in (trunk, balance, feet)]
    return torch.tensor(axes, dtype=torch.float64)


# (3, 15) factors of the joints of MASS_SHARES; the sums are the axes of trunk, balance and feet.
AXIS_FACTORS = _axis_factors()


@dataclass(frozen=True)
class Leaning:
    """How the axes of trunk and balance lean in n frames of a standing person.

    1. ``trunk = X_neck - X_pelvis``
    2. ``balance = Σ_j m_j X_j - X_feet``
       with ``X_feet = (X_left + X_right) / 2 + s (X_left - X_right)``

    The body's mass is above the feet, even if the person crouches or bends. ``s`` is the share of
    the weight on the left foot, minus a half. All shares between zero and one are equally likely,
    and the best one is taken. With the direction up ``u``, an axis leans by

    3. ``lean = (axis - (u · axis) u) / length``

    where ``length`` is the length of the trunk axis, or of the balance axis with s = 0.

    At rest ``X_neck`` is moved straight above the pelvis, and the feet below the mass
    (:func:`upright_at_rest`), because the ankles of a standing person are behind it.

    Attributes:
        lean: (n, 2, 3) of eq. 3, trunk and balance.
        share: (n, 1) ``s``.
        axes: (n, 2, 3) trunk and balance, metres.
        length: (n, 2, 1) metres.
        along: (n, 2, 3) derivative of the length with respect to the axis with s = 0.
        up: (3,) ``u``.
    """

    lean: Tensor
    share: Tensor
    axes: Tensor
    length: Tensor
    along: Tensor
    up: Tensor

    @staticmethod
    def of(X: Tensor, up: Tensor, sigma: float) -> Leaning:
        """Measure how joints X (n, 15, 3), metres, lean; ``sigma`` is the spread of ``lean``."""
        trunk, balance, feet = torch.einsum("ap,npc->anc", AXIS_FACTORS.to(up), X)
        level = torch.eye(3).to(up) - up[:, None] * up
        axes = torch.stack([trunk, balance], 1)
        length = axes.norm(dim=2, keepdim=True)
        lean, aside = axes @ level / length, feet @ level / length[:, 1]
        share = (lean[:, 1] * aside).sum(1, keepdim=True)
        share = share / (aside.square().sum(1, keepdim=True) + (sigma / SHARE_SIGMA) ** 2)
        share = share.clamp(-0.5, 0.5)
        carried = torch.stack([trunk, balance - share * feet], 1)
        return Leaning(carried @ level / length, share, carried, length, axes / length, up)

    def slopes(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``lean`` (n, 2, 3, U) from the joints' derivatives (n, 15, 3,
        U).

        The share counts as constant: it is the best share, so the energy is stationary in it.
        """
        trunk, balance, feet = torch.einsum("ap,npcu->ancu", AXIS_FACTORS.to(by), by)
        longer = torch.einsum("nac,nacu->nau", self.along, torch.stack([trunk, balance], 1))
        by = torch.stack([trunk, balance - self.share[..., None] * feet], 1)
        level = torch.eye(3).to(by) - self.up[:, None] * self.up
        return (level @ by - self.lean[..., None] * longer[:, :, None]) / self.length[..., None]

    def slopes_by_up(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``lean`` (n, 2, 3, U) from the derivatives of u (3, U)."""
        turned = (self.axes @ self.up)[..., None, None] * by
        turned = turned + self.up[:, None] * (self.axes @ by)[:, :, None]
        return -turned / self.length[..., None]


def upright_at_rest(places: Tensor) -> Tensor:
    """Move the neck above the pelvis, and the feet below the mass, in joints (..., 15, 3) at rest.

    The map changes z alone and is linear, so it also applies to derivatives with respect to betas.
    """
    names, z = list(MASS_SHARES), places[..., 2].clone()
    mass = z.new_tensor(list(MASS_SHARES.values()))
    z[..., names.index("neck")] = z[..., names.index("pelvis")]
    feet = [names.index(name) for name in FEET]
    mass[feet] = 0
    z[..., feet] = ((z @ mass) / mass.sum())[..., None]
    return torch.stack([*places[..., :2].unbind(-1), z], -1)
