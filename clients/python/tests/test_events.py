import time

import numpy as np
import pytest
from conftest import SLOW, SMALL

from oviduct import Client, NotFound


def test_the_events_of_a_model_end_with_it(client):
    model = client.submit(seed=31, spec=SLOW)
    events = list(client.events(model))
    assert events[-1].name == "end" and events[-1].status == "succeeded" and events[-1].model.files
    assert {"status", "progress", "end"} <= {event.name for event in events}
    assert all(event.model_id == model.id and event.model.spec is None for event in events)
    sections = [event.section for event in events if event.section]
    assert sections and all(section.inner.shape[1] == 2 for section in sections)
    assert sections[0].outer.dtype == np.float32 and sections[-1].z_um > 0
    # Nothing follows what is known.
    assert list(client.events(model, last_event_id=events[-1].id)) == []
    assert [event.model.spec["steps"] for event in client.events(model, spec=True)] == [SLOW["steps"]]


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
    states, restarts = [], []

    def look(state):
        states.append(state.status)
        if state.status == "running" and not restarts:
            own_service.kill()
            restarts.append(time.monotonic())
            time.sleep(0.5)
            own_service.start()

    with Client(own_service.url) as client:
        model = client.wait(client.submit(seed=35, spec=SLOW), progress=look, timeout=60)
    assert model.status == "succeeded" and restarts and states[-1] == "succeeded"


def test_a_wait_for_a_batch_lasts_through_a_restart(own_service):
    seen = []

    def look(progress):
        seen.append(progress.ended)
        if progress.ended == 1 and seen.count(1) == 1:
            own_service.kill()
            own_service.start()

    with Client(own_service.url) as client:
        batch = client.wait_batch(client.submit_batch(seeds=[1, 2, 3], spec=SMALL), progress=look, timeout=60)
    assert batch.counts.succeeded == 3 and seen[-1] == 3 and 1 in seen
