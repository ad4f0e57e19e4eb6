import numpy as np
import pytest
from conftest import ENDLESS, SMALL

from oviduct import Client, ModelCancelled, NotFound


def test_the_events_of_a_model_end_with_it(client):
    model = client.submit(seed=31, spec=ENDLESS)
    events = []
    for event in client.events(model):
        events.append(event)
        if event.name == "progress" and any(seen.section and seen.section.z_um > 0 for seen in events):
            client.cancel(model)
    assert events[-1].name == "end" and events[-1].status == "cancelled"
    assert {"status", "progress", "end"} <= {event.name for event in events}
    assert all(event.model_id == model.id and event.model.spec is None for event in events)
    sections = [event.section for event in events if event.section]
    assert sections and all(section.inner.shape[1] == 2 for section in sections)
    assert sections[0].outer.dtype == np.float32 and sections[-1].z_um > 0
    # There are no events after the last known one.
    assert list(client.events(model, last_event_id=events[-1].id)) == []
    assert [event.model.spec["steps"] for event in client.events(model, spec=True)] == [ENDLESS["steps"]]


def test_the_last_event_of_a_model_has_its_files(client, grown):
    (end,) = client.events(grown)
    assert (end.name, end.status) == ("end", "succeeded") and end.model.files == grown.files


def test_the_events_of_some_models_end_with_the_last(client):
    models = [client.submit(seed=seed, spec=SMALL, labels={"some": "events"}) for seed in (32, 33)]
    gone = "01900000-0000-7000-8000-000000000000"
    ends = {event.model_id: event for event in client.events(models=[*models, gone]) if event.name == "end"}
    assert {name: event.status for name, event in ends.items()} == {
        models[0].id: "succeeded", models[1].id: "succeeded", gone: "deleted"
    }  # fmt: skip
    assert ends[gone].model is None


def test_a_stream_of_all_models_can_be_left(client):
    stream = client.events(labels={"stream": "all"})
    model = client.submit(seed=34, spec=SMALL, labels={"stream": "all"})
    first = next(stream)
    assert first.model_id == model.id
    stream.close()
    client.wait(model)


def test_events_of_one_model_take_no_conditions(client, grown):
    with pytest.raises(TypeError):
        client.events(grown, labels={"a": "b"})
    with pytest.raises(NotFound):
        next(client.events("01900000-0000-7000-8000-000000000000"))


def test_a_wait_lasts_through_a_restart(own_service):
    states = []

    def look(state):
        if state.status == "running" and "running" not in states:
            own_service.kill()
            own_service.start()
        elif state.status == "running" and state.attempts > 1:
            client.cancel(state)
        states.append(state.status)

    with Client(own_service.url) as client:
        model = client.submit(seed=35, spec=ENDLESS)
        with pytest.raises(ModelCancelled) as caught:
            client.wait(model, progress=look, timeout=60)
    assert caught.value.model.attempts > 1 and states[-1] == "cancelled"


def test_a_wait_for_a_batch_lasts_through_a_restart(own_service):
    seen = []

    def look(progress):
        if not seen:
            own_service.kill()
            own_service.start()
            client.resume_workers()
        seen.append(progress.ended)

    with Client(own_service.url) as client:
        client.pause_workers()
        batch = client.wait_batch(client.submit_batch(seeds=[1, 2, 3], spec=SMALL), progress=look, timeout=60)
    assert batch.counts.succeeded == 3 and seen[0] == 0 and seen[-1] == 3
