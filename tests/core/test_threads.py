"""Threads of torch and of Dr.Jit."""

import drjit as dr
import pytest
import torch

from gva_mi.core.threads import core_for_torch, in_torch_thread, one_torch_thread


def test_work_beside_has_the_callers_number_of_threads():
    count = lambda: torch.get_num_threads()
    before = torch.get_num_threads()
    assert in_torch_thread(count).result() == before
    with one_torch_thread():
        assert in_torch_thread(count).result() == 1
    assert in_torch_thread(count).result() == before == torch.get_num_threads()


def test_work_beside_gives_the_same_bits():
    x, weight = torch.rand(1, 3, 40, 40), torch.rand(16, 3, 3, 3)
    with one_torch_thread():
        there, here = in_torch_thread(torch.conv2d, x, weight), torch.conv2d(x, weight)
        assert torch.equal(there.result(), here)


def test_an_error_of_work_beside_reaches_the_caller():
    with pytest.raises(RuntimeError, match="size"):
        in_torch_thread(torch.add, torch.zeros(2), torch.zeros(3)).result()


def test_drjit_leaves_torch_a_core_and_gets_it_back_also_after_an_error():
    before = dr.thread_count()
    try:
        for threads, left in ((2, 1), (1, 1)):
            dr.set_thread_count(threads)
            with pytest.raises(ZeroDivisionError), core_for_torch():
                assert dr.thread_count() == left
                1 / 0  # noqa: B018
            assert dr.thread_count() == threads
    finally:
        dr.set_thread_count(before)
