# SPDX-License-Identifier: Apache-2.0
"""Drives a headless Chromium: a small WebDriver client of the standard library alone [W3C WebDriver].

    with Browser(1440, 900) as browser:
        browser.open(Path("report.html"))
        print(browser.run("return document.title"))
        browser.screenshot(Path("report.png"))

Needs the programs `chromium` and `chromedriver` (Debian's packages chromium and chromium-driver).
"""
import base64
import json
import os
import re
import shutil
import subprocess
import tempfile
import urllib.error
import urllib.request
from pathlib import Path


class BrowserError(Exception):
    """What the browser or its driver complained about."""


def missing_programs() -> list[str]:
    """The names of those that are not installed."""
    return [name for name in ("chromium", "chromedriver") if shutil.which(name) is None]


class Browser:
    """One window of width x height CSS pixels; `scale` device pixels for each."""

    def __init__(self, width: int = 1440, height: int = 900, scale: float = 1, timeout: float = 120):
        if missing := missing_programs():
            raise BrowserError(f"not installed: {', '.join(missing)} (Debian packages chromium, chromium-driver)")
        self._timeout = timeout
        self._profile = tempfile.TemporaryDirectory(prefix="tempera_browser_", ignore_cleanup_errors=True)
        self._driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE,
                                        stderr=subprocess.DEVNULL, text=True)
        self._session = ""
        try:
            self._base = f"http://127.0.0.1:{self._port()}"
            arguments = ["--headless=new", f"--user-data-dir={self._profile.name}", "--hide-scrollbars",
                         f"--force-device-scale-factor={scale}", "--force-color-profile=srgb", "--no-first-run",
                         "--disable-dev-shm-usage", "--disable-background-networking"]
            if os.geteuid() == 0:
                arguments.append("--no-sandbox")  # Chromium's sandbox refuses to work for root
            capabilities = {"alwaysMatch": {
                "browserName": "chrome",
                "pageLoadStrategy": "normal",
                "timeouts": {"script": int(timeout * 1000), "pageLoad": int(timeout * 1000)},
                "goog:loggingPrefs": {"browser": "ALL"},
                "goog:chromeOptions": {"binary": shutil.which("chromium"), "args": arguments},
            }}
            self._session = self._call("POST", "/session", {"capabilities": capabilities})["sessionId"]
            self.resize(width, height)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        try:
            if self._session:
                self._call("DELETE", self._path(""))
        except BrowserError:
            pass  # the driver is ended below, and the browser with it
        finally:
            self._session = ""
            self._driver.terminate()
            self._driver.wait(timeout=20)
            self._driver.stdout.close()
            self._profile.cleanup()

    def resize(self, width: int, height: int):
        """Makes the page, not the window with its borders, width x height."""
        self._call("POST", self._path("/window/rect"), {"width": width, "height": height})
        inner = self.run("return [innerWidth, innerHeight]")
        self._call("POST", self._path("/window/rect"),
                   {"width": 2 * width - inner[0], "height": 2 * height - inner[1]})

    def open(self, page: Path | str, fragment: str = ""):
        """Loads a file and waits for it."""
        address = Path(page).resolve().as_uri()
        self._call("POST", self._path("/url"), {"url": "about:blank"})  # a mere change of fragment would not load it
        self._call("POST", self._path("/url"), {"url": address + (f"#{fragment}" if fragment else "")})

    def run(self, script: str, *arguments):
        """The value that the body of a function, `script`, returns for `args`; promises are awaited."""
        body = ("const done = arguments[arguments.length - 1];"
                "(async (...args) => {" + script + "})(...[...arguments].slice(0, -1))"
                ".then((value) => done({ value }), (error) => done({ error: String(error && error.stack || error) }));")
        answer = self._call("POST", self._path("/execute/async"), {"script": body, "args": list(arguments)})
        if "error" in answer:
            raise BrowserError(answer["error"])
        return answer.get("value")

    def screenshot(self, file: Path | None = None, kind: str = "png", quality: int = 90) -> bytes:
        """The window as "png", "jpeg" or "webp", written to `file` if that is given."""
        parameters = {"format": kind} if kind == "png" else {"format": kind, "quality": quality}
        answer = self._call("POST", self._path("/goog/cdp/execute"),
                            {"cmd": "Page.captureScreenshot", "params": parameters})
        data = base64.b64decode(answer["data"])
        if file:
            Path(file).write_bytes(data)
        return data

    def messages(self) -> list[dict]:
        """What the page wrote to the console since the last call: [{"level", "message", ...}]."""
        return self._call("POST", self._path("/se/log"), {"type": "browser"})

    # --- Mouse and keys, as a person's: the page cannot tell them apart ---

    def move(self, x: float, y: float):
        self._pointer([self._move(x, y)])

    def click(self, x: float, y: float):
        self._pointer([self._move(x, y), {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}])

    def drag(self, start: tuple[float, float], end: tuple[float, float]):
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        self._pointer([self._move(*start), {"type": "pointerDown", "button": 0}, self._move(*middle), self._move(*end),
                       {"type": "pointerUp", "button": 0}])

    def wheel(self, x: float, y: float, delta: float):
        self._actions({"type": "wheel", "id": "wheel", "actions": [
            {"type": "scroll", "x": int(x), "y": int(y), "deltaX": 0, "deltaY": int(delta), "duration": 0}]})

    def press(self, *keys: str):
        """Presses keys one after another: characters, or names such as "ArrowRight"."""
        names = {"ArrowLeft": "\ue012", "ArrowRight": "\ue014", "Home": "\ue011", "End": "\ue010", "Escape": "\ue00c"}
        steps = []
        for key in keys:
            value = names.get(key, key)
            steps += [{"type": "keyDown", "value": value}, {"type": "keyUp", "value": value}]
        self._actions({"type": "key", "id": "keyboard", "actions": steps})

    def _pointer(self, steps: list[dict]):
        self._actions({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps})

    @staticmethod
    def _move(x: float, y: float) -> dict:
        return {"type": "pointerMove", "duration": 0, "x": int(x), "y": int(y)}

    def _actions(self, source: dict):
        self._call("POST", self._path("/actions"), {"actions": [source]})

    def _port(self) -> int:
        for line in self._driver.stdout:
            if found := re.search(r"started successfully on port (\d+)", line):
                return int(found[1])
        raise BrowserError("chromedriver did not start")

    def _path(self, rest: str) -> str:
        return f"/session/{self._session}{rest}"

    def _call(self, method: str, path: str, body: dict | None = None):
        data = json.dumps(body or {}).encode() if method == "POST" else None
        request = urllib.request.Request(self._base + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=self._timeout + 30) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            value = json.load(error).get("value", {})
            raise BrowserError(f"{value.get('error')}: {value.get('message')}") from None
        except OSError as error:
            raise BrowserError(f"no answer from chromedriver: {error}") from None
