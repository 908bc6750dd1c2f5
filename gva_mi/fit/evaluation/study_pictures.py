"""Pictures of the study, like the paper's Figures 2, 5, 10, 11 and 12: the truth and some rows.

Novel poses and views are shown in the avatar's own world (:mod:`gva_mi.fit.evaluation.similarity`),
so that a picture shows the avatar and not how far away the person was taken to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.data.video import spread
from gva_mi.fit import run_folder
from gva_mi.fit.evaluation.evaluate import Split, View, views_of
from gva_mi.fit.evaluation.metrics import aligned_views
from gva_mi.fit.evaluation.regions import close_ups, person_box
from gva_mi.fit.evaluation.report_pictures import dots, same_size
from gva_mi.fit.evaluation.row_run import RowRun
from gva_mi.fit.evaluation.rows import FULL, NO_HANDS, NO_REFINEMENT, NO_REINIT_NAKED, TRUE
from gva_mi.fit.evaluation.similarity import posed_joints, similarity_to_truth
from gva_mi.fit.renders import cut_out, render_frame
from gva_mi.page import Picture, Section, picture
from gva_mi.pose.crop import Box
from gva_mi.splat import Gaussians

SHOWN = 3  # frames of a figure
ENLARGED = 220  # pixels, about the side of an enlarged box


@dataclass(frozen=True)
class CaseRuns:
    """The finished runs of one case, by row."""

    name: str  # of the case
    runs: Mapping[str, RowRun]


@dataclass(frozen=True)
class _Shown:
    """An avatar, and the views that it is shown in."""

    avatar: Avatar
    views: Mapping[Split, View]

    @staticmethod
    def of(run: RowRun) -> _Shown:
        avatar, video = run.avatar(), run.video()
        trained, driven = run_folder.under_trained_poses(video, run.out), run.driven(video)
        views = views_of(trained, ("test", "novel_pose", "novel_view"), run.body)
        similarity = similarity_to_truth(avatar.rig, trained, run.body)
        if similarity is not None:
            views = [v for v in views if v.split == "test"] + aligned_views(
                views, similarity, avatar.rig, run.body
            )
        change = lambda source: replace(source, pose=driven(source.pose))
        return _Shown(avatar, {view.split: view.through(change) for view in views})

    def render(self, split: Split, frame: int) -> np.ndarray:
        """A frame of a split, on white."""
        seen = self.views[split].video[frame]
        return render_frame(self.avatar, seen.pose, seen.camera)

    def rested(self) -> Gaussians:
        """The canonical Gaussians."""
        G = self.avatar.canonical
        values = (G.means, G.quats, G.scales, G.opacities)
        return Gaussians(*(x.detach() for x in values), sh=G.sh.detach())


def sections_of_pictures(cases: Sequence[CaseRuns]) -> Iterator[Section]:
    """The figures; one whose rows were not made is left out."""
    shown = [
        {name: _Shown.of(run) for name, run in case.runs.items() if name in _SHOWN_ROWS}
        for case in cases
    ]
    if any(FULL.name in rows for rows in shown):
        yield Section("Novel views (as Figure 5)", _NOVEL_VIEWS, _novel_views(shown), columns=2)
    for (title, text, others), figure in _FIGURES.items():
        pictures = []
        for case, rows in zip(cases, shown, strict=True):
            if all(row.name in rows for row in (FULL, *others)):
                pictures += figure(case.name, rows, others[0].name)
        if pictures:
            yield Section(title, text, pictures, columns=2)


_NOVEL_VIEWS = "Frames of the video from cameras that never saw it: truth left, full right."


def _novel_views(shown: Sequence[Mapping[str, _Shown]]) -> list[Picture]:
    pictures = []
    for rows in shown:
        if FULL.name in rows and "novel_view" in rows[FULL.name].views:
            view = rows[FULL.name].views["novel_view"]
            for k in spread(view.frames, SHOWN):
                pictures.append(_beside(rows, [FULL.name], "novel_view", k))
    return [picture("", image) for image in same_size(pictures)]


def _gaussians(name: str, rows: Mapping[str, _Shown], other: str) -> list[Picture]:
    with torch.no_grad():
        return [
            picture(f"{name}: {row}, {len(rows[row].avatar.canonical):,}", dots(rows[row].rested()))
            for row in (other, FULL.name)
        ]


def _hands(name: str, rows: Mapping[str, _Shown], other: str) -> list[Picture]:
    """Each hand that is seen in a test frame: truth, without, with."""
    view, found = rows[FULL.name].views["test"], []
    for k in spread(view.frames, SHOWN):
        details = view.details.boxes(k) if view.details is not None else ()
        boxes = [box for region, box in details if region == "hands"]
        found += [
            picture(f"{name}, frame {k}: truth, {other}, {FULL.name}", image)
            for image in (_beside(rows, [other, FULL.name], "test", k, box) for box in boxes)
        ]
    return found


def _close_ups(name: str, rows: Mapping[str, _Shown], other: str) -> list[Picture]:
    """Head, armpits, hem and hands in a novel pose."""
    full = rows[FULL.name]
    if "novel_pose" not in full.views:
        return []
    view = full.views["novel_pose"]
    k = spread(view.frames, SHOWN)[1 % len(view.frames)]
    seen = view.video[k]
    joints = posed_joints(full.avatar.rig, seen.pose)[0].double().numpy()
    return [
        picture(
            f"{name}, frame {k}, {part}: truth, {other}, {FULL.name}",
            _beside(rows, [other, FULL.name], "novel_pose", k, box),
        )
        for part, box in close_ups(seen.camera, joints)
    ]


def _test_frames(name: str, rows: Mapping[str, _Shown], other: str) -> list[Picture]:
    return _of_split(name, rows, other, "test")


def _novel_poses(name: str, rows: Mapping[str, _Shown], other: str) -> list[Picture]:
    return _of_split(name, rows, other, "novel_pose")


def _of_split(name: str, rows: Mapping[str, _Shown], other: str, split: Split) -> list[Picture]:
    if split not in rows[FULL.name].views:
        return []
    frames = spread(rows[FULL.name].views[split].frames, SHOWN)
    return [
        picture(
            f"{name}, frame {k}: truth, {other}, {FULL.name}",
            _beside(rows, [other, FULL.name], split, k),
        )
        for k in frames
    ]


def _beside(
    rows: Mapping[str, _Shown], names: Sequence[str], split: Split, k: int, box: Box | None = None
) -> np.ndarray:
    """A frame's truth and its renders, side by side, cut to a box or to the person."""
    view = rows[FULL.name].views[split]
    frame, mask = view.video[k], view.video.true_mask(k)
    frame = frame if mask is None else replace(frame, mask=mask)
    part = person_box(frame.mask) if box is None else box
    images = [cut_out(frame), *(rows[name].render(split, k) for name in names)]
    times = max(1, round(ENLARGED / part.width)) if box is not None else 1
    cut = [part.cut(image).repeat(times, 0).repeat(times, 1) for image in images]
    return np.concatenate(cut, axis=1)


# Title, text, the rows beside "full"; and what is shown of them.
_FIGURES = {
    (
        "Where the Gaussians lie (as Figure 2)",
        "Every Gaussian as a dot of its own colour, in the rest pose, from the front and the side.",
        (NO_REINIT_NAKED,),
    ): _gaussians,
    (
        "The hand skeleton (as Figure 10)",
        "Hands that are seen in test frames: truth, without and with a skeleton of the hand.",
        (NO_HANDS,),
    ): _hands,
    (
        "The poses (as Figure 11)",
        "Test frames: truth, under stage-1 poses as they are, and full.",
        (NO_REFINEMENT,),
    ): _test_frames,
    (
        "The re-initialisation (as Figure 12)",
        "Novel poses: truth, seeded on the naked body without re-initialisation, and full.",
        (NO_REINIT_NAKED,),
    ): _novel_poses,
    (
        "Closer",
        "What goes wrong first in a novel pose, enlarged: truth, the row of true poses, and full.",
        (TRUE,),
    ): _close_ups,
}
_SHOWN_ROWS = {FULL.name} | {row.name for _, _, others in _FIGURES for row in others}
