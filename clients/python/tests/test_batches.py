import io
import json
import zipfile

import pytest
from conftest import SMALL

from oviduct import CheckFailed, Client, InvalidRequest, NotFound
from oviduct._download import check_archive

VARY = {
    "design": "lhs",
    "samples": 4,
    "seed": 4,
    "values": {"/collision/gap_um": {"from": 25, "to": 50}, "/friction": [0.2, 0.3]},
}


@pytest.fixture(scope="module")
def study(service):
    with Client(service.url) as client:
        return client.wait_batch(client.study(vary=VARY, seeds=[1, 2], spec=SMALL, labels={"study": "lhs"}))


def test_a_study_is_waited_for(study, client):
    assert study.has_ended and study.counts.total == study.counts.succeeded == len(study.models) == 8
    assert [model.point for model in study.study.models] == [0, 0, 1, 1, 2, 2, 3, 3]
    assert client.batch(study.id).study == study.study
    assert client.wait_batch(study.id).counts == study.counts
    assert [batch.id for batch in client.batches()][0:1] and study.id in {batch.id for batch in client.batches()}
    assert {model.id for model in client.models(batch=study)} == set(study.models)


def test_a_table_is_a_sequence_of_rows(study, client):
    table = client.table(study)
    assert [row["id"] for row in table] == list(study.models) == table.column("id")
    for row, model in zip(table, study.study.models, strict=True):
        assert row["status"] == "succeeded" and row["seed"] == model.seed and row["summary.vertices"] > 0
        assert {name: row[name] for name in model.values} == model.values
    assert table[-1]["id"] == study.models[-1] and len(table[2:4]) == 2
    with pytest.raises(KeyError):
        table.column("no")


def test_a_table_is_a_data_frame(study, client):
    pandas = pytest.importorskip("pandas")
    frame = client.table(study).to_pandas()
    assert frame.shape == (8, len(client.table(study).columns)) and list(frame["id"]) == list(study.models)
    assert pandas.api.types.is_float_dtype(frame["/collision/gap_um"])
    assert frame["summary.certificate.passed"].all()


@pytest.mark.parametrize("name", ["study.zip", "study.tar"])
def test_an_archive_is_saved_and_checked(study, client, tmp_path, name):
    path = client.archive(study, tmp_path / name, files=["report.json", "sections.bin"])
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith("zip"):
        with zipfile.ZipFile(path) as archive:
            assert len(archive.namelist()) == 1 + 2 * 8
    with pytest.raises(InvalidRequest):
        client.archive(study, tmp_path / name, files=["../secret"])
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_archive_that_differs_from_its_manifest_is_refused():
    def packed(content, manifest):
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as out:
            out.writestr("manifest.json", json.dumps(manifest))
            out.writestr("0/report.json", content)
        return archive

    digest = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
    manifest = {"models": [{"files": [{"path": "0/report.json", "bytes": 4, "sha256": digest}]}]}
    check_archive(packed(b"test", manifest), "zip")
    whole = packed(b"test", manifest).getvalue()
    for broken, form in (
        (packed(b"tost", manifest), "zip"),
        (packed(b"test", {"models": []}), "zip"),
        (packed(b"test", {}), "zip"),
        (io.BytesIO(whole[:-10]), "zip"),
        (io.BytesIO(whole), "tar"),
        (io.BytesIO(whole.replace(b"test", b"tast")), "zip"),
    ):
        with pytest.raises(CheckFailed):
            check_archive(broken, form)


def test_batches_are_validated_cancelled_and_deleted(client):
    valid = client.validate_batch(vary=VARY, count=3, spec=SMALL)
    assert valid.models == 12 and len(valid.points) == 4 and valid.seeds is None
    assert valid.cost.seconds["cpu"] > 0 and valid.points[0].values.keys() == VARY["values"].keys()
    with pytest.raises(InvalidRequest) as caught:
        client.study(vary={**VARY, "values": {"/no": [1]}})
    assert caught.value.errors[0].pointer.startswith("/vary/values")
    client.pause_workers()
    try:
        batch = client.submit_batch(count=2, spec=SMALL, idempotency_key="batch")
        assert client.submit_batch(count=2, spec=SMALL, idempotency_key="batch").id == batch.id
        assert client.cancel_batch(batch).counts.cancelled == 2
        assert client.wait_batch(batch).counts.ended == 2
        client.delete_batch(batch)
        with pytest.raises(NotFound):
            client.batch(batch)
    finally:
        client.resume_workers()
