"""A page holds the avatar: skinned by its own numbers, and drawn by a browser, it is the avatar."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from samples.browser import CHROMIUM, NO_BROWSER, SOFTWARE_WEBGL, Browser
from samples.web_pages import unpack

from gva_mi.avatar.avatar import AvatarOptions, SeedOptions, seed_avatar
from gva_mi.avatar.export import NamedMotion
from gva_mi.body.pose import Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.core.errors import InputError
from gva_mi.fit import web_page
from gva_mi.fit.renders import WHITE, CameraPath, over, render_layer, shots
from gva_mi.fit.web_page import save_page
from gva_mi.splat.axes import matrices
from gva_mi.splat.kernels.sh import C0

browser_needed = pytest.mark.skipif(CHROMIUM is None, reason=NO_BROWSER)


@pytest.fixture(scope="module")
def bends():
    """Three frames in which every joint turns, the face moves and the person walks away."""
    generator = torch.Generator().manual_seed(3)
    normal = lambda *size: torch.randn(*size, generator=generator)
    return Pose(0.3 * normal(3, 55, 3), normal(3, 3), normal(3, 10))


@pytest.fixture(scope="module")
def lit(built_in_body):
    """The built-in body in colours that depend on the light."""
    x = built_in_body.v_template
    stripes = 0.5 + 0.4 * torch.sin(torch.stack([9 * x[:, 0], 11 * x[:, 1], 7 * x.sum(1)], dim=1))
    options = AvatarOptions(SeedOptions(count=6000))
    avatar = seed_avatar(built_in_body, Shape(torch.zeros(10)), options=options, colors=stripes)
    with torch.no_grad():
        avatar.canonical.sh[:, 1:].normal_(std=0.3, generator=torch.Generator().manual_seed(2))
    return avatar


class Skinned:
    """Points of a page in a frame, by eq. 1-6 of ``skin_gaussians`` in numpy."""

    def __init__(self, page, kind, motion, frame):
        array = lambda name: page[f"{kind}{name}"]
        T = page[f"{motion}Transforms"].reshape(-1, 55, 3, 4)[frame]
        frames = page["motions"][0]["frames"]
        c = page[f"{motion}Coefficients"].reshape(frames, -1)[frame]
        x = array("Means").reshape(-1, 3).copy()
        shapes = np.repeat(np.arange(len(x)), array("ShapeCounts"))
        bent = c[array("ShapeNumbers")][:, None] * array("ShapeMetres").reshape(-1, 3)
        np.add.at(x, shapes, bent)
        of = np.repeat(np.arange(len(x)), array("PairCounts"))
        maps = T[array("PairJoints")]
        placed = np.einsum("pij,pj->pi", maps[:, :, :3], x[of]) + maps[:, :, 3]
        A, E = np.zeros((len(x), 3, 4)), np.zeros((len(x), 3, 3))
        np.add.at(A, of, array("PairWeights")[:, None, None] * maps)
        np.add.at(E, of, placed[:, :, None] * array("PairSlopes").reshape(-1, 1, 3))
        self.A = A
        self.places = np.einsum("nij,nj->ni", A[:, :, :3], x) + A[:, :, 3]
        beta = 1 / np.sqrt(1 + (E**2).sum((1, 2)) / page["maxStretch"] ** 2)
        self.J = A[:, :, :3] + beta[:, None, None] * E


def test_the_pages_numbers_give_the_avatars_gaussians(lit, bends, tmp_path):
    path, frame = tmp_path / "a.html", 2
    save_page(path, lit, [NamedMotion("bend", bends, 25)], "A <person>")
    assert "A &lt;person&gt;" in path.read_text() and "http" not in path.read_text()
    page = unpack(path)
    found = Skinned(page, "splat", "motion0", frame)
    with torch.no_grad():
        expected = lit(bends[frame])
    assert np.abs(found.places - expected.means.numpy()).max() < 1e-4  # metres
    w, x, y, z = page["quats"].reshape(-1, 4).T
    M = np.array(
        [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    ).transpose(2, 0, 1)  # fmt: skip
    F = found.J @ M * np.exp(page["logScales"].reshape(-1, 1, 3))
    sigma, exact = F @ F.swapaxes(1, 2), matrices(expected.covars).numpy()
    size = np.trace(exact, axis1=1, axis2=2)
    assert (np.abs(sigma - exact).max((1, 2)) / size).max() < 0.01
    light = np.einsum("i,nik->nk", page["light"], found.A[:, :, :3])
    f = page["colors"].reshape(len(light), 4, 3)
    colors = f[:, 0] + np.einsum("nk,nkc->nc", light, f[:, 1:])
    assert C0 * np.abs(colors - expected.sh[:, 0].numpy()).max() < 1e-3
    assert np.abs(page["opacities"] - expected.opacities.numpy()).max() < 1e-4

    surface = Skinned(page, "mesh", "motion0", frame).places
    skeleton = lit.posed_skeleton(bends[frame])
    rest = lit.rig.vertices + lit.rig.directions @ skeleton.coefficients[0]
    exact = skin_points(rest, lit.rig.weights, skeleton.T_world_rest[0].float())
    assert np.abs(surface - exact.detach().numpy()).max() < 1e-4
    assert np.array_equal(page["faces"].reshape(-1, 3), lit.rig.faces)


def test_of_many_blend_shapes_the_largest_are_kept(lit, tmp_path):
    """Bodies of other makers move every point by 486 shapes; a page would be too large."""
    directions = torch.randn(6000, 3, 68, generator=torch.Generator().manual_seed(4)).div(1000)
    avatar = deepcopy(lit)
    avatar.canonical.directions = directions
    save_page(tmp_path / "a.html", avatar, [NamedMotion("rest", Pose.rest(), 25)], "A")
    page = unpack(tmp_path / "a.html")
    assert set(page["splatShapeCounts"]) == {12}
    kept = np.sort(page["splatShapeNumbers"].reshape(-1, 12), axis=1)
    largest = directions.abs().amax(1).topk(12, dim=1).indices.sort(dim=1).values
    assert np.array_equal(kept, largest)


def test_a_page_without_the_body_holds_neither_surface_nor_blend_shapes(lit, tmp_path):
    save_page(tmp_path / "a.html", lit, [NamedMotion("rest", Pose.rest(), 25)], "A", surface=False)
    page = unpack(tmp_path / "a.html")
    assert "faces" not in page and not page["splatShapeCounts"].any()


def test_a_page_that_would_be_too_large_is_refused(lit, bends, tmp_path, monkeypatch):
    for name, most, said in (
        ("MOST_GAUSSIANS", 5999, "at most 5,999 Gaussians, not 6,000"),
        ("MOST_FRAMES", 2, "at most 2 frames of motion, not 3"),
    ):
        with monkeypatch.context() as changed, pytest.raises(InputError, match=said):
            changed.setattr(web_page, name, most)
            save_page(tmp_path / "a.html", lit, [NamedMotion("bend", bends, 25)], "A")
    assert not list(tmp_path.iterdir())


def psnr(found, expected):
    """Of 8-bit pictures, in the box of what is not white."""
    rows, columns = (np.flatnonzero((expected < 250).any((2, axis))) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    difference = found[box].astype(float) - expected[box]
    return 10 * np.log10(255**2 / np.mean(difference**2))


DRAWN = "document.body && document.body.dataset.drawn"


@pytest.fixture(scope="module")
def paged(lit, bends, tmp_path_factory):
    """The address of a page of two motions."""
    path = tmp_path_factory.mktemp("page") / "a.html"
    still = NamedMotion("rest", Pose.rest(), 25)
    save_page(path, lit, [NamedMotion("bend", bends, 25), still], "A person")
    return path.as_uri()


@pytest.mark.slow
@browser_needed
def test_a_browser_draws_what_render_draws(lit, bends, paged, tmp_path):
    """A page without the body lacks its blend shapes, which thicken bent joints."""
    size, naked = (300, 380), tmp_path / "naked.html"
    save_page(naked, lit, [NamedMotion("bend", bends, 25)], "A person", surface=False)
    with Browser(*SOFTWARE_WEBGL) as browser:
        for page, frame, turn, elevation, least in (
            (paged, 0, 0, 5, 45), (paged, 2, 130, -20, 45), (naked.as_uri(), 0, 0, 5, 25),
        ):  # fmt: skip
            view = f"#frame={frame}&turn={turn}&elevation={elevation}&bare"
            browser.open(page + view, *size, DRAWN)
            path = CameraPath("static", turn=turn, elevation=elevation, size=size)
            camera = shots(path, lit.rig, bends)[frame].camera
            expected = over(render_layer(lit, bends[frame], camera), np.array(WHITE))
            assert psnr(browser.picture(), expected) > least
        assert browser.complaints == []


@pytest.mark.slow
@browser_needed
def test_keys_and_buttons_do_what_they_say(paged):
    with Browser(*SOFTWARE_WEBGL) as browser:
        browser.open(paged + "#frame=1", 390, 700, DRAWN, phone=True)
        order = []
        for _ in range(7):
            browser.press("Tab")
            order.append(browser.run("document.activeElement.id"))
        assert order == ["view", "play", "motion", "time", "skeleton", "mesh", "reset"]
        before = browser.picture()
        for key, what in (("ArrowRight", "turn"), ("+", "zoom")):
            value = browser.run(f"player.orbit.{what}")
            browser.run("document.getElementById('view').focus()")
            browser.press(key, key if len(key) == 1 else None)
            assert browser.run(f"player.orbit.{what}") > value, key
        for button in ("skeleton", "mesh"):
            browser.run(f"document.getElementById('{button}').click()")
            browser.wait("!player.changed")
            after = browser.picture()
            assert (np.abs(after.astype(int) - before)[:500] > 30).any(2).mean() > 0.005, button
            before = after
        browser.run("document.getElementById('play').click()")
        browser.wait("player.time !== 1")
        assert browser.run("document.documentElement.scrollWidth") == 390
        assert browser.complaints == []


@pytest.mark.slow
@browser_needed
def test_a_browser_without_webgl_gets_a_sentence(paged):
    with Browser("--disable-gpu", "--disable-3d-apis") as browser:
        message = "document.getElementById('message')"
        browser.open(paged, 600, 400, f"{message} && !{message}.hidden")
        assert "does not offer WebGL 2" in browser.run(f"{message}.textContent")
