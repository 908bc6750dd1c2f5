"""Each metric is its definition, of the pixels that its region names."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gva_mi.evaluate.regions import person_box
from gva_mi.evaluate.scores import (
    NETWORK_LONGEST,
    NETWORK_SIDE,
    PSNR_MAX,
    PicturePair,
    Scorer,
    psnr,
    score_pictures,
    ssim,
)
from gva_mi.fit.perceptual import TAPS, Weights, vgg16
from gva_mi.fit.renders import cut_out
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

SIDE, PSNR = 96, "PSNR, dB"
BOXES = np.s_[:20, :30], np.s_[:24, :30], np.s_[300:, 350:]


def test_psnr_is_its_definition():
    random = np.random.default_rng(0)
    a, b = random.integers(0, 256, (2, 12, 14, 3), dtype=np.uint8)
    error = np.mean((a.astype(float) - b) ** 2)
    assert psnr(a, b) == pytest.approx(10 * np.log10(255**2 / error))
    assert psnr(a, a) == PSNR_MAX


@pytest.mark.parametrize("box", [np.s_[150:190, 300:330], np.s_[:9, 440:], np.s_[:0, :0]])
def test_only_where_pictures_differ_is_looked_at_and_scores_are_those_of_the_whole(box):
    from skimage.metrics import structural_similarity

    random = np.random.default_rng(3)
    a = random.integers(0, 256, (330, 450, 3), dtype=np.uint8)
    b = a.copy()
    b[box] = 255 - b[box]
    settings = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    whole = structural_similarity(a, b, channel_axis=-1, **settings)
    assert ssim(a, b) == pytest.approx(whole, abs=1e-12)
    scorer = Scorer(Weights())
    both = [torch.from_numpy(x.astype(np.float32) / 255) for x in (a, b)]
    expected = float(scorer.rand_vgg(*both))
    assert scorer(a, b).rand_vgg == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_renders_of_one_target_have_the_scores_that_each_has_alone():
    """Also where they differ from it in other places, so that its features are not shared."""
    random = np.random.default_rng(4)
    target, noise = random.integers(0, 256, (2, 400, 400, 3), dtype=np.uint8)
    renders = [target.copy() for _ in range(3)]
    for render, box in zip(renders, BOXES, strict=True):
        render[box] = noise[box]
    scorer = Scorer(Weights())
    together = scorer.of_renders(renders, target)
    assert [one[::3] for one in together] == [scorer(one, target)[::3] for one in renders]


def test_small_pictures_are_enlarged_for_the_networks_alone():
    random = np.random.default_rng(1)
    a, b = random.integers(0, 256, (2, NETWORK_SIDE // 4, NETWORK_SIDE // 2, 3), dtype=np.uint8)
    scorer = Scorer(Weights())
    enlarged = [x.repeat(4, 0).repeat(4, 1) for x in (a, b)]
    assert scorer(a, b).rand_vgg == scorer(*enlarged).rand_vgg > 0
    assert scorer(a, b).psnr == psnr(a, b) and scorer(a, b).ssim == ssim(a, b)


def test_large_pictures_are_shrunk_for_the_networks_alone():
    random = np.random.default_rng(2)
    small = random.integers(0, 256, (2, 80, NETWORK_LONGEST // 2 + 6, 3), dtype=np.uint8)
    large = [np.pad(x.repeat(2, 0).repeat(2, 1), ((0, 1), (0, 1), (0, 0))) for x in small]
    scorer = Scorer(Weights())
    assert scorer(*large).rand_vgg == scorer(*small).rand_vgg > 0
    assert scorer(*large).psnr == psnr(*large)


def test_networks_and_weights_are_named(tmp_path, monkeypatch):
    small = ((4, 4), (8, 8), (8,) * 3, (8,) * 3, (8,) * 3)
    monkeypatch.setattr("gva_mi.fit.perceptual.VGG16_WIDTHS", small)
    assert Scorer(Weights()).networks()["lpips"] is None
    layers, weights, heads = vgg16(), tmp_path / "vgg16.pth", tmp_path / "lpips_vgg.pth"
    torch.save(
        {f"features.{k}": torch.zeros_like(x) for k, x in layers.state_dict().items()}, weights
    )
    widths = [layers[tap - 1].out_channels for tap in TAPS]
    torch.save(
        {f"lin{k}.model.1.weight": torch.ones(1, n, 1, 1) for k, n in enumerate(widths)}, heads
    )
    scorer = Scorer(Weights(weights, heads))
    named = scorer.networks()
    assert named["lpips"]["network"] == "VGG16"
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    assert named["lpips"]["sha256"]["vgg16.pth"] == digest
    assert named["rand_vgg"]["weights"] == "random, seed 0"
    box = np.zeros((16, 16, 3), np.uint8)  # of a small hand
    assert np.isfinite(scorer(box, box + 9).lpips)


def person():
    """A smooth picture on white, and the mask of its person."""
    rng = np.random.default_rng(0)
    noise = gaussian_filter(rng.uniform(0, 255, (SIDE, SIDE, 3)), (2, 2, 0)) * 3 % 255
    mask = np.zeros((SIDE, SIDE), np.float32)
    mask[20:80, 34:62] = 1
    picture = np.where(mask[..., None] > 0, noise, 255).astype(np.uint8)
    return picture, mask


def test_regions_differ_by_the_background_that_they_count():
    """An error e on the person alone: mean squares are e² times the person's share."""
    truth, mask = person()
    render = truth.copy()
    render[mask > 0] = np.clip(truth[mask > 0].astype(int) + 9, 0, 255)
    figures = score_pictures([PicturePair("a", render, truth, mask)], Scorer(Weights()))
    rows = {(f.region, f.metric): f.value for f in figures}
    square = np.square(render[mask > 0].astype(float) - truth[mask > 0]).mean()
    box = person_box(mask)
    area = (box.right - box.left) * (box.bottom - box.top)
    for region, pixels in (("whole", SIDE**2), ("box", area), ("mask", mask.sum())):
        expected = 10 * np.log10(255**2 / (square * mask.sum() / pixels))
        assert rows[region, PSNR] == pytest.approx(expected)
    assert rows["mask", "rand_vgg"] is None and rows["box", "pictures"] == 1


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
    figures = json.loads((tmp_path / "scores.json").read_text())["figures"]
    found = {(row["region"], row["metric"]): row["value"] for row in figures}
    assert found["whole", "pictures"] == 2 and found["whole", PSNR] > 50 < found["mask", PSNR]
    write_image(tmp_path / "renders/r_7.png", truth)
    cli.refuses("has no frame 7", "score", *folders)


def test_a_subject_brings_masks_and_boxes_of_hands(subject, tmp_path, cli):
    """Its own pictures score as high as rounding to 8 bits allows, in every region."""
    video = load_video(subject)
    for frame in video.frames(range(3)):
        mask = video.true_mask(frame.index)
        known = frame if mask is None else replace(frame, mask=mask)
        write_image(tmp_path / f"{frame.index}.png", cut_out(known))
    out = cli.works("score", str(tmp_path), str(subject))
    rows = [line.split() for line in out.splitlines()[1:]]
    assert {row[0] for row in rows} == {"whole", "box", "hands", "mask"}
    assert all(float(row[1]) > 58 for row in rows)
