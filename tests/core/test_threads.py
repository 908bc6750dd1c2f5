"""Work of torch in another thread."""

import pytest
import torch

from gva_mi.core.threads import in_torch_thread, one_torch_thread


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
