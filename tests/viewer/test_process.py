"""``gva-mi view`` in a process of its own serves a page, which works, until Ctrl-C."""

import os
import signal
import subprocess
import sys
import urllib.request

import pytest
from samples.browser import CHROMIUM, NO_BROWSER, SOFTWARE_WEBGL, Browser
from samples.viewer_page import FIELD, ViewerPage

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


@pytest.mark.skipif(CHROMIUM is None, reason=NO_BROWSER)
def test_a_browser_turns_poses_and_plays(served):
    _, url = served
    with Browser(*SOFTWARE_WEBGL) as browser:
        page = ViewerPage(browser, url)
        opened = page.settled()
        page.turn(200)
        turned = page.settled(opened)
        page.enter("z", "60")
        posed = page.settled(turned)
        page.choose("show", "surface")
        page.settled(posed)
        page.click("play")
        browser.wait(f"Number({FIELD}('frame').value) !== 0")
        assert not [text for text in browser.complaints if "deprecated" not in text]
