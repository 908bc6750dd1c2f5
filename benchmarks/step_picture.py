"""Draw a step of a fit by its stages, of one commit above another.

    gva-mi bench fit --json before.json     # in a checkout of the older commit
    gva-mi bench fit --json now.json
    python -m benchmarks.step_picture before.json now.json docs/step.png

A bar is the mean step: the sum of the least time of each stage, the perceptual term by the share of
steps that have it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from gva_mi.core.files import read_json
from gva_mi.fit.options import FitOptions

WITH, WITHOUT = "with VGG", "without"
LOSS = "Eq. 9 and back"
STAGES = (
    "pose", "avatar", "target", "splatting",
    LOSS, "splatting, back", "avatar and pose, back", "Adam",
)  # fmt: skip


def stages_of(path: Path) -> dict[str, float]:
    """Return the milliseconds of each stage of the mean step in a file of ``bench fit --json``."""
    rows = {row[""]: row["min ms"] for row in read_json(path, "of bench fit --json")[0]["rows"]}
    found = dict.fromkeys(STAGES, 0.0)
    share = 1 / FitOptions().perceptual_every
    for name, ms in rows.items():
        part = share if WITH in name else 1 - share if WITHOUT in name else 1
        found[LOSS if name.startswith(LOSS) else name] += part * ms
    return found


def draw(files: dict[str, Path], out: Path) -> None:
    """Draw the bars of some files, by their labels, from the top down."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 1.2 + 0.7 * len(files)), layout="constrained")
    left = dict.fromkeys(files, 0.0)
    bars = {label: stages_of(path) for label, path in files.items()}
    for stage in STAGES:
        widths = [bar[stage] for bar in bars.values()]
        axes.barh(list(bars), widths, left=list(left.values()), label=stage, edgecolor="white")
        left = {label: left[label] + width for label, width in zip(bars, widths, strict=True)}
    for label, total in left.items():
        axes.text(total, label, f" {total:.1f} ms", va="center")
    axes.invert_yaxis()
    axes.set(xlim=(0, 1.12 * max(left.values())), xlabel="ms")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python -m benchmarks.step_picture BEFORE.json NOW.json OUT.png")
    before, now, out = map(Path, sys.argv[1:])
    draw({"before": before, "now": now}, out)
