"""The files of `deploy/` against the service."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from tactiled.diagnostics.warning_codes import WarningCode
from tests.conftest import ask, pressed, until
from tests.web.ws.clients import images, stream

DEPLOY = Path(__file__).parents[1] / "deploy"
PROMETHEUS_LABELS = ("job", "instance")  # that it adds itself
METRIC = r"\b(?:(?:tactiled|process)_\w+|up\b)"


def queries():
    """Every query of alerts and dashboard, and the labels that its text names."""
    for group in yaml.safe_load((DEPLOY / "prometheus/alerts.yml").read_text())["groups"]:
        for rule in group["rules"]:
            yield rule["expr"], re.findall(r"\$labels\.(\w+)", rule["annotations"]["summary"])
    for panel in json.loads((DEPLOY / "grafana/tactiled.json").read_text())["panels"]:
        for target in panel["targets"]:
            yield target["expr"], re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])


@pytest.fixture
def exposed(rig, url):
    """Every metric of a service with a client and a warning: its labels and their values."""
    rig.stale_after(600.0)
    with stream(url, "?kinds=restored") as client:
        for _ in range(3):  # jitter is of two periods or more
            rig.show(pressed(force=3950))  # saturated
        images(client, 1)
        until(lambda: 'at="send"' in ask("GET", url + "/metrics").text)
        families = text_string_to_metric_families(ask("GET", url + "/metrics").text)
    metrics = {"up": {label: set() for label in PROMETHEUS_LABELS}}
    for sample in (each for family in families for each in family.samples):
        for label, value in {**sample.labels, **dict.fromkeys(PROMETHEUS_LABELS)}.items():
            metrics.setdefault(sample.name, {}).setdefault(label, set()).add(value)
    metrics["tactiled_warning"]["code"] |= set(get_args(WarningCode))
    return metrics


def test_dashboard_and_alerts_ask_for_metrics_and_labels_that_the_service_has(exposed):
    for query, text_labels in queries():
        names = re.findall(METRIC, query)
        assert set(names) <= exposed.keys(), query
        for name, matchers in re.findall(r"(\w+)\{([^}]*)\}", query):
            for label, values in re.findall(r'(\w+)=~?"([^"]*)"', matchers):
                assert label in exposed[name], (query, label)
                if label not in PROMETHEUS_LABELS and "$" not in values:
                    assert set(values.split("|")) <= exposed[name][label], query
        groups = [set(labels.split(", ")) for labels in re.findall(r"by \(([^)]*)\)", query)]
        assert all(labels <= exposed[names[0]].keys() for labels in groups), query
        assert set(text_labels) <= (groups[0] if groups else exposed[names[0]].keys()), (query, text_labels)


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="this machine has no systemd-analyze")
def test_the_unit_has_few_rights_but_those_for_can_and_for_metrics_of_the_process():
    unit = DEPLOY / "systemd/tactiled.service"
    command = ["systemd-analyze", "security", "--offline=yes", "--threshold=20", unit]  # tenths; 0 is best
    assert subprocess.run(command, capture_output=True).returncode == 0
    settings = dict(re.findall(r"^(\w+)=(.*)$", unit.read_text(), re.MULTILINE))
    assert "AF_CAN" in settings["RestrictAddressFamilies"].split()
    assert "ProcSubset" not in settings  # /proc/stat has the time that the machine started


def test_the_client_by_itself_has_the_version_of_the_package_and_all_that_it_imports():
    client = tomllib.loads((DEPLOY / "client/pyproject.toml").read_text())
    whole = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
    assert client["project"]["version"] == whole["project"]["version"] + "+client"
    files = client["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert all(source == f"../../{target}" for source, target in files.items())
    loaded = "import sys, tactiled.client; print(*sorted(n for n in sys.modules if n.startswith('tactiled')))"
    modules = subprocess.run([sys.executable, "-c", loaded], check=True, capture_output=True, text=True).stdout
    names, there = {name.replace(".", "/") for name in modules.split()}, {*files.values()}
    forms = {name: {name, f"{name}.py", f"{name}/__init__.py", name.rpartition("/")[0]} for name in names}
    assert "tactiled/client" in forms
    assert not [name for name, each in forms.items() if not each & there]
