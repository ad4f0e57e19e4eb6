"""A proxy that serves the service under a path and injects faults into responses."""

import http.client
import http.server
import threading
import urllib.parse

HOP = {"connection", "transfer-encoding", "keep-alive"}


class Relay:
    """Forwards requests below `/prefix/` to a service.

    Each request that matches `only` uses up one entry of each list.
    """

    def __init__(self, url):
        target = urllib.parse.urlsplit(url).netloc
        relay = self
        self.only = ""
        self.answers = []  # (status, headers, body) to send instead of the service's response.
        self.cuts = []  # Number of bytes of the body after which the connection is closed.
        self.damage = False  # True if the first byte of a body is changed.
        self.requests = []  # Methods, paths and headers (names in lower case) received so far.

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def handle_one_request(self):
                try:
                    super().handle_one_request()
                except OSError:
                    self.close_connection = True

            def relay(self):
                relay.requests.append(
                    (self.command, self.path, {name.lower(): value for name, value in self.headers.items()})
                )
                body = self.rfile.read(int(self.headers.get("content-length", 0)))
                matches = relay.only in self.path
                if matches and relay.answers:
                    status, headers, content = relay.answers.pop(0)
                    return self.answer(status, {**headers, "content-length": str(len(content))}, [content])
                cut = relay.cuts.pop(0) if matches and relay.cuts else None
                path = self.path.removeprefix("/prefix")
                connection = http.client.HTTPConnection(target, timeout=60)
                try:
                    headers = {name: value for name, value in self.headers.items() if name.lower() not in HOP}
                    connection.request(self.command, path, body or None, headers)
                    response = connection.getresponse()
                    headers = {name: value for name, value in response.getheaders() if name.lower() not in HOP}
                    if cut == 0:
                        self.close_connection = True
                        return
                    chunks = iter(lambda: response.read1(65536), b"")
                    self.answer(response.status, headers, self.disturbed(chunks, cut))
                except (OSError, http.client.HTTPException):
                    self.close_connection = True
                finally:
                    connection.close()

            def disturbed(self, chunks, cut):
                for chunk in chunks:
                    if relay.damage:
                        chunk = bytes([chunk[0] ^ 1]) + chunk[1:]
                    if cut is not None and len(chunk) >= cut:
                        yield chunk[:cut]
                        raise ConnectionError
                    cut = None if cut is None else cut - len(chunk)
                    yield chunk

            def answer(self, status, headers, chunks):
                self.send_response_only(status)
                # Without a length, the end of the connection marks the end of the body.
                self.close_connection = "content-length" not in headers
                for name, value in headers.items():
                    self.send_header(name, value)
                if self.close_connection:
                    self.send_header("connection", "close")
                self.end_headers()
                for chunk in chunks:
                    self.wfile.write(chunk)
                    self.wfile.flush()

            def log_message(self, *_):
                pass

            do_GET = do_POST = do_DELETE = relay

        class Server(http.server.ThreadingHTTPServer):
            daemon_threads = True

        self.server = Server(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/prefix"
        self.thread = threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()
