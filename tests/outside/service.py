"""Runs the service for tests: a binary on a free loopback port with its own directory."""

import json
import os
import random
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request

# A model that takes about a second: few steps and particles, but all stages.
SMALL = {"steps": 120, "particles": {"total": {"keys": [[0, 300], [1, 600]]}}, "lean": {"strength_um": 0}}

# A model that takes hours; its first sections come soon.
ENDLESS = {"steps": 100_000, "solver": {"search": "all_pairs", "record_every": 100}}


def free_port():
    """Returns a port on which nobody listens, below the range of outgoing connections."""
    while True:
        port = random.randrange(15_000, 30_000)
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


class Service:
    """`oviduct serve`; can be killed and started again with the same data."""

    def __init__(self, binary, data, *options, port=None):
        self.binary, self.data, self.options = binary, data, options
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.process = None
        # API key that every call sends, if there is one.
        self.key = None
        self.log = open(os.path.join(data, "server.log"), "ab")

    def start(self, *options, **variables):
        """Starts the service and waits until it is ready."""
        assert self.process is None
        line = [self.binary, "serve", "--addr", f"127.0.0.1:{self.port}", "--data", self.data]
        self.process = subprocess.Popen(
            [*line, *self.options, *options], stdout=self.log, stderr=self.log, env={**os.environ, **variables}
        )
        deadline = time.monotonic() + 900
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                break
            try:
                if self.call("GET", "/readyz")[0] == 200:
                    return self
            except OSError:
                pass
            time.sleep(0.05)
        raise SystemExit(f"the service did not become ready:\n{self.tail()}")

    def add_key(self, owner, scopes):
        """Creates an API key, which all later calls send."""
        line = [self.binary, "keys", "add", "--create", "--data", self.data, "--owner", owner, "--scopes", scopes,
                "--json"]
        self.key = json.loads(subprocess.run(line, check=True, capture_output=True).stdout)["key"]

    def kill(self):
        """Kills the service with SIGKILL."""
        self.process.kill()
        self.process.wait()
        self.process = None

    def gone(self, seconds):
        """Waits for the service to exit; returns whether it did."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        self.process = None
        return True

    def stop(self):
        """Stops the service with SIGTERM; it must exit with code 0."""
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(900)
        self.process = None
        if code != 0:
            raise SystemExit(f"the service ended with {code}:\n{self.tail()}")

    def tail(self):
        self.log.flush()
        with open(self.log.name, "rb") as log:
            return log.read()[-4000:].decode(errors="replace")

    def call(self, method, path, body=None, headers=None):
        """Returns status, headers and body of a response."""
        data = None if body is None else json.dumps(body).encode()
        headers = {**({"Content-Type": "application/json"} if data else {}), **(headers or {})}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        request = urllib.request.Request(self.url + path, data=data, method=method, headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=900) as answer:
                return answer.status, answer.headers, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.headers, error.read()

    def json(self, method, path, body=None, headers=None, expect=(200, 201, 202)):
        """Returns the JSON body of a response, which must have an expected status."""
        status, _, content = self.call(method, path, body, headers)
        if status not in expect:
            raise SystemExit(f"{method} {path} answered {status}: {content.decode(errors='replace')[:2000]}")
        return json.loads(content)

    def ended(self, model, seconds=3600):
        """Waits until a model ends; returns it."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            found = self.json("GET", f"/models/{model}")
            if found["status"] not in ("queued", "running"):
                return found
            time.sleep(0.1)
        raise SystemExit(f"the model {model} did not end in {seconds} s: {found}\n{self.tail()}")
