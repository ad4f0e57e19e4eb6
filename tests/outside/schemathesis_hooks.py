"""What schemathesis must know of this service."""

import os
import uuid

import schemathesis
from schemathesis.core.parameters import ParameterLocation

KNOWN = [os.environ["OVIDUCT_SUCCEEDED"], os.environ["OVIDUCT_CANCELLED"]]
FILES = ["model.glb", "model.obj", "sections.bin", "report.json"]
COUNT = {"calls": 0}


@schemathesis.hook
def before_call(context, case, kwargs):
    """Leads two of three requests for something to models that exist, and keeps those from being deleted."""
    COUNT["calls"] += 1
    turn = COUNT["calls"] % 3
    parameters = dict(case.path_parameters or {})
    if case.method.upper() == "DELETE" and parameters.get("id") in KNOWN:
        case.path_parameters = {**parameters, "id": str(uuid.uuid4())}
    elif "id" in parameters and turn < 2 and case.method.upper() == "GET" and not chained(case) and plain(case):
        parameters["id"] = KNOWN[turn]
        if "name" in parameters:
            parameters["name"] = FILES[COUNT["calls"] // 3 % len(FILES)]
        case.path_parameters = parameters
    for name in list(case.headers or {}):
        # Waiting is not the point, and a key that was used for another body is refused by design.
        if name.lower() == "prefer" and "wait=" in str(case.headers[name]):
            case.headers[name] = "wait=1"
        if name.lower() == "idempotency-key" and case.headers[name]:
            case.headers[name] = str(uuid.uuid4())


def chained(case):
    """Whether the request follows from the answer to another one."""
    return case.meta is not None and case.meta.phase.name.value == "stateful"


def plain(case):
    """Whether the path is meant to be valid."""
    return case.meta is None or not case.meta.is_negative_at(ParameterLocation.PATH)
