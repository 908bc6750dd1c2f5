import numpy as np
import pytest
import torch

from gva_mi.fit.samples import Samples, Stream, random_state, torch_state

TRAIN = [0, 1, 2, 4, 5]


def samples(video, seed=0, random_background=True, window=16):
    return Samples(video, TRAIN, seed, random_background, window)


def test_each_pass_shows_every_frame_once_in_another_order(video):
    found = samples(video)
    first, second = ([found[5 * p + k].frame for k in range(5)] for p in range(2))
    assert sorted(first) == sorted(second) == TRAIN and first != second


def test_a_step_draws_the_same_whatever_came_before_it(video):
    a, b = samples(video), samples(video)
    a[3], a[4]
    for step in (7, 2):
        x, y = a[step], b[step]
        assert x.frame == y.frame and x.window == y.window
        assert torch.equal(x.background, y.background) and torch.equal(x.color, y.color)


def test_another_seed_draws_another_run(video):
    a, b = samples(video), samples(video, seed=1)
    assert [a[k].frame for k in range(10)] != [b[k].frame for k in range(10)]
    assert not torch.equal(a[0].background, b[0].background)


@pytest.mark.parametrize("random_background", [True, False])
def test_the_person_is_cut_out_onto_the_background(random_background, video):
    sample = samples(video, random_background=random_background)[0]
    frame = video[sample.frame]
    mask = frame.mask[..., None]
    expected = frame.image * mask + sample.background.numpy() * (1 - mask)
    np.testing.assert_allclose(sample.color.numpy(), expected, atol=1e-6)
    np.testing.assert_allclose(sample.mask.numpy(), frame.mask, atol=1e-6)
    assert random_background or bool((sample.background == 1).all())


@pytest.mark.parametrize("window", [11, 16, 48, 100])
def test_windows_lie_in_the_image_and_in_the_person_s_box(window, video):
    found = samples(video, window=window)
    for step in range(20):
        sample = found[step]
        for axis, side in enumerate(sample.window):
            assert 0 <= side.start and side.stop <= 48
            assert side.stop - side.start == min(window, 48)
            assert sample.mask.amax(1 - axis)[side].max() > 0.5


def test_purposes_and_steps_have_streams_of_their_own():
    drawn = {(p, k): random_state(0, p, k).random() for p in Stream for k in range(3)}
    assert len(set(drawn.values())) == len(drawn)
    assert torch_state(0, Stream.SEED).initial_seed() != torch_state(1, Stream.SEED).initial_seed()
