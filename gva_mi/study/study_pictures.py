"""Pictures of the avatar study: the ground truth beside every fitted variant.

Novel poses and views are shown after the similarity transform (:mod:`gva_mi.study.similarity`), so
that a picture shows the avatar and not how far away the subject was assumed to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from gva_mi.data.crop import Box
from gva_mi.data.video import Frame, spread
from gva_mi.fit import run_folder
from gva_mi.fit.renders import cut_out, render_frame
from gva_mi.splat import Gaussians
from gva_mi.study.avatar_study import VariantRun
from gva_mi.study.cases import StudyCase
from gva_mi.study.evaluate import Split, SplitView, views_of
from gva_mi.study.metrics import aligned_views
from gva_mi.study.page import Picture, Section, picture
from gva_mi.study.regions import close_ups, person_box
from gva_mi.study.report_pictures import ZOOMED_PIXELS, dots
from gva_mi.study.similarity import posed_joints, similarity_to_truth

SHOWN = 2  # frames of a split
SECTIONS: dict[Split, tuple[str, str]] = {
    "test": ("Test frames", "Frames that training left out, and their visible hands."),
    "novel_pose": ("Novel poses", "A motion that is not in the video, and close-ups."),
    "novel_view": ("Novel views", "Frames of the video from cameras that never saw it."),
}


def sections_of_pictures(
    cases: Sequence[tuple[StudyCase, Mapping[str, VariantRun]]],
) -> Iterator[Section]:
    """Yield a section for each split, and one of the Gaussians at rest."""
    views = {(case, name): _views(run) for case, runs in cases for name, run in runs.items()}
    for split, (title, text) in SECTIONS.items():
        pictures = []
        for case, runs in cases:
            own = {name: (runs[name], views[case, name].get(split)) for name in runs}
            pictures += _of_split(case.name, {k: v for k, v in own.items() if v[1] is not None})
        if pictures:
            names = dict.fromkeys(name for _, runs in cases for name in runs)
            order = f" From left to right: ground truth, {', '.join(names)}."
            yield Section(title, text + order, pictures, columns=1)
    pictures = [
        _at_rest(f"{case.name}: {name}", run) for case, runs in cases for name, run in runs.items()
    ]
    if pictures:
        text = "Every Gaussian as a dot of its own colour, from the front and from the side."
        yield Section("Where the Gaussians lie", text, pictures, columns=3)


def _views(run: VariantRun) -> dict[Split, SplitView]:
    """Return the splits of a run, novel ones in the avatar's world."""
    avatar, video = run.avatar(), run.video()
    trained, driven = run_folder.under_trained_poses(video, run.out), run.driven(video)
    views = views_of(trained, tuple(SECTIONS), run.body)
    similarity = similarity_to_truth(avatar.rig, trained, run.body)
    if similarity is not None:
        test = [view for view in views if view.split == "test"]
        views = test + aligned_views(views, similarity, avatar.rig, run.body)
    change = lambda source: replace(source, pose=driven(source.pose))
    return {view.split: view.through(change) for view in views}


def _of_split(case: str, fits: Mapping[str, tuple[VariantRun, SplitView]]) -> list[Picture]:
    """Show some frames of a split, whole and in close-ups, for every variant."""
    if not fits:
        return []
    pictures, (run, view) = [], next(iter(fits.values()))
    for k in spread(view.frames, SHOWN):
        frame, mask = view.video[k], view.video.true_mask(k)
        frame = frame if mask is None else replace(frame, mask=mask)
        renders = [
            render_frame(run.avatar(), own.video[k].pose, own.video[k].camera)
            for run, own in fits.values()
        ]
        for what, box in _boxes(run, view, frame):
            times = 1 if not what else max(1, round(ZOOMED_PIXELS / box.width))
            parts = [box.cut(image) for image in (cut_out(frame), *renders)]
            row = np.concatenate(parts, axis=1).repeat(times, 0).repeat(times, 1)
            pictures.append(picture(f"{case}, frame {k}{what}", row))
    return pictures


def _boxes(run: VariantRun, view: SplitView, frame: Frame) -> Iterator[tuple[str, Box]]:
    """Yield the person's box, and boxes of details: hands in test frames, else close-ups."""
    yield "", person_box(frame.mask)
    if view.split == "test" and view.details is not None:
        yield from ((f", {r}", box) for r, box in view.details.boxes(frame.index) if r == "hands")
    elif view.split == "novel_pose":
        joints = posed_joints(run.avatar().rig, frame.pose)[0].double().numpy()
        yield from ((f", {part}", box) for part, box in close_ups(frame.camera, joints))


def _at_rest(caption: str, run: VariantRun) -> Picture:
    G = run.avatar().canonical
    with torch.no_grad():
        values = (x.detach() for x in (G.means, G.quats, G.scales, G.opacities))
        image = dots(Gaussians(*values, sh=G.sh.detach()))
    return picture(f"{caption}, {len(G):,}", image)
