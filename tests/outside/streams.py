"""Measures the memory of 1,000 streams of /events and 1,024 streams of one model.

Usage: python3 tests/outside/streams.py target/release/oviduct [--all 1000] [--one 1024]
       [--rate 50] [--seconds 60]

In the meantime, models are submitted at --rate per second. A quarter of the readers of /events read
nothing during the first half. Prints the resident memory of the service while the streams are read
and after they have closed. Fails if the memory exceeds --limit (300 MB), or if more memory remains
than after a run with one stream of each kind.
"""

import argparse
import json
import multiprocessing
import os
import resource
import select
import socket
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(__file__))
from service import SMALL, Service


def megabytes(pid, name):
    """Returns a value of /proc/PID/status, such as VmRSS, in MB."""
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith(name))


def read_streams(port, paths, idle, until_idle, until, results):
    """Opens the streams and reads them; the first `idle` streams are read only after `until_idle`.
    """
    poll, streams = select.epoll(), {}
    refused = 0
    for place, path in enumerate(paths):
        stream = socket.create_connection(("127.0.0.1", port))
        stream.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        stream.setblocking(False)
        streams[stream.fileno()] = stream
        if place >= idle:
            poll.register(stream, select.EPOLLIN)
    late = list(streams.values())[:idle]
    buffer, taken = bytearray(1 << 20), 0
    read, ends = set(), 0
    while (now := time.monotonic()) < until:
        if late and now > until_idle:
            for stream in late:
                poll.register(stream, select.EPOLLIN)
            late = []
        for descriptor, _ in poll.poll(0.2):
            try:
                count = streams[descriptor].recv_into(buffer)
            except BlockingIOError:
                continue
            except OSError:
                count = 0
            if count == 0:
                ends += 1
                poll.unregister(descriptor)
            elif descriptor not in read:
                read.add(descriptor)
                refused += not buffer.startswith(b"HTTP/1.1 200")
            taken += count
    results.put({"opened": len(streams), "read": len(read), "refused": refused, "closed": ends, "bytes": taken})


def submit(port, rate, until, results):
    """Submits small models at this rate per second."""
    connection, accepted, start = socket.create_connection(("127.0.0.1", port)), 0, time.monotonic()
    answer = connection.makefile("rb")
    waits = []
    for n in range(10**9):
        if (due := start + n / rate) > until:
            break
        time.sleep(max(0, due - time.monotonic()))
        body = json.dumps({"seed": n, "reuse": False, "spec": SMALL}).encode()
        head = f"POST /models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
        sent = time.monotonic()
        connection.sendall(head.encode() + body)
        status, length = answer.readline(), 0
        while (line := answer.readline().lower()) != b"\r\n":
            if line.startswith(b"content-length:"):
                length = int(line.split(b":")[1])
        answer.read(length)
        accepted += b" 202 " in status
        waits.append(time.monotonic() - sent)
        if time.monotonic() > until:
            break
    waits.sort()
    results.put({"accepted": accepted, "p50_ms": 1e3 * waits[len(waits) // 2], "max_ms": 1e3 * waits[-1]})


def measure(options, to_all, to_one):
    """Returns the resident memory before, at the maximum, and after.

    `to_all` and `to_one` are the numbers of streams of all models and of one model.
    """
    with tempfile.TemporaryDirectory() as data:
        service = Service(options.binary, data, "--cpu-workers", "1", "--cpu-threads", "1", "--queue-limit", "100000")
        service.start()
        pid = service.process.pid
        # This model is large enough to run for much of the test. Levels of detail would take more
        # memory than all streams.
        watched = service.json("POST", "/models", {"priority": 100, "outputs": ["glb"]})["id"]
        before = megabytes(pid, "VmRSS")
        results, now = multiprocessing.Queue(), time.monotonic()
        middle, until = now + options.seconds / 2, now + options.seconds
        works = [
            (read_streams, (service.port, ["/events"] * to_all, to_all // 4, middle, until, results)),
            (read_streams, (service.port, [f"/models/{watched}/events"] * to_one, 0, middle, until, results)),
            (submit, (service.port, options.rate, until, results)),
        ]
        works = [multiprocessing.Process(target=work, args=arguments) for work, arguments in works]
        for work in works:
            work.start()
        while time.monotonic() < until:
            time.sleep(5)
            print(f"{time.monotonic() - now:5.0f} s {megabytes(pid, 'VmRSS'):6.0f} MB resident", flush=True)
        for _ in works:
            print(json.dumps(results.get()), flush=True)
        for work in works:
            work.join()
        peak = megabytes(pid, "VmHWM")
        # The memory of running models must not count, so no model runs any more.
        service.json("POST", "/workers/pause")
        service.call("POST", f"/models/{watched}/cancel")
        after = peak
        end = time.monotonic() + options.rest
        while time.monotonic() < end:
            time.sleep(1)
            after = min(after, megabytes(pid, "VmRSS"))
        print(f"before {before:.0f} MB, at most {peak:.0f} MB, "
              f"within {options.rest} s after the streams have closed {after:.0f} MB")
        service.kill()
        return peak, after


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary")
    numbers = {"--all": 1000, "--one": 1024, "--rate": 50, "--seconds": 60, "--limit": 300, "--rest": 75}
    for name, default in numbers.items():
        parser.add_argument(name, type=int, default=default)
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    print("with one stream of each kind, for comparison:")
    _, alone = measure(options, 1, 1)
    print("with all streams:")
    peak, after = measure(options, options.all, options.one)
    if peak > options.limit:
        raise SystemExit(f"over {options.limit} MB")
    if after > alone + 64:
        raise SystemExit("memory was not given back")


if __name__ == "__main__":
    main()
