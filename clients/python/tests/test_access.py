import logging
import pickle
import traceback

import httpx
import pytest
from conftest import SMALL

from oviduct import Client, Forbidden, NotFound, Problem, QuotaExceeded, RateLimited, Unauthorized


def test_a_key_is_needed(keyed, monkeypatch):
    with Client(keyed.url) as client:
        with pytest.raises(Unauthorized):
            client.presets()
        assert client.health().status == "ok"
    with Client(keyed.url, key=keyed.lab[:-1] + ("0" if keyed.lab[-1] != "0" else "1")) as client:
        with pytest.raises(Unauthorized) as caught:
            client.presets()
        assert caught.value.name == "unauthorized" and caught.value.request_id
    monkeypatch.setenv("OVIDUCT_KEY", keyed.lab + "\n")
    monkeypatch.setenv("OVIDUCT_URL", keyed.url)
    with Client() as client:
        assert client.presets()
    with Client(key="") as client, pytest.raises(Unauthorized):
        client.presets()


def test_scopes_and_owners(keyed):
    with Client(keyed.url, key=keyed.reader) as client, pytest.raises(Forbidden):
        client.submit(spec=SMALL)
    with Client(keyed.url, key=keyed.lab) as lab, Client(keyed.url, key=keyed.admin) as admin:
        model = lab.wait(lab.submit(seed=1, spec=SMALL))
        assert model.owner == "lab"
        with pytest.raises(Forbidden):
            lab.pause_workers()
        assert admin.pause_workers().pause.by == "admin"
        assert admin.resume_workers().pause is None
        assert [found.id for found in admin.models(owner="lab")] == [model.id]
        with Client(keyed.url, key=keyed.hasty) as hasty, pytest.raises(NotFound):
            hasty.model(model)


def test_a_ticket_stands_for_the_key(keyed):
    with Client(keyed.url, key=keyed.lab) as client:
        ticket = client.ticket("/models")
        assert ticket.ticket not in repr(ticket) and ticket.expires_at
        assert httpx.get(ticket.url).status_code == 200
        assert httpx.get(ticket.url).status_code == 401


def test_the_rate_of_a_key_is_kept_by_waiting(keyed):
    with Client(keyed.url, key=keyed.hasty, retries=0) as client, pytest.raises(RateLimited) as caught:
        for _ in range(40):
            client.presets()
    assert caught.value.retry_after >= 1
    with Client(keyed.url, key=keyed.hasty) as client:
        assert client.presets()


def test_a_quota_has_its_own_class(keyed):
    with Client(keyed.url, key=keyed.admin) as admin, Client(keyed.url, key=keyed.small, retries=0) as client:
        admin.pause_workers()
        try:
            client.submit(seed=1, spec=SMALL)
            with pytest.raises(QuotaExceeded) as caught:
                client.submit(seed=2, spec=SMALL)
            assert caught.value.retry_after
        finally:
            admin.resume_workers()


def test_the_key_is_never_shown(keyed, caplog):
    caplog.set_level(logging.DEBUG)
    shown = []
    with Client(keyed.url, key=keyed.lab) as client:
        shown += [repr(client), str(vars(client)), str(vars(client._options))]
        client.presets()
        with pytest.raises(Problem) as caught:
            client.model("a")
        shown += ["".join(traceback.TracebackException.from_exception(caught.value, capture_locals=True).format())]
        problem = pickle.loads(pickle.dumps(caught.value))
        assert (type(problem), str(problem)) == (NotFound, str(caught.value))
    with Client("http://127.0.0.1:9", key=keyed.lab, retries=0) as client, pytest.raises(Exception) as failed:
        client.presets()
    shown += ["".join(traceback.TracebackException.from_exception(failed.value, capture_locals=True).format())]
    with pytest.raises(ValueError) as refused:
        Client(key=keyed.lab + "\nb")
    shown += [str(refused.value), caplog.text]
    assert not any(keyed.lab[20:] in text for text in shown)
