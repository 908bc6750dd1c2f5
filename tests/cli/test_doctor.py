"""``gva-mi doctor``: what was found, and what is used if something is missing."""

import pytest

from gva_mi.cli.doctor import examine


@pytest.mark.slow
def test_every_component_is_listed(cli):
    out = cli.works("doctor")
    for name in ("python", "libLLVM", "drjit", "mitsuba", "torch", "ai_edge_litert", "LPIPS"):
        assert name in out


@pytest.mark.slow
def test_a_missing_package_is_found_among_the_others(monkeypatch):
    monkeypatch.setattr("gva_mi.cli.doctor.PACKAGES", {"mesh": ("numpy", "no_such_module")})
    found = {x.name: x for x in examine()}
    assert found["torch"].fine and found["numpy"].fine and not found["no_such_module"].fine
    assert found["no_such_module"].found.endswith("; pip install 'gva_mi[mesh]'")


def test_a_missing_optional_package_is_fine_and_names_its_commands_and_extra(monkeypatch):
    monkeypatch.setattr("gva_mi.cli.doctor.PACKAGES", {})
    monkeypatch.setattr("gva_mi.cli.doctor.OPTIONAL", {"no_such_module": ("`gva-mi x`", "video")})
    (missing,) = (x for x in examine() if x.name == "no_such_module")
    assert missing.fine and missing.found.startswith("none; `gva-mi x` would need it")
    assert "'gva_mi[video]'" in missing.found


@pytest.mark.parametrize("there", [False, True])
def test_weights_are_optional_and_a_fit_must_be_given_them(there, tmp_path, monkeypatch):
    weights = tmp_path / "hub/checkpoints/vgg16-397923af.pth"
    if there:
        weights.parent.mkdir(parents=True)
        weights.write_bytes(b"")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr("gva_mi.cli.doctor.PACKAGES", {})
    found = {x.name: x.found for x in examine()}
    assert found["drjit"] and found["libLLVM"]
    if there:
        assert str(weights) in found["VGG16"] and "--vgg16" in found["VGG16"]
    else:
        assert "rand_vgg" in found["VGG16"] and "rand_vgg" in found["LPIPS"]
