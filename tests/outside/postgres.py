"""Temporary PostgreSQL servers from Debian's package, on free loopback ports, and connections to them."""

import contextlib
import glob
import os
import pwd
import shutil
import socket
import struct
import subprocess
import tempfile
import threading
import time

from service import free_port


def programs():
    """Returns the program directory of the newest installed PostgreSQL version."""
    found = [path for path in glob.glob("/usr/lib/postgresql/*/bin") if os.path.exists(f"{path}/initdb")]
    if not found:
        raise SystemExit("PostgreSQL is missing: run scripts/need, or apt-get install postgresql")
    return max(found, key=lambda path: float(path.split("/")[4]))


def url_of(port):
    return f"postgres://postgres@127.0.0.1:{port}/postgres?sslmode=disable"


class Cluster:
    """A running server, stopped and removed at the end of a `with` block.

    If root starts the server, it runs as user `postgres`.
    """

    def __enter__(self):
        self.prepare()
        # PostgreSQL refuses to run as root.
        self.run("initdb", "-U", "postgres", "-A", "trust", "-E", "UTF8", "--locale=C.UTF-8", "--no-sync")
        return self.start()

    def prepare(self):
        """Creates the folder of the server."""
        self.bin = programs()
        self.folder = tempfile.mkdtemp(prefix="oviduct-postgres-", dir="/tmp")
        self.user = pwd.getpwnam("postgres") if os.getuid() == 0 else None
        if self.user:
            os.chown(self.folder, self.user.pw_uid, self.user.pw_gid)

    def start(self):
        # Another program may take the port before the server does.
        for _ in range(5):
            self.port = free_port()
            settings = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories="
            fault = self.attempt("pg_ctl", "-o", settings, "-l", f"{self.folder}/log", "-w", "start")
            if fault is None:
                break
        else:
            raise SystemExit(fault)
        self.url = url_of(self.port)
        return self

    def __exit__(self, *_):
        self.attempt("pg_ctl", "-m", "immediate", "stop")
        shutil.rmtree(self.folder)

    def crash(self):
        """Stops the server without a checkpoint, like a loss of its machine."""
        self.run("pg_ctl", "-m", "immediate", "stop")

    def promote(self):
        """Makes a replica the primary."""
        self.run("pg_ctl", "-w", "promote")

    def sql(self, statement):
        """Runs a statement; returns its output without headings."""
        line = [f"{self.bin}/psql", "-X", "-A", "-t", "-d", self.url, "-c", statement]
        return subprocess.run(line, check=True, capture_output=True, text=True).stdout.strip()

    def run(self, program, *arguments):
        fault = self.attempt(program, *arguments)
        if fault is not None:
            raise SystemExit(fault)

    def attempt(self, program, *arguments):
        """Runs a program; returns its output if the program failed."""
        who = {"user": self.user.pw_uid, "group": self.user.pw_gid, "extra_groups": []} if self.user else {}
        line = [f"{self.bin}/{program}", "-D", f"{self.folder}/data", *arguments]
        environment = {"PATH": f"{self.bin}:{os.environ['PATH']}", "LC_ALL": "C.UTF-8", "PGCTLTIMEOUT": "300"}
        # The output goes to a file, because the server would keep a pipe open.
        with open(f"{self.folder}/{program}.out", "wb") as out:
            code = subprocess.run(line, stdout=out, stderr=out, env=environment, cwd="/", **who).returncode
        if code == 0:
            return None
        with open(f"{self.folder}/{program}.out", errors="replace") as said:
            return f"{program} ended with {code}:\n{said.read()}"

    def cpu_seconds(self):
        """Returns the CPU time of the server so far; that of ended processes is a multiple of 10 ms."""
        with open(f"{self.folder}/data/postmaster.pid") as file:
            postmaster = file.readline().strip()
        with open(f"/proc/{postmaster}/stat") as stat:
            ended = sum(map(int, stat.read().rpartition(")")[2].split()[13:15])) / os.sysconf("SC_CLK_TCK")
        with open(f"/proc/{postmaster}/task/{postmaster}/children") as children:
            processes = [postmaster, *children.read().split()]
        nanoseconds = 0
        for process in processes:
            with contextlib.suppress(OSError), open(f"/proc/{process}/schedstat") as schedstat:
                nanoseconds += int(schedstat.read().split()[0])
        return ended + nanoseconds / 1e9


