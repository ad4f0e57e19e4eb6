"""Live services for the tests: the binary OVIDUCT_BINARY with temporary stores."""

import json
import os
import pathlib
import subprocess
import sys

import pytest

from oviduct import Client

ROOT = pathlib.Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests/outside"))
from service import ENDLESS, SMALL, Service  # noqa: E402, F401

# A small fit.
FIT = {
    "spec": SMALL,
    "targets": [{"region": "ampulla", "quantity": "lumen_perimeter_mm", "value": 100}],
    "vary": [{"parameter": "/friction", "from": 0.2, "to": 0.4}, {"parameter": "/collision/gap_um"}],
    "evaluations": 60,
    "seeds": 1,
    "models": 1,
}

# A fit that takes more than half an hour, so it ends only if a test cancels or deletes it.
ENDLESS_FIT = {
    **FIT,
    "spec": {
        "steps": 1000,
        "particles": {"total": {"keys": [[0, 600], [1, 2000]]}},
        "solver": {"search": "all_pairs"},
    },
    "evaluations": 2000,
}


@pytest.fixture(scope="session", autouse=True)
def environment():
    """Removes the developer's settings, and disables a Mesa layer that prints errors."""
    for name in ("OVIDUCT_URL", "OVIDUCT_KEY"):
        os.environ.pop(name, None)
    os.environ.setdefault("NODEVICE_SELECT", "1")


@pytest.fixture(scope="session")
def binary(environment):
    if "OVIDUCT_BINARY" not in os.environ:
        pytest.exit("OVIDUCT_BINARY must name the program `oviduct`; scripts/clients sets it", returncode=2)
    return os.path.abspath(os.environ["OVIDUCT_BINARY"])


def live(binary, folder, *options):
    """Runs a service and stops it at the end; a generator for fixtures."""
    # ENDLESS exceeds the default limit of the predicted time.
    service = Service(binary, str(folder), "--gpu", "off", "--grace", "1s", "--max-model-time", "30d", *options)
    try:
        yield service.start()
    finally:
        if service.process:
            service.kill()
        service.log.close()


@pytest.fixture(scope="session")
def service(binary, tmp_path_factory):
    """A service without API keys."""
    yield from live(binary, tmp_path_factory.mktemp("service"))


@pytest.fixture
def own_service(binary, tmp_path):
    """A service for one test, which may kill it or list all of its models."""
    (tmp_path / "own").mkdir()
    yield from live(binary, tmp_path / "own")


@pytest.fixture(scope="session")
def failing_service(binary, tmp_path_factory):
    """A service in which every model fails, because the time limit is one millisecond."""
    yield from live(binary, tmp_path_factory.mktemp("failing"), "--job-timeout", "1ms", "--max-attempts", "1")


class Keys:
    """A service with API keys."""

    def __init__(self, binary, folder, service):
        self.binary, self.folder, self.url = binary, folder, service.url

    def add(self, *options):
        """Creates an API key; returns its secret."""
        line = [self.binary, "keys", "add", "--create", "--data", str(self.folder), "--json", *options]
        return json.loads(subprocess.run(line, check=True, capture_output=True).stdout)["key"]


@pytest.fixture(scope="session")
def keyed(binary, tmp_path_factory):
    folder = tmp_path_factory.mktemp("keyed")
    # The first API key is created before the service starts, so the service requires keys
    # immediately.
    keys = Keys(binary, folder, type("Nowhere", (), {"url": ""}))
    keys.admin = keys.add("--owner", "admin", "--scopes", "admin")
    keys.lab = keys.add("--owner", "lab", "--scopes", "read,submit")
    keys.reader = keys.add("--owner", "lab", "--scopes", "read")
    keys.hasty = keys.add("--owner", "hasty", "--scopes", "read,submit", "--rate", "2")
    keys.small = keys.add("--owner", "small", "--scopes", "read,submit", "--models", "1")
    for service in live(binary, folder):
        keys.url = service.url
        yield keys


@pytest.fixture
def client(service):
    with Client(service.url) as client:
        yield client


@pytest.fixture(scope="session")
def grown(service):
    """A model that has succeeded, with all its files."""
    with Client(service.url) as client:
        return client.wait(client.submit(seed=7, spec=SMALL, outputs=["glb", "obj"], labels={"kept": "yes"}))
