"""Tests openapi.yaml with linters and with client generators.

Usage: description.py
"""

import importlib
import json
import os
import subprocess
import sys
import tempfile

import yaml

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
DESCRIPTION = os.path.join(ROOT, "openapi.yaml")
NODE = os.path.join(ROOT, "target", "judges", "node", "node_modules")


class Loader(yaml.SafeLoader):
    """YAML 1.2 as OpenAPI uses it: a time is a string."""


Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def run(name, *command):
    """Runs a program that must succeed; returns its output."""
    quiet = {"REDOCLY_TELEMETRY": "off", "REDOCLY_SUPPRESS_UPDATE_NOTICE": "true"}
    # The generator calls ruff, which is installed next to Python.
    path = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]
    done = subprocess.run(command, env={**os.environ, **quiet, "PATH": path}, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{name} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done.stdout


def program(name):
    return os.path.join(NODE, ".bin", name)


def redocly():
    config = os.path.join(HERE, "redocly.yaml")
    found = json.loads(run("Redocly", program("redocly"), "lint", DESCRIPTION, "--config", config, "--format", "json"))
    problems = [f"{p['ruleId']}: {p['message']} {p['location']}" for p in found["problems"] if not p.get("ignored")]
    assert not problems, "\n".join(problems)
    print(f"Redocly: {found['totals']['errors']} errors, {found['totals']['warnings']} warnings,"
          f" {found['totals']['ignored']} ignored with a reason")


def spectral():
    config = os.path.join(HERE, "spectral.yaml")
    run("Spectral", program("spectral"), "lint", DESCRIPTION, "--ruleset", config, "--fail-severity", "hint")
    print("Spectral: 0 errors, 0 warnings")


def typescript(folder):
    types = os.path.join(folder, "types.ts")
    run("openapi-typescript", program("openapi-typescript"), DESCRIPTION, "--output", types)
    compiler = os.path.join(NODE, "typescript", "lib", "typescript.js")
    run("unknown.mjs", "node", os.path.join(HERE, "unknown.mjs"), compiler, types)
    run("tsc", program("tsc"), "--noEmit", "--strict", "--skipLibCheck", types)
    print("openapi-typescript: every documented member has a type")


def python(folder):
    generator = os.path.join(os.path.dirname(sys.executable), "openapi-python-client")
    # With --fail-on-warning, an omitted part of the description is an error.
    run("openapi-python-client", generator, "generate", "--path", DESCRIPTION, "--output-path",
        os.path.join(folder, "oviduct_client"), "--meta", "none", "--fail-on-warning",
        "--config", os.path.join(HERE, "openapi-python-client.yaml"))
    sys.path.insert(0, folder)
    for base, _, files in os.walk(os.path.join(folder, "oviduct_client")):
        package = os.path.relpath(base, folder).replace(os.sep, ".")
        for file in sorted(files):
            if file.endswith(".py"):
                importlib.import_module(f"{package}.{file[:-3]}")
    models = importlib.import_module("oviduct_client.models")
    with open(DESCRIPTION, encoding="utf-8") as file:
        examples = yaml.load(file, Loader)["components"]["examples"]
    # Reading and writing an example must return the example, except for the format of times.
    for name in ["Model", "ModelList", "Batch", "Table", "WorkerList", "Ticket", "TicketRequest"]:
        value = examples[name]["value"]
        again = getattr(models, name).from_dict(value).to_dict()
        assert plain(again) == plain(value), f"{name}: {again} is not {value}"
    changed = models.ModelRequest.from_dict(examples["ChangedModel"]["value"])
    assert changed.to_dict()["spec"] == examples["ChangedModel"]["value"]["spec"], "a patch has only what was set"
    print("openapi-python-client: no warnings; its package imports and reads the examples")


def plain(value):
    """Returns a value without times, because the client changes their format."""
    if isinstance(value, dict):
        return {name: plain(member) for name, member in value.items() if not name.endswith("_at")}
    return [plain(item) for item in value] if isinstance(value, list) else value


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        redocly()
        spectral()
        typescript(temporary)
        python(temporary)
