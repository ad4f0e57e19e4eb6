"""Validates the objects in deploy/kubernetes with the schemas of Kubernetes.

Usage: manifests.py
"""

import glob
import os

import kubernetes_validate
import yaml

VERSION = "1.31"
# Kinds that are not part of Kubernetes, so there is no schema.
OTHERS = {"Kustomization", "ScaledObject", "TriggerAuthentication"}

folder = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "deploy", "kubernetes")
checked = []
for path in sorted(glob.glob(os.path.join(folder, "*.yaml"))):
    with open(path) as file:
        for thing in yaml.safe_load_all(file):
            if thing["kind"] not in OTHERS:
                kubernetes_validate.validate(thing, VERSION, strict=True)
                checked.append(f"{thing['kind']} {thing['metadata']['name']}")
assert len(checked) >= 8, checked
print(f"manifests: {len(checked)} objects are valid for Kubernetes {VERSION}")
