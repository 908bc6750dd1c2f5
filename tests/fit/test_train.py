"""A fit comes closer to unseen frames, is reproducible, and resumes to the bit."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.avatar.avatar import Avatar, AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.body.pose import Pose, load_poses
from gva_mi.core.errors import InputError
from gva_mi.evaluate.figures import where
from gva_mi.evaluate.measure import evaluate
from gva_mi.fit import run_folder
from gva_mi.fit.first_surface import seen_colors
from gva_mi.fit.options import FitOptions, Rates, Schedule
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.poses import PoseOptions
from gva_mi.fit.samples import RandomStream, smallest_pixel, torch_state
from gva_mi.fit.train import fit, make_adam
from gva_mi.mesh.surface import vertex_normals

STEPS = 24
OPTIONS = FitOptions(steps=STEPS, window=16, checkpoint_every=10,
    avatar=AvatarOptions(seed=SeedOptions(count=400), residual=ResidualOptions(enabled=True)),
    schedule=Schedule(densify_every=5, reinit_at=()), poses=PoseOptions(every=3))  # fmt: skip
PARAMETERS = [
    "light",
    *(f"canonical.{n}" for n in ("means", "quats", "log_scales", "logit_opacities", "sh")),
    "residual.codes",
    *(f"residual.{n}.weight" for n in ("place", "condition", "hidden", "offset")),
    *(f"residual.{n}.bias" for n in ("place", "hidden")),
]


def seed_of(body, video, options):
    generator = torch_state(options.seed, RandomStream.SEED)
    colors = seen_colors(video, body)
    return seed_avatar(body, video.shape, None, options.avatar, generator, colors)


def same(a: Avatar, b: Avatar):
    x, y = a.state_dict(), b.state_dict()
    return x.keys() == y.keys() and all(torch.equal(x[k], y[k]) for k in x)


class Killed(Exception):
    pass


def killed_at(step):
    def progress(done, total, **figures):
        if done == step:
            raise Killed

    return progress


@pytest.fixture(scope="module")
def fitted(video, body, tmp_path_factory):
    out = tmp_path_factory.mktemp("fitted")
    return fit(video, body, OPTIONS, out), out


def test_a_fit_comes_closer_to_frames_it_has_not_seen(video, body, tmp_path):
    def figures(avatar):
        found = evaluate(avatar, video, splits=["test"], weights=Weights())
        return {figure.metric: figure.value for figure in where(found, region="white")}

    options = replace(OPTIONS, steps=100, schedule=Schedule(densify_every=0, reinit_at=()))
    before, after = (figures(seed_of(body, video, OPTIONS)),
        figures(fit(video, body, options, tmp_path)))  # fmt: skip
    assert after["PSNR, dB"] > before["PSNR, dB"] + 2
    assert after["SSIM"] > before["SSIM"] and after["rand_vgg"] < before["rand_vgg"]
    loss = run_folder.load_history(tmp_path)["loss"]
    assert loss[-20:].mean() < 0.8 * loss[:20].mean()


def test_a_fit_goes_on_where_too_few_gaussians_are_opaque(video, body, tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr("gva_mi.fit.train.say", said.append)
    faint = replace(OPTIONS.avatar, seed=SeedOptions(count=400, opacity=1e-3))
    schedule = Schedule(densify_every=0, reinit_at=(0.5,))
    options = replace(OPTIONS, steps=2, avatar=faint, schedule=schedule)
    assert len(fit(video, body, options, tmp_path).canonical) >= 300
    assert said == [f"{tmp_path}: step 1: too few opaque Gaussians, no re-initialisation"]


@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize(("name", "plain"), [("means", 2e-4), ("sh", 6e-6)])
def test_gaussians_that_only_noise_pulls_stay_as_they_are(known, name, plain, one_sided):
    """Hidden Gaussians have a hundredth of the gradient of visible ones, and move by a fifth."""
    avatar = copy.deepcopy(known)
    optimizer = make_adam(avatar, None, Rates(), one_sided)
    moving = getattr(avatar.canonical, name)
    group = next(g for g in optimizer.param_groups if g["name"] == name)
    start = moving.detach().clone()
    size = 3**0.5 if one_sided and name == "means" else 1.0  # of a vector of ones
    for _ in range(20):
        moving.grad = torch.full_like(start, plain / size)
        moving.grad[::2] /= 100
        group["lr"] = 1e-3
        optimizer.step()
    moved = size * (moving - start).detach().abs()
    assert moved[1::2].min() > 0.9 * 20e-3 and moved[::2].max() < 0.2 * 20e-3


def test_adam_of_one_sided_people_moves_places_alike_in_all_axes(known):
    """In turned axes it takes the turned steps; along an axis without a signal it hardly moves."""
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)))[0]

    def moved(axes, one_sided):
        avatar, generator = copy.deepcopy(known), torch.Generator().manual_seed(1)
        optimizer, means = make_adam(avatar, None, Rates(), one_sided), avatar.canonical.means
        optimizer.param_groups[0]["lr"] = 1e-3
        start = means.detach().clone()
        for _ in range(20):
            noise = 1e-5 * torch.randn(len(means), generator=generator)
            means.grad = torch.stack([torch.full_like(noise, 4e-4), 0 * noise, noise], 1) @ axes
            optimizer.step()
        return (means - start).detach() @ axes.T

    straight, turned = moved(torch.eye(3), True), moved(turn, True)
    torch.testing.assert_close(straight, turned, atol=1e-6, rtol=0)
    assert straight[:, 0].max() < -0.9 * 20e-3
    assert straight[:, 2].abs().mean() < 0.1 * moved(torch.eye(3), False)[:, 2].abs().mean()


def test_adam_of_one_sided_people_goes_on_from_its_state_to_the_bit(known):
    def stepped(avatar, steps, state=None):
        optimizer = make_adam(avatar, None, Rates(), one_sided=True)
        if state:
            optimizer.load_state_dict(state)
        for k in steps:
            generator = torch.Generator().manual_seed(k)
            for x in avatar.canonical.parameters():
                x.grad = 1e-5 * torch.randn(x.shape, generator=generator)
            optimizer.param_groups[0]["lr"] = 1e-3
            optimizer.step()
        return copy.deepcopy(optimizer.state_dict())

    whole, parts = copy.deepcopy(known), copy.deepcopy(known)
    stepped(whole, range(6))
    stepped(parts, range(3, 6), stepped(parts, range(3)))
    assert same(whole, parts)


def test_weights_follow_gaussians_and_the_end_of_a_fit_changes_colors_and_sizes_alone(
    video, body, tmp_path, monkeypatch
):
    """``complete`` colours what no frame shows; ``min_scale`` is the least size, in pixels."""
    schedule = Schedule(densify_every=0, reinit_at=(), rebind_every=2)
    options = replace(OPTIONS, steps=4, complete=True, min_scale=20.0, schedule=schedule)
    completed = fit(video, body, options, tmp_path / "completed")
    monkeypatch.setattr("gva_mi.fit.train.complete_colors", lambda *arguments: None)
    plain = fit(video, body, options, tmp_path / "plain").state_dict()
    differ = {k for k, x in completed.state_dict().items() if not torch.equal(x, plain[k])}
    assert differ == {"canonical.sh"}
    bound = completed.skin.bind(completed.canonical.means)["weights"]
    assert torch.equal(completed.canonical.weights, bound)
    least = 20 * smallest_pixel(video, completed.rig)
    assert completed.canonical.scales.min().item() == pytest.approx(least)


def test_the_avatar_is_saved_and_the_checkpoint_is_gone(fitted):
    avatar, out = fitted
    assert same(Avatar.load(out / run_folder.AVATAR), avatar)
    assert not (out / run_folder.CHECKPOINT).exists()
    assert not list(out.glob("**/*.part"))


def test_the_perceptual_term_counts_in_the_mean_as_much_as_its_weight_says(fitted):
    """It is left out of most steps, and weighs more in the others."""
    history = run_folder.load_history(fitted[1])
    weights, every = OPTIONS.loss, OPTIONS.perceptual_every
    share = history["loss"] - history["recon"] - weights.residual * history["residual"]
    due = np.arange(STEPS) % every == 0
    assert every > 1 and due.any() and (~due).any()
    np.testing.assert_allclose(share[~due], 0, atol=1e-6)
    found = every * weights.perceptual * history["perceptual"][due]
    np.testing.assert_allclose(share[due], found, rtol=1e-4)
    assert (found > 0).all()


def test_every_parameter_is_trained(video, body, tmp_path):
    options = replace(OPTIONS, steps=3, schedule=Schedule(densify_every=0, reinit_at=()))
    before = dict(seed_of(body, video, OPTIONS).named_parameters())
    after = dict(fit(video, body, options, tmp_path).named_parameters())
    assert set(before) == set(after) == set(PARAMETERS)
    for name in PARAMETERS:
        assert after[name].isfinite().all() and not torch.equal(before[name], after[name]), name


def test_a_seed_gives_the_same_bits_on_any_number_of_threads(fitted, video, body, tmp_path):
    before = torch.get_num_threads()
    torch.set_num_threads(1 if before > 1 else 2)
    try:
        assert same(fit(video, body, OPTIONS, tmp_path), fitted[0])
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(
    "step", [pytest.param(4, marks=pytest.mark.slow), 17]
)  # before and after the first checkpoint
def test_a_resumed_run_ends_like_an_uninterrupted_one(step, fitted, video, body, tmp_path):
    with pytest.raises(Killed):
        fit(video, body, OPTIONS, tmp_path, progress=killed_at(step))
    avatar = fit(video, body, OPTIONS, tmp_path, resume=True)
    assert same(avatar, fitted[0])
    whole, resumed = run_folder.load_history(fitted[1]), run_folder.load_history(tmp_path)
    for name in set(whole) - {"milliseconds"}:
        np.testing.assert_array_equal(whole[name], resumed[name])
    whole, resumed = (load_poses(d / run_folder.TRAINED_POSES)[0] for d in (fitted[1], tmp_path))
    assert torch.equal(whole.rotations, resumed.rotations)
    assert torch.equal(whole.transl, resumed.transl)
    assert (whole.transl != video.pose.transl).any(1).all()


def test_a_resumed_run_holds_gaussians_as_close_where_parts_touch(
    video, body, tmp_path, monkeypatch
):
    for name in ("HOLD_EVERY", "HOLD_BODY_EVERY"):
        monkeypatch.setattr(f"gva_mi.fit.train.{name}", 5)
    options = replace(OPTIONS, touching=True)
    about = {"offsets": 0.05 * vertex_normals(body.v_template, body.faces)}
    whole = fit(video, body, options, tmp_path / "whole", **about)
    with pytest.raises(Killed):
        fit(video, body, options, tmp_path / "killed", progress=killed_at(17), **about)
    assert same(fit(video, body, options, tmp_path / "killed", resume=True, **about), whole)


def test_a_finished_run_is_returned_by_resume(fitted, video, body):
    assert same(fit(video, body, OPTIONS, fitted[1], resume=True), fitted[0])


def test_refined_poses_are_trained_from_where_they_are(video, body, tmp_path):
    """Before their first step, also of a run that goes on; those of stage 1 have been smoothed."""
    few = replace(OPTIONS, steps=2, poses=PoseOptions(every=8))
    saved = lambda name: load_poses(tmp_path / name / run_folder.TRAINED_POSES)[0].transl
    noise = 0.02 * torch.randn(len(video), 3, generator=torch.Generator().manual_seed(0))
    shaky = Pose(video.pose.rotations, video.pose.transl + noise, video.pose.expression)
    stage1 = replace(video, pose=shaky)
    refined = replace(stage1, stage=2)
    fit(refined, body, few, tmp_path / "refined")
    fit(stage1, body, few, tmp_path / "stage1")
    with pytest.raises(Killed):
        fit(refined, body, few, tmp_path / "resumed", progress=killed_at(1))
    fit(refined, body, few, tmp_path / "resumed", resume=True)
    for name in ("refined", "resumed"):
        torch.testing.assert_close(saved(name), shaky.transl, atol=1e-6, rtol=0)
    assert (saved("stage1") - shaky.transl).abs().max() > 1e-3


def test_a_second_fit_starts_anew_with_the_poses_of_the_first(video, body, tmp_path):
    """The first is the fit that its options alone would be; a kill in either changes nothing."""
    few = replace(OPTIONS, steps=6)
    both = replace(few, first_steps=9)
    fit(video, body, replace(few, steps=9), tmp_path / "alone")
    poses = load_poses(tmp_path / "alone" / run_folder.TRAINED_POSES)[0]
    wanted = fit(replace(video, pose=poses, stage=2), body, few, tmp_path / "second")
    for step in (4, 11):
        with pytest.raises(Killed):
            fit(video, body, both, tmp_path / "run", resume=True, progress=killed_at(step))
    assert same(fit(video, body, both, tmp_path / "run", resume=True), wanted)
    with pytest.raises(InputError, match="--preset video trains poses first"):
        replace(both, poses=PoseOptions(trained=False))


def test_poses_of_a_tall_person_are_trained_on_smaller_pictures(
    doubled, body, tmp_path, monkeypatch
):
    few = replace(OPTIONS, steps=9)
    fit(doubled.downscaled(2), body, few, tmp_path / "small")
    monkeypatch.setattr("gva_mi.fit.train.shrunk_to_tall", lambda video: video.downscaled(2))
    avatar = fit(doubled, body, replace(few, steps=6, first_steps=9), tmp_path / "run")
    small = (tmp_path / name / run_folder.TRAINED_POSES for name in ("small", "run/first"))
    first, again = (load_poses(path)[0] for path in small)
    assert torch.equal(first.rotations, again.rotations)
    large = fit(
        replace(doubled, pose=first, stage=2), body, replace(few, steps=6), tmp_path / "two"
    )
    assert same(avatar, large)


@pytest.mark.slow
def test_reinitialisation_is_reproducible_and_leaves_a_snapshot(video, body, tmp_path):
    options = replace(OPTIONS, schedule=Schedule(densify_every=5, reinit_at=(0.5,)))
    whole = fit(video, body, options, tmp_path / "whole")
    with pytest.raises(Killed):
        fit(video, body, options, tmp_path / "killed", progress=killed_at(17))
    assert same(fit(video, body, options, tmp_path / "killed", resume=True), whole)
    (found,) = run_folder.load_snapshots(tmp_path / "whole")
    assert found.step == STEPS // 2 and len(found.before) > 0 and len(found.after) > 0
