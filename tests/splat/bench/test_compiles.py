"""What was rendered once finds its kernels again."""

from gva_mi.splat.bench.compiles import measure_compiles


def test_a_size_seen_before_compiles_nothing(work):
    found = {compiled.scene: compiled for compiled in measure_compiles(work)}
    assert all(compiled.launched > 5 for compiled in found.values())
    for same in ("the same again", "another pose", "fewer Gaussians", "the first again"):
        assert found[same].new == 0, same
    assert found["a smaller picture"].new <= 1
