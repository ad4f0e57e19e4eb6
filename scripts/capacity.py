"""Capacity of the queue: the costs of a model, and a simulation of a load that no test machine carries.

Usage: capacity.py measure OVIDUCT_BINARY > MEASURED.json
       capacity.py simulate MEASURED.json [--check] [--rate R] [--full-rate R] [--workers W] ...

`measure` counts what small and full models cost at PostgreSQL and S3 (scripts/costs.py), and runs `oviduct
load` at several rates. `simulate` computes waiting times and utilizations from these costs. With `--check` it
simulates the measured runs of `oviduct load` and prints both results.
"""

import argparse
import bisect
import collections
import heapq
import json
import math
import os
import random
import statistics


def constants(measured):
    """Derives the costs of the simulation, in CPU seconds of the database unless they say otherwise."""
    small, full, idle = measured["small"], measured["full"], measured["idle_all"]["database_cpu"]
    serve = measured["idle_serve"].get("database_cpu", 0)
    many = max(measured["runs"], key=lambda run: run["workers"])
    work = small["database_cpu"] - idle * small["seconds"]
    beat = (full["database_cpu"] - idle * full["seconds"] - work) / (full["heartbeats"] - small["heartbeats"])
    submit = measured["submit"]["database_cpu"]
    alone = many["models"] * (submit + work) + many["idle"]["database_cpu"] * many["cost"]["seconds"]
    busy = many["rate"] * measured["times"]["small"][2]
    return {
        "submit": submit, "work": work, "beat": beat,
        "look": max(0, many["cost"]["database_cpu"] - alone) / many["models"] / (many["workers"] - busy),
        "poll": (many["idle"]["database_cpu"] - serve) / many["workers"],
        "listener": measured["notification"]["per_listener"],
        "notifications_small": measured["submit"]["notifications"] + small["notifications"],
        "notifications_full": full["notifications"],
        "beats_per_second": full["heartbeats"] / measured["times"]["full"][2],
        # Part of the time of a model in which its worker may claim the next one.
        "ahead": stages(small, "certify", "measure", "export") / stages(small),
        # Seconds of a worker with a core of its own, and of an idle database until its answer.
        "small_seconds": small["worker_cpu"], "full_seconds": full["worker_cpu"],
        "answer": measured["submit"]["seconds"],
    }


def stages(cost, *names):
    """Returns the seconds of a worker in these stages, by default all that use its threads."""
    names = names or ("simulate", "mesh", "certify", "measure", "export")
    return sum(cost.get(f"stage {name}", 0) for name in names)


class Server:
    """A database that runs operations in the order of their arrival on some cores."""

    def __init__(self, cores):
        self.free, self.used = [0.0] * cores, collections.Counter()

    def run(self, part, now, seconds, count=1):
        """Runs `count` equal operations that arrive now; returns when the last of them ends."""
        self.used[part] += seconds * count
        chunks = min(count, len(self.free))
        for _ in range(chunks):
            end = max(now, heapq.heappop(self.free)) + seconds * count / chunks
            heapq.heappush(self.free, end)
        return end


