"""Checks the files in the archives of `python -m build`.

Usage: package.py SDIST WHEEL
"""

import pathlib
import sys
import tarfile
import zipfile

SOURCE = pathlib.Path(__file__).resolve().parents[1]


def main(sdist, wheel):
    for name in ("LICENSE-MIT", "LICENSE-APACHE"):
        assert (SOURCE / name).read_bytes() == (SOURCE / "../.." / name).read_bytes(), f"{name} differs"
    with tarfile.open(sdist) as archive:
        files = {path.partition("/")[2] for path in archive.getnames()}
    assert {"pyproject.toml", "README.md", "LICENSE-MIT", "LICENSE-APACHE", "src/oviduct/py.typed"} <= files, files
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    assert "oviduct/py.typed" in names, names
    assert {name.rpartition("/")[2] for name in names if "licenses/" in name} == {"LICENSE-MIT", "LICENSE-APACHE"}
    assert "License-Expression: MIT OR Apache-2.0" in metadata, metadata
    assert {name.partition("/")[0] for name in names if ".dist-info/" not in name} == {"oviduct"}, names


if __name__ == "__main__":
    main(*sys.argv[1:])
