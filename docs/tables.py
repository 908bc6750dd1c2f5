"""Tables of the documents, written from the figures of the studies: no figure is copied by hand.

    python docs/tables.py STUDY     # the folder of `gva-mi study all`
    python docs/tables.py           # from docs/figures.csv alone, after a layout has changed

A table stands below the line ``<!-- figures of NAME -->`` of a page. :data:`TABLES` says which
figures are its rows and columns. ``docs/figures.csv`` keeps the figures that tables show, one row
for each subject. STUDY may lack studies: then their older figures are kept. Sources in STUDY are

==================  ==========================================  ================================
file                written by                                  study, variant of its figures
==================  ==========================================  ================================
table.json          ``gva-mi study all --out STUDY``            as the file says
NAME.json           ``gva-mi study multiview … --json``         NAME, none
NAME/RUN/           ``gva-mi fit`` and ``evaluate``, or         NAME, RUN
metrics.json        ``gva-mi demo --out STUDY/demo``
==================  ==========================================  ================================
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from cells import Part, Row, Shown, Table, Writer, extremes, part

from gva_mi.evaluate.figures import STAGES
from gva_mi.study.cases import LIMITS, TOUCH, held_out
from gva_mi.study.variants import BY_ALPHA, FULL, LADDER, VARIANTS, AvatarVariant
from gva_mi.subject.fingerprint import VIDEO_KIND

DOCS = Path(__file__).parent
FIGURES = DOCS / "figures.csv"
COLUMNS = (
    "study", "row", "subject", "variant", "split", "region", "alignment", "metric", "value",
)  # fmt: skip
MARKED = re.compile(r"(<!-- figures of (\S+) -->\n\n)((?:\|.*\n)+)")


def error(region: str, alignment: str) -> Shown:
    """Pose errors of one stage, mm."""
    return Shown("error, mm", {"region": region, "alignment": alignment, "split": ""})


def errors(region: str, alignment: str, *stages: str, **how: str) -> Shown:
    """Pose errors of several stages, mm; by default of the refinement's two."""
    each = ("stage", stages or STAGES[:2])
    return replace(error(region, alignment), each=each, join=" → ", **how)


def psnr(split: str, alignment: str = "", *regions: str, **how: object) -> Shown:
    """PSNR in dB, of one region or of several; without any, of the row's or the whole picture."""
    where = {"split": split, "alignment": alignment}
    each = ("region", regions) if regions else None
    return Shown("PSNR, dB", where, **{"form": ".1f", "each": each} | how)


def change(alignment: str, *regions: str) -> Shown:
    """Relative change of pose errors by the refinement, per cent."""
    where = {"alignment": alignment, "split": ""}
    return Shown("change", where, ("region", regions), "+.0f", " %", scale=100)


def worse(*alignments: str) -> Shown:
    """Share of frames whose body error the refinement increased, per cent."""
    where = {"region": "body", "split": ""}
    return Shown("increased", where, ("alignment", alignments), unit=" %", scale=100)


def depth(region: str, **how: object) -> Shown:
    """Error of depth after the refinement, mm; positive if too far away."""
    return Shown("depth, mm", {"region": region, "stage": "refined"}, form="+.0f", **how)


def regions(make: Callable[[str, str], Shown], *alignments: str) -> list[Part]:
    """Return columns for the body, the hands and the feet, of each alignment."""
    titles = {ALIGNED: "aligned: ", ABSOLUTE: ""}
    return [
        part(titles[alignment] * (region == "body") + region, make(region, alignment))
        for alignment in alignments or (ABSOLUTE, ALIGNED)
        for region in ("body", "hands", "feet")
    ]


ALIGNED, ABSOLUTE = "pelvis-aligned", "absolute"
THREE = (*STAGES[:2], "trained")
IOU = Shown("mask IoU", form=".3f")
LENGTHS = [(region, way) for way in (ALIGNED, ABSOLUTE) for region in ("body", "hands", "feet")]
WHOLE_AND_PERSON, DETAILS = ("white", "person"), ("face", "hands")

# The cases of the studies' held-out sets, by the rows of their tables.
OF_VIDEOS = [case for case in held_out(80) if case.kind_of_errors == VIDEO_KIND]
ROWS = dict.fromkeys(case.row for case in held_out(72))
SIMULATED = tuple(row for row in ROWS if row not in (VIDEO_KIND, TOUCH))
VIDEO_NAMES = (
    "turn", "everyday, clothes that nothing was tuned on", "half a turn, stretched body (joints)",
)  # fmt: skip
LIMIT_NAMES = (
    "as usual: one turn", "half a turn", "no turn", "everyday motion", "30 frames", "120 frames",
    "256², a person of 160 pixels", "1024²", "other clothes: thick soles, hood",
    "camera held by hand", "motion blur, the shutter open half of the time",
)  # fmt: skip
LIMIT_ROWS = dict(zip(LIMIT_NAMES, (case.row for case in LIMITS), strict=True))
NOTES = {  # of a table in own_video.md: conditions, and what their figures mean
    "as usual: one turn": "",
    "no turn": "turn around once",
    "half a turn": "the side that the video never shows is a guess",
    "30 frames": "turn slowly",
    "120 frames": "more frames help little",
    "motion blur, the shutter open half of the time": "use good light",
    "256², a person of 160 pixels": "masks are worse too",
}
ALL_MODELS = {"study": "simulated", "variant": "refined", "row": SIMULATED, "counts": "row"}


