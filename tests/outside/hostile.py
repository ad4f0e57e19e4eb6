"""Measures a service under request bodies that are made to take memory.

Usage: python3 tests/outside/hostile.py target/release/oviduct [--limit 400] [--get-ms 100]

The bodies are sent with the key of one owner. First 24 bodies arrive at once, of each kind that has
needed much memory: up to 8 MiB of small or nested objects, of numbers or of one string, and batches
of 1,000 models. Then 190 bodies of 8 MB arrive except for their ends. In each case the service may
have at most --limit MB of resident memory, and must respond to another owner within --get-ms.
"""

import argparse
import functools
import http.client
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, os.path.dirname(__file__))
from service import Service
from streams import megabytes

MAX_BYTES = 8 << 20
AT_ONCE, UNFINISHED, UNFINISHED_BYTES = 24, 190, 8_000_000


def repeated(item):
    """A list of as many of these items as a body may have bytes."""
    return b"[" + b",".join([item] * ((MAX_BYTES - 2) // (len(item) + 1))) + b"]"


def cases():
    """Name, path and body of each kind, and the statuses that the service may respond with."""
    refused = {413, 503}
    yield "empty objects", "/fits/validate", repeated(b"{}"), refused
    yield "objects", "/fits/validate", repeated(b'{"":0}'), refused
    yield "nested objects", "/fits/validate", repeated(b'{"a":' * 120 + b"0" + b"}" * 120), refused
    yield "numbers", "/fits/validate", repeated(b"0"), refused
    string = b'{"preset":"\\n' + b"A" * (MAX_BYTES - 100) + b'"}'
    yield "string", "/fits/validate", string, {422, 503}
    yield "seeds", "/batches", json.dumps({"seeds": list(range(1000))}).encode(), {202, 429, 503}
    grid = {"design": "grid", "values": {"/steps": list(range(100, 1100))}}
    yield "study", "/batches/validate", json.dumps({"vary": grid}).encode(), {200, 422, 503}


def request(port, key, method, path, body=None):
    """Returns the status of a response, and the seconds until it was complete."""
    start = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    headers = {"authorization": f"Bearer {key}", "content-type": "application/json"}
    connection.request(method, path, body, headers)
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status, time.monotonic() - start


def send_at_once(port, key, path, body):
    """Sends the body on many connections; returns the statuses."""
    statuses = []
    threads = [
        threading.Thread(target=lambda: statuses.append(request(port, key, "POST", path, body)[0]))
        for _ in range(AT_ONCE)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return statuses


def send_unfinished(port, key):
    """Sends bodies except for their ends; returns the connections."""
    head = (
        f"POST /fits/validate HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {key}\r\n"
        f"Content-Type: application/json\r\nContent-Length: {UNFINISHED_BYTES}\r\n\r\n"
    )
    body = b"[" + b"0," * (UNFINISHED_BYTES // 2 - 10)
    connections = [socket.create_connection(("127.0.0.1", port)) for _ in range(UNFINISHED)]
    for connection in connections:
        connection.sendall(head.encode() + body)
    # The service has read the bodies once the last bytes have left the buffers of the system.
    time.sleep(1)
    return connections


class Prober:
    """Requests a preset again and again, in a process of its own."""

    def __init__(self, port, key):
        line = [sys.executable, os.path.abspath(__file__), "--probe", str(port), key]
        self.process = subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.process.stdout.readline()

    def slowest_ms(self):
        """Ends the process; returns the time of the slowest request."""
        return float(self.process.communicate("\n")[0])


def probe(port, key):
    """The process of a Prober: runs until a line comes from the standard input."""
    stopped = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stopped.set()), daemon=True).start()
    request(port, key, "GET", "/presets/pig")
    print("started", flush=True)
    slowest = 0
    while not stopped.wait(0.02):
        status, seconds = request(port, key, "GET", "/presets/pig")
        assert status == 200, status
        slowest = max(slowest, seconds * 1000)
    print(slowest)


def measure(binary, name, send, allowed, options):
    """Starts a service and runs `send` on it; returns what is wrong."""
    with tempfile.TemporaryDirectory() as data:
        service = Service(binary, data, "--cpu-workers", "0")
        service.add_key("greedy", "read,submit")
        greedy = service.key
        service.add_key("modest", "read,submit")
        service.start()
        prober = Prober(service.port, service.key)
        result = send(service.port, greedy)
        slowest, peak = prober.slowest_ms(), megabytes(service.process.pid, "VmHWM")
        statuses = {status: result.count(status) for status in result if isinstance(status, int)}
        print(f"{name:16} peak {peak:5.0f} MB, slowest GET {slowest:4.0f} ms, statuses {statuses}", flush=True)
        wrong = [f"{name}: {peak:.0f} MB"] if peak > options.limit else []
        wrong += [f"{name}: a GET took {slowest:.0f} ms"] if slowest > options.get_ms else []
        wrong += [f"{name}: status {status}" for status in statuses if status not in allowed]
        service.kill()
        return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary")
    for name, default in [("--limit", 400), ("--get-ms", 100)]:
        parser.add_argument(name, type=int, default=default)
    options = parser.parse_args()
    wrong = []
    for name, path, body, allowed in cases():
        send = functools.partial(send_at_once, path=path, body=body)
        wrong += measure(options.binary, name, send, allowed, options)
    wrong += measure(options.binary, "unfinished", send_unfinished, set(), options)
    if wrong:
        raise SystemExit("\n".join(wrong))
    print("memory and times are bounded")


if __name__ == "__main__":
    if sys.argv[1] == "--probe":
        probe(int(sys.argv[2]), sys.argv[3])
    else:
        main()
