"""Tests the service behind a TLS proxy with the configurations in deploy/.

Usage: python3 tests/outside/proxy.py target/release/oviduct

The proxies are nginx, and Caddy if it is installed. The service is tested over HTTP/2, at the root
of a host and under a path. The tests cover requests and problems, immediate events, many streams on
one connection, and downloads with ranges and conditions.
"""

import contextlib
import hashlib
import os
import pathlib
import shutil
import signal
import ssl
import subprocess
import sys
import tempfile
import time

import httpx

sys.path.insert(0, os.path.dirname(__file__))
from service import SMALL, Service, free_port

DEPLOY = pathlib.Path(__file__).resolve().parents[2] / "deploy"
# More streams than a browser opens connections over HTTP/1.1.
STREAMS = 20


def certificate(folder):
    """Creates a certificate for localhost; returns the paths of the certificate and its key."""
    files = [str(folder / name) for name in ("cert.pem", "key.pem")]
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-out", files[0], "-keyout", files[1]],
        check=True, capture_output=True,
    )
    return files


def replaced(text, changes):
    """Replaces parts of a text; each part must occur."""
    for old, new in changes.items():
        assert old in text, f"the configuration has no {old!r}"
        text = text.replace(old, new)
    return text


@contextlib.contextmanager
def nginx(folder, port, files):
    """Prepares nginx with deploy/nginx; returns the URLs of the service and the URL that redirects.
    """
    tls, plain = free_port(), free_port()
    site = replaced((DEPLOY / "nginx/oviduct.conf").read_text(), {
        "server 127.0.0.1:8080;": f"server 127.0.0.1:{port};",
        "server_name oviduct.example;": "server_name localhost;",
        "    listen [::]:80;\n": "",
        "    listen [::]:443 ssl http2;\n": "",
        "listen 80;": f"listen 127.0.0.1:{plain};",
        "listen 443 ssl": f"listen 127.0.0.1:{tls} ssl",
        "/etc/letsencrypt/live/oviduct.example/fullchain.pem": files[0],
        "/etc/letsencrypt/live/oviduct.example/privkey.pem": files[1],
    })
    (folder / "site.conf").write_text(site)
    temporary = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in
                        ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
    (folder / "nginx.conf").write_text(
        f"daemon off;\npid {folder}/nginx.pid;\nerror_log {folder}/error.log;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{temporary}include {folder}/site.conf;\n}}\n"
    )
    program = shutil.which("nginx") or "/usr/sbin/nginx"
    line = [program, "-e", f"{folder}/error.log", "-c", f"{folder}/nginx.conf"]
    with running(line, tls, folder / "error.log"):
        yield [f"https://localhost:{tls}", f"https://localhost:{tls}/oviduct"], f"http://localhost:{plain}"


@contextlib.contextmanager
def caddy(folder, port, files):
    """Prepares Caddy with deploy/caddy; returns the same as `nginx`."""
    root, path = free_port(), free_port()
    tls = f"\n\ttls {files[0]} {files[1]}"
    site = replaced((DEPLOY / "caddy/Caddyfile").read_text(), {
        "reverse_proxy 127.0.0.1:8080": f"reverse_proxy 127.0.0.1:{port}",
        "\noviduct.example {": f"\nhttps://localhost:{root} {{{tls}",
        "\nlab.example {": f"\nhttps://localhost:{path} {{{tls}",
    })
    (folder / "Caddyfile").write_text("{\n\tadmin off\n\tauto_https disable_redirects\n}\n" + site)
    line = ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]
    with running(line, path, folder / "caddy.log"):
        yield [f"https://localhost:{root}", f"https://localhost:{path}/oviduct"], None