def of_simulated(row: str | tuple[str, ...], label: str = "") -> Part:
    """Return a row of an error model, or of several, each of which counts once."""
    return Part(label or str(row), None, ALL_MODELS | {"row": row})


def ablation(study: str, variants: Sequence[AvatarVariant]) -> Table:
    """Return a table with a row for each variant of the avatar study."""
    end = {"split": "end"}
    return Table(
        "PSNR, dB",
        [part(variant.name, study=study, variant=variant.name) for variant in variants],
        [
            part("test", psnr("test", "", "white")),
            part("person's box", psnr("test", "", "person")),
            part("hands", psnr("test", "", "hands")),
            part("novel pose", psnr("novel_pose", "", "white")),
            part("aligned", psnr("novel_pose", "aligned", "white")),
            part("novel view", psnr("novel_view", "", "white")),
            part("aligned", psnr("novel_view", "aligned", "white")),
            part("spacing", Shown("spacing", end, form=".2f")),
            part("strays, mm", Shown("stray, mm", end)),
        ],
    )


def by_variant(split: str, study: str, *variants: str, alignment: str = "") -> Shown:
    """PSNR of whole pictures, variant after variant."""
    shown = psnr(split, alignment, each=("variant", variants), join=" → ", unit=" dB")
    return replace(shown, where={**shown.where, "study": study, "region": "white"})


PARTS = (
    FULL.name, "without refinement", "without either", "without hand skeleton",
    "without re-initialisation",
)  # fmt: skip
SUMMARY = [
    Part("body, twelve simulated error models, pelvis-aligned: stage 1 → refined",
         errors("body", ALIGNED, unit=" mm"), ALL_MODELS, "[errors](#simulated-errors)"),
    Part("their frames made worse: pelvis-aligned, absolute", worse(ALIGNED, ABSOLUTE), ALL_MODELS,
         "[errors](#simulated-errors)"),
    *(
        part(f"{region}, three phone videos, pelvis-aligned: stage 1 → refined → trained",
             errors(region, ALIGNED, *THREE, unit=" mm"), "[videos](#avatars-of-videos)",
             study="videos")
        for region in ("body", "hands")
    ),
    part("body: stage 1 → Eq. 8 as printed, pelvis-aligned",
         errors("body", ALIGNED, unit=" mm"), "[Eq. 8](paper.md#eq-8-as-printed)",
         study="eq8", variant="Eq. 8 as printed"),
    part("body: stage 1 → all frames together, the same subjects",
         errors("body", ALIGNED, unit=" mm"), "[Eq. 8](paper.md#eq-8-as-printed)",
         study="eq8", variant="refined"),
    part("test frames: the method as printed → default",
         by_variant("test", "ladder", "as printed", "full"),
         "[ladder](paper.md#what-each-change-is-worth)"),
    part("novel views, aligned: the method as printed → default",
         by_variant("novel_view", "ladder", "as printed", "full", alignment="aligned"),
         "[ladder](paper.md#what-each-change-is-worth)"),
    part("test frames: stage-1 poses as they are → refined and trained",
         by_variant("test", "variants", "without either", "full"), "[variants](#variants)"),
    part("person under one lamp from the left: not relit → relit",
         psnr("test", each=("alignment", ("not relit", "relit")), join=" → ", unit=" dB"),
         "[relighting](#relighting)", study="relit", variant="left", region="silhouette"),
]  # fmt: skip

EXPECTED = [
    *(part(f"{region}, {way}, mm", errors(region, way, *THREE)) for region, way in LENGTHS),
    part("frames made worse by refinement (body: aligned, absolute)", worse(ALIGNED, ABSOLUTE)),
    *(
        part(f"PSNR, {name}", psnr(split, alignment, *parts, unit=" dB"))
        for title, split, alignment in (
            ("test frames", "test", ""),
            ("novel poses, aligned", "novel_pose", "aligned"),
            ("novel views, aligned", "novel_view", "aligned"),
        )
        for name, parts in (
            (f"{title}: whole picture, person's box", WHOLE_AND_PERSON),
            ("the same: face, hands", DETAILS),
        )
    ),
]  # fmt: skip

