"""Simulates a deployment on several machines: two API processes and changing workers.

The processes share one PostgreSQL database and one bucket of an S3 server (moto). Every model must
end once with the same bytes as `oviduct generate`, although processes are killed in the meantime,
and the database fails over to a synchronous replica while clients submit models. Both API processes
must show the same models. Events must arrive through an API process that neither accepted the model
nor grows it.

Usage: cluster.py OVIDUCT_BINARY [--asynchronous]

With --asynchronous, the replica is not synchronous. Then the test must fail.
"""

import hashlib
import http.client
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from urllib.parse import urljoin

import boto3
from postgres import Address, Cluster, Replica
from service import ENDLESS, SMALL, Service, free_port

BUCKET = "organs"
OPTIONS = ["--lease", "2s", "--heartbeat", "500ms", "--max-attempts", "100"]
MODELS = 14


class Bucket:
    """An S3 server with one empty bucket, running inside a `with` block. `log` receives a line per request."""

    def __init__(self, log=subprocess.DEVNULL):
        self.log = log

    def __enter__(self):
        # Another program may take the port before the server does.
        for _ in range(5):
            if self.starts(free_port()):
                return self
        raise SystemExit("the S3 server did not start")

    def starts(self, port):
        """Starts the server on a port; returns whether it runs there."""
        program = os.path.join(os.path.dirname(sys.executable), "moto_server")
        self.process = subprocess.Popen([program, "-H", "127.0.0.1", "-p", str(port)], stderr=self.log)
        self.variables = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
        }
        os.environ.update(self.variables)
        self.s3 = boto3.client("s3", region_name="us-east-1", endpoint_url=self.variables["AWS_ENDPOINT_URL"])
        deadline = time.monotonic() + 900
        while self.process.poll() is None:
            try:
                self.s3.create_bucket(Bucket=BUCKET)
                return True
            except Exception:
                if time.monotonic() > deadline:
                    self.__exit__()
                    raise
                time.sleep(0.2)
        return False

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()

    def keys(self):
        pages = self.s3.get_paginator("list_objects_v2").paginate(Bucket=BUCKET)
        return {item["Key"]: item["Size"] for page in pages for item in page.get("Contents", [])}

    def unfinished(self):
        return self.s3.list_multipart_uploads(Bucket=BUCKET).get("Uploads", [])


class Worker:
    """`oviduct worker` with its own directory."""

    def __init__(self, binary, folder, stores):
        data = tempfile.mkdtemp(dir=folder)
        with open(os.path.join(data, "worker.log"), "ab") as log:
            line = [binary, "worker", "--data", data, "--gpu", "off", *OPTIONS, *stores]
            self.process = subprocess.Popen(line, stdout=log, stderr=log)

    def kill(self):
        self.process.kill()
        self.process.wait()

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(900)
        assert code == 0, f"a worker ended with {code}"


class Listener(threading.Thread):
    """Collects the event types of a model until its stream ends."""

    def __init__(self, service, model):
        super().__init__(daemon=True)
        self.url = f"{service.url}/models/{model}/events"
        self.events = []
        self.progressed = threading.Event()
        self.start()

    def run(self):
        with urllib.request.urlopen(self.url, timeout=3600) as stream:
            for line in stream:
                if line.startswith(b"event: "):
                    self.events.append(line[7:].decode().strip())
                    if self.events[-1] == "progress":
                        self.progressed.set()


def spec_of(seed):
    """Returns the spec of a model; the last model is large, so its files need multipart uploads."""
    large = {"steps": 2000, "particles": {"total": {"keys": [[0, 710], [1, 6000]]}}}
    return large if seed == MODELS - 1 else SMALL


def body_of(seed):
    return {"seed": seed, "spec": spec_of(seed), "outputs": ["glb", "lod"], "reuse": False}


def submit(service, seed):
    return service.json("POST", "/models", body_of(seed))["id"]


class Submitter(threading.Thread):
    """Submits models one after the other. Repeats each request until it is acknowledged."""

    def __init__(self, apis, first):
        super().__init__(daemon=True)
        self.apis, self.first = apis, first
        self.models, self.over = {}, threading.Event()
        # Longest time without an acknowledged model, seconds.
        self.gap = 0
        self.start()

    def run(self):
        seed, last = self.first, time.monotonic()
        for turn in itertools.count():
            if self.over.is_set():
                return
            try:
                status, _, content = self.apis[turn % 2].call(
                    "POST", "/models", body_of(seed), {"Idempotency-Key": f"cluster-{seed}"})
            except (OSError, http.client.HTTPException):
                status = 503
            if status in (200, 202):
                self.models[json.loads(content)["id"]] = seed
                self.gap, last, seed = max(self.gap, time.monotonic() - last), time.monotonic(), seed + 1
            else:
                assert status == 503, content
            time.sleep(0.3)

    def until_acknowledged(self, count):
        """Waits for this number of further models."""
        count, deadline = len(self.models) + count, time.monotonic() + 300
        while len(self.models) < count:
            assert time.monotonic() < deadline and self.is_alive(), "no model is accepted"
            time.sleep(0.02)

    def stop(self):
        """Returns the acknowledged models."""
        self.over.set()
        self.join(900)
        return self.models


