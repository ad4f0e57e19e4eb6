import hashlib
import struct

import numpy as np
import pytest

from oviduct import CheckFailed, InvalidRequest, NotFound, read_sections


@pytest.fixture
def data(client, grown):
    return client.content(grown, "sections.bin")


def test_the_file_and_the_interface_have_the_same_sections(client, grown, data, tmp_path):
    (tmp_path / "sections.bin").write_bytes(data)
    sections = client.sections(grown)
    assert len(sections) == len(read_sections(data)) == len(read_sections(tmp_path / "sections.bin")) == 13
    assert sections.header["units"] == "um" and sections.header["seed"] == 7
    assert sections.z_um[0] == 0 and (np.diff(sections.z_um) > 0).all() and not sections.added.any()
    for section in sections:
        other = client.section(grown, section.index)
        assert (section.z_um, section.step, section.added) == (other.z_um, other.step, other.added)
        for ring, answer, count in zip(
            (section.inner, section.outer), (other.inner, other.outer), sections.points[section.index], strict=True
        ):
            assert ring.points.dtype == np.float32 and ring.points.shape == (count, 2) and len(ring) == count
            assert np.array_equal(ring.ids, answer.ids) and np.array_equal(ring.points, answer.points)
    assert sections[-1].index == 12 and [section.index for section in sections[3:5]] == [3, 4]
    with pytest.raises(IndexError):
        sections[13]
    with pytest.raises(NotFound) as caught:
        client.section(grown, 13)
    assert caught.value.name == "section-not-found"
    assert client.section_svg(grown, 3).startswith(("<svg", "<?xml"))
    page = client.report_page(grown)
    assert page.startswith("<!DOCTYPE html>") and page.count("data:image/png;base64,") == 2
    assert {"isthmus", "ampulla", "whole"} <= client.report(grown)["morphometry"]["regions"].keys()


def test_a_model_is_drawn(client, grown):
    def size(png):
        assert png.startswith(b"\x89PNG\r\n\x1a\n")
        return struct.unpack_from(">II", png, 16)

    assert size(client.section_png(grown, 3, size=64)) == size(client.section_png(grown, 3, size=64, labels=True))
    assert max(size(client.section_png(grown, 3))) == 1024
    assert size(client.preview(grown)) == (1024, 683)
    end = client.preview(grown, view="ampulla", size=48)
    assert size(end) == (48, 48) and end != client.preview(grown, view="isthmus", size=48)
    with pytest.raises(InvalidRequest) as caught:
        client.preview(grown, view="inside", size=1)
    assert [error.parameter for error in caught.value.errors] == ["view", "size"]


def area(points):
    x, y = points.T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def test_the_surface_is_cut_across_and_along(client, grown):
    # Without lean, a cut at the position of a section equals the section.
    section = client.section(grown, 6)
    cut = client.cut(grown, z_um=section.z_um)
    assert [ring.kind for ring in cut.rings] == ["tissue", "lumen"] and (cut.islands, cut.pockets) == (0, 0)
    assert cut.file == "model.glb" and cut.plane.normal == (0, 0, 1) and (cut.plane.u, cut.plane.v)[1] == (0, 1, 0)
    tissue, lumen = cut.rings
    assert (tissue.parent, lumen.parent) == (None, 0) and "points" not in repr(cut)
    for ring, contour, sign in ((tissue, section.outer, 1), (lumen, section.inner, -1)):
        assert ring.points.dtype == np.float64 and ring.points.shape == (len(ring), 2)
        assert area(ring.points) == pytest.approx(sign * ring.area_um2, rel=1e-6)
        assert area(contour.points.astype(float)) == pytest.approx(ring.area_um2, rel=1e-3)
    assert cut.tissue_area_um2 == pytest.approx(tissue.area_um2 - lumen.area_um2)
    along = client.cut(grown, origin_um=(0, 0, section.z_um), normal=np.array([0, 2, 0]))
    assert along.plane.normal == (0, 1, 0) and along.plane.origin_um[1] == 0
    assert client.cut_svg(grown, z_um=section.z_um).startswith(("<svg", "<?xml"))
    for labels in (False, True):
        png = client.cut_png(grown, z_um=section.z_um, size=64, labels=labels)
        assert png.startswith(b"\x89PNG\r\n\x1a\n") and max(struct.unpack_from(">II", png, 16)) == 64
    with pytest.raises(NotFound) as caught:
        client.cut(grown, z_um=1e6)
    assert caught.value.name == "cut-not-found"
    with pytest.raises(InvalidRequest) as caught:
        client.cut(grown, origin_um=(0, 0, 0))
    assert [error.parameter for error in caught.value.errors] == ["normal"]


def test_a_leaning_surface_has_islands(client):
    keys = {"keys": [[0, 0], [0.2125, 0], [0.33, 1000], [1, 1000]], "ease": "smooth"}
    sway = {"strength": {"keys": [[0, 0], [0.25, 0], [0.35, 3], [1, 3]], "ease": "smooth"}}
    # Half of the cuts across this model pass through islands.
    spec = {"steps": 600, "length_mm": 12, "sway": sway, "lean": {"strength_um": keys, "wavelength_um": 200}}
    model = client.wait(client.submit(preset="paper", seed=3, spec=spec))
    end = client.sections(model).z_um[-1]
    cuts = [client.cut(model, z_um=part * end) for part in np.linspace(0.5, 0.95, 10)]
    assert sum(cut.islands for cut in cuts) > 0
    for cut in cuts:
        assert [ring.kind for ring in cut.rings].count("island") == cut.islands
        for at, ring in enumerate(cut.rings):
            assert ring.parent is None or ring.parent < at
    report = client.report(model)
    assert 0 <= report["cuts"]["with_islands"] <= 1 and report["lean"]["scale"] > 0


def test_damage_is_found(data):
    for at in (0, 9, 14, 30, len(data) // 2, len(data) - 60, len(data) - 30, len(data) - 1):
        with pytest.raises(CheckFailed):
            list(read_sections(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]))
    for length in (0, 15, 100, len(data) - 1):
        with pytest.raises(CheckFailed):
            read_sections(data[:length])


def test_damage_with_right_hashes_is_found(data):
    def signed(data):
        end = len(data) - 64
        (offset,) = struct.unpack_from("<Q", data, end)
        data[end + 16 : end + 24] = hashlib.sha256(data[offset:end]).digest()[:8]
        data[end + 24 : end + 56] = hashlib.sha256(data[: end + 24]).digest()
        return bytes(data)

    (offset,) = struct.unpack_from("<Q", data, len(data) - 64)
    assert signed(bytearray(data)) == data
    # Bytes of the first entry: offset, length, number of inner points, checksum.
    for at in (0, 8, 12, 15, 40):
        changed = bytearray(data)
        changed[offset + at] ^= 1
        with pytest.raises(CheckFailed):
            list(read_sections(signed(changed)))