@contextlib.contextmanager
def running(line, port, log):
    """Runs a proxy inside a `with` block, which begins when the proxy listens."""
    with open(log, "ab") as out:
        process = subprocess.Popen(line, stdout=out, stderr=out, env={**os.environ, "HOME": str(log.parent)})
    try:
        deadline = time.monotonic() + 60
        while True:
            try:
                httpx.get(f"http://localhost:{port}/")
                break
            except httpx.RemoteProtocolError:
                # The port expects TLS, so the proxy listens.
                break
            except httpx.TransportError:
                if process.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit(f"{line[0]} does not listen:\n{log.read_text()}")
                time.sleep(0.05)
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def events(stream):
    """Yields the events of a stream as they arrive: name, and time of arrival."""
    for line in stream.iter_lines():
        if line.startswith("event:"):
            yield line.removeprefix("event:").strip(), time.monotonic()


def check(client, base):
    """Checks the service at this URL."""
    answer = client.get(f"{base}/readyz")
    assert (answer.status_code, answer.http_version) == (200, "HTTP/2"), answer
    assert client.get(f"{base}/metrics").status_code == 404, "metrics are for operators"

    # Errors must be problems of the service, not pages of the proxy.
    nowhere = client.get(f"{base}/nowhere")
    assert (nowhere.status_code, nowhere.headers["content-type"]) == (404, "application/problem+json"), nowhere
    # A body of the maximum length that the service accepts by default.
    large = client.post(f"{base}/models", content=b" " * (1 << 20), headers={"content-type": "application/json"})
    assert (large.status_code, large.json()["type"]) == (400, "urn:oviduct:problem:invalid-json"), large

    # While the workers are paused, a stream has only one event. A buffering proxy would hold it
    # back.
    assert client.post(f"{base}/workers/pause").json()["pause"]
    asked = client.post(f"{base}/models", json={"spec": SMALL, "reuse": False, "outputs": ["glb"]})
    assert asked.status_code == 202, asked.text
    model = asked.url.join(asked.headers["location"])
    assert str(model).startswith(f"{base}/models/"), asked.headers["location"]
    with contextlib.ExitStack() as open_streams:
        streams = []
        for _ in range(STREAMS):
            begun = time.monotonic()
            stream = open_streams.enter_context(client.stream("GET", f"{model}/events"))
            assert stream.headers["content-type"].startswith("text/event-stream"), stream.headers
            assert "content-encoding" not in stream.headers
            found = events(stream)
            name, at = next(found)
            assert name == "status" and at - begun < 5, f"{name} after {at - begun:.1f} s"
            streams.append(found)
        assert client.get(f"{base}/healthz").status_code == 200, "streams keep no other request waiting"
        assert client.get(str(model)).json()["status"] == "queued"
        assert client.post(f"{base}/workers/resume").json()["pause"] is None
        for found in streams:
            names = [name for name, _ in found]
            assert names[-1] == "end", names
    ended = client.get(str(model)).json()
    assert ended["status"] == "succeeded", ended

    for file in ended["files"]:
        address = f"{model}/files/{file['name']}"
        whole = client.get(address)
        assert hashlib.sha256(whole.content).hexdigest() == file["sha256"], file
        part = client.get(address, headers={"range": "bytes=100-299"})
        assert (part.status_code, part.content) == (206, whole.content[100:300]), part
        assert part.headers["content-range"] == f"bytes 100-299/{file['bytes']}", part.headers
        same = client.get(address, headers={"if-none-match": whole.headers["etag"]})
        assert (same.status_code, same.content) == (304, b""), same


def main(binary):
    proxies = [nginx] + ([caddy] if shutil.which("caddy") else [])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        # The worker processes of nginx run as another user.
        folder.chmod(0o755)
        files = certificate(folder)
        trusted = ssl.create_default_context(cafile=files[0])
        service = Service(binary, name, "--gpu", "off").start()
        try:
            for proxy in proxies:
                home = folder / proxy.__name__
                home.mkdir()
                with proxy(home, service.port, files) as (bases, plain), \
                        httpx.Client(http2=True, verify=trusted, timeout=60) as client:
                    for base in bases:
                        check(client, base)
                        print(f"{proxy.__name__}: {base} serves over HTTP/2")
                    if plain:
                        answer = client.get(f"{plain}/models?limit=1")
                        place = answer.headers["location"]
                        assert (answer.status_code, place) == (308, "https://localhost/models?limit=1"), answer
        finally:
            service.stop()


main(os.path.abspath(sys.argv[1]))
