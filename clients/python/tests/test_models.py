import datetime
import hashlib
import json

import pytest
from conftest import ENDLESS, SMALL

import oviduct
from oviduct import Client, InvalidRequest, ModelCancelled, ModelDeleted, NotFound, WaitTimeout


def test_a_model_is_submitted_waited_for_and_saved(client, tmp_path):
    states = []
    before = datetime.datetime.now(datetime.timezone.utc)
    model = client.submit(seed=21, spec=SMALL, outputs=["glb", "obj"], labels={"study": "A 3"}, priority=5)
    assert (model.preset, model.seed, model.priority, model.labels) == ("pig", 21, 5, {"study": "A 3"})
    model = client.wait(model, progress=states.append)
    assert model.status == "succeeded" and model.has_ended and model.spec["steps"] == 120
    assert before - datetime.timedelta(seconds=2) < model.created_at <= model.started_at <= model.finished_at
    assert states[-1] == model and model in set(states)
    assert [state.version for state in states] == sorted(state.version for state in states)

    paths = client.download_all(model, tmp_path / "new")
    assert [path.name for path in paths] == [file.name for file in model.files]
    assert {path.name for path in paths} == {"model.glb", "model.obj", "sections.bin", "report.json"}
    for path, file in zip(paths, model.files, strict=True):
        assert hashlib.sha256(path.read_bytes()).hexdigest() == file.sha256
    assert client.download(model.id, "report.json", tmp_path) == tmp_path / "report.json"
    assert client.content(model, "model.glb")[:4] == b"glTF"
    assert client.report(model)["certificate"]["passed"] is True
    files = {file["name"]: file for file in client.manifest(model)["files"]}
    assert files.keys() == {path.name for path in paths}
    assert (files["model.glb"]["unit"], files["model.glb"]["body"]) == ("m", "tissue")
    assert (model.bodies, model.units) == (("tissue",), None)
    course = client.course(model)
    assert (course["shape"], len(course["points"]), course["points"][0]["u"]) == ("straight", 2, [1, 0, 0])
    way = client.way(model)
    assert way["clearance_um"] > 0 and len(way["points"]) > 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "report.json"]


def test_a_finished_model_is_reused_unless_told_otherwise(client, grown):
    again = client.submit(seed=7, spec=SMALL, outputs=["glb"])
    assert again.has_ended and again.reused_from == grown.id
    assert client.submit(seed=7, spec=SMALL, outputs=["glb"], reuse=False).reused_from is None


def test_the_same_idempotency_key_gives_the_same_model(client):
    first = client.submit(seed=22, spec=SMALL, idempotency_key="once")
    assert client.submit(seed=22, spec=SMALL, idempotency_key="once").id == first.id
    with pytest.raises(oviduct.Problem) as caught:
        client.submit(seed=23, spec=SMALL, idempotency_key="once")
    assert caught.value.name == "idempotency-key-reused" and not isinstance(caught.value, InvalidRequest)


def test_an_invalid_spec_is_an_error_with_all_faults(client):
    with pytest.raises(InvalidRequest) as caught:
        client.submit(spec={"length_mm": 40, "collision": {"gap_um": -3}, "colour": "red"})
    problem = caught.value
    assert problem.status == 422 and problem.type == "urn:oviduct:problem:invalid-request" and problem.request_id
    assert {fault.pointer for fault in problem.errors} == {"/spec/collision/gap_um", "/spec/colour"}
    assert "/spec/collision/gap_um: is -3" in str(problem)
    with pytest.raises(InvalidRequest):
        client.validate(spec={"friction": -1})
    with pytest.raises(TypeError, match="output"):
        client.submit(output="glb")


def test_a_valid_spec_is_validated(client):
    valid = client.validate(spec=SMALL, seed=3)
    assert valid.seed == 3 and valid.digest and valid.spec["steps"] == 120
    assert valid.cost.seconds["cpu"].seconds > 0 and valid.cost.bytes["glb"] > 0 and valid.cost.vertices > 0


def test_a_cost_limit_has_its_own_class(client):
    with pytest.raises(oviduct.CostLimit) as caught:
        client.validate(spec={"steps": 50000, "solver": {"record_every": 1}})
    assert caught.value.members["prediction"]["memory_bytes"] > 0


def test_what_does_not_exist_is_not_found(client, grown):
    for call in (client.model, client.wait, client.cancel, client.delete, client.report):
        with pytest.raises(NotFound) as caught:
            call("01900000-0000-7000-8000-000000000000")
        assert caught.value.name == "model-not-found"
    with pytest.raises(NotFound) as caught:
        client.download(grown, "model.stl")
    assert caught.value.name == "file-not-found"
    with pytest.raises(NotFound):
        client.preset("cow/../pig")
    for name in ("", ".."):
        with pytest.raises(ValueError):
            client.delete(name)


