"""Laws of a picture and its gradients, and determinism over runs, threads and recordings."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch
from samples.scenes import draw, scene

from gva_mi.gradcheck import tangent_image
from gva_mi.splat import Screen, render
from gva_mi.splat.kernels import passes


def changed(s, **arrays):
    return s.with_inputs(s.inputs() | arrays)


def assert_same(a, b, atol=1e-12):
    for name in ("color", "alpha", "depth"):
        torch.testing.assert_close(getattr(a, name), getattr(b, name), atol=atol, rtol=0)


def test_order_of_the_input_is_irrelevant():
    s = scene()
    shuffle = torch.randperm(40, generator=torch.Generator().manual_seed(1))
    shuffled = {k: v if k == "background" else v[shuffle] for k, v in s.inputs().items()}
    assert_same(draw(s), draw(s.with_inputs(shuffled)), atol=0)


def test_the_quaternions_length_and_sign_are_irrelevant():
    s = scene()
    assert_same(draw(s), draw(changed(s, quats=-3 * s.gaussians.quats)))


def test_a_crop_is_part_of_the_picture():
    s = scene(width=40, height=30)
    # near the middle: far outside a picture the linearisation depends on where its border lies
    s = changed(s, means=0.3 * s.gaussians.means)
    whole, part = draw(s), draw(replace(s, camera=s.camera.cropped(5, 3, 31, 25)))
    for name in ("color", "alpha", "depth"):
        inside = getattr(whole, name)[3:28, 5:36]
        torch.testing.assert_close(getattr(part, name), inside, atol=1e-12, rtol=0)


def test_screen_holds_means_radii_and_their_gradient():
    s = scene()
    # far outside a picture the linearisation depends on where its border lies: stay inside
    s = changed(s, means=0.5 * s.gaussians.means).to(torch.float64)
    screen = Screen()
    draw(s, screen=screen).color.square().sum().backward()
    means = s.gaussians.means.detach().numpy()
    np.testing.assert_allclose(screen.means2d.numpy(), s.camera.project(means), atol=1e-10)
    assert screen.visible.any() and screen.radii.shape == (40,)
    assert (screen.grad[~screen.visible] == 0).all()

    # moving the principal point moves all means alike
    step, loss = 1e-6, []
    for sign in (1, -1):
        camera = replace(s.camera, cy=s.camera.cy + sign * step)
        with torch.no_grad():
            loss.append(draw(replace(s, camera=camera)).color.square().sum())
    difference = (loss[0] - loss[1]) / (2 * step)
    torch.testing.assert_close(screen.grad[:, 1].sum(), difference, rtol=1e-6, atol=0)


def test_an_input_overwritten_before_backward_raises():
    s = scene().to(torch.float32)
    loss = draw(s).color.sum()
    with torch.no_grad():
        s.gaussians.means.add_(1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def bits(s):
    for tensor in s.inputs().values():
        tensor.grad = None
    screen = Screen(absolute=True)
    image = draw(s, screen=screen)
    (image.color.square().sum() + image.alpha.square().sum() + image.depth.sum()).backward()
    parts = [image.color, image.alpha, image.depth, screen.absgrad]
    parts += [t.grad for t in s.inputs().values()]
    return [part.detach().numpy().tobytes() for part in parts]


def test_same_bits_at_every_run_and_for_any_number_of_threads():
    """Of pictures, gradients including the camera's, and tangents."""
    s = scene(gaussians=3000, width=200, height=150, degree=1)
    s = s.with_camera_inputs().to(torch.float32)
    turn = torch.ones_like(s.camera.tensors.T_camera_world)
    tangent = lambda: tangent_image(render, s, "T_camera_world", turn).color.numpy().tobytes()
    first, threads = [*bits(s), tangent()], dr.thread_count()
    try:
        for count in (1, 2, 4):
            dr.set_thread_count(count)
            assert [*bits(s), tangent()] == first
    finally:
        dr.set_thread_count(threads)


SIZES = ((500, 150, 100), (501, 150, 100), (700, 99, 130), (650, 201, 80))


def draw_all_sizes():
    for n, width, height in SIZES:
        bits(scene(seed=n, gaussians=n, width=width, height=height).to(torch.float32))


def test_other_sizes_and_poses_compile_nothing():
    bits(scene(gaussians=400, width=160, height=90).to(torch.float32))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        draw_all_sizes()
        kernels = [k for k in dr.kernel_history() if k["type"] is dr.KernelType.JIT]
    assert kernels and all(kernel["cache_hit"] for kernel in kernels)


def test_other_distances_and_blurs_are_not_traced_again():
    s = scene(gaussians=400, width=160, height=90).to(torch.float32)
    first, frozen = bits(s), (passes.project_gaussians, passes.gaussians_adjoint)
    before = [recordings(function) for function in frozen]
    found = {"": first}
    for name, value in (("blur", 0.5), ("near", 2.8), ("far", 3.1), ("radius_min", 30.0)):
        found[name] = bits(replace(s, options=replace(s.options, **{name: value})))
    assert [recordings(function) for function in frozen] == before
    assert len({image for image, *_ in found.values()}) == len(found)  # each has its effect


def recordings(function):
    """Count the recordings of a frozen function."""
    return sum(variant.n_recordings for variant in function.variants.values())
