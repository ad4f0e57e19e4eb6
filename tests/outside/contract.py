"""Tests the live service against openapi.yaml with schemathesis.

Usage: contract.py OVIDUCT_BINARY [--max-examples N]

Runs without API keys, and with fewer cases using an API key. With --max-examples, the run without
keys generates N requests per operation instead of schemathesis' default. It omits operations such as
POST /models/validate, whose requests are those of POST /models; the run with a key includes them.
"""

import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

from service import SMALL, Service

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.join(HERE, "..", "..")


def main(folder, keyed):
    # First create one model in each final state. Then run a service that only queues jobs, so that
    # valid requests cost nothing.
    service = Service(BINARY, folder, "--queue-limit", "100000")
    options = [*OPTIONS, *(["--exclude-path-regex", "/validate$"] if OPTIONS else [])]
    if keyed:
        service.add_key("judge", "admin")
        # Every request gets the header, so none lacks it. tests/api/access.rs sends requests
        # without a key.
        options = ["--header", f"Authorization: Bearer {service.key}", "--exclude-checks", "missing_required_header",
                   "--max-examples", "5", "--phases", "examples,fuzzing"]
    service.start()
    succeeded = service.json("POST", "/models", {"seed": 1, "spec": SMALL, "outputs": ["glb", "obj"]})["id"]
    assert service.ended(succeeded)["status"] == "succeeded", service.ended(succeeded)
    service.stop()
    service.start("--cpu-workers", "0")
    cancelled = service.json("POST", "/models", {"seed": 2, "spec": SMALL})["id"]
    service.json("POST", f"/models/{cancelled}/cancel")
    # A model that stays queued, so that every event stream has a first event immediately.
    service.json("POST", "/models", {"seed": 3, "spec": SMALL})

    live = service.call("GET", "/openapi.yaml")[2]
    with open(os.path.join(ROOT, "openapi.yaml"), "rb") as committed:
        assert live == committed.read(), "openapi.yaml differs from that of the service; run `just openapi`"

    judge = os.path.join(os.path.dirname(sys.executable), "schemathesis")
    done = subprocess.run(
        [
            judge, "--config-file", os.path.join(HERE, "schemathesis.toml"), "run", os.path.join(ROOT, "openapi.yaml"),
            "--url", service.url, "--seed", "7", *options,
        ],
        env={
            **os.environ,
            "SCHEMATHESIS_HOOKS": "schemathesis_hooks",
            "PYTHONPATH": HERE,
            "OVIDUCT_SUCCEEDED": succeeded,
            "OVIDUCT_CANCELLED": cancelled,
            "OVIDUCT_URL": service.url,
            "OVIDUCT_KEY": service.key or "",
            "OVIDUCT_SMALL": json.dumps(SMALL),
        },
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )
    print(done.stdout, flush=True)
    if done.returncode != 0:
        sys.exit(f"schemathesis ended with {done.returncode}; the end of the server's log:\n{service.tail()}")
    # The service must still be ready afterwards.
    assert service.call("GET", "/readyz")[0] == 200
    service.stop()
    print(f"contract: the service {'with' if keyed else 'without'} keys conforms to openapi.yaml")


if __name__ == "__main__":
    BINARY, *OPTIONS = sys.argv[1:]
    BINARY = os.path.abspath(BINARY)
    if OPTIONS and (len(OPTIONS) != 2 or OPTIONS[0] != "--max-examples"):
        sys.exit(__doc__)
    # Both runs are concurrent, because schemathesis uses only one core.
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second, ThreadPoolExecutor() as pool:
        list(pool.map(main, (first, second), (False, True)))