def fail_over(primary, replica, address, submitter):
    """Loses the primary while models are submitted, and promotes the replica."""
    submitter.until_acknowledged(2)
    # What is committed from here on does not reach the replica. A primary that acknowledged it
    # nevertheless, as with an asynchronous replica, would lose it.
    replica.link.point_at(free_port())
    time.sleep(3)
    primary.crash()
    # Longer than the service retries changes, so that clients see the outage.
    time.sleep(6)
    replica.promote()
    address.point_at(replica.port)
    submitter.until_acknowledged(3)


def until_some_have_ended(service, count):
    deadline = time.monotonic() + 3600
    while True:
        ended = service.json("GET", "/models?status=succeeded&limit=50")["models"]
        if len(ended) >= count:
            return
        assert time.monotonic() < deadline, f"{len(ended)} of {count} models ended"
        time.sleep(0.05)


def generated(binary, folder, seed):
    """Returns the hashes of the files of `oviduct generate`, without the manifest.

    The service creates the manifest only on request.
    """
    spec = os.path.join(folder, "spec.json")
    with open(spec, "w") as file:
        json.dump(spec_of(seed), file)
    out = os.path.join(folder, f"seed-{seed}")
    line = [binary, "generate", "--seed", str(seed), "--spec", spec, "--backend", "cpu", "--out", out, "--json"]
    made = json.loads(subprocess.run(line, check=True, capture_output=True).stdout)
    return {file["name"]: file["sha256"] for file in made["files"] if file["name"] != "manifest.json"}


def main(binary, folder, primary, replica, bucket):
    address = Address(primary.port)
    stores = ["--database", address.url, "--artifacts", f"s3://{BUCKET}/models-of-a-lab"]
    apis = []
    for name in "ab":
        data = os.path.join(folder, name)
        os.mkdir(data)
        apis.append(Service(binary, data, *stores, "--cpu-workers", "0", "--gpu", "off",
                            "--max-model-time", "30d").start())
    a, b = apis
    workers = [Worker(binary, folder, stores) for _ in range(2)]
    models = {submit(apis[seed % 2], seed): seed for seed in range(MODELS)}

    until_some_have_ended(a, 2)
    workers.pop(0).kill()
    workers.append(Worker(binary, folder, stores))
    b.kill()
    until_some_have_ended(a, 5)
    workers.pop(0).stop()
    workers.append(Worker(binary, folder, stores))
    b.start()

    submitter = Submitter(apis, MODELS)
    fail_over(primary, replica, address, submitter)
    models.update(submitter.stop())

    # The events come through an API process that neither accepted the model nor grows it.
    endless = b.json("POST", "/models", {"spec": ENDLESS})["id"]
    listener = Listener(a, endless)
    assert listener.progressed.wait(900), listener.events
    b.json("POST", f"/models/{endless}/cancel")
    listener.join(900)
    assert listener.events[-1:] == ["end"], listener.events
    assert b.call("DELETE", f"/models/{endless}")[0] == 204

    sizes = {}
    for model, seed in models.items():
        found = b.ended(model)
        assert found["status"] == "succeeded", found
        assert a.json("GET", f"/models/{model}") == found, "the APIs differ"
        whole = {file["name"]: file["sha256"] for file in found["files"]}
        for service in apis:
            for file in found["files"]:
                status, _, content = service.call("GET", urljoin(f"/models/{model}", file["href"]))
                assert status == 200 and hashlib.sha256(content).hexdigest() == file["sha256"], (file, status)
        if seed in (0, 1, MODELS - 1, MODELS + 1):
            assert whole == generated(binary, folder, seed), f"the bytes differ from those of the generator, seed {seed}"
        sizes[model] = {file["name"]: file["bytes"] for file in found["files"]}
    listed = a.json("GET", "/models?limit=100")["models"]
    assert sorted(model["id"] for model in listed) == sorted(models), "these are not the accepted models"

    there = bucket.keys()
    tried = {model["id"]: model["attempts"] for model in listed}
    for model, files in sizes.items():
        attempts = {}
        for key, size in there.items():
            if f"/{model}/" in key:
                attempt, name = key.rsplit("/", 2)[1:]
                attempts.setdefault(int(attempt), {})[name] = size
        # An attempt that was killed, or whose end was lost in the fail-over, may have left its files.
        assert max(attempts) == tried[model], f"attempt {tried[model]} of {model} ended: {attempts}"
        # Small files are one object, the pack of the attempt.
        objects = attempts[tried[model]]
        assert (sum(objects.values()) == sum(files.values())
                and all(files.get(name) == size for name, size in objects.items() if name != "pack")
                ), f"the files of {model} are not in the bucket: {files}, {attempts}"
    assert bucket.unfinished() == [], "an upload was left open"
    for model in models:
        status, _, _ = a.call("DELETE", f"/models/{model}")
        assert status == 204, status
    for worker in workers:
        worker.stop()
    for api in apis:
        api.stop()
    attempts = sum(found["attempts"] for found in listed)
    print(f"cluster: {len(models)} models over 2 APIs, 2 workers at a time (one killed, one stopped), a fail-over "
          f"of the database ({submitter.gap:.1f} s without an accepted model), {attempts} attempts: each ended once, with the "
          "bytes of the generator")


if __name__ == "__main__":
    with (tempfile.TemporaryDirectory() as place, Cluster() as first, Bucket() as artifacts,
          Replica(first, synchronous=sys.argv[2:] != ["--asynchronous"]) as second):
        main(os.path.abspath(sys.argv[1]), place, first, second, artifacts)
