"""Measures what an owner waits for while another one takes as much as it can.

Usage: python3 tests/outside/greedy.py target/release/oviduct [--seconds 60] [--model-s 10] [--get-ms 100]

The service has one worker. The greedy owner requests fits and models, and at the same time holds
event streams and responses, reads downloads slowly, asks for pictures, tables, archives and
deletions, and sends large bodies and bodies without an end. The other owner requests one tiny model
after the other, and a process of its own requests a preset. Each of its models must end within
--model-s seconds of its request and each GET must be answered within --get-ms milliseconds.
"""

import argparse
import http.client
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from urllib.parse import urljoin

sys.path.insert(0, os.path.dirname(__file__))
from hostile import Prober, cases, request, send_unfinished
from service import Service

TINY = {"steps": 60, "particles": {"total": {"keys": [[0, 300], [1, 420]]}}, "lean": {"strength_um": 0}}
FITS, QUEUED, STREAMS, DOWNLOADS = 10, 40, 300, 100


class Greedy:
    """Uses everything of a service until it is stopped; counts the responses by kind."""

    def __init__(self, service):
        self.service, self.key = service, service.key
        self.stopped, self.counts, self.held = threading.Event(), {}, []
        body = {"seed": 1, "spec": {"steps": 400}, "outputs": ["glb", "obj"]}
        model = service.ended(service.json("POST", "/models", body)["id"])
        self.model = f"/models/{model['id']}"
        self.file = next(urljoin(self.model, file["href"]) for file in model["files"] if file["name"] == "model.obj")
        batch = service.json("POST", "/batches", {"seeds": list(range(20)), "spec": TINY})
        self.batch = f"/batches/{batch['id']}"
        service.ended(batch["models"][-1])

    def count(self, kind, status):
        self.counts.setdefault(kind, {}).setdefault(status, 0)
        self.counts[kind][status] += 1

    def again(self, kind, method, path, body=None):
        """Sends a request again and again."""
        while not self.stopped.is_set():
            try:
                self.count(kind, request(self.service.port, self.key, method, path, body)[0])
            except (OSError, http.client.HTTPException):
                self.count(kind, "cut")

    def open(self, path, headers=""):
        """Sends a request without reading its response."""
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(("127.0.0.1", self.service.port))
        head = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {self.key}\r\n{headers}\r\n"
        connection.sendall(head.encode())
        self.held.append(connection)

    def start(self):
        targets = [{"region": "whole", "quantity": "fill", "value": 0.7}]
        for seed in range(FITS):
            fit = {"targets": targets, "evaluations": 400, "seeds": 4, "seed": 100 * seed, "priority": 100}
            self.count("fit", request(self.service.port, self.key, "POST", "/fits", json.dumps(fit))[0])
        for seed in range(QUEUED):
            model = {"seed": seed, "reuse": False, "priority": 0}
            self.count("model", request(self.service.port, self.key, "POST", "/models", json.dumps(model))[0])
        for _ in range(STREAMS):
            self.open("/events")
        for _ in range(DOWNLOADS):
            self.open(self.file)
        self.held += send_unfinished(self.service.port, self.key)
        kinds = [(name, "POST", path, body) for name, path, body, _ in cases()]
        kinds += [("picture", "GET", f"{self.model}/preview.png?size=2048", None)] * 4
        kinds += [("table", "GET", f"{self.batch}/table", None), ("archive", "GET", f"{self.batch}/archive", None)]
        kinds += [("cut", "GET", f"{self.model}/cut?z_um=500", None), ("delete", "DELETE", "/models?label=a:b", None)]
        kinds += [("held", "GET", self.model, None), ("list", "GET", "/models?limit=100&view=full", None)]
        for kind in kinds * 2:
            threading.Thread(target=self.again, args=kind, daemon=True).start()

    def stop(self):
        self.stopped.set()
        for connection in self.held:
            connection.close()


def modest(port, key, seconds):
    """The process of the other owner: requests one model after the other, prints their times."""
    def call(method, path, body=None):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
        headers = {"authorization": f"Bearer {key}", "content-type": "application/json"}
        connection.request(method, path, body and json.dumps(body), headers)
        with connection.getresponse() as response:
            return json.load(response)

    waits, start = [], time.monotonic()
    while time.monotonic() - start < seconds:
        sent = time.monotonic()
        model = call("POST", "/models", {"seed": len(waits), "spec": TINY, "reuse": False})
        while model["status"] in ("queued", "running"):
            time.sleep(0.05)
            model = call("GET", f"/models/{model['id']}")
        assert model["status"] == "succeeded", model
        waits.append(time.monotonic() - sent)
        time.sleep(0.2)
    print(json.dumps(waits))


def compete(service, greedy_key, modest_key, seconds):
    """Returns the waits for models, the time of the slowest GET, and the responses to the greedy owner."""
    service.key = greedy_key
    greedy = Greedy(service)
    prober = Prober(service.port, modest_key)
    line = [sys.executable, os.path.abspath(__file__), "--modest", str(service.port), modest_key, str(seconds)]
    other = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    # The greedy clients are elsewhere: they must not take the processor from the service.
    os.nice(19)
    greedy.start()
    waits = json.loads(other.communicate()[0])
    slowest = prober.slowest_ms()
    greedy.stop()
    return waits, slowest, greedy.counts


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary")
    for name, default in [("--seconds", 60), ("--model-s", 10), ("--get-ms", 100)]:
        parser.add_argument(name, type=int, default=default)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data:
        service = Service(options.binary, data, "--cpu-workers", "1", "--gpu", "off")
        service.add_key("greedy", "read,submit")
        greedy_key = service.key
        service.add_key("modest", "read,submit")
        modest_key = service.key
        service.start()
        try:
            waits, slowest, counts = compete(service, greedy_key, modest_key, options.seconds)
        finally:
            service.kill()
    print(f"{len(waits)} models, {sorted(waits)[len(waits) // 2]:.1f} s at the median and {max(waits):.1f} s at most")
    print(f"the slowest GET took {slowest:.0f} ms")
    for kind, statuses in sorted(counts.items()):
        print(f"greedy: {kind}: {statuses}")
    if max(waits) > options.model_s or slowest > options.get_ms:
        raise SystemExit("the greedy owner delayed the other one")


if __name__ == "__main__":
    if sys.argv[1] == "--modest":
        modest(int(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
    else:
        main()
