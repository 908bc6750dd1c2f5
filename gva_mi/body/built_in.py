"""The built-in body, in SMPL-X's format and under the licence of this package.

``puppet.npz`` has the keys of an SMPL-X file and is read by the same loader. It is generated from
scratch, as a smooth union of simple solids, by ``python -m tools.body_generator``.

* 11,000 vertices, watertight, connected, symmetric; denser at hands, face and toes.
* 1.77 m tall; the pelvis at the origin, y up, facing +z, the left hand toward +x.
* Separate fingers, a mouth that opens with the jaw, eyes that turn, pose correctives.
"""

from __future__ import annotations

from pathlib import Path

BUILT_IN_BODY = Path(__file__).with_name("puppet.npz")

# Its coefficients; one unit is a clear but common deviation (height: 4 %).
SHAPES = (
    "height", "weight", "leg length", "arm length", "shoulder width", "hip width", "chest", "belly",
    "muscles", "size of the head",
)  # fmt: skip
EXPRESSIONS = (
    "mouth open", "smile", "corners of the mouth down", "lips pushed out", "brows up", "brows down",
    "blink", "cheeks blown", "upper lip up", "mouth to the left",
)  # fmt: skip
