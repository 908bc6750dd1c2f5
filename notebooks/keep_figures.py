"""Keep the figures of a study that a lesson plots, few enough to commit.

gva-mi study avatar ... --out STUDY
python notebooks/keep_figures.py STUDY/avatar.json notebooks/6_an_ablation.json
"""

import json
import sys
from pathlib import Path

KEPT = ("psnr", "psnr in boxes", "pose error, mm", "cost")  # groups of gva_mi.study.tables
DIGITS = 3


def keep(study):
    """Return the record of a study (``gva_mi.study.engine``) with the figures that are kept."""
    results = [
        {"name": result["name"], "held_out": result["held_out"], "variant": result["variant"]}
        | {
            "figures": {
                name: round(value, DIGITS)
                for name, value in result["figures"].items()
                if value is not None and name.rpartition(": ")[0] in KEPT
            }
        }
        for result in study["results"]
    ]
    return {name: study[name] for name in ("kind", "made_with", "versions")} | {"results": results}


def text_of(record):
    """Write the record as JSON with a line for each result."""
    *others, _ = (f"{json.dumps(name)}: {json.dumps(x)}" for name, x in record.items())
    lines = ",\n".join(json.dumps(result) for result in record["results"])
    return "{" + ",\n".join([*others, f'"results": [\n{lines}\n]']) + "}\n"


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    target.write_text(text_of(keep(json.loads(source.read_text()))))
    print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")
