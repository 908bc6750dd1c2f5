"""Keep the figures of a study that a lesson plots, few enough to commit.

gva-mi study avatar ... --out STUDY
python notebooks/keep_figures.py STUDY/avatar.json notebooks/6_an_ablation.json
"""

import json
import sys
from pathlib import Path

KEPT = ("PSNR, dB", "Gaussians", "seconds")  # metrics
REGIONS = ("white", "hands", "")
DIGITS = 3


def keep(study):
    """Return a study's record (``gva_mi.study.engine``) with the figures that are kept."""
    kept = [
        row | {"value": round(row["value"], DIGITS)}
        for row in study["figures"]
        if row["metric"] in KEPT and row["region"] in REGIONS and row["split"] != "train"
    ]
    return {name: study[name] for name in ("kind", "made_with", "versions")} | {"figures": kept}


def text_of(record):
    """Write the record as JSON with a line for each figure."""
    *others, _ = (f"{json.dumps(name)}: {json.dumps(x)}" for name, x in record.items())
    lines = ",\n".join(json.dumps(row) for row in record["figures"])
    return "{" + ",\n".join([*others, f'"figures": [\n{lines}\n]']) + "}\n"


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    target.write_text(text_of(keep(json.loads(source.read_text()))))
    print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")
