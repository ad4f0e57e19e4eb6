"""Hooks of schemathesis for this service."""

import json
import os
import urllib.request
import uuid

import schemathesis
from schemathesis.core.parameters import ParameterLocation

KNOWN = [os.environ["OVIDUCT_SUCCEEDED"], os.environ["OVIDUCT_CANCELLED"]]
FILES = ["model.glb", "model.obj", "sections.bin", "report.json"]
KEY = os.environ["OVIDUCT_KEY"]
PRESETS = ["pig", "paper"]
COUNT = {"calls": 0}


@schemathesis.hook
def before_load_schema(context, raw_schema):
    """Adapts the schema: makes the example studies small, and drops security without API keys."""
    # schemathesis generates thousands of bodies from the examples, and the service would validate
    # 50 points of each.
    components = raw_schema["components"]
    for study in (components["schemas"]["Vary"]["examples"][0], components["examples"]["StudyBatch"]["value"]["vary"]):
        study["samples"] = 5
    if KEY:
        return
    del raw_schema["components"]["securitySchemes"]
    for item in raw_schema["paths"].values():
        for operation in item.values():
            del operation["security"]


@schemathesis.hook
def before_call(context, case, kwargs):
    """Directs two of three requests for a resource to existing models, deletions to copies of them.
    """
    COUNT["calls"] += 1
    turn = COUNT["calls"] % 3
    parameters = dict(case.path_parameters or {})
    if case.method.upper() == "DELETE" and parameters.get("id") in KNOWN:
        case.path_parameters = {**parameters, "id": copy()}
    elif "id" in parameters and turn < 2 and case.method.upper() == "GET" and not chained(case) and plain(case):
        parameters["id"] = KNOWN[turn]
        if "name" in parameters:
            parameters["name"] = FILES[COUNT["calls"] // 3 % len(FILES)]
        case.path_parameters = parameters
    elif (case.method.upper(), case.path) in (("DELETE", "/models"), ("POST", "/models/cancel")):
        # Without a dry run, the models that other requests need would be gone.
        case.query = {**(case.query or {}), "dry_run": "true"}
    elif case.path == "/presets/{name}" and turn < 2 and plain(case):
        case.path_parameters = {**parameters, "name": PRESETS[turn]}
    if case.path.endswith("/cut") and plain(case) and (case.meta is None or not case.meta.is_negative_at(ParameterLocation.QUERY)):
        # In two of three requests, use a plane that intersects the model.
        query = {name: value for name, value in (case.query or {}).items() if name not in ("z_um", "origin_um", "normal")}
        places = [{"z_um": 1000.0 * (COUNT["calls"] % 50)}, {"origin_um": "0,0,3000", "normal": "0,1,0.5"}]
        case.query = {**query, **places[turn]} if turn < 2 else case.query
    if case.path.endswith(("/sections/{k}", "/cut")) and case.query:
        # The service refuses picture options without a picture, and a stain of label images.
        refused = {"size", "stain", "labels"} if case.query.get("format") in ("json", "svg") else set()
        if "labels" in case.query:
            refused.add("stain")
        case.query = {name: value for name, value in case.query.items() if name not in refused}
    for name in list(case.headers or {}):
        # Waiting is not tested here, and the service refuses an idempotency key that was used with
        # another body.
        if name.lower() == "prefer" and "wait=" in str(case.headers[name]):
            case.headers[name] = "wait=1"
        if name.lower() == "idempotency-key" and case.headers[name]:
            case.headers[name] = str(uuid.uuid4())
        # A range of a JSON file is not valid JSON, which schemathesis does not know.
        if name.lower() == "range" and (case.path_parameters or {}).get("name") == "report.json":
            del case.headers[name]


def copy():
    """Creates a model that shares the files of the succeeded one."""
    body = json.dumps({"seed": 1, "spec": json.loads(os.environ["OVIDUCT_SMALL"]), "outputs": ["glb", "obj"]}).encode()
    request = urllib.request.Request(
        os.environ["OVIDUCT_URL"] + "/models", data=body, headers={"Content-Type": "application/json"}
    )
    if KEY:
        request.add_header("Authorization", f"Bearer {KEY}")
    with urllib.request.urlopen(request, timeout=20) as answer:
        return json.load(answer)["id"]


def chained(case):
    """Returns whether the request follows from the response to another request."""
    return case.meta is not None and case.meta.phase.name.value == "stateful"


def plain(case):
    """Returns whether the path is meant to be valid."""
    return case.meta is None or not case.meta.is_negative_at(ParameterLocation.PATH)
