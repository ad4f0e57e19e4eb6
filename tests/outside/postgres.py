"""A temporary PostgreSQL server from Debian's package, on a free loopback port."""

import glob
import os
import pwd
import shutil
import subprocess
import tempfile

from service import free_port


def programs():
    """Returns the program directory of the newest installed PostgreSQL version."""
    found = [path for path in glob.glob("/usr/lib/postgresql/*/bin") if os.path.exists(f"{path}/initdb")]
    if not found:
        raise SystemExit("PostgreSQL is missing: run scripts/need, or apt-get install postgresql")
    return max(found, key=lambda path: float(path.split("/")[4]))


class Cluster:
    """A running server, stopped and removed at the end of a `with` block.

    If root starts the server, it runs as user `postgres`.
    """

    def __enter__(self):
        self.bin = programs()
        self.folder = tempfile.mkdtemp(prefix="oviduct-postgres-", dir="/tmp")
        # PostgreSQL refuses to run as root.
        self.user = pwd.getpwnam("postgres") if os.getuid() == 0 else None
        if self.user:
            os.chown(self.folder, self.user.pw_uid, self.user.pw_gid)
        self.run("initdb", "-U", "postgres", "-A", "trust", "-E", "UTF8", "--locale=C.UTF-8", "--no-sync")
        # Another program may take the port before the server does.
        for _ in range(5):
            self.port = free_port()
            settings = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories="
            fault = self.attempt("pg_ctl", "-o", settings, "-l", f"{self.folder}/log", "-w", "start")
            if fault is None:
                break
        else:
            raise SystemExit(fault)
        self.url = f"postgres://postgres@127.0.0.1:{self.port}/postgres?sslmode=disable"
        return self

    def __exit__(self, *_):
        self.run("pg_ctl", "-m", "immediate", "stop")
        shutil.rmtree(self.folder)

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