TABLES: dict[str, Table] = {
    "summary": Table("compared", SUMMARY, [part("")], "table"),
    "expected": Table(
        "",
        EXPECTED,
        [
            part("`make demo`", study="demo"),
            part("[three subjects, simulated errors](docs/paper.md#what-each-change-is-worth)",
                 study="ladder", variant=FULL.name),
            part("[three rendered phone videos](docs/studies.md#avatars-of-videos)",
                 study="videos"),
        ],
    ),
    "simulated": Table(
        "error model",
        [*map(of_simulated, SIMULATED), of_simulated(SIMULATED, "mean over error models")],
        [
            *regions(lambda region, alignment: change(alignment, region)),
            part("fingers", change("wrist-aligned", "fingers")),
            part("ankles, mm", depth("ankles")),
            part("body made worse: aligned, absolute", worse(ALIGNED, ABSOLUTE)),
        ],
    ),
    "known": Table(
        "",
        [part(row, row=row, variant="refined") for row in ("shape", "focal", "anything")],
        [
            part(f"{label}, {name}", shown, study=study)
            for label, shown in (
                ("body, hands, feet", change(ABSOLUTE, "body", "hands", "feet")),
                ("ankles, mm", depth("ankles")),
            )
            for study, name in (("simulated", "unknown"), ("known", "known"))
        ],
    ),
    "height": Table(
        "change of the body error of stage 1",
        [part("the study's error model [shape](studies.md#simulated-errors): a wrong size",
              change(ABSOLUTE, "body"), row="shape", variant="refined")],
        [part("without `--height`", study="simulated"), part("with it", study="known")],
    ),
    "limits": Table(
        "stage 1, mm",
        [part(name, study="limits", row=row) for name, row in LIMIT_ROWS.items()],
        [
            *regions(lambda region, alignment: errors(region, alignment, STAGES[0])),
            part("IoU of masks", IOU),
        ],
    ),
    "how-to-film": Table(
        "video",
        [part(name, note=note, study="limits", row=LIMIT_ROWS[name], stage="stage 1")
         for name, note in NOTES.items()],
        [part("hands, pelvis-aligned, mm", error("hands", ALIGNED))],
        "what it means",
    ),
    "real": Table(
        "50 frames, four cameras",
        [
            part(f"cam0{k}{name}", subject=f"cam0{k}")
            for k, name in enumerate(
                (", turned aside by 13°", "", ", from behind",
                 ", from behind, turned aside by 26°"), 1)
        ],
        [
            part("lens, found / true, px",
                 Shown("", each=("metric", ("lens, px", "true lens, px")), join=" / "),
                 study="real"),
            part("up, degrees", Shown("up, degrees", form=".1f"), study="real"),
            part("joints, mm", Shown("joints, mm"), study="real"),
            part("lens known", Shown("joints, mm"), study="real-known"),
            part("aligned", Shown("aligned, mm", {"region": ""}), study="real"),
            part("of that, across the line of sight", Shown("aside, mm"), study="real"),
            part("the network's own depths, aligned", Shown("network, mm"), study="real"),
        ],
    ),
    "video-poses": Table(
        "stage 1 → refined → trained, mm",
        [
            *(part(name, study="videos", subject=case.take.name)
              for name, case in zip(VIDEO_NAMES, OF_VIDEOS, strict=True)),
            part("mean", study="videos"),
        ],
        regions(lambda region, alignment: errors(region, alignment, *THREE)),
    ),
    "video-pictures": Table(
        "PSNR, dB",
        [
            part(name, study="videos", region=region)
            for region, name in (
                ("white", "whole picture"), ("person", "person's box"), ("hands", "hands"),
                ("face", "face"),
            )
        ],
        [
            part("test", psnr("test")),
            part("worst", psnr("test", of=min)),
            part("poses as refined", psnr("test", "poses as refined")),
            part("novel pose", psnr("novel_pose")),
            part("aligned", psnr("novel_pose", "aligned")),
            part("novel view", psnr("novel_view")),
            part("aligned", psnr("novel_view", "aligned")),
        ],
    ),
    "variants": ablation("variants", [v for v in VARIANTS if v.name in PARTS]),
    "light": Table(
        "PSNR, dB",
        [
            part(f"{name}: {color}", study="light", variant=f"{way}-{video}", region="white")
            for video, name in (("lit", "turning"), ("circled", "circling camera"))
            for way, color in (
                ("follows", "colour follows a fixed light"), ("constant", "constant colour")
            )
        ],
        [part(split.replace("_", " "), psnr(split)) for split in
         ("test", "novel_pose", "novel_view")],
    ),
    "relit": Table(
        "PSNR, dB",
        [
            part(name, study="relit", variant=light)
            for light, name in (
                ("left", "left: one lamp"), ("right", "right: one warm lamp"),
                ("above", "above: one lamp"), ("turned", "turned: the video's own, turned"),
                ("usual", "usual: the video's own"),
            )
        ],
        [
            *(
                part(title * (way == "not relit") + way, psnr("test", way), region=region)
                for region, title in (("silhouette", "person: "), ("white", "whole: "))
                for way in ("not relit", "own light turned", "relit")
            ),
            part("person: gain, each subject",
                 psnr("test", "relit", form="+.1f", join=" … ", of=extremes,
                      minus={"alignment": "not relit"}), region="silhouette"),
        ],
    ),
    "eq8": Table(
        "",
        [
            part("stage 1", study="eq8", variant="refined", stage="stage 1"),
            *(part(name, study="eq8", variant=name, stage="refined")
              for name in ("Eq. 8 as printed", "refined")),
        ],
        [
            *regions(error, ALIGNED),
            part("body made worse: aligned, absolute", worse(ALIGNED, ABSOLUTE)),
        ],
    ),
    "alphas": Table(
        "PSNR, dB",
        [part(variant.name, study="alphas", variant=variant.name)
         for variant in (*BY_ALPHA, LADDER[0])],
        [
            part("area, m²", Shown("area, m²", {"split": "step 200, after"}, form=".2f")),
            part("open edges", Shown("open edges", {"split": "step 200, after"}, form=",.0f")),
            *(part(split.replace("_", " "), psnr(split, "", "white"))
              for split in ("test", "novel_pose", "novel_view")),
        ],
    ),
    "ladder": ablation("ladder", (*LADDER, FULL)),
    "gains": Table(
        "dB, against the row above",
        [
            Part(after.name, None, {"study": "ladder", "variant": after.name},
                 minus={"variant": before.name})
            for before, after in pairwise((*LADDER, FULL))
        ],
        [
            part(name, psnr(split, alignment, region, form="+.1f", error=True))
            for name, split, alignment, region in (
                ("test", "test", "", "white"),
                ("person's box", "test", "", "person"),
                ("hands", "test", "", "hands"),
                ("novel pose, aligned", "novel_pose", "aligned", "white"),
                ("novel view, aligned", "novel_view", "aligned", "white"),
            )
        ],
    ),
}  # fmt: skip


