"""Kills a live server in each stage of a job and starts it again.

Every accepted model must end once, with complete files. No incomplete file may ever be visible.

Usage: crash.py OVIDUCT_BINARY [sqlite|postgres]

The binary must have the feature fault-injection, which `cargo test` enables.
"""

import hashlib
import http.client
import os
import sys
import tempfile
import time
from urllib.parse import urljoin

from postgres import Cluster
from service import SMALL, Service

# Points at which the server kills itself (OVIDUCT_FAULT, src/jobs/fault.rs).
POINTS = ["after-claim", "simulate", "mesh", "certify", "export", "store",
          "before-upload", "after-upload", "before-commit", "after-commit"]
OPTIONS = ["--lease", "2s", "--heartbeat", "500ms", "--max-attempts", "100"]


def submit(service, seed, steps=None):
    """Requests a model without reuse."""
    spec = SMALL if steps is None else {**SMALL, "steps": steps}
    body = {"seed": seed, "spec": spec, "outputs": ["glb", "obj"], "reuse": False}
    return service.json("POST", "/models", body, {"Idempotency-Key": f"crash-{seed}"})["id"]


def submit_to_one_that_ends(service, seed):
    """Requests a model from a server that may kill itself before it responds.

    The caller repeats the request with the same idempotency key.
    """
    try:
        return submit(service, seed)
    except (OSError, http.client.HTTPException):
        return None


def verify(service, ids):
    """Checks that every accepted model succeeded once and that each of its files is complete."""
    for model in ids:
        found = service.ended(model)
        assert found["status"] == "succeeded", found
        assert found["progress"]["fraction"] == 1, found["progress"]
        assert found["progress"]["sections"] == found["summary"]["sections"], found["progress"]
        names = [file["name"] for file in found["files"]]
        assert sorted(names) == ["model.glb", "model.obj", "report.json", "sections.bin"], names
        for file in found["files"]:
            status, _, content = service.call("GET", urljoin(f"/models/{model}", file["href"]))
            assert status == 200 and len(content) == file["bytes"], (file, status, len(content))
            assert hashlib.sha256(content).hexdigest() == file["sha256"], file
    listed, cursor = [], ""
    while cursor is not None:
        page = service.json("GET", f"/models?limit=50{cursor and '&cursor=' + cursor}")
        listed += [model["id"] for model in page["models"]]
        cursor = page["next"]
    assert sorted(listed) == sorted(ids), f"{len(listed)} models are listed, {len(ids)} were accepted"


def stray(data):
    """Returns the incomplete files in the artifact store."""
    found = []
    for folder, _, files in os.walk(os.path.join(data, "artifacts")):
        found += [os.path.join(folder, name) for name in files if "#" in name or name.endswith((".part", ".tmp"))]
    return found


def sweep(service, folder):
    """Checks that the orphan sweep deletes the uploads of killed processes.

    The sweep deletes only uploads that are at least a day old. The files are therefore given an old
    time first.
    """
    for path in stray(folder):
        os.utime(path, (0, 0))
    service.start()
    deadline = time.monotonic() + 900
    while stray(folder) and time.monotonic() < deadline:
        time.sleep(0.1)
    service.stop()


def main(folder, *database):
    service = Service(BINARY, folder, *OPTIONS, *database)
    ids, endings = [], {}
    for seed, point in enumerate(POINTS):
        service.start(OVIDUCT_FAULT=f"{point}:kill")
        model = submit_to_one_that_ends(service, seed)
        assert service.gone(900), f"the server did not pass {point}\n{service.tail()}"
        print(f"crash: killed at {point}")
        service.start()
        again = submit(service, seed)
        assert model in (None, again), "an accepted model was accepted twice"
        ids.append(again)
        ended = service.ended(ids[-1])
        assert ended["status"] == "succeeded", ended
        endings[ids[-1]] = ended
        service.stop()

    # SIGKILL at arbitrary moments, while models are queued and running.
    service.start()
    waiting = [submit(service, 100 + i, steps=200) for i in range(6)]
    ids += waiting
    for i in range(6):
        time.sleep(0.15 + 0.37 * i)
        service.kill()
        service.start()
    verify(service, ids)
    for model, ended in endings.items():
        assert service.json("GET", f"/models/{model}") == ended, "an ended model changed"
    service.stop()
    sweep(service, folder)
    assert stray(folder) == [], stray(folder)
    print(f"crash: {len(ids)} models accepted, {len(ids)} ended, each once, with complete files, on {DATABASE}")


if __name__ == "__main__":
    BINARY, DATABASE = os.path.abspath(sys.argv[1]), (sys.argv[2:] or ["sqlite"])[0]
    assert DATABASE in ("sqlite", "postgres"), __doc__
    with tempfile.TemporaryDirectory() as folder:
        if DATABASE == "postgres":
            with Cluster() as cluster:
                main(folder, "--database", cluster.url)
        else:
            main(folder)
