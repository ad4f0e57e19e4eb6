"""What schemathesis must know of this service: ids that exist, and that waiting is not the point."""

import os

import schemathesis

KNOWN = [os.environ["OVIDUCT_SUCCEEDED"], os.environ["OVIDUCT_CANCELLED"]]
FILES = ["model.glb", "model.obj", "sections.bin", "report.json"]
COUNT = {"calls": 0}


@schemathesis.hook
def before_call(context, case, kwargs):
    """Puts existing ids into two of three requests whose path is meant to be valid, and waits for a second at most."""
    COUNT["calls"] += 1
    turn = COUNT["calls"] % 3
    valid_path = case.meta is None or not case.meta.is_negative_at(schemathesis.generation.meta.ParameterLocation.PATH)
    # A model that is deleted once cannot be deleted again, and the others are needed.
    if valid_path and turn < 2 and case.method.upper() != "DELETE" and "id" in (case.path_parameters or {}):
        parameters = {**case.path_parameters, "id": KNOWN[turn]}
        if "name" in parameters:
            parameters["name"] = FILES[COUNT["calls"] % len(FILES)]
        case.path_parameters = parameters
    for name in list(case.headers or {}):
        if name.lower() == "prefer" and "wait=" in str(case.headers[name]):
            case.headers[name] = "wait=1"
