"""Grows models with `oviduct generate` and checks the output."""

import hashlib
import json
import os
import subprocess
import sys


class Oviduct:
    """The binary under test."""

    def __init__(self, binary):
        self.binary = os.path.abspath(binary)

    def run(self, *arguments, expect=0):
        """Runs a command; returns its stdout, or its stderr if the command is expected to fail."""
        done = subprocess.run([self.binary, *arguments], capture_output=True, text=True, timeout=3600)
        if done.returncode != expect:
            line = f"oviduct {' '.join(arguments)}"
            sys.exit(f"{line} ended with {done.returncode}, not {expect}:\n{done.stdout}{done.stderr}")
        return done.stdout if expect == 0 else done.stderr

    def generate(self, out, *arguments):
        """Grows a model; checks its files against the output, and that its certificate passed."""
        told = json.loads(self.run("generate", "--out", out, "--json", *arguments))
        assert sorted(os.listdir(out)) == sorted(file["name"] for file in told["files"]), "the files are not those in the output"
        for file in told["files"]:
            with open(os.path.join(out, file["name"]), "rb") as stored:
                content = stored.read()
            assert len(content) == file["bytes"] and hashlib.sha256(content).hexdigest() == file["sha256"], file
        proof = told["certificate"]
        assert proof["passed"] and proof["closed"] and proof["manifold"] and proof["oriented"], proof
        assert proof["euler"] == 0 and proof["triangle_intersections"] == 0 and proof["section_crossings"] == 0, proof
        seconds = {stage: round(time, 2) for stage, time in told["seconds"].items()}
        print(f"generated {told['preset']} seed {told['seed']}: {told['vertices']} vertices, {seconds}, "
              f"peak {(told['peak_rss_bytes'] or 0) / 1e6:.0f} MB", flush=True)
        return told


def grown(binary, folder, preset, seed, *settings):
    """Grows a model with a glTF surface; returns its report."""
    options = [f"--set={setting}" for setting in settings]
    subprocess.run([binary, "generate", "--preset", preset, "--seed", str(seed), "--outputs", "glb", "--out", folder, *options],
                   check=True, capture_output=True)
    with open(os.path.join(folder, "report.json"), encoding="utf-8") as file:
        return json.load(file)


def of_paper_size(told):
    """Returns a sentence for each property in which a model differs in size from the paper's model.
    """
    faults = []
    if told["sections"] != 201:
        faults.append(f"{told['sections']} sections, not 201")
    start, end = told["particles"]["start"], told["particles"]["end"]
    if start != 710:
        faults.append(f"{start} particles at the start, not 710")
    if abs(end - 8300) > 0.005 * 8300:
        faults.append(f"{end} particles at the end, not 8300")
    # The number is below 8300 only if splits were refused for lack of space, which the summary
    # reports.
    missing = told["summary"]["splits_missing"]
    if end + missing != 8300:
        faults.append(f"{end} particles at the end, {missing} splits reported missing, not 8300 together")
    if abs(told["vertices"] - 790_211) > 0.03 * 790_211:
        faults.append(f"{told['vertices']} vertices, not 790211 within 3 %")
    return faults
