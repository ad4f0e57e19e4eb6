import gc
import hashlib
import json
import time

import httpx
import pytest
from conftest import ENDLESS, SMALL
from relay import Relay

from oviduct import (
    CheckFailed,
    Client,
    ConnectionFailed,
    Fault,
    InvalidRequest,
    Problem,
    RateLimited,
    ServerError,
    UnexpectedAnswer,
)


@pytest.fixture
def relay(service):
    with Relay(service.url) as relay:
        yield relay


@pytest.fixture
def client(relay):
    with Client(relay.url + "/", timeout=10) as client:
        yield client


def unavailable(status, retry_after=None, name="store-unavailable"):
    """Returns a problem to send instead of the service's response."""
    headers = {"content-type": "application/problem+json"}
    if retry_after is not None:
        headers["retry-after"] = str(retry_after)
    content = f'{{"type": "urn:oviduct:problem:{name}", "title": "T", "status": {status}, "detail": "D"}}'
    return status, headers, content.encode()


def sizes(file):
    return file.bytes // 4, file.bytes // 4, 0, 1


def test_the_service_may_be_under_a_path(client, relay, tmp_path):
    model = client.wait(client.submit(seed=41, spec=SMALL))
    assert model.files[0].href == f"{relay.url}/models/{model.id}/files/model.glb"
    assert client.download(model, "model.glb", tmp_path).stat().st_size == model.files[0].bytes
    assert client.ticket("/models").url.startswith(f"{relay.url}/models?ticket=")
    assert all(path.startswith("/prefix/") for _, path, _ in relay.requests)
    assert all(headers["user-agent"].startswith("oviduct-python/") for _, _, headers in relay.requests)


def test_a_broken_download_goes_on_where_it_broke(client, relay, grown, tmp_path):
    relay.only, relay.cuts = "model.glb", list(sizes(grown.files[0]))
    path = client.download(grown, "model.glb", tmp_path)
    assert hashlib.sha256(path.read_bytes()).hexdigest() == grown.files[0].sha256
    quarter = grown.files[0].bytes // 4
    ranges = [headers.get("range") for _, path, headers in relay.requests if path.endswith("model.glb")]
    assert ranges == [None, *(f"bytes={at}-" for at in (quarter, 2 * quarter, 2 * quarter, 2 * quarter + 1))]
    assert [path.name for path in tmp_path.iterdir()] == ["model.glb"]


def test_a_redirect_to_the_artifact_store_gets_no_key(relay, service, grown, tmp_path):
    with Relay(service.url) as store, Client(relay.url, key="oviduct_secret") as client:
        place = f"{store.url}/models/{grown.id}/files/model.glb"
        store.cuts = [5000]
        relay.only, relay.answers = "/files/", 2 * [(307, {"location": place}, b"")]
        path = client.download(grown, "model.glb", tmp_path)
        assert path.stat().st_size == grown.files[0].bytes
    assert [headers.get("range") for _, _, headers in store.requests] == [None, "bytes=5000-"]
    assert all("authorization" in headers for _, _, headers in relay.requests)
    assert not any("authorization" in headers for _, _, headers in store.requests)


