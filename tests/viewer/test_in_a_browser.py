"""The viewer in a browser without a window, spoken to over Chrome's DevTools protocol."""

import base64
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

from gva_mi.body.pose import save_poses

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PANEL = 400  # pixels to the right that hold no picture
FRAMES = 5


@pytest.fixture
def served(known, turning, tmp_path):
    """``gva-mi view`` in a process of its own, and its address."""
    pytest.importorskip("viser", reason="viser is not installed: pip install 'gva_mi[viewer]'")
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(FRAMES), stage=2)
    command = (sys.executable, "-m", "gva_mi", "view", tmp_path / "run", "--port", "0")
    # Whoever runs tests in the background has Ctrl-C ignored, and so would the process.
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True} | heard
    out = ("--out", tmp_path / "out")
    with subprocess.Popen(
        (*command, *out), env=os.environ | {"OMP_NUM_THREADS": "1"}, **pipes
    ) as p:
        try:
            yield p, p.stdout.readline().split(": ")[0]
        finally:
            p.kill()


class Chromium:
    """One page. A context, which ends the browser."""

    def __init__(self, folder, url, width, height):
        flags = ("--headless=new", "--no-sandbox", "--no-first-run", "--enable-unsafe-swiftshader")
        ports = ("--remote-debugging-port=0", f"--user-data-dir={folder}")
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = (CHROMIUM, *flags, *ports, f"--window-size={width},{height}", url)
        self._process, self._calls = subprocess.Popen(command, **quiet), 0
        self._told = folder / "DevToolsActivePort"

    def __enter__(self):
        from websockets.sync.client import connect

        try:
            wait_until(lambda: self._told.exists() and len(self._told.read_text().split()) == 2)
            port = self._told.read_text().split()[0]
            page = wait_until(lambda: [p for p in listed(port) if p["type"] == "page"])[0]
            self._socket = connect(page["webSocketDebuggerUrl"], max_size=1 << 26)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_):
        self._socket.close()
        self._end()

    def call(self, method, **parameters):
        """One command of the protocol, and its result."""
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == self._calls:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script):
        """The value of a line of JavaScript."""
        return self.call("Runtime.evaluate", expression=script)["result"].get("value")

    def press_right_arrow(self):
        key = {"key": "ArrowRight", "code": "ArrowRight", "windowsVirtualKeyCode": 39}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, **key)

    def picture(self):
        """What is seen beside the panel, 8-bit (H, W, 3)."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))[:, :-PANEL].astype(int)

    def _end(self):
        self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def listed(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=20) as answer:
        return json.load(answer)


def wait_until(found, seconds=90):
    """What a function finds, as soon as it finds something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(0.2)
    raise AssertionError(f"not within {seconds} seconds")


def test_it_serves_a_page_and_ctrl_c_ends_it(served, tmp_path):
    process, url = served
    with urllib.request.urlopen(url, timeout=30) as page:
        assert b"<html" in page.read()[:2000]
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert process.stdout.read() == "" and not (tmp_path / "out").exists()


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_the_avatar_is_seen_and_a_slider_turns_it(served, tmp_path):
    _, url = served
    with Chromium(tmp_path / "profile", url, 1000, 700) as browser:
        # Stripes of the known avatar, which nothing else on the page has: no two channels alike.
        colourful = lambda picture: (np.ptp(picture, axis=2) > 60).mean()
        first = wait_until(
            lambda: (p := browser.picture()) is not None and colourful(p) > 0.02 and [p]
        )
        slider = f"[...document.querySelectorAll('[role=slider][aria-valuemax=\"{FRAMES - 1}\"]')]"
        assert browser.run(f"{slider}.length") == 1
        browser.run(f"{slider}[0].focus()")
        browser.press_right_arrow()
        assert wait_until(lambda: browser.run(f"{slider}[0].ariaValueNow") == "1")
        changed = lambda: (np.abs(browser.picture() - first[0]).max(2) > 60).mean() > 0.01
        assert wait_until(changed)
