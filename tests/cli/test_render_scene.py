"""``gva-mi render --scene``: an avatar in a Mitsuba scene."""

from pathlib import Path

import numpy as np
import pytest

from gva_mi.app.scenes import load_scene, scene_path
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import read_image

SENSOR = """
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 1, 4" target="0, 0.8, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="2"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="40"/> <integer name="height" value="48"/>
            <rfilter type="box"/>
        </film>
    </sensor>"""  # noqa: E501
FLOOR = """
    <shape type="rectangle" id="floor">
        <transform name="to_world">
            <rotate x="1" angle="-90"/> <scale value="3"/> <translate y="0.1"/>
        </transform>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
            <string name="filename" value="tiles.png"/>
        </texture></bsdf>
    </shape>"""
SKY = '<emitter type="constant"><rgb name="radiance" value="0.4, 0.6, 0.9"/></emitter>'


def write_scene(folder, *parts, name="scene.xml"):
    from PIL import Image

    Image.fromarray(np.full((2, 2, 3), 90, np.uint8)).save(folder / "tiles.png")
    (folder / name).write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')
    return folder / name


def test_a_motion_in_a_scene_is_resumed_and_follows_its_files(run, cli):
    scene, out = write_scene(run.parent, SENSOR, FLOOR, SKY), run.parent / "out"
    command = ("render", run, "--scene", scene, "--light", "scene", "--out", out, "--video")
    said = cli.works(*command)
    assert "3 pictures" in said and "limits: surfaces are diffuse" in said
    images = {name: (out / name).read_bytes() for name in ("000000.png", "000002.png")}
    image = read_image(out / "000000.png", 3)
    assert image.shape == (48, 40, 3)
    assert np.abs(image[0, 0] - np.array([170, 203, 243])).max() <= 1  # the sky, in sRGB
    (out / "000002.png").unlink()
    (out / "video.mp4").unlink()
    assert "resumed" in cli.works(*command)
    assert all((out / name).read_bytes() == content for name, content in images.items())
    (out / "000002.png").unlink()
    write_scene(run.parent, SENSOR, FLOOR, SKY)
    (run.parent / "tiles.png").write_bytes((out / "000000.png").read_bytes())
    assert "give --overwrite" in cli.fails(*command)  # a picture of the scene has changed


def test_the_person_stands_on_the_ground_and_turns(run, turning):
    from gva_mi.app.scenes import SceneOptions, StagedMotion
    from gva_mi.fit.run_folder import load_avatar

    path = write_scene(run.parent, SENSOR, FLOOR, SKY)
    avatar, motion = load_avatar(run), turning(1)[0]
    places = []
    for place in ((0.0, 0.0, 0.0), (0.5, -1.0, 90.0)):
        staged = StagedMotion.of(run, avatar, motion, SceneOptions(scene=Path(path), place=place))
        staged.stage.place(motion[0])
        vertices = staged.stage.params["person.vertex_positions"].numpy().reshape(-1, 3)
        assert vertices[:, 1].min() == pytest.approx(0.1, abs=1e-4)  # the floor
        places.append(vertices)
    before, after = (x - np.median(x, 0) for x in places)
    turned = after[:, [2, 1, 0]] * [-1, 1, 1]
    np.testing.assert_allclose(turned - turned.mean(0), before - before.mean(0), atol=1e-3)


BAD = {
    "no sensor": ((FLOOR, SKY), (), "has no sensor, expected one"),
    "no light": ((SENSOR, FLOOR), (), "has no light, expected an emitter"),
    "shape": ((SENSOR, SKY, '<shape type="sfere"/>'), (), 'plugin of type "sfere"'),
    "xml": ((SENSOR, "<shape>"), (), "Mitsuba cannot load this scene: Parsing of XML file"),
    "background": ((SENSOR, SKY), ("--background", "red"), "a scene is the background"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_scenes_are_one_sentence(run, cli, name):
    parts, more, sentence = BAD[name]
    scene = write_scene(run.parent, *parts)
    cli.refuses(sentence, "render", run, "--scene", scene, "--out", run.parent / "out", *more)
    assert not (run.parent / "out").exists()


def test_what_is_no_scene_is_one_sentence(run, cli):
    out = ("--out", run.parent / "out")
    assert "mitsuba-blender" in cli.fails("render", run, "--scene", "kitchen.blend", *out)
    assert "kitchen: no such file" in cli.fails("render", run, "--scene", "kitchen", *out)
    assert "need --scene" in cli.fails("render", run, "--exposure", 1, *out)


def test_cameras_of_a_file_look_into_the_scene(run, cli, camera):
    save_cameras(run.parent / "cameras.npz", [camera])
    scene, out = write_scene(run.parent, FLOOR, SKY), run.parent / "out"  # without a sensor
    cli.works("render", run, "--scene", scene, "--cameras", run.parent / "cameras.npz",
              "--out", out, "--spp", 1)  # fmt: skip
    cli.works("render", run, "--cameras", run.parent / "cameras.npz", "--out", run.parent / "plain")
    inside, plain = (read_image(run.parent / f / "000000.png", 3) for f in ("out", "plain"))
    person = (plain < 200).any(2)
    assert np.median(np.abs(inside.astype(int) - plain)[person]) <= 1  # kept


@pytest.mark.parametrize("name", ["studio", "room", "sky"])
def test_a_scene_of_the_package_has_light_and_ground_for_a_person_at_the_origin(name):
    scene = load_scene(scene_path(Path(name)))
    import mitsuba as mi

    assert scene.integrator() and scene.emitters()
    down = scene.ray_intersect(mi.Ray3f([0.0, 1.9, 0.0], [0, -1, 0]))
    assert down.p.y.numpy() == pytest.approx(0, abs=1e-3)
    (sensor,) = scene.sensors()
    eye = mi.Point3f(sensor.world_transform().translation())
    for height in (0.05, 1.85):  # a person's feet and head, with nothing before them
        to = mi.Point3f(0, height, 0) - eye
        assert not scene.ray_test(mi.Ray3f(eye, to, 1.0, 0.0, [])).numpy().any()
        local = sensor.world_transform().inverse() @ mi.Point3f(0, height, 0)
        tilt = np.degrees(np.arctan2(abs(local.y.numpy()), local.z.numpy()))
        assert tilt < 0.97 * float(mi.traverse(sensor)["x_fov"][0]) / 2
