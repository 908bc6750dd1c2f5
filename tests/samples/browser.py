"""A headless Chromium, spoken to by its DevTools protocol."""

import base64
import io
import json
import shutil
import subprocess
import tempfile
import time

import numpy as np
from PIL import Image

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
NO_BROWSER = "no chromium, chromium-browser or google-chrome on the path"
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class Browser:
    """One page of a browser, with what it complained about in ``complaints``."""

    def __init__(self, *flags):
        from websockets.sync.client import connect

        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            [CHROMIUM, "--headless=new", "--no-sandbox", "--hide-scrollbars", "--disable-gpu-vsync",
             "--force-color-profile=srgb", "--remote-debugging-port=0", "--remote-allow-origins=*",
             f"--user-data-dir={self._folder.name}", *flags, "about:blank"],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        for line in self._process.stderr:
            if line.startswith("DevTools listening on "):
                break
        whole = connect(line.split()[-1], max_size=None)
        self._socket, self._number, self._session = whole, 0, None
        self.complaints = []
        target = self("Target.createTarget", url="about:blank")["targetId"]
        attached = self("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._session = None
        self("Browser.close")
        self._socket.close()
        self._process.wait(60)
        self._process.stderr.close()
        self._folder.cleanup()

    def __call__(self, method, **params):
        """Call a method of the protocol and return its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            heard = json.loads(self._socket.recv(timeout=120))
            if heard.get("id") == self._number:
                assert "error" not in heard, heard
                return heard["result"]
            self._listen(heard.get("method"), heard.get("params", {}))

    def _listen(self, method, about):
        if method == "Runtime.exceptionThrown":
            self.complaints.append(about["exceptionDetails"]["text"])
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.complaints.append(str(about["args"]))
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            self.complaints.append(about["entry"]["text"])

    def open(self, url, width, height, ready, sharpness=1, phone=False):
        """Open a page in so many CSS pixels and wait until an expression is true."""
        self("Emulation.setDeviceMetricsOverride", width=width, height=height,
             deviceScaleFactor=sharpness, mobile=phone)  # fmt: skip
        self("Page.navigate", url="about:blank")
        self("Page.navigate", url=url)
        self.wait(ready)

    def wait(self, expression, seconds=60):
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.run(f"Boolean({expression})"):
            assert time.monotonic() < end, f"not after {seconds} s: {expression}; {self.complaints}"
            time.sleep(0.05)

    def run(self, expression):
        """Evaluate an expression, a promise's result included."""
        found = self(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def press(self, key, text=None):
        """Press a key, as a keyboard does."""
        about = {"key": key, "code": key} | ({"text": text} if text else {})
        if key == "Tab":
            about |= {"windowsVirtualKeyCode": 9}
        self("Input.dispatchKeyEvent", type="keyDown", **about)
        self("Input.dispatchKeyEvent", type="keyUp", key=key, code=key)

    def picture(self):
        """Take a picture of the page, 8-bit (H, W, 3)."""
        data = base64.b64decode(self("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
