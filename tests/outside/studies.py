"""Grows a Latin hypercube of small models on a live service.

Usage: studies.py OVIDUCT_BINARY

Python's standard library reads the table and the archive.
"""

import csv
import hashlib
import io
import json
import os
import sys
import tarfile
import tempfile
import zipfile

from service import SMALL, Service

SAMPLES = 6
GAPS = (25, 50)


def check(manifest, files, models):
    """Checks that the manifest lists exactly these models and files."""
    assert [model["id"] for model in manifest["models"]] == models
    listed = {file["path"]: file for model in manifest["models"] for file in model["files"]}
    assert listed.keys() == files.keys() and len(files) == 2 * len(models), (listed.keys(), files.keys())
    for path, file in listed.items():
        assert len(files[path]) == file["bytes"], path
        assert hashlib.sha256(files[path]).hexdigest() == file["sha256"], path
    for model in manifest["models"]:
        assert model["spec"]["collision"]["gap_um"] == model["values"]["/collision/gap_um"]


def main(service):
    vary = {"design": "lhs", "samples": SAMPLES, "seed": 4,
            "values": {"/collision/gap_um": {"from": GAPS[0], "to": GAPS[1]}}}
    batch = service.json("POST", "/batches", {"seeds": [1, 2], "spec": SMALL, "vary": vary})
    models = batch["models"]
    for model in models:
        assert service.ended(model)["status"] == "succeeded"
    path = f"/batches/{batch['id']}"

    _, headers, content = service.call("GET", f"{path}/table", headers={"Accept": "text/csv"})
    assert headers.get_content_type() == "text/csv", headers
    rows = list(csv.DictReader(io.StringIO(content.decode(), newline="")))
    assert [row["id"] for row in rows] == models
    assert all(row["status"] == "succeeded" and int(row["summary.vertices"]) > 0 for row in rows)
    assert all(row["summary.certificate.passed"] == "true" for row in rows)
    width = (GAPS[1] - GAPS[0]) / SAMPLES
    parts = sorted(int((float(row["/collision/gap_um"]) - GAPS[0]) / width) for row in rows)
    assert parts == sorted(2 * list(range(SAMPLES))), parts
    table = service.json("GET", f"{path}/table")
    assert table["columns"] == list(rows[0]) and len(table["rows"]) == len(rows)

    query = "files=report.json,model.glb"
    _, _, content = service.call("GET", f"{path}/archive?{query}")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        files = {name: archive.read(name) for name in archive.namelist()}
    check(json.loads(files.pop("manifest.json")), files, models)
    _, _, content = service.call("GET", f"{path}/archive?{query}&format=tar")
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        files = {member.name: archive.extractfile(member).read() for member in archive.getmembers()}
    check(json.loads(files.pop("manifest.json")), files, models)
    print("studies: all checks passed")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as data:
        live = Service(os.path.abspath(sys.argv[1]), data).start()
        try:
            main(live)
        finally:
            live.stop()
