import asyncio

import pytest
from conftest import ENDLESS_FIT, FIT

import oviduct
from oviduct import (
    AsyncClient,
    Client,
    FitCancelled,
    FitDeleted,
    FitFailed,
    InvalidRequest,
    NotFound,
    WaitTimeout,
)


@pytest.fixture(scope="module")
def fitted(service):
    """A fit that has succeeded, and its events."""
    with Client(service.url) as client:
        fit = client.submit_fit(**FIT, labels={"kind": "fit"}, idempotency_key="fit")
        assert client.submit_fit(**FIT, labels={"kind": "fit"}, idempotency_key="fit").id == fit.id
        events = list(client.fit_events(fit))
        return client.wait_fit(fit), events


def test_a_fit_is_followed_to_its_result(fitted, client):
    fit, events = fitted
    assert fit.status == "succeeded" and fit.has_ended and fit.progress.models == len(fit.result.models) == 1
    assert fit.result.spec["steps"] == FIT["spec"]["steps"] and fit.result.search["evaluations"] > 8
    assert fit.result.unmet[0]["quantity"] == "lumen_perimeter_mm" and not fit.result.targets[0]["met"]
    assert fit.result.parameters[0]["parameter"] == "/friction" and fit.created_at <= fit.started_at <= fit.finished_at
    names = [event.name for event in events]
    assert names[0] == "status" and "progress" in names and names.index("end") == len(names) - 1
    assert all(event.fit_id == fit.id and event.fit.request is None for event in events)
    assert events[-1].fit.result == fit.result and events[-1].fit.raw["result"] == fit.raw["result"]
    # There are no events after the last known one.
    assert list(client.fit_events(fit, last_event_id=events[-1].id)) == []
    states = []
    assert client.wait_fit(fit.id, progress=states.append).result == fit.result and states[-1] == fit


def test_fits_are_validated(fitted, client, grown):
    fit, _ = fitted
    valid = client.validate_fit(**FIT)
    assert valid.digest == fit.digest and valid.request == fit.request and valid.seconds > 0
    # The tissue labels of a section, as the bytes of an image.
    image = {"region": "ampulla", "image": client.section_png(grown, 0, labels=True), "pixel_um": 5}
    image |= {"tissue": [2, 3, 4, 5, 6, 7, 8, 9], "quantities": ["lumen_perimeter_mm"]}
    (target,) = client.validate_fit(spec=FIT["spec"], images=[image]).request["targets"]
    assert target["quantity"] == "lumen_perimeter_mm" and target["value"] > 0 and target["source"]
    with pytest.raises(InvalidRequest) as caught:
        client.submit_fit(
            targets=[{"region": "ampulla", "quantity": "folds", "value": 30}],
            vary=[{"parameter": "/nothing"}],
            labels={"study": 3},
        )
    places = [fault.pointer for fault in caught.value.errors]
    assert places == ["/labels/study", "/targets/0/quantity", "/vary/0/parameter"]
    with pytest.raises(TypeError, match="target"):
        client.submit_fit(target=[])


def test_fits_are_listed_cancelled_and_deleted(own_service, monkeypatch):
    monkeypatch.setattr("oviduct._calls.PAGE", 2)
    with Client(own_service.url) as client:
        client.pause_workers()
        fits = [client.submit_fit(**ENDLESS_FIT, labels={"even": str(n % 2 == 0)}) for n in range(3)]
        first, second, third = (fit.id for fit in fits)
        assert [fit.id for fit in client.fits()] == [third, second, first]
        assert [fit.id for fit in client.fits(labels={"even": "True"}, status="queued", preset="pig")] == [third, first]
        assert [fit.id for fit in client.fits(created_after=fits[2].created_at)] == [third]
        assert [fit.id for fit in client.fits(created_before=fits[1].created_at)] == [first]
        assert next(client.fits()).request is None and client.fit(first).request["evaluations"] == 2000
        assert client.fit(third).queue.position == 2
        with pytest.raises(TypeError, match="batch"):
            client.fits(batch="a")
        assert client.cancel_fit(first).status == "cancelled"
        with pytest.raises(FitCancelled) as cancelled:
            client.wait_fit(first)
        assert cancelled.value.fit.id == first
        with pytest.raises(WaitTimeout):
            client.wait_fit(second, timeout=0.3)
        with pytest.raises(FitDeleted) as deleted:
            client.wait_fit(second, progress=client.delete_fit)
        assert deleted.value.fit_id == second
        for call in (client.fit, client.wait_fit, client.cancel_fit, client.delete_fit):
            with pytest.raises(NotFound) as caught:
                call(second)
            assert caught.value.name == "fit-not-found"


def test_a_failed_fit_raises(failing_service):
    with Client(failing_service.url) as client, pytest.raises(FitFailed) as caught:
        client.wait_fit(client.submit_fit(**FIT))
    problem = caught.value.fit.problem
    assert problem.type.startswith("urn:oviduct:problem:") and problem.detail in str(caught.value)


def test_progress_of_a_fit_is_shown_on_a_line(fitted, client, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tqdm.auto", None)
    client.wait_fit(fitted[0], progress=True)
    assert capsys.readouterr().err == "100 % succeeded\n"


def test_a_wait_lasts_through_a_restart(own_service):
    restarts = []

    def look(fit):
        if fit.progress and fit.progress.evaluations and not restarts:
            restarts.append(fit)
            own_service.kill()
            own_service.start()
        elif fit.attempts > 1 and not fit.has_ended:
            client.cancel_fit(fit)

    with Client(own_service.url) as client:
        endless, small = client.submit_fit(**ENDLESS_FIT), client.submit_fit(**FIT)
        with pytest.raises(FitCancelled) as caught:
            client.wait_fit(endless, progress=look, timeout=50)
        assert caught.value.fit.attempts == 2 and restarts
        assert client.wait_fit(small, timeout=50).status == "succeeded"


def test_the_asynchronous_client_has_the_same_fits(fitted, service):
    async def main():
        async with AsyncClient(service.url) as client:
            known, _ = fitted
            assert (await client.validate_fit(**FIT)).digest == known.digest
            fit = await client.submit_fit(**FIT)
            names = [event.name async for event in client.fit_events(fit)]
            assert names[-1] == "end"
            done = await client.wait_fit(fit)
            assert done.result == known.result and (await client.fit(fit)).result == known.result
            assert {fit.id, known.id} <= {found.id async for found in client.fits(status="succeeded")}
            fit = await client.submit_fit(**ENDLESS_FIT)
            async for event in client.fit_events(fit):
                if event.name == "progress":
                    await client.cancel_fit(fit)
            with pytest.raises(FitCancelled):
                await client.wait_fit(fit)
            await client.delete_fit(fit)
            with pytest.raises(NotFound):
                await client.fit(fit)
            with pytest.raises(InvalidRequest):
                await client.submit_fit()

    asyncio.run(main())


def test_events_of_something_else_are_refused():
    for data in ([], {}, {"id": "a"}, {"id": "a", "status": "queued", "result": 3}):
        with pytest.raises(oviduct.UnexpectedAnswer):
            oviduct.types.read_fit_event("status", data, None, "")
