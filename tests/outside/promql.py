"""The expressions of the alert rules and of the dashboard are valid PromQL.

    python3 tests/outside/promql.py

Whether the metrics that they name exist is checked by tests/whole/monitoring.rs.
"""

import json
import pathlib
import re

import promql_parser
import yaml

DEPLOY = pathlib.Path(__file__).parents[2] / "deploy"


def expressions():
    """Each expression with its place."""
    rules = yaml.safe_load((DEPLOY / "prometheus/oviduct.rules.yaml").read_text())
    for group in rules["groups"]:
        for rule in group["rules"]:
            yield rule["alert"], rule["expr"]
    dashboard = json.loads((DEPLOY / "grafana/oviduct.json").read_text())
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            # Variables that Grafana replaces by a duration.
            yield panel["title"], re.sub(r"\$__(rate_interval|interval|range)", "5m", target["expr"])


def main():
    count, faults = 0, []
    for place, expression in expressions():
        count += 1
        try:
            promql_parser.parse(expression)
        except Exception as error:  # The parser raises ValueError, and other kinds in earlier versions.
            faults.append(f"{place}: {error}: {expression}")
    if faults or count < 40:
        raise SystemExit("\n".join(faults) or f"only {count} expressions were found")
    print(f"{count} expressions are valid PromQL")


main()
