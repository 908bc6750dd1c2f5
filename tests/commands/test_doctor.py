"""``gva-mi doctor``: what it found, and what serves where something is missing."""

from gva_mi.commands.doctor import examine


def test_doctor_says_what_it_found(cli):
    code, out, _ = cli("doctor")
    assert code == 0
    for name in ("python", "libLLVM", "drjit", "mitsuba", "torch", "pymeshlab", "LPIPS"):
        assert name in out


def test_doctor_names_the_weights_that_are_used(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr("gva_mi.commands.doctor.PACKAGES", {})
    found = {finding.name: finding.found for finding in examine()}
    assert "rand_vgg" in found["VGG16"] and "rand_vgg" in found["LPIPS"]


def test_doctor_says_that_a_fit_must_be_told_of_weights(tmp_path, monkeypatch):
    weights = tmp_path / "hub/checkpoints/vgg16-397923af.pth"
    weights.parent.mkdir(parents=True)
    weights.write_bytes(b"")
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr("gva_mi.commands.doctor.PACKAGES", {})
    found = {finding.name: finding.found for finding in examine()}
    assert str(weights) in found["VGG16"] and "--vgg16" in found["VGG16"]
