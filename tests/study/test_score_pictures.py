"""Scores of any method's renders: each region is the pixels that its name says."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.renders import cut_out
from gva_mi.study.regions import person_box
from gva_mi.study.score_pictures import PicturePair, score_pictures
from gva_mi.study.scores import Scorer

SIDE = 96


def person(dx=0):
    """A smooth picture on white, and the mask of its person."""
    rng = np.random.default_rng(0)
    noise = gaussian_filter(rng.uniform(0, 255, (SIDE, SIDE, 3)), (2, 2, 0)) * 3 % 255
    mask = np.zeros((SIDE, SIDE), np.float32)
    mask[20:80, 34:62] = 1
    picture = np.where(mask[..., None] > 0, noise, 255).astype(np.uint8)
    return np.roll(picture, dx, 1), mask


def rows_of(*pairs):
    return {(row.region, row.protocol): row for row in score_pictures(pairs, Scorer(Weights()))}


def test_regions_differ_by_the_background_that_they_count():
    """An error e on the person alone: mean squares are e² times the person's share."""
    truth, mask = person()
    render = truth.copy()
    render[mask > 0] = np.clip(truth[mask > 0].astype(int) + 9, 0, 255)
    rows = rows_of(PicturePair("a", render, truth, mask))
    square = np.square(render[mask > 0].astype(float) - truth[mask > 0]).mean()
    box = person_box(mask)
    area = (box.right - box.left) * (box.bottom - box.top)
    for region, pixels in (("whole", SIDE**2), ("box", area), ("mask", mask.sum())):
        expected = 10 * np.log10(255**2 / (square * mask.sum() / pixels))
        assert rows[region, "strict"].psnr == pytest.approx(expected)
    assert rows["mask", "strict"].rand_vgg is None and rows["box", "strict"].count == 1


def test_a_shift_is_found_and_nothing_else_is_forgiven():
    truth, mask = person()
    moved, darker = person(dx=2)[0], np.clip(truth.astype(int) - 20, 0, 255).astype(np.uint8)
    rows = rows_of(PicturePair("a", moved, truth, mask))
    assert rows["whole", "shifted"].psnr > rows["whole", "strict"].psnr + 20
    rows = rows_of(PicturePair("a", darker, truth, mask))
    assert rows["whole", "shifted"].psnr == pytest.approx(rows["whole", "strict"].psnr, abs=0.1)


def test_renders_are_paired_by_number_and_put_on_the_background(tmp_path, cli):
    """Renders with alpha, named as another program names them; two of three frames."""
    truth, mask = person()
    for folder in ("truth", "masks", "renders"):
        (tmp_path / folder).mkdir()
    for k in range(3):
        write_image(tmp_path / f"truth/{k:04d}.png", np.where(mask[..., None] > 0, truth, 30 * k))
        write_image(tmp_path / f"masks/{k:04d}.png", (255 * mask).astype(np.uint8))
    for k in (0, 2):
        layer = np.dstack([truth, 255 * mask]).astype(np.uint8)
        write_image(tmp_path / f"renders/r_{k}.png", layer)
    folders = [str(tmp_path / name) for name in ("renders", "truth")]
    masked = ("--masks", str(tmp_path / "masks"), "--out", str(tmp_path / "scores.json"))
    cli.works("score", *folders, *masked)
    rows = json.loads((tmp_path / "scores.json").read_text())["rows"]
    strict = {row["region"]: row for row in rows if row["protocol"] == "strict"}
    assert strict["whole"]["count"] == 2 and strict["mask"]["psnr"] > 50 < strict["whole"]["psnr"]
    write_image(tmp_path / "renders/r_7.png", truth)
    err = cli.fails("score", *folders)
    assert "has no frame 7" in err and err.count("\n") == 1


def test_a_subject_brings_masks_and_boxes_of_hands(subject, tmp_path, cli):
    """Its own pictures score as high as rounding to 8 bits allows, in every region."""
    video = load_video(subject)
    for frame in video.frames(range(3)):
        mask = video.true_mask(frame.index)
        known = frame if mask is None else replace(frame, mask=mask)
        write_image(tmp_path / f"{frame.index}.png", cut_out(known))
    out = cli.works("score", str(tmp_path), str(subject))
    figures = [line.split() for line in out.splitlines()[1:]]
    assert {"whole", "box", "mask", "hands"} <= {line[0] for line in figures}
    assert all(float(line[2]) > 58 for line in figures)