def simulate(cost, options):
    """Simulates the queue; returns waiting times and utilizations. The same seed gives the same result."""
    draw, database = random.Random(options.seed), Server(options.cores)
    # The load over a day is a power of a cosine with its maximum at noon.
    power = next(n / 20 for n in range(2000) if peak_of(n / 20) >= options.peak)
    rate, workers = options.rate + options.full_rate, options.workers
    events, queue, idle, waits, number = [], collections.deque(), [], [], 0
    herd, longest, occupied, ended = 0.0, 0, 0.0, 0

    def later(at, what, *data):
        nonlocal number
        number += 1
        heapq.heappush(events, (at, number, what, data))

    def claim(now, created, is_full, free):
        """A worker whose threads are free at `free` claims a model."""
        nonlocal occupied
        claimed = database.run("work", now, cost["work"] / 2) + cost["answer"]
        waits.append(claimed - created)
        begin = max(claimed, free)
        seconds = (cost["full_seconds"] if is_full else cost["small_seconds"]) * draw.gauss(1, options.spread)
        if options.speeds:
            seconds = options.speeds[bisect.bisect(options.speeds, (begin, 0)) - 1][1]
        if not is_full:
            seconds /= options.computing
        occupied += seconds
        later(begin + seconds, "end", is_full)
        if is_full:
            for beat in range(int(seconds * cost["beats_per_second"])):
                later(begin + beat / cost["beats_per_second"], "beat")
        # A worker claims its next model shortly before its threads are free.
        later(max(claimed, begin + seconds - min(0.5, cost["ahead"] * seconds)), "ready", begin + seconds)

    for arrival in options.arrivals or [0]:
        later(arrival, "arrival")
    later(0, "poll")
    for _ in range(workers):
        later(0, "ready", 0)
    while events:
        now, _, what, data = heapq.heappop(events)
        if now > options.seconds:
            break
        if what == "arrival":
            if not options.arrivals:
                later(now + draw.expovariate(rate * options.peak), "arrival")
            if options.arrivals or draw.random() <= math.sin(math.pi * now / 86400) ** (2 * power):
                is_full = draw.random() * (options.rate + options.full_rate) < options.full_rate
                done = database.run("submit", now, cost["submit"]) + cost["answer"]
                notifications = cost["notifications_full" if is_full else "notifications_small"]
                database.run("notify", now, cost["listener"] * notifications * options.listeners)
                later(done, "queued", now, is_full)
        elif what == "queued":
            queue.append(data)
            if idle:
                claim(now, *queue.popleft(), idle.pop())
            # All other idle workers look at the queue as well, but not while they still look.
            if idle and now >= herd:
                herd = database.run("look", now, cost["look"] * options.wakes, len(idle))
        elif what == "ready":
            if queue:
                claim(now, *queue.popleft(), *data)
            else:
                idle.append(*data)
        elif what == "end":
            ended += 1
            database.run("work", now, cost["work"] / 2)
        elif what == "beat":
            database.run("beat", now, cost["beat"])
        elif what == "poll":
            database.run("poll", now, cost["poll"], workers)
            later(now + 1, "poll")
        longest = max(longest, len(queue))
    waits.sort()
    span = options.seconds
    return {
        "rate_per_second": round(rate, 2), "workers": workers, "models": ended,
        "models_per_second": round(ended / span, 2),
        "wait_mean": round(statistics.fmean(waits), 4), "wait_p50": round(waits[len(waits) // 2], 4),
        "wait_p99": round(waits[len(waits) * 99 // 100], 4), "wait_max": round(waits[-1], 4),
        "queue_longest": longest, "queue_at_end": len(queue),
        "workers_busy": round(occupied / span / workers, 3),
        "database_busy": round(sum(database.used.values()) / span / options.cores, 3),
        "database_cores_by_part": {part: round(used / span, 3) for part, used in database.used.items()},
    }


def peak_of(power):
    """Returns the load at noon divided by the mean of the day."""
    return math.gamma(power + 1) * math.sqrt(math.pi) / math.gamma(power + 0.5)


def speeds(run):
    """Returns pairs of a time of a run and the mean seconds of the models that ended about then."""
    found, before = [(0, stages(run["cost"]) / run["models"])], run["stages"][0]
    for now in run["stages"][1:]:
        models = now[1]["measured models"] - before[1].get("measured models", 0)
        if models >= 5:
            found.append((before[0], (stages(now[1]) - stages(before[1])) / models))
            before = now
    return found


def check(measured, options):
    """Prints the measured runs of `oviduct load` beside simulations of them."""
    for run in measured["runs"]:
        wait, seconds = run["queue_wait"], run["cost"]["seconds"]
        # All processes of the measured machine share its cores: a model takes more than CPU time.
        options.speeds = speeds(run)
        options.rate, options.full_rate, options.workers = run["models"] / seconds, 0, run["workers"]
        options.arrivals, options.seconds, options.cores, options.listeners = run["arrivals"], seconds, 2, 0
        real = {"models_per_second": round(run["models"] / seconds, 2), "wait_mean": round(wait["mean"], 4),
                "wait_p50": round(wait["p50"], 4), "wait_p99": round(wait["p99"], 4),
                "database_busy": round(run["cost"]["database_cpu"] / seconds / 2, 4)}
        made = simulate(constants(measured), options)
        row = {name: [value, made[name]] for name, value in real.items()}
        print(json.dumps({"workers": run["workers"], "measured, simulated": row}))


def main():
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure")
    measuring.add_argument("binary")
    measuring.add_argument("--small", type=int, default=300, help="small models of the backlog")
    measuring.add_argument("--full", type=int, default=4, help="full models")
    measuring.add_argument("--seconds", type=int, default=40, help="duration of each run of `oviduct load`")
    simulating = commands.add_parser("simulate")
    simulating.add_argument("measured")
    simulating.add_argument("--check", action="store_true", help="compare with the measured runs")
    for name, default, meaning in [
        ("rate", 1e7 / 86400, "small models per second, mean of the day"),
        ("full-rate", 1e5 / 86400, "full models per second, mean of the day"),
        ("workers", 100, "single-threaded workers"),
        ("cores", 4, "cores of the database"), ("listeners", 10, "processes beyond the measured ones"),
        ("peak", 1.0, "load at noon divided by the mean of the day"), ("seconds", 600, "simulated time"),
        ("spread", 0.1, "relative standard deviation of the time of a model"),
        ("computing", 0.89, "part of the time that a busy worker of small models computes (performance.md)"),
        ("seed", 1, "seed of the random numbers"),
        ("wakes", 1.0, "fraction of the idle workers that a submission wakes"),
    ]:
        meaning += f" [default: {default:g}]"
        simulating.add_argument(f"--{name}", type=type(default), default=default, help=meaning)
    options = parser.parse_args()
    options.arrivals = options.speeds = None
    if options.command == "measure":
        # Only this command needs the packages of tests/outside.
        import costs
        binary = os.path.abspath(options.binary)
        print(json.dumps(costs.measure(binary, options.small, options.full, options.seconds), indent=1))
        return
    with open(options.measured) as file:
        measured = json.load(file)
    if options.check:
        check(measured, options)
    else:
        cost = constants(measured)
        print(json.dumps({"costs": cost, "result": simulate(cost, options)}, indent=1))


if __name__ == "__main__":
    main()
