"""The viewer's page in a browser: its controls, and its picture once it stands still."""

import time

import numpy as np

# The input beside a label of viser's panel.
FIELD = """(name => {
  let at = [...document.querySelectorAll('label')].find(x => x.innerText.trim() === name);
  while (!at.querySelector('input:not([type=hidden])')) at = at.parentElement;
  return at.querySelector('input:not([type=hidden])');
})"""
OPTION = "[...document.querySelectorAll('[role=option]')].find(x => x.innerText.trim() === '{}')"
NOTICES = "document.querySelectorAll('.mantine-Notification-closeButton')"
SECONDS = 300  # for a picture, of a crowded machine
PANEL = 340  # CSS pixels, width of the panel at the right


class ViewerPage:
    """The page of ``gva-mi view`` at an address, in a browser of so many CSS pixels."""

    def __init__(self, browser, url, width=800, height=500):
        self.browser, self.width, self.height = browser, width, height
        browser.open(url, width, height, "document.querySelectorAll('label').length > 10")

    def close_notice(self):
        """Close the notice that WebGL runs in software."""
        self.browser.wait(f"{NOTICES}.length")
        self.browser.run(f"{NOTICES}.forEach(x => x.click())")
        self.browser.wait(f"!{NOTICES}.length")

    def enter(self, name, text):
        """Type a number into a field."""
        self.browser.run(f"(x => {{ x.focus(); x.select(); }})({FIELD}('{name}'))")
        self.browser("Input.insertText", text=text)
        self.browser.press("Enter", "\r")

    def click(self, name):
        """Click a check box."""
        self.browser.run(f"{FIELD}('{name}').click()")

    def choose(self, name, option):
        """Choose an option of a list."""
        self.click(name)
        self.browser.wait(OPTION.format(option))
        self.browser.run(OPTION.format(option) + ".click()")

    def turn(self, pixels):
        """Drag the mouse to the right."""
        begin, y = self.width // 4, self.height * 3 // 5
        mouse = lambda kind, x, **more: self.browser(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", **more
        )
        mouse("mousePressed", begin, clickCount=1)
        for x in range(begin + 20, begin + pixels, 20):
            mouse("mouseMoved", x, buttons=1)
        mouse("mouseReleased", begin + pixels, clickCount=1)

    def settled(self, before=None):
        """Return the page (H, W, 3) once the avatar stands still and differs from ``before``."""
        avatar = lambda page: page[self.height // 3 :, : self.width - PANEL - 10]
        last, end = None, time.monotonic() + SECONDS
        while time.monotonic() < end:
            page = self.browser.picture()
            still = last is not None and np.array_equal(avatar(page), avatar(last))
            new = before is None or not np.array_equal(avatar(page), avatar(before))
            if still and new and avatar(page).std() > 10:
                return page
            last = page
            time.sleep(0.5)
        raise AssertionError("the picture does not change, or not settle")
