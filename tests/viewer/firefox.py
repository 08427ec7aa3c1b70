"""Firefox by WebDriver BiDi (W3C), which it speaks itself: no driver, and nothing but websockets."""

import json
import re
import subprocess
import tempfile
import time
from contextlib import contextmanager
from itertools import count

from websockets.sync.client import connect

from tests.conftest import BUSY_S

LISTENS = re.compile(r"WebDriver BiDi listening on (ws://\S+)")


@contextmanager
def firefox():
    """A browser without a window, as a `Page`."""
    with tempfile.TemporaryDirectory() as profile:
        options = "--headless", "--no-remote", "--profile", profile, "--remote-debugging-port", "0"
        command = ["firefox-esr", *options]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            address = next(filter(None, map(LISTENS.search, process.stderr)))[1]
            with connect(f"{address}/session", max_size=None, compression=None, open_timeout=BUSY_S) as socket:
                yield Page(socket)
        finally:
            process.kill()
            process.communicate()


class Page:
    """One page; `errors` has what its console and its scripts reported."""

    def __init__(self, socket):
        self._socket, self._numbers, self._host, self.errors = socket, count(1), "", []
        self._call("session.new", capabilities={})
        self._call("session.subscribe", events=["log.entryAdded"])
        self._context = self._call("browsingContext.getTree")["contexts"][0]["context"]

    def _call(self, method, **parameters):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=BUSY_S))
            if answer.get("method") == "log.entryAdded" and answer["params"]["level"] == "error":
                text = answer["params"]["text"]
                if "ws://" not in text or self._host in text:  # the page before may have lost its service
                    self.errors.append(text)
            if answer.get("id") == number:
                assert answer["type"] == "success", answer
                return answer["result"]

    def open(self, url, width, height):
        size = {"width": width, "height": height}
        self._call("browsingContext.setViewport", context=self._context, viewport=size)
        self._host = url.partition("//")[2]
        self.errors.clear()
        self._call("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def evaluate(self, expression):
        """The value of an expression, as JSON has it."""
        text = f"JSON.stringify({expression})"
        return json.loads(self._evaluate(text).get("value", "null"))

    def _evaluate(self, expression):
        target = {"context": self._context}
        answer = self._call("script.evaluate", expression=expression, target=target, awaitPromise=False)
        assert answer["type"] == "success", answer
        return answer["result"]

    def wait(self, true, send=lambda: None):
        """Send frames until an expression is true; gives it."""
        end = time.monotonic() + BUSY_S
        send()
        while not (value := self.evaluate(true)):
            assert time.monotonic() < end, f"never: {true}"
            time.sleep(0.02)
            send()
        return value

    def click(self, selector):
        self.drag(selector, (0, 0), (0, 0))

    def drag(self, selector, start, end):
        """Press the mouse's button at `start`, release it at `end`: parts of an element's size from its middle."""
        node = f"document.querySelector({json.dumps(selector)})"
        self.evaluate(f"{node}.scrollIntoView({{block: 'nearest'}})")
        width, height = self.evaluate(f"[{node}.offsetWidth, {node}.offsetHeight]")
        origin = {"type": "element", "element": {"sharedId": self._evaluate(node)["sharedId"]}}
        places = [
            {"type": "pointerMove", "x": round(x * width), "y": round(y * height), "origin": origin}
            for x, y in (start, end)
        ]
        actions = [places[0], {"type": "pointerDown", "button": 0}, places[1], {"type": "pointerUp", "button": 0}]
        pointer = [{"type": "pointer", "id": "mouse", "actions": actions}]
        self._call("input.performActions", context=self._context, actions=pointer)