def load() -> list[Row]:
    """Read ``docs/figures.csv``."""
    with FIGURES.open() as file:
        return list(csv.DictReader(file))


def figures_of(study: Path) -> list[Row]:
    """Read all figures of a folder of studies; those whose value is unknown are left out."""
    found = []
    for path in sorted([*study.glob("*.json"), *study.glob("*/*/metrics.json")]):
        about = {"study": path.stem}
        if path.name == "metrics.json":
            about = {"study": path.parts[-3], "variant": path.parts[-2]}
        record = json.loads(path.read_text())
        of_all = path.name == "table.json"
        found += [figure if of_all else figure | about for figure in record["figures"]]
    text = lambda figure: {name: str(figure.get(name, "")) for name in COLUMNS[:-1]}
    return [
        text(figure) | {"value": f"{figure['value']:.4f}"}
        for figure in found if figure["value"] is not None
    ]  # fmt: skip


def written(text: str, writer: Writer) -> str:
    """Return a page with its marked tables written anew."""
    return MARKED.sub(lambda match: match[1] + writer.table(TABLES[match[2]]), text)


def pages() -> list[Path]:
    """Return the pages that may have tables of figures."""
    return [DOCS.parent / "README.md", *sorted(DOCS.glob("*.md"))]


def unequal(figures: Sequence[Row]) -> list[str]:
    """Return the studies whose variants were measured on different cases: means would mislead."""
    cases: dict[str, dict[str, set[tuple[str, str]]]] = {}
    for figure in (figure for figure in figures if figure["row"]):  # of the studies of cases
        of_study = cases.setdefault(figure["study"], {})
        of_study.setdefault(figure["variant"], set()).add((figure["row"], figure["subject"]))
    return [name for name, of in cases.items() if any(x != y for x, y in pairwise(of.values()))]


def main(study: Path | None) -> None:
    """Write tables and ``figures.csv`` anew."""
    new = [] if study is None else figures_of(study)
    measured = {figure["study"] for figure in new}
    figures = [figure for figure in load() if figure["study"] not in measured] + new
    if unfinished := unequal(figures):
        sys.exit(f"{study}: cases without some variants: {', '.join(unfinished)}; resume them")
    figures.sort(key=lambda figure: figure["study"])  # stable
    writer = Writer(figures)
    for path in pages():
        text = path.read_text()
        if (new_text := written(text, writer)) != text:
            path.write_text(new_text)
    with FIGURES.open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(figures[k] for k in sorted(writer.used))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else None)