def test_a_download_that_never_ends_is_given_up(relay, grown, tmp_path):
    relay.only, relay.cuts = "model.glb", [1000] + 9 * [0]
    (tmp_path / "model.glb").write_text("old")
    with Client(relay.url, retries=1) as client, pytest.raises(ConnectionFailed):
        client.download(grown, "model.glb", tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


def test_a_file_that_is_not_the_right_one_is_refused(client, relay, grown, tmp_path):
    relay.only, relay.damage = "/files/", True
    with pytest.raises(CheckFailed, match="SHA-256"):
        client.download(grown, "model.glb", tmp_path)
    with pytest.raises(CheckFailed):
        client.sections(grown)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", ".hidden", "../x", "../../x", "a/../../../x", "a/b", "/no/such/x", "//host/x"),
        *("..\\x", "a\\b", "\\x", "\\\\host\\x", "C:x", "C:\\x", "C:/x", "x:stream", "x\0", "x\n"),
        "{outside}/x",
    ],
)
def test_a_name_that_leads_out_of_the_folder_is_refused(tmp_path, monkeypatch, name):
    name = name.replace("{outside}", str(tmp_path))
    content = b"content"
    files = [
        {"name": each, "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for each in ("model.glb", name)
    ]
    record = {"id": "a", "status": "succeeded", "version": 1, "preset": "pig", "seed": 1, "files": files}

    def answer(request):
        return httpx.Response(200, **({"content": content} if "/files/" in str(request.url) else {"json": record}))

    inner = tmp_path / "outer" / "inner"
    with httpx.Client(transport=httpx.MockTransport(answer)) as http, Client(http=http) as client:
        with pytest.raises(CheckFailed, match="not a name"):
            client.download_all("a", inner)
        assert list(tmp_path.iterdir()) == []
        inner.mkdir(parents=True)
        monkeypatch.chdir(inner)
        for path in (inner, None):
            with pytest.raises(CheckFailed, match="not a name"):
                client.download("a", name, path)
        assert list(tmp_path.rglob("*")) == [tmp_path / "outer", inner]
        # The same responses with a safe name.
        files[1]["name"] = "model..v2.obj"
        paths = client.download_all("a", inner)
        assert paths == [inner / "model.glb", inner / "model..v2.obj"]
        assert all(path.read_bytes() == content for path in paths)


def test_a_request_whose_answer_is_lost_is_not_done_twice(client, relay):
    relay.cuts = [0, 0]
    model = client.submit(spec=SMALL, labels={"lost": "answer"})
    assert [found.id for found in client.models(labels={"lost": "answer"})] == [model.id]
    keys = {headers.get("idempotency-key") for method, _, headers in relay.requests if method == "POST"}
    assert len(keys) == 1 and len(relay.requests) == 4
    relay.cuts = [0]
    client.delete(model)
    with pytest.raises(Problem):
        client.delete(model)


def test_retry_after_is_waited_for(client, relay, monkeypatch):
    pauses = []
    monkeypatch.setattr("time.sleep", pauses.append)
    relay.answers = [unavailable(429, 1), unavailable(503, 2), unavailable(502)]
    assert client.health().status == "ok"
    assert 1 <= pauses[0] < 1.5 and 2 <= pauses[1] < 2.5 and 0.5 < pauses[2] < 1.5
    relay.answers = [unavailable(429, 3600, "rate-limited")]
    with pytest.raises(RateLimited) as caught:
        client.health()
    assert caught.value.retry_after == 3600 and len(pauses) == 3
    relay.answers = 5 * [unavailable(503, 0)]
    with pytest.raises(ServerError) as caught:
        client.health()
    assert caught.value.name == "store-unavailable" and relay.answers == []
    relay.answers = [unavailable(500)]
    with pytest.raises(ServerError):
        client.health()


@pytest.mark.parametrize(
    "errors",
    [
        ["upstream timeout"],
        {"upstream": "timeout"},
        "upstream timeout",
        7,
        [None, ["upstream"]],
        [{"detail": {"upstream": "timeout"}}, {"detail": "timeout", "pointer": ["upstream"]}],
    ],
)
def test_a_problem_of_a_proxy_has_no_faults_and_is_tried_again(client, relay, errors):
    answer = 503, {"content-type": "application/json", "retry-after": "0"}, json.dumps({"errors": errors}).encode()
    relay.answers = [answer]
    assert client.health().status == "ok"
    relay.only, relay.answers = "/events", [answer]
    assert client.wait(client.submit(seed=45, spec=SMALL)).status == "succeeded"
    relay.only, relay.answers = "", 5 * [answer]
    with pytest.raises(ServerError) as caught:
        client.health()
    assert caught.value.errors == () and caught.value.members == {"errors": errors}


def test_faults_are_found_among_other_errors(client, relay):
    errors = [{"detail": "is -3", "pointer": "/spec/friction"}, "timeout", {"parameter": "limit", "header": None}]
    relay.answers = [(422, {"content-type": "application/json"}, json.dumps({"errors": errors}).encode())]
    with pytest.raises(InvalidRequest) as caught:
        client.health()
    assert caught.value.errors == (Fault("is -3", pointer="/spec/friction"), Fault("", parameter="limit"))


def test_streams_that_are_refused_leave_the_record_to_read(client, relay):
    relay.only, relay.answers = "/events", 3 * [unavailable(503, 0, "too-many-streams")]
    assert client.wait(client.submit(seed=42, spec=SMALL)).status == "succeeded"


def test_a_stream_that_breaks_goes_on_after_its_last_event(client, relay, grown):
    relay.only, relay.cuts = "/events", [3000, 0]
    model = client.submit(seed=43, spec=ENDLESS)

    def streams():
        return [headers for _, path, headers in relay.requests if path.endswith("/events")]

    names = []
    for event in client.events(model):
        names.append(event.name)
        if len(streams()) == 3:
            client.cancel(model)
    assert names[-1] == "end"
    _, second, third = streams()
    assert second["last-event-id"] == third["last-event-id"]


def test_a_wait_reconnects_more_than_a_thousand_times(monkeypatch):
    """If a proxy ends every stream immediately, the record shows when the model has ended."""
    streams, pauses = [], []

    def answer(request):
        if request.url.path.endswith("/events"):
            streams.append(request)
            return httpx.Response(200, headers={"content-type": "text/event-stream"})
        status = "succeeded" if len(streams) >= 1100 else "running"
        return httpx.Response(200, json={"id": "a", "status": status, "version": 1, "preset": "pig", "seed": 1})

    monkeypatch.setattr("time.sleep", pauses.append)
    with httpx.Client(transport=httpx.MockTransport(answer)) as http, Client(http=http) as client:
        assert client.wait("a").status == "succeeded"
    assert len(streams) == 1100 and len(pauses) == 1099
    assert 0.2 <= pauses[0] <= 0.3 and all(6.4 <= pause <= 9.6 for pause in pauses[5:])


def test_a_service_that_is_away_is_an_error(monkeypatch):
    monkeypatch.setattr("time.sleep", lambda _: None)
    with Client("http://127.0.0.1:9", retries=2) as client, pytest.raises(ConnectionFailed, match="ConnectError"):
        client.health()
    with Client("http://127.0.0.1:9", outage=0.0) as client, pytest.raises(ConnectionFailed):
        client.wait("a")


@pytest.mark.parametrize(
    "answer",
    [
        (200, {"content-type": "text/html"}, b"<h1>Welcome</h1>"),
        (200, {"content-type": "application/json"}, b"[1]"),
        (302, {"location": "http://127.0.0.1:9/login"}, b""),
    ],
)
def test_what_is_not_the_service_is_an_error(client, relay, answer):
    relay.answers = [answer]
    with pytest.raises(UnexpectedAnswer):
        client.cancel("a")
    relay.answers = [(404, {"content-type": "text/html"}, b"no")]
    with pytest.raises(Problem) as caught:
        client.health()
    assert caught.value.type == "about:blank" and caught.value.detail == "no"


def test_addresses_are_checked(monkeypatch):
    for url in ("localhost:8080", "ftp://host", "http://", "http://host/?a=b"):
        with pytest.raises(ValueError):
            Client(url)
    monkeypatch.setenv("OVIDUCT_URL", "http://host/path")
    with Client() as client:
        assert repr(client) == "Client('http://host/path/')"
    with Client("http://user:secret@host") as client:
        assert "secret" not in repr(client)
    gc.collect()


def test_a_stream_is_given_up_only_after_an_outage(relay):
    """The time for which the caller handles an event does not count as an outage."""
    relay.only, relay.cuts = "/events", [2000]
    with Client(relay.url, outage=0.5) as client:
        stream = client.events(client.submit(seed=44, spec=SMALL))
        next(stream)
        time.sleep(1)
        assert list(stream)[-1].name == "end"
