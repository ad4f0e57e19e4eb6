"""Sends invalid requests to a live server.

Usage: refusals.py OVIDUCT_BINARY

Each response must be a problem that names the place, and the service must keep running.
"""

import http.client
import json
import os
import socket
import subprocess
import sys
import tempfile

from service import SMALL, Service

# Name, body, status, slug of the problem, and the place that the problem must name: a JSON pointer,
# or line and column of a syntax error.
SCHEDULE = {"friction": {"keys": [[0, 0.1], [0.7, 0.1], [0.3, 0.1], [1, 0.1]]}}
CASES = [
    ("unknown field", {"presett": "pig"}, 422, "invalid-request", "/presett"),
    ("unknown field of the spec", {"spec": {"colour": "red"}}, 422, "invalid-request", "/spec/colour"),
    ("unknown field in a group", {"spec": {"collision": {"gap_mm": 1}}}, 422, "invalid-request", "/spec/collision/gap_mm"),
    ("NaN", b'{"spec": {"length_mm": NaN}}', 400, "invalid-json", (1, 24)),
    ("Infinity", b'{"spec": {"length_mm": -Infinity}}', 400, "invalid-json", (1, 25)),
    ("a number beyond doubles", b'{"spec": {"length_mm": 1e999}}', 400, "invalid-json", (1, 28)),
    ("negative count", {"spec": {"particles": {"total": -5}}}, 422, "invalid-request", "/spec/particles/total"),
    ("negative steps", {"spec": {"steps": -1}}, 422, "invalid-request", "/spec/steps"),
    ("10^9 particles", {"spec": {"particles": {"total": 10**9}}}, 422, "invalid-request", "/spec/particles/total"),
    ("schedule out of order", {"spec": SCHEDULE}, 422, "invalid-request", "/spec/friction/keys/2/0"),
    ("wrong type", {"spec": {"length_mm": "long"}}, 422, "invalid-request", "/spec/length_mm"),
    ("wrong type of a group", {"spec": {"collision": 3}}, 422, "invalid-request", "/spec/collision"),
    ("wrong type of the whole", [], 422, "invalid-request", ""),
    ("seed of half", {"seed": 0.5}, 422, "invalid-request", "/seed"),
    ("broken JSON", b'{\n  "seed": 7,\n  "preset" "pig"\n}', 400, "invalid-json", (3, 12)),
    ("half a body of JSON", b'{"seed": 7, "spec": {', 400, "invalid-json", (1, 21)),
    ("a member twice", b'{"seed": 7, "seed": 8}', 400, "invalid-json", (1, 18)),
    ("a byte that is not UTF-8", b'{"preset": "\xff"}', 400, "invalid-json", (1, 13)),
    ("nothing", b"", 400, "invalid-json", (1, 0)),
    ("brackets without end", b"[" * 200_000, 400, "invalid-json", (1, 128)),
    ("50 MB", b'{"labels": {"a": "' + b"x" * 50_000_000 + b'"}}', 413, "payload-too-large", None),
]


def post(service, body, headers=None):
    """Returns status, headers and body of the response to POST /models.

    Works even if the server closes the connection before it has read the whole body.
    """
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=30)
    try:
        connection.putrequest("POST", "/models")
        for name, value in {"Content-Type": "application/json", "Content-Length": len(body), **(headers or {})}.items():
            connection.putheader(name, str(value))
        connection.endheaders()
        try:
            connection.send(body)
        except (BrokenPipeError, ConnectionResetError):
            pass
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def check(name, answer, status, slug, place):
    got, headers, content = answer
    assert got == status, f"{name}: {got}, not {status}: {content[:500]}"
    assert headers["Content-Type"] == "application/problem+json", f"{name}: {headers['Content-Type']}"
    problem = json.loads(content)
    assert problem["type"] == f"urn:oviduct:problem:{slug}" and problem["status"] == status, f"{name}: {problem}"
    assert problem["request_id"] == headers["x-request-id"], f"{name}: {problem}"
    if isinstance(place, str):
        places = [fault["pointer"] for fault in problem["errors"]]
        assert place in places, f"{name}: {places}, not {place}"
    elif place is not None:
        assert (problem["line"], problem["column"]) == place, f"{name}: {problem['line']}, {problem['column']}, not {place}"


def no_fault_injection(folder):
    """Checks that a release build refuses to start with an armed fault, which it cannot inject."""
    line = [BINARY, "serve", "--addr", "127.0.0.1:0", "--data", folder, "--gpu", "off"]
    ended = subprocess.run(line, env={**os.environ, "OVIDUCT_FAULT": "after-claim"}, capture_output=True, timeout=60)
    assert ended.returncode == 2 and b"fault-injection" in ended.stderr, ended


def main(folder):
    no_fault_injection(folder)
    service = Service(BINARY, folder).start()
    for name, body, status, slug, place in CASES:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        check(name, post(service, data), status, slug, place)
        assert service.call("GET", "/healthz")[0] == 200, name

    # One response names all faults of a request.
    many = {"seed": -1, "spec": {"steps": -5, "length_mm": "long", "colour": 1, "collision": {"gap_um": 1e9}}}
    faults = [fault["pointer"] for fault in json.loads(post(service, json.dumps(many).encode())[2])["errors"]]
    for place in ["/seed", "/spec/steps", "/spec/length_mm", "/spec/colour", "/spec/collision/gap_um"]:
        assert place in faults, faults

    # Requests without a JSON body, and bytes that are not HTTP.
    check("other media type", post(service, b"{}", {"Content-Type": "text/plain"}), 415, "unsupported-media-type", None)
    check("no route", service.call("GET", "/nowhere"), 404, "not-found", None)
    check("no such method", service.call("PUT", "/models"), 405, "method-not-allowed", None)
    for noise in [b"\x16\x03\x01 no HTTP at all\r\n\r\n", b"POST /models HTTP/1.1\r\nHost: x\r\nContent-Length: 100\r\n\r\n{"]:
        with socket.create_connection(("127.0.0.1", service.port), timeout=5) as raw:
            raw.sendall(noise)

    # The service keeps running: it has queued nothing, and it still grows models.
    assert service.json("GET", "/models")["models"] == []
    model = service.json("POST", "/models", {"seed": 1, "spec": SMALL})["id"]
    assert service.ended(model)["status"] == "succeeded"
    service.stop()
    print(f"refusals: {len(CASES) + 4} bad requests, each a problem that names its place; the service keeps running")


if __name__ == "__main__":
    BINARY = os.path.abspath(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        main(folder)
