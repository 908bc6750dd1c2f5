"""``gva-mi view`` in a process of its own serves a page, which works, until Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest
from samples.browser import CHROMIUM, NO_BROWSER, SOFTWARE_WEBGL, Browser

from gva_mi.body.pose import save_poses

FRAMES = 5
pytestmark = pytest.mark.slow


@pytest.fixture
def served(known, turning, tmp_path):
    """``gva-mi view`` in a process of its own, and its address."""
    pytest.importorskip("viser", reason="viser is not installed: pip install 'gva_mi[viewer]'")
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(FRAMES), stage=2)
    command = (sys.executable, "-m", "gva_mi", "view", tmp_path / "run", "--port", "0")
    # A background job ignores Ctrl-C, and so would its child.
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True} | heard
    with subprocess.Popen(command, env=os.environ | {"OMP_NUM_THREADS": "1"}, **pipes) as p:
        try:
            yield p, p.stdout.readline().split(": ")[0]
        finally:
            p.kill()


def test_it_serves_a_page_and_ctrl_c_ends_it(served):
    process, url = served
    with urllib.request.urlopen(url, timeout=30) as page:
        assert b"<html" in page.read()[:2000]
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert process.stdout.read() == ""


# The input beside a label of viser's panel.
FIELD = """(name => {
  let at = [...document.querySelectorAll('label')].find(x => x.innerText.trim() === name);
  while (!at.querySelector('input:not([type=hidden])')) at = at.parentElement;
  return at.querySelector('input:not([type=hidden])');
})"""


def settled(browser, before=None):
    """The picture left of the panel, once it stands still and differs from the one before."""
    last, end = None, time.monotonic() + 120
    while time.monotonic() < end:
        shown = browser.picture()[150:, :450]
        still = last is not None and np.array_equal(shown, last)
        if still and shown.std() > 10 and (before is None or not np.array_equal(shown, before)):
            return shown
        last = shown
        time.sleep(0.5)
    raise AssertionError("the picture does not change, or not settle")


@pytest.mark.skipif(CHROMIUM is None, reason=NO_BROWSER)
def test_a_browser_turns_poses_and_plays(served):
    _, url = served
    with Browser(*SOFTWARE_WEBGL) as browser:
        browser.open(url, 800, 500, "document.querySelectorAll('label').length > 10")
        opened = settled(browser)
        mouse = lambda kind, x, **more: browser(
            "Input.dispatchMouseEvent", type=kind, x=x, y=300, button="left", **more
        )
        mouse("mousePressed", 200, clickCount=1)
        for x in range(220, 400, 20):
            mouse("mouseMoved", x, buttons=1)
        mouse("mouseReleased", 400, clickCount=1)
        turned = settled(browser, opened)
        browser.run(f"(x => {{ x.focus(); x.select(); }})({FIELD}('z'))")
        browser("Input.insertText", text="60")
        browser.press("Enter", "\r")
        settled(browser, turned)
        browser.run(f"{FIELD}('play').click()")
        browser.wait(f"Number({FIELD}('frame').value) !== 0")
        assert not [text for text in browser.complaints if "deprecated" not in text]
