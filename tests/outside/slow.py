"""Tests slow readers: 2,000 clients that download a file at one byte per minute.

Usage: python3 tests/outside/slow.py target/release/oviduct [--clients 2000] [--seconds 120]
       [--probe-ms 100]

In the meantime probes must respond within --probe-ms, submitted models must end, and memory and
file descriptors must stay bounded. The service must disconnect the clients. Prints the
measurements; fails if a condition is violated.
"""

import argparse
import os
import resource
import select
import socket
import sys
import tempfile
import time
from urllib.parse import urljoin

sys.path.insert(0, os.path.dirname(__file__))
from service import SMALL, Service
from streams import megabytes


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary")
    for name, default in [("--clients", 2000), ("--seconds", 120), ("--limit", 400), ("--probe-ms", 100)]:
        parser.add_argument(name, type=int, default=default)
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    with tempfile.TemporaryDirectory() as data:
        service = Service(options.binary, data, "--cpu-workers", "1", "--cpu-threads", "1")
        service.start()
        pid = service.process.pid
        model = service.ended(service.json("POST", "/models", {"seed": 1, "spec": {"steps": 400}})["id"])
        file = next(file for file in model["files"] if file["name"] == "model.glb")
        path = urljoin(f"/models/{model['id']}", file["href"])
        print(f"file of {file['bytes'] >> 20} MiB, {megabytes(pid, 'VmRSS'):.0f} MB resident before", flush=True)
        clients, poll = {}, select.epoll()
        for _ in range(options.clients):
            client = socket.socket()
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            client.connect(("127.0.0.1", service.port))
            client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            clients[client.fileno()] = client
            poll.register(client, select.EPOLLRDHUP | select.EPOLLERR | select.EPOLLHUP)
        start, next_byte, probes, done, memory, files = time.monotonic(), 0, [], 0, 0, 0
        pending, refused, first_cut = None, 0, None
        while (age := time.monotonic() - start) < options.seconds:
            if age >= next_byte:
                next_byte += 60
                for client in clients.values():
                    try:
                        client.recv(1, socket.MSG_DONTWAIT)
                    except OSError:
                        pass
            for path in ["/healthz", "/readyz"]:
                sent = time.monotonic()
                assert service.call("GET", path)[0] == 200
                probes.append((time.monotonic() - sent, path, age))
            if pending is None:
                pending = service.json("POST", "/models", {"reuse": False, "spec": SMALL})["id"]
            elif (status := service.json("GET", f"/models/{pending}")["status"]) not in ("queued", "running"):
                assert status == "succeeded", status
                pending, done = None, done + 1
            for descriptor, _ in poll.poll(0):
                first_cut = first_cut or age
                poll.unregister(descriptor)
                clients.pop(descriptor).close()
            memory = max(memory, megabytes(pid, "VmRSS"))
            files = max(files, len(os.listdir(f"/proc/{pid}/fd")))
            time.sleep(0.25)
        for path in ["/healthz", "/readyz"]:
            times = sorted((took, age) for took, asked, age in probes if asked == path)
            within = f"99 % within {1e3 * times[len(times) * 99 // 100][0]:.1f} ms"
            print(f"{len(times)} probes of {path}: {within}, the slowest {1e3 * times[-1][0]:.1f} ms", end=" ")
            print(f"after {times[-1][1]:.1f} s")
        slowest = max(took for took, _, _ in probes)
        print(f"{len(os.listdir(f'/proc/{pid}/fd'))} descriptors at the end")
        print(f"at most {memory:.0f} MB resident and {files} descriptors; {done} models ended meanwhile")
        first = "none" if first_cut is None else f"the first after {first_cut:.0f} s"
        print(f"{options.clients - len(clients)} of {options.clients} clients were cut off, {first}")
        service.kill()
        faults = [
            fault
            for fault, holds in [
                (f"a probe took over {options.probe_ms} ms", slowest < options.probe_ms / 1000),
                ("memory", memory < options.limit),
                ("descriptors", files < 2 * options.clients + 200),
                ("no model ended", done > 0),
                ("clients were not cut off", not clients),
            ]
            if not holds
        ]
        if faults:
            raise SystemExit("; ".join(faults))


if __name__ == "__main__":
    main()
