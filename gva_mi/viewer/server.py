"""The viser server on this machine, and its pages in browsers."""

from __future__ import annotations

import io
import logging
import socket
import warnings
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.avatar.rig import Rig
from gva_mi.core.errors import InputError
from gva_mi.mesh.overlay import CLAY, OUTLINE
from gva_mi.viewer.state import ShownPose, Start, State, ViewerCamera

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import viser

JPEG_QUALITY = 85  # of pictures that change, of 100; chosen: small files without visible blocks
NEAR_PLANE = 0.01  # metres, the nearest that a browser shows; chosen: a view of a finger


@contextmanager
def serving(host: str, port: int, start: Start, title: str) -> Iterator[viser.ViserServer]:
    """Run a server whose browsers start with a view; port 0 picks a free one.

    Raises:
        InputError: viser is not installed, or nothing can listen there.
    """
    try:
        import viser
    except ImportError:
        raise InputError(
            "view: the package viser is not installed: pip install 'gva_mi[viewer]'"
        ) from None
    _require_free(host, port)  # viser would pick another port, or try for ever
    with redirect_stdout(io.StringIO()):  # it prints a table
        server = viser.ViserServer(host=host, port=port, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.set_panel_label(title)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction(start.up)
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = start.position, start.look_at, start.up
    camera.fov, camera.near = start.fov, NEAR_PLANE
    # Browsers open connections that they never use; websockets would print a traceback for each.
    logging.getLogger("websockets.server").addHandler(logging.NullHandler())
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def _require_free(host: str, port: int) -> None:
    """Raise an InputError if nothing can listen there."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"view: cannot listen at {host}, port {port} ({reason}); expected an address of this "
            "machine, and a port that is free"
        ) from None


def address(server: viser.ViserServer) -> str:
    """Return the URL for a browser on this machine."""
    host = server.get_host()
    name = "localhost" if host in ("127.0.0.1", "0.0.0.0") else host
    return f"http://{f'[{name}]' if ':' in name else name}:{server.get_port()}"


def when_moved(server: viser.ViserServer, changed: Callable[[], None]) -> None:
    """Call a function, in any thread, when a browser connects or moves its camera."""

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        client.camera.on_update(lambda _: changed())
        changed()


class Page:
    """One open page in a browser."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client

    def camera(self) -> ViewerCamera:
        """Return the page's camera."""
        camera = self._client.camera
        floats = lambda values: tuple(float(x) for x in values)
        return ViewerCamera(
            position=floats(camera.position),
            wxyz=floats(camera.wxyz),
            fov=float(camera.fov),
            width=int(camera.image_width),
            height=int(camera.image_height),
        )

    def show(self, picture: np.ndarray, fine: bool) -> None:
        """Show an 8-bit picture (H, W, 3), lossless if ``fine``."""
        kind = {"format": "png"} if fine else {"format": "jpeg", "jpeg_quality": JPEG_QUALITY}
        with warnings.catch_warnings():  # the page may just have been closed
            warnings.filterwarnings("ignore", "Queued a .* on a closed connection")
            self._client.scene.set_background_image(picture, **kind)

    def save(self, picture: np.ndarray, name: str) -> None:
        """Let the browser save an 8-bit picture (H, W, 3) under a name."""
        from PIL import Image

        content = io.BytesIO()
        Image.fromarray(picture).save(content, format="PNG")
        self._client.send_file_download(name, content.getvalue())


class Shapes:
    """The surface and the skeleton under the Gaussians, which browsers draw in front of them."""

    def __init__(self, scene: viser.SceneApi, rig: Rig) -> None:
        self._bones = [(j, parent) for j, parent in enumerate(rig.parents) if parent >= 0]
        color = lambda rgb: tuple(round(255 * x) for x in rgb)
        vertices, faces = rig.vertices.float().numpy(), rig.faces.numpy()
        clay = {"color": color(CLAY), "visible": False}
        self._mesh = scene.add_mesh_simple("surface", vertices, faces, **clay)
        lines = np.zeros((len(self._bones), 2, 3), dtype=np.float32)
        self._lines = scene.add_line_segments("skeleton", lines, color(OUTLINE), visible=False)

    def show(self, state: State, posed: ShownPose) -> None:
        """Show surface or skeleton in a pose, as the state says; nothing beside a video.

        The video's picture has its own camera.
        """
        kind = "none" if state.beside else state.mode
        self._mesh.visible, self._lines.visible = kind == "surface", kind == "skeleton"
        if kind == "surface":
            self._mesh.vertices = posed.vertices
        if kind == "skeleton":
            self._lines.points = posed.joints[self._bones].astype(np.float32)


def pages(server: viser.ViserServer) -> dict[int, Page]:
    """Return the open pages by their numbers."""
    return {k: Page(client) for k, client in server.get_clients().items()}
