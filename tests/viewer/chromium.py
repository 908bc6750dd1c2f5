"""A browser without a window, spoken to over Chrome's DevTools protocol."""

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request

import numpy as np

PROGRAM = shutil.which("chromium") or shutil.which("google-chrome")
NO_GPU = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist")


class Chromium:
    """One page. A context, which ends the browser."""

    def __init__(self, folder, url, width, height):
        from websockets.sync.client import connect

        flags = ("--headless=new", "--no-sandbox", "--no-first-run", "--disable-gpu", *NO_GPU)
        ports = ("--remote-debugging-port=0", f"--user-data-dir={folder}")
        size = f"--window-size={width},{height}"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen([PROGRAM, *flags, *ports, size, url], **quiet)
        try:
            told = folder / "DevToolsActivePort"
            wait_until(lambda: told.exists() and len(told.read_text().split()) == 2, 60)
            port = told.read_text().split()[0]
            pages = wait_until(lambda: [p for p in self._pages(port) if p["type"] == "page"], 30)
            self._socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=1 << 26)
        except BaseException:
            self._end()
            raise
        self._calls = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()
        self._end()

    def call(self, method, **parameters):
        """One command of the protocol, and its result."""
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=120))
            if answer.get("id") == self._calls:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script):
        """The value of a line of JavaScript."""
        return self.call("Runtime.evaluate", expression=script)["result"].get("value")

    def press(self, key, code):
        """A key, with its number on keyboards."""
        for kind in ("keyDown", "keyUp"):
            key_event = {"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code}
            self.call("Input.dispatchKeyEvent", **key_event)

    def screenshot(self):
        """What is seen, 8-bit (H, W, 3)."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def _end(self):
        self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @staticmethod
    def _pages(port):
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=20) as answer:
            return json.load(answer)


def wait_until(found, seconds, every=0.1):
    """What a function finds, as soon as it finds something."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if value := found():
            return value
        time.sleep(every)
    raise AssertionError(f"not within {seconds} seconds")
