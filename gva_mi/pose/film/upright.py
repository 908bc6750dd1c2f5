"""What is above what in a person who stands: the axes of trunk and balance.

1. ``trunk = X_neck - X_pelvis``
2. ``balance = Σ_j m_j X_j - X_feet``: the body's mass is above the feet, of people who crouch or
   bend as well

At rest ``X_neck`` is straight above the pelvis, and ``X_feet`` below the mass, because the ankles
of a person who stands are behind it.
"""

from __future__ import annotations

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


def _axes() -> Tensor:
    trunk, balance = ({name: 0.0 for name in MASSES} for _ in range(2))
    trunk |= {"neck": 1.0, "pelvis": -1.0}
    balance |= {name: mass - (name in FEET) / len(FEET) for name, mass in MASSES.items()}
    return torch.tensor([list(axis.values()) for axis in (trunk, balance)], dtype=torch.float64)


AXES = _axes()  # (2, 15) factors of the joints of MASSES, whose sums are (1) and (2)


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
