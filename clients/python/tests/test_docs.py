"""Runs the examples of docs/clients.md in their order against a live service."""

import csv
import re
import zipfile

import pytest
from conftest import ROOT

DOCUMENT = ROOT / "docs/clients.md"


def blocks():
    """Yields the Python blocks, each with the heading before it.

    Blank lines in front of a block keep its line numbers, so errors point to the line in the
    document.
    """
    text = DOCUMENT.read_text()
    (section,) = re.findall(r"^## Python\n.*?(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    start = text.index(section)
    found = {}
    for block in re.finditer(r"^```python\n(.*?)^```", section, re.MULTILINE | re.DOTALL):
        heading = re.findall(r"^### (.*)", section[: block.start()], re.MULTILINE)[-1]
        found[heading] = "\n" * text.count("\n", 0, start + block.start(1)) + block[1]
    return found


# The examples grow more than 50 models.
@pytest.mark.timeout(300)
def test_the_examples_run(service, tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OVIDUCT_URL", service.url)
    names = {}
    printed = {}
    for heading, code in blocks().items():
        if heading == "A study":
            # The example of a study is a separate script.
            names["client"].close()
            names = {}
        exec(compile(code, str(DOCUMENT), "exec"), names)
        printed[heading] = capsys.readouterr().out
    names["client"].close()

    assert len(printed) == 7
    assert (tmp_path / "model.glb").stat().st_size > 0 and "True" in printed["Submit, wait, download"]
    assert "/spec/collision/gap_um" in printed["Errors"] and "/spec/colour" in printed["Errors"]
    assert printed["asyncio"] == "['succeeded', 'succeeded', 'succeeded']\n"
    assert "end succeeded" in printed["Events"]
    assert re.fullmatch(r"lumen_perimeter_mm [\d.]+ met\n", printed["A fit"])
    assert len(names["table"]) == 50 and set(names["table"]["status"]) == {"succeeded"}
    with open(tmp_path / "study.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == 50
    with zipfile.ZipFile(tmp_path / "study.zip") as archive:
        names = archive.namelist()
        assert len(names) == 101 and sum(name.endswith("/model.glb") for name in names) == 50


def test_the_study_is_a_script_of_at_most_15_lines():
    assert len(blocks()["A study"].strip().splitlines()) <= 15