class Session:
    """A connection to PostgreSQL with trusted authentication, for simple queries and notifications."""

    def __init__(self, cluster):
        self.socket = socket.create_connection(("127.0.0.1", cluster.port))
        self.stream = self.socket.makefile("rb")
        startup = struct.pack("!i", 196608) + b"user\0postgres\0database\0postgres\0\0"
        self.socket.sendall(struct.pack("!i", len(startup) + 4) + startup)
        self.notified = 0
        self.rows()

    def message(self):
        head = self.stream.read(5)
        if len(head) < 5:
            raise EOFError
        kind, length = head[:1], struct.unpack("!i", head[1:])[0]
        return kind, self.stream.read(length - 4)

    def rows(self):
        """Returns the first column of all rows until the server is ready."""
        rows = []
        while True:
            kind, body = self.message()
            if kind == b"E":
                raise SystemExit(body.replace(b"\0", b" ").decode())
            if kind == b"D":
                length = struct.unpack("!i", body[2:6])[0]
                rows.append(body[6:6 + length].decode() if length >= 0 else None)
            if kind == b"Z":
                return rows

    def ask(self, sql):
        self.socket.sendall(b"Q" + struct.pack("!i", len(sql.encode()) + 5) + sql.encode() + b"\0")
        return self.rows()

    def listen(self, channel):
        """Counts the notifications of a channel in a thread of its own."""
        self.ask(f"LISTEN {channel}")

        def count():
            with contextlib.suppress(EOFError, OSError):
                while True:
                    self.notified += self.message()[0] == b"A"

        threading.Thread(target=count, daemon=True).start()

    def close(self):
        self.socket.shutdown(socket.SHUT_RDWR)


class Replica(Cluster):
    """A replica of a running server, by default a synchronous one."""

    def __init__(self, primary, synchronous=True):
        self.primary, self.synchronous = primary, synchronous
        # The way of the write-ahead log, which can be cut.
        self.link = Address(primary.port)

    def __enter__(self):
        self.prepare()
        self.run("pg_basebackup", "-R", "-X", "stream", "-c", "fast", "-d", self.link.url)
        self.start()
        if not self.synchronous:
            return self
        # Set after the copy was made: the promoted server must not wait for a replica of its own.
        self.primary.sql("ALTER SYSTEM SET synchronous_standby_names = '*'")
        self.primary.sql("SELECT pg_reload_conf()")
        deadline = time.monotonic() + 300
        while self.primary.sql("SELECT sync_state FROM pg_stat_replication") != "sync":
            assert time.monotonic() < deadline, "the replica did not become synchronous"
            time.sleep(0.05)
        return self


class Address:
    """A TCP address whose connections go to one server at a time, like a virtual IP or a proxy."""

    def __init__(self, port):
        self.target, self.open = port, []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = url_of(self.listener.getsockname()[1])
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            try:
                server = socket.create_connection(("127.0.0.1", self.target))
            except OSError:
                client.close()
                continue
            self.open += [client, server]
            for pair in ((client, server), (server, client)):
                threading.Thread(target=self.forward, args=pair, daemon=True).start()

    def forward(self, source, sink):
        try:
            while data := source.recv(1 << 16):
                sink.sendall(data)
        except OSError:
            pass
        self.end([source, sink])

    def point_at(self, port):
        """Ends all connections; new ones go to this port."""
        self.target = port
        self.end(self.open)

    @staticmethod
    def end(sockets):
        for end in sockets:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
