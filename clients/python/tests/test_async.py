import asyncio
import inspect

import pytest
from conftest import ENDLESS, SMALL
from relay import Relay

from oviduct import AsyncClient, Client, InvalidRequest, ModelCancelled, NotFound, WaitTimeout


def methods(kind):
    return {name: value for name, value in inspect.getmembers(kind, callable) if not name.startswith("_")}


def test_both_clients_have_the_same_methods():
    sync, other = methods(Client), methods(AsyncClient)
    assert sync.keys() - {"close"} == other.keys() - {"aclose"}
    for name in sync.keys() & other.keys():
        parameters = [
            [(p.name, p.kind, p.default) for p in inspect.signature(method).parameters.values()]
            for method in (sync[name], other[name])
        ]
        assert parameters[0] == parameters[1], name
        assert sync[name].__doc__ and sync[name].__doc__ == other[name].__doc__, name


def test_models_events_files_and_batches(service, tmp_path):
    async def main():
        async with AsyncClient(service.url) as client:
            assert repr(client).startswith("AsyncClient('http")
            seen = []
            models = await asyncio.gather(*(client.submit(seed=seed, spec=SMALL) for seed in (61, 62)))
            models = await asyncio.gather(*(client.wait(model, progress=seen.append) for model in models))
            assert [model.status for model in models] == ["succeeded", "succeeded"] and seen
            model = models[0]
            assert [event.name async for event in client.events(model)] == ["end"]
            path = await client.download(model, "model.glb", tmp_path)
            assert path.stat().st_size == model.files[0].bytes
            assert len(await client.download_all(model, tmp_path / "all")) == len(model.files) == 6
            sections = await client.sections(model)
            assert (sections[2].inner.ids == (await client.section(model, 2)).inner.ids).all()
            cut = await client.cut(model, z_um=sections[2].z_um)
            assert cut.rings[0].kind == "tissue" and "<svg" in await client.cut_svg(model, z_um=cut.plane.origin_um[2])
            png = await client.cut_png(model, origin_um=cut.plane.origin_um, normal=(0, 0, 1), size=32)
            assert png.startswith(b"\x89PNG")
            assert (await client.report(model))["certificate"]["passed"]
            assert model.id in [found.id async for found in client.models(status="succeeded")]

            vary = {"design": "grid", "values": {"/friction": [0.2, 0.3]}}
            batch = await client.wait_batch(await client.study(vary=vary, seeds=[1], spec=SMALL))
            assert [row["/friction"] for row in await client.table(batch)] == [0.2, 0.3]
            assert (await client.archive(batch, tmp_path / "a.zip", files=["report.json"])).exists()
            assert batch.id in [found.id async for found in client.batches()]
            await client.delete_batch(batch)
            assert len(await client.workers()) == 1 and (await client.presets())[0].default

            with pytest.raises(InvalidRequest):
                await client.submit(spec={"friction": -1})
            with pytest.raises(NotFound):
                await client.download(model, "model.stl", tmp_path)
            model = await client.submit(seed=65, spec=SMALL)
            async for event in client.events():
                assert event.model_id == model.id
                break

    asyncio.run(main())


def test_a_wait_lasts_through_a_restart(own_service):
    async def main():
        async with AsyncClient(own_service.url) as client:
            model = await client.submit(seed=63, spec=ENDLESS)
            running, again = asyncio.Event(), asyncio.Event()

            def look(state):
                if state.status == "running":
                    (again if state.attempts > 1 else running).set()

            waiting = asyncio.create_task(client.wait(model, progress=look))
            await running.wait()
            own_service.kill()
            await asyncio.to_thread(own_service.start)
            await again.wait()
            await client.cancel(model)
            with pytest.raises(ModelCancelled):
                await waiting

    asyncio.run(main())


def test_broken_downloads_and_cancelled_waits(service, grown, tmp_path):
    async def main():
        with Relay(service.url) as relay:
            relay.only, relay.cuts = "model.glb", [5000, 0]
            async with AsyncClient(relay.url) as client:
                path = await client.download(grown, "model.glb", tmp_path)
                assert path.stat().st_size == grown.files[0].bytes
                await client.pause_workers()
                try:
                    model = await client.submit(seed=64, spec=SMALL)
                    with pytest.raises(WaitTimeout):
                        await client.wait(model, timeout=0.2)
                    with pytest.raises(asyncio.TimeoutError):
                        await asyncio.wait_for(client.wait(model), 0.2)
                    await client.delete(model)
                finally:
                    await client.resume_workers()

    asyncio.run(main())
