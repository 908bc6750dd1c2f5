"""The built-in body: a puppet in SMPL-X's format that needs no licence.

``puppet.npz`` holds the same keys as an SMPL-X file and is read by the same loader. It was modelled from scratch, as a
smooth union of simple solids, by ``python -m gva_mi.data.synthetic.sculpt``, which rewrites it to the bit.
"""

from __future__ import annotations

from pathlib import Path

PUPPET = Path(__file__).with_name("puppet.npz")  # lies beside this file, about 1 MB
