"""What the bench of the plugin tells."""

from gva_mi.mesh.bench import SIZES, bench_normals


def test_stages_add_up_to_a_step():
    found = bench_normals(repeats=1, seed=0)
    assert [size.size for size in found.sizes] == list(SIZES)
    for size in found.sizes:
        *parts, whole = (least for least, _ in size.stages.values())
        assert abs(sum(parts) - whole) < 1e-6
    assert found.table().count("whole step") == len(SIZES)