def test_models_are_listed_page_by_page(own_service, monkeypatch):
    monkeypatch.setattr("oviduct._calls.PAGE", 2)
    with Client(own_service.url) as client:
        client.pause_workers()
        start = datetime.datetime.now()
        ids = [client.submit(seed=seed, spec=SMALL, labels={"even": str(seed % 2 == 0)}).id for seed in range(5)]
        assert [model.id for model in client.models()] == ids[::-1]
        assert next(client.models()).spec is None and next(client.models(spec=True)).spec["steps"] == 120
        assert [model.seed for model in client.models(labels={"even": "True"}, status="queued")] == [4, 2, 0]
        assert list(client.models(created_before=start)) == []
        assert len(list(client.models(created_after=start, preset="pig"))) == 5
        assert client.model(ids[4]).queue.position == 4

        with pytest.raises(InvalidRequest):
            client.cancel_models()
        counted = client.cancel_models(labels={"even": "False"}, dry_run=True)
        assert (counted.count, counted.dry_run) == (2, True)
        assert client.cancel_models(labels={"even": "False"}).count == 2
        assert client.cancel(ids[0]).status == "cancelled"
        with pytest.raises(ModelCancelled):
            client.wait(ids[0])
        client.delete(ids[0])
        assert client.delete_models(status="cancelled").count == 2
        assert client.delete_models(all=True, dry_run=True).count == 2
        with pytest.raises(TypeError, match="state"):
            client.delete_models(state="cancelled")
        with pytest.raises(WaitTimeout):
            client.wait(ids[2], timeout=0.3)
        for count in (1000, 100):
            client.submit_batch(count=count, spec=SMALL, labels={"many": "yes"})
        assert client.delete_models(labels={"many": "yes"}).count == 1100
        operation = next(client.operations())
        assert (operation.action, operation.status) == ("delete", "succeeded")
        assert operation.conditions == {"label": ["many:yes"]} and operation.progress.total == 1100
        assert client.cancel_operation(operation.id) == client.operation(operation.id) == operation
        assert client.resume_workers().pause is None
        assert client.wait(ids[2]).seed == 2


def test_a_model_that_is_deleted_while_it_is_waited_for(client):
    model = client.submit(seed=24, spec=ENDLESS)
    with pytest.raises(ModelDeleted):
        client.wait(model, progress=lambda state: client.delete(state) if state.status == "running" else None)


def test_a_failed_model_raises_and_can_be_tried_again(failing_service):
    with Client(failing_service.url) as client:
        with pytest.raises(oviduct.ModelFailed) as caught:
            client.wait(client.submit(seed=1, spec=SMALL))
        failed = caught.value.model
        assert failed.problem.type.startswith("urn:oviduct:problem:") and failed.problem.detail in str(caught.value)
        again = client.retry(failed)
        assert again.id != failed.id and again.retry_of == failed.id
        with pytest.raises(oviduct.ModelFailed):
            client.wait(again)
        with pytest.raises(NotFound):
            client.download(failed, "model.glb")


def test_only_failed_models_are_tried_again(client, grown):
    with pytest.raises(oviduct.Conflict) as caught:
        client.retry(grown)
    assert caught.value.name == "not-failed"


def test_presets_schema_health_and_workers(client):
    first, *others = client.presets()
    assert first.name == "pig" and first.default and not any(preset.default for preset in others)
    assert client.preset("pig")["name"] == "pig"
    assert client.schema()["properties"]["steps"]["title"]
    assert client.health().status == "ok"
    (worker,) = client.workers()
    assert worker.state == "active" and worker.backend == "cpu"
    assert client.pause_worker(worker.id).state == "paused"
    assert client.drain_worker(worker.id).state in ("draining", "drained")
    assert client.resume_worker(worker.id).state == "active"
    with pytest.raises(NotFound):
        client.pause_worker("no/such worker")


def test_progress_is_shown_on_a_line(client, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tqdm.auto", None)
    client.wait(client.submit(seed=25, spec=SMALL), progress=True)
    assert capsys.readouterr().err.splitlines()[-1] == "100 % succeeded"


def test_progress_is_shown_by_tqdm(client, capsys):
    pytest.importorskip("tqdm")
    client.wait(client.submit(seed=26, spec=SMALL), progress=True)
    assert "succeeded 100%" in capsys.readouterr().err


def test_unknown_members_are_ignored_and_missing_ones_have_defaults():
    answer = {"id": "a", "status": "queued", "version": 1, "preset": "pig", "seed": 3, "new": {"a": 1}, "files": None}
    model = oviduct.types.read_model(answer, "http://host/prefix/models/a")
    assert model.raw == answer and model.files == () and model.progress is None
    file = {"name": "model.glb", "bytes": 1, "sha256": "", "href": "a/files/model.glb", "new": 1}
    model = oviduct.types.read_model({**answer, "files": [file]}, "http://host/prefix/models/a")
    assert model.files[0].href == "http://host/prefix/models/a/files/model.glb"
    for broken in ({}, [], {**answer, "files": [{}]}, {**answer, "created_at": "yesterday"}):
        with pytest.raises(oviduct.UnexpectedAnswer):
            oviduct.types.read_model(broken, "http://host/")
    assert json.dumps(model.raw)
