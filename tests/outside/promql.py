"""Checks that the expressions of the alert rules and of the dashboard are valid PromQL.

Usage: python3 tests/outside/promql.py

tests/whole/monitoring.rs checks that the metrics in the expressions exist.
"""

import json
import pathlib
import re

import promql_parser
import yaml

DEPLOY = pathlib.Path(__file__).parents[2] / "deploy"


def expressions():
    """Yields each expression with its place."""
    rules = yaml.safe_load((DEPLOY / "prometheus/oviduct.rules.yaml").read_text())
    for group in rules["groups"]:
        for rule in group["rules"]:
            yield rule["alert"], rule["expr"]
    dashboard = json.loads((DEPLOY / "grafana/oviduct.json").read_text())
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            # Grafana replaces these variables by a duration.
            yield panel["title"], re.sub(r"\$__(rate_interval|interval|range)", "5m", target["expr"])


def main():
    count, faults = 0, []
    for place, expression in expressions():
        count += 1
        try:
            promql_parser.parse(expression)
        except Exception as error:  # ValueError; earlier versions of the parser differ.
            faults.append(f"{place}: {error}: {expression}")
    if faults or count < 40:
        raise SystemExit("\n".join(faults) or f"only {count} expressions were found")
    print(f"{count} expressions are valid PromQL")


main()
