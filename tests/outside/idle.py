"""Measures the memory of 10,000 idle event streams that follow queued models.

Usage: python3 tests/outside/idle.py target/release/oviduct [--streams 10000] [--models 20]
       [--seconds 30] [--processes 4]

While the streams are idle, the models stay queued because the workers are paused. Fails if the
service then has more resident memory than 100 MB plus 30 kB per stream (400 MB for 10,000 streams).
Then the models grow. Every stream must deliver the `end` event of its model within --wait seconds.
"""

import argparse
import json
import multiprocessing
import os
import queue
import resource
import select
import socket
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(__file__))
from service import SMALL, Service
from streams import megabytes

BASE_MB, STREAM_MB = 100, 0.030


class Stream:
    """One event stream: unprocessed bytes, and whether the `end` event arrived."""

    def __init__(self, port, model):
        self.model, self.rest, self.told = model, b"", False
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.sendall(f"GET /models/{model}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        self.socket.setblocking(False)
        self.opened = False

    def take(self, piece):
        """Processes the events that this chunk completes."""
        *events, self.rest = (self.rest + piece).split(b"\n\n")
        for event in events:
            self.opened |= b"event: status" in event
            if b"event: end" in event:
                assert self.model.encode() in event, f"the end of another model: {event[:200]}"
                self.told = True


def follow(port, models, until, results):
    """Opens a stream for each of these models and reads the streams until all are closed."""
    try:
        poll, streams = select.epoll(), {}
        for model in models:
            stream = Stream(port, model)
            streams[stream.socket.fileno()] = stream
            poll.register(stream.socket, select.EPOLLIN)
        all_opened, told, cut = False, 0, 0
        while streams and time.monotonic() < until:
            for descriptor, _ in poll.poll(0.5):
                stream = streams[descriptor]
                try:
                    piece = stream.socket.recv(1 << 18)
                except BlockingIOError:
                    continue
                except OSError:
                    piece = b""
                if piece:
                    stream.take(piece)
                # The connection stays open for further requests after the end of the stream.
                if stream.told or not piece:
                    told += stream.told
                    cut += not stream.told
                    poll.unregister(descriptor)
                    streams.pop(descriptor).socket.close()
            if not all_opened and all(stream.opened for stream in streams.values()):
                all_opened = True
                results.put(("opened", len(streams)))
        results.put(("ended", {"told": told, "cut": cut, "untold": len(streams)}))
    except BaseException as error:
        results.put(("failed", repr(error)))
        raise


def gather(results, kind, count, seconds):
    """Waits for this many results of one kind; returns them."""
    deadline, found = time.monotonic() + seconds, []
    while len(found) < count:
        try:
            got, value = results.get(timeout=max(0.1, deadline - time.monotonic()))
        except queue.Empty:
            raise SystemExit(f"only {len(found)} of {count} processes reported `{kind}` within {seconds} s") from None
        if got != kind:
            raise SystemExit(f"a process reported `{got}` instead of `{kind}`: {value}")
        found.append(value)
    return found


def submit(service, count, spec):
    """Submits this many models; returns their ids."""
    body = {"count": count, "spec": spec, "reuse": False}
    return service.json("POST", "/batches", body)["models"]


def measure(service, options):
    """Opens the streams and lets the models end; returns the violated conditions."""
    pid = service.process.pid
    # While the workers are paused no model grows, so only the streams add memory.
    assert service.call("POST", "/workers/pause")[0] == 200
    models = submit(service, options.models, SMALL)
    before = megabytes(pid, "VmRSS")
    results, processes = multiprocessing.Queue(), options.processes
    followed = [models[n % len(models)] for n in range(options.streams)]
    until = time.monotonic() + options.seconds + options.wait + 300
    works = [
        multiprocessing.Process(target=follow, args=(service.port, followed[n::processes], until, results), daemon=True)
        for n in range(processes)
    ]
    for work in works:
        work.start()
    begin = time.monotonic()
    opened = sum(gather(results, "opened", processes, 300))
    print(f"{opened} streams opened in {time.monotonic() - begin:.1f} s", flush=True)
    idle, end = 0, time.monotonic() + options.seconds
    while time.monotonic() < end:
        time.sleep(1)
        idle = max(idle, megabytes(pid, "VmRSS"))
    limit = BASE_MB + STREAM_MB * options.streams
    each = 1000 * (idle - before) / options.streams
    print(f"{before:.0f} MB resident before, at most {idle:.0f} MB idle ({each:.1f} kB per stream, limit {limit:.0f} MB)")
    probe = time.monotonic()
    assert service.call("GET", "/readyz")[0] == 200
    print(f"/readyz answered within {1e3 * (time.monotonic() - probe):.1f} ms", flush=True)
    waiting = sum(service.json("GET", f"/models/{model}")["status"] == "queued" for model in models)
    assert service.call("POST", "/workers/resume")[0] == 200
    begin = time.monotonic()
    ends = gather(results, "ended", processes, options.wait)
    told, cut, untold = (sum(end[name] for end in ends) for name in ["told", "cut", "untold"])
    seconds = time.monotonic() - begin
    print(f"{told} streams were told of their end in {seconds:.1f} s, {cut} were cut, {untold} were not told")
    statuses = {service.json("GET", f"/models/{model}")["status"] for model in models}
    print(json.dumps({"statuses": sorted(statuses), "peak_mb": round(megabytes(pid, "VmHWM"))}))
    for work in works:
        work.join()
    return [
        fault
        for fault, holds in [
            (f"over {limit:.0f} MB", idle <= limit),
            (f"only {opened} streams were opened", opened == options.streams),
            (f"only {waiting} models still waited: the streams were not idle", waiting == len(models)),
            (f"only {told} streams were told", told == options.streams),
            (f"models ended as {statuses}", statuses == {"succeeded"}),
        ]
        if not holds
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary")
    numbers = {"--streams": 10_000, "--models": 20, "--seconds": 30, "--processes": 4, "--wait": 600}
    for name, default in numbers.items():
        parser.add_argument(name, type=int, default=default)
    options = parser.parse_args()
    descriptors = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))
    if descriptors != resource.RLIM_INFINITY and descriptors < options.streams + 500:
        raise SystemExit(f"{options.streams} streams need more than the {descriptors} descriptors allowed: `ulimit -n`")
    with tempfile.TemporaryDirectory() as data:
        # At most half of the connections can be event streams.
        limits = ["--connections", str(2 * options.streams + 200), "--event-streams", str(options.streams)]
        workers = ["--cpu-workers", "1", "--cpu-threads", "1", "--gpu", "off"]
        service = Service(options.binary, data, *limits, *workers)
        service.start()
        try:
            faults = measure(service, options)
            service.stop()
        finally:
            if service.process:
                service.kill()
    if faults:
        raise SystemExit("; ".join(faults))


if __name__ == "__main__":
    main()
