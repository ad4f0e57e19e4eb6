"""Measures what a model costs at the stores, for scripts/capacity.py.

Starts a temporary PostgreSQL and an S3 server (moto), one `serve` without workers, and worker processes.
Needs Debian's package postgresql and the Python packages of tests/outside/requirements.txt.
"""

import collections
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "tests", "outside"))
from cluster import BUCKET, Bucket  # noqa: E402
from postgres import Cluster, Session  # noqa: E402
from service import Service, free_port  # noqa: E402

TINY = {"steps": 60, "particles": {"total": {"keys": [[0, 300], [1, 420]]}}}
# Records that are copied to measure their size on disk.
COPIES = 20_000
# Parts of the normalized statements of the program, and what they count.
STATEMENTS = {
    "commits": "COMMIT",
    "notifications": "SELECT pg_notify",
    "heartbeats": "UPDATE jobs SET lease_until = $2",
    "worker_heartbeats": "INSERT INTO workers",
    "looks": "SELECT (SELECT $_ FROM jobs WHERE status = $_",
    "claims": "WITH heads AS MATERIALIZED",
}


def cpu_seconds(pid):
    """Returns the CPU time of a process so far, in ticks of 10 ms."""
    with open(f"/proc/{pid}/stat") as stat:
        return sum(map(int, stat.read().rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")


class Bench:
    """The stores and processes that are measured."""

    def __init__(self, binary, folder, cluster, log):
        self.binary, self.folder, self.cluster, self.log = binary, folder, cluster, log
        first = Session(cluster)
        first.ask("ALTER SYSTEM SET shared_preload_libraries = 'pg_stat_statements'")
        first.ask("ALTER SYSTEM SET max_connections = 300")
        cluster.run("pg_ctl", "-w", "-m", "fast", "restart")
        self.sql = Session(cluster)
        self.sql.ask("CREATE EXTENSION pg_stat_statements")
        # Counts the statements of the program alone.
        self.sql.ask("SET pg_stat_statements.track = 'none'")
        self.stores = ["--database", cluster.url, "--artifacts", f"s3://{BUCKET}/organs"]
        self.listener = Session(cluster)
        self.listener.listen("oviduct_changes")
        self.workers = []
        self.serve = Service(binary, folder, *self.stores, "--cpu-workers", "0", "--gpu", "off",
                             "--queue-limit", "100000")
        self.serve.start()

    def start_workers(self, processes, slots):
        for _ in range(processes):
            data = tempfile.mkdtemp(dir=self.folder)
            address = f"127.0.0.1:{free_port()}"
            line = [self.binary, "worker", "--data", data, "--gpu", "off", "--cpu-workers", str(slots),
                    "--cpu-threads", "1", "--metrics-addr", address, *self.stores]
            with open(os.path.join(data, "worker.log"), "ab") as log:
                self.workers.append((subprocess.Popen(line, stdout=log, stderr=log), address))
        count = processes * slots
        while int(self.sql.ask("SELECT count(*) FROM workers WHERE NOT stopped")[0]) < count:
            time.sleep(0.1)
        time.sleep(2)

    def stop_workers(self):
        for worker, _ in self.workers:
            worker.send_signal(signal.SIGTERM)
        for worker, _ in self.workers:
            worker.wait(120)
        self.workers = []

    def counters(self):
        """Returns all counts so far."""
        text = self.sql.ask("""
            SELECT jsonb_build_object('wal_bytes', pg_current_wal_lsn() - '0/0',
              'wal_syncs', (SELECT wal_sync FROM pg_stat_wal),
              'page_images', (SELECT wal_fpi FROM pg_stat_wal),
              'statements', (SELECT jsonb_agg(jsonb_build_array(query, calls))
                             FROM pg_stat_statements))""")[0]
        counts = collections.Counter(json.loads(text))
        statements = counts.pop("statements")
        counts["statements"] = sum(calls for _, calls in statements)
        for query, calls in statements:
            plain = re.sub(r"\$\d+", "$_", query)
            for name, part in STATEMENTS.items():
                if query.startswith(part) or plain.startswith(part):
                    counts[name] += calls
        counts["database_cpu"] = self.cluster.cpu_seconds()
        counts["serve_cpu"] = cpu_seconds(self.serve.process.pid)
        counts["worker_cpu"] = sum(cpu_seconds(worker.pid) for worker, _ in self.workers)
        counts.update(self.stages())
        counts["notified"] = self.listener.notified
        with open(self.log, errors="replace") as lines:
            for line in lines:
                found = re.search(r'"([A-Z]+) (\S+) HTTP', line)
                if found:
                    counts[f"s3 {found[1]}{request_kind(found[2])}"] += 1
        counts["seconds"] = time.monotonic()
        return counts

    def stages(self):
        """Returns the seconds of the workers in each stage, and the number of models that were exported."""
        counts = collections.Counter()
        for _, address in self.workers:
            with urllib.request.urlopen(f"http://{address}/metrics") as metrics:
                text = metrics.read().decode()
            for stage, seconds in re.findall(r'oviduct_stage_seconds_sum{stage="(\w+)"} (\S+)', text):
                counts[f"stage {stage}"] += float(seconds)
            exports = re.findall(r'_stage_seconds_count{stage="export"} (\S+)', text)
            counts["measured models"] += sum(map(float, exports))
        return counts

    def cost(self, work, models=1, settle=2.0):
        """Runs `work`; returns the differences of all counts, divided by the number of models."""
        before = self.counters()
        work()
        seconds = time.monotonic() - before["seconds"]
        time.sleep(settle)
        after = self.counters()
        cost = {name: (after[name] - before[name]) / models for name in after}
        cost["seconds"] = seconds / models
        return {name: round(value, 6) for name, value in sorted(cost.items()) if value}

    def submit(self, count, spec, first):
        for seed in range(first, first + count):
            self.serve.json("POST", "/models", {"seed": seed, "spec": spec, "reuse": False})

    def until_idle(self):
        while int(self.sql.ask("SELECT count(*) FROM jobs WHERE finished_at IS NULL")[0]):
            time.sleep(0.2)

    def run(self, workers, rate, seconds):
        """Submits small models at a rate and returns what they cost and how long they waited."""
        line = [self.binary, "load", "--url", self.serve.url, "--rate", f"{rate}/s",
                "--duration", f"{seconds}s", "--warm-up", "0s", "--mix", "submit=1", "--seed", str(workers),
                "--json",
                "--set", "steps=60", "--set", f"particles.total={json.dumps(TINY['particles']['total'])}"]
        idle = self.cost(lambda: time.sleep(15), 15, settle=0)
        said, start = {}, self.sql.ask("SELECT EXTRACT(EPOCH FROM clock_timestamp())")[0]

        samples = []

        def load():
            # Other programs slow the workers down at times, so their speed is recorded as well.
            with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
                since = time.monotonic()
                while process.poll() is None:
                    samples.append((time.monotonic() - since, self.stages()))
                    time.sleep(2)
                said.update(json.load(process.stdout))

        cost = self.cost(load, settle=1)
        models = {name: said["models"][name] for name in ("models", "succeeded", "queue_wait", "end_to_end")}
        arrivals = self.sql.ask(f"""SELECT jsonb_agg(round(created_at / 1e6 - {start}, 4) ORDER BY created_at)
            FROM jobs WHERE created_at > {start} * 1e6""")[0]
        return {"workers": workers, "rate": rate, "idle": idle, "cost": cost, **models,
                "arrivals": json.loads(arrivals), "stages": samples}

    def upkeep(self):
        """Returns the time to sum the sizes of all files, and the number of models that retention deletes."""
        files, since = int(self.sql.ask("SELECT count(*) FROM files")[0]), time.monotonic()
        self.sql.ask("SELECT SUM(bytes) FROM (SELECT MAX(bytes) AS bytes FROM files GROUP BY key) AS kept")
        seconds = time.monotonic() - since
        self.serve.stop()
        self.serve.start("--keep", "1s", "--sweep-now")
        time.sleep(3)
        before = int(self.sql.ask("SELECT count(*) FROM jobs")[0])
        cost = self.cost(lambda: time.sleep(20), settle=0)
        deleted = before - int(self.sql.ask("SELECT count(*) FROM jobs")[0])
        return {"files": files, "sum_seconds": seconds, "deleted": deleted, "cost": cost}

    def sizes(self):
        tables = self.sql.ask("""SELECT jsonb_object_agg(relname, jsonb_build_array(pg_table_size(oid),
            pg_indexes_size(oid))) FROM pg_class
            WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace""")
        return json.loads(tables[0])

    def bytes_per_record(self, job):
        """Copies the records of a finished model; returns their bytes on disk by table: heap, indexes."""
        before = self.sizes()
        for table, column in [("jobs", "id"), ("attempts", "job_id"), ("files", "job_id")]:
            extra = {"jobs": ", 'digest', encode(sha256(n::text::bytea), 'hex')", "attempts": "",
                     "files": ", 'key', 'models/' || new || '/1/' || t.name"}[table]
            columns = self.sql.ask(f"""SELECT string_agg(quote_ident(attname), ', r.' ORDER BY attnum)
                FROM pg_attribute WHERE attrelid = '{table}'::regclass AND attnum > 0 AND attgenerated = ''
                AND NOT attisdropped""")[0]
            self.sql.ask(f"""INSERT INTO {table} ({columns.replace("r.", "")})
                SELECT r.{columns} FROM {table} t,
                (SELECT n, overlay('{job}' placing lpad(to_hex(n), 12, '0') from 25) AS new
                FROM generate_series(1, {COPIES}) n) c,
                jsonb_populate_record(t, jsonb_build_object('{column}', new{extra})) r
                WHERE t.{column} = '{job}'""")
        names = self.sql.ask("""SELECT attname FROM pg_attribute
            WHERE attrelid = 'jobs'::regclass AND attnum > 0""")
        widths = ", ".join(f"'{name}', pg_column_size({name})" for name in names)
        widths = self.sql.ask(f"SELECT jsonb_build_object({widths}) FROM jobs WHERE id = '{job}'")[0]
        large = {name: width for name, width in json.loads(widths).items() if (width or 0) > 99}
        self.sql.ask("VACUUM")
        after = self.sizes()
        sizes = {name: [(b - a) / COPIES for a, b in zip(before[name], after[name])] for name in after}
        tables = {name: [round(size) for size in both] for name, both in sizes.items() if sum(both) > 5}
        return {"tables": tables, "large_columns": large}


def request_kind(path):
    query = path.partition("?")[2]
    if "partNumber" in query:
        return " part"
    return " upload" if "upload" in query else ""


def notification_costs(bench):
    """Returns the CPU seconds of the database per notification, without listeners and per listener."""
    payload = f"{'0' * 32} {'1' * 32} 12"
    points = []
    for listeners in (0, 40):
        sessions = [Session(bench.cluster) for _ in range(listeners)]
        for session in sessions:
            session.listen("capacity")
        before = bench.cluster.cpu_seconds()
        for _ in range(2000):
            bench.sql.ask(f"SELECT pg_notify('capacity', '{payload}')")
        time.sleep(2)
        points.append((bench.cluster.cpu_seconds() - before) / 2000)
        assert all(session.notified == 2000 for session in sessions)
        for session in sessions:
            session.close()
    return {"alone": points[0], "per_listener": (points[1] - points[0]) / 40}


def measure(binary, small, full, seconds):
    with (tempfile.TemporaryDirectory() as folder, Cluster() as cluster,
          open(f"{folder}/s3.log", "wb") as log, Bucket(log)):
        bench = Bench(binary, folder, cluster, log.name)
        out = {"machine": machine(), "small_models": small, "full_models": full}
        out["idle_serve"] = bench.cost(lambda: time.sleep(20), 20, settle=0)
        bench.submit(small // 3, TINY, 1)
        out["submit"] = bench.cost(lambda: bench.submit(small // 3, TINY, 1001), small // 3)
        # The first models prepare the statements of each connection.
        bench.start_workers(2, 1)
        bench.until_idle()
        bench.submit(small, TINY, 2001)
        unfinished = int(bench.sql.ask("SELECT count(*) FROM jobs WHERE finished_at IS NULL")[0])
        out["small"] = bench.cost(bench.until_idle, unfinished)
        out["idle_all"] = bench.cost(lambda: time.sleep(20), 20, settle=0)
        out["full"] = bench.cost(lambda: (bench.submit(full, {}, 5001), bench.until_idle()), full)
        jobs = bench.serve.json("GET", "/models?limit=2&status=succeeded")["models"]
        first = json.loads(bench.sql.ask("""SELECT jsonb_agg(id ORDER BY finished_at - started_at) FROM jobs
            WHERE seed < 5000""")[0])
        for name, job in [("small", first[0]), ("full", jobs[0]["id"])]:
            files = bench.serve.json("GET", f"/models/{job}")["files"]
            out[f"{name}_files"] = {file["name"]: file["bytes"] for file in files}
        out["times"] = json.loads(bench.sql.ask("""
            SELECT jsonb_object_agg(kind, jsonb_build_array(n, changes, seconds)) FROM (
            SELECT CASE WHEN seed < 5000 THEN 'small' ELSE 'full' END AS kind, count(*) AS n,
            avg(version) AS changes, avg(finished_at - started_at) / 1e6 AS seconds
            FROM jobs GROUP BY 1) t""")[0])
        rate = 1 / out["small"]["seconds"]
        out["runs"] = []
        for processes, slots, share in [(2, 1, 0.5), (2, 1, 0.85), (3, 8, 0.5)]:
            bench.stop_workers()
            bench.start_workers(processes, slots)
            out["runs"].append(bench.run(processes * slots, round(rate * share, 2), seconds))
        bench.stop_workers()
        out["notification"] = notification_costs(bench)
        out["record_bytes"] = {"small": bench.bytes_per_record(first[0]),
                               "full": bench.bytes_per_record(jobs[0]["id"])}
        out["upkeep"] = bench.upkeep()
        bench.serve.stop()
    return out


def machine():
    said = subprocess.run(["lscpu", "-J"], capture_output=True, check=True).stdout
    fields = {field["field"].strip(":"): field["data"] for field in json.loads(said)["lscpu"]}
    names = ("Model name", "CPU family", "Model", "CPU(s)")
    return {**{name: fields.get(name) for name in names}, "date": time.strftime("%Y-%m-%d"),
            "load": os.getloadavg()[0]}
