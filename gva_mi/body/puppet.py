"""The built-in body: a puppet in SMPL-X's format that needs no licence.

``puppet.npz`` holds the keys of an SMPL-X file and is read by the same loader. It is modelled from
scratch, as a smooth union of simple solids, by ``python -m gva_mi.sculptor``, and
comes under the licence of this package.

* 11,000 vertices, watertight, of one piece, symmetric; more of them at hands, face and toes.
* 1.77 m tall; the pelvis at the origin, y up, facing +z, the left hand toward +x.
* Fingers apart, a mouth that opens with the jaw, eyes that turn, correctives where joints bend.
"""

from __future__ import annotations

from pathlib import Path

PUPPET = Path(__file__).with_name("puppet.npz")

# What its coefficients mean; one unit is a clear but common deviation (height: 4 %).
SHAPES = (
    "height", "weight", "leg length", "arm length", "shoulder width", "hip width", "chest", "belly",
    "muscles", "size of the head",
)  # fmt: skip
EXPRESSIONS = (
    "mouth open", "smile", "corners of the mouth down", "lips pushed out", "brows up", "brows down",
    "blink", "cheeks blown", "upper lip up", "mouth to the left",
)  # fmt: skip
