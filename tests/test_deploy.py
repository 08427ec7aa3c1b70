"""The files of `deploy/` against the service and against each other."""

import json
import re
import shutil
import subprocess
from itertools import combinations
from pathlib import Path
from typing import get_args

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from tactiled.diagnostics.warning_codes import WarningCode
from tests.conftest import ask, pressed, until
from tests.web.ws.clients import images, stream

DEPLOY = Path(__file__).parents[1] / "deploy"
DASHBOARD = json.loads((DEPLOY / "grafana/tactiled.json").read_text())
SCRAPE_LABELS = {"job", "instance"}  # that Prometheus adds
UP = {"up": {label: set() for label in SCRAPE_LABELS}}  # its own metric


def settings(name):
    return yaml.safe_load((DEPLOY / name).read_text())


def expressions():
    rules = [rule["expr"] for group in settings("prometheus/alerts.yml")["groups"] for rule in group["rules"]]
    return rules + [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]


@pytest.fixture
def exposed(rig, url):
    """Every metric of a service with a client and a warning: its labels and their values."""
    with stream(url, "?kinds=restored") as client:
        rig.stale_after(600.0)
        for _ in range(3):  # jitter is of two periods or more
            rig.show(pressed(force=3950))  # saturated
        images(client, 1)
        until(lambda: 'at="send"' in ask("GET", url + "/metrics").text)
        text = ask("GET", url + "/metrics").text
    metrics = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            for label, value in {**sample.labels, "job": None, "instance": None}.items():
                metrics.setdefault(sample.name, {}).setdefault(label, set()).add(value)
    metrics["tactiled_warning"]["code"] |= set(get_args(WarningCode))
    return metrics | UP


def test_dashboard_and_alerts_ask_for_metrics_and_labels_that_the_service_has(exposed):
    queries = expressions()
    assert len(queries) > 20
    for query in queries:
        names = re.findall(r"\b(?:(?:tactiled|process)_\w+|up\b)", query)
        assert names, query
        assert set(names) <= exposed.keys(), query
        for name, matchers in re.findall(r"(\w+)\{([^}]*)\}", query):
            for label, _, values in re.findall(r'(\w+)(=~|=)"([^"]*)"', matchers):
                assert label in exposed[name], (query, label)
                if label not in SCRAPE_LABELS and "$" not in values:
                    assert set(values.split("|")) <= exposed[name][label], (query, values)
        for labels in re.findall(r"by \(([^)]*)\)", query):
            assert set(labels.split(", ")) <= {label for name in names for label in exposed[name]}, query


def test_the_labels_in_texts_are_those_that_the_query_keeps(exposed):
    texts = [
        (rule["expr"], " ".join(re.findall(r"\$labels\.(\w+)", rule["annotations"]["summary"])))
        for rule in settings("prometheus/alerts.yml")["groups"][0]["rules"]
    ]
    texts += [
        (target["expr"], " ".join(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])))
        for panel in DASHBOARD["panels"]
        for target in panel["targets"]
    ]
    for query, labels in texts:
        kept = re.findall(r"by \(([^)]*)\)", query)
        name = re.search(r"\b(?:(?:tactiled|process)_\w+|up\b)", query)[0]
        assert set(labels.split()) <= (set(kept[0].split(", ")) if kept else exposed[name].keys()), (query, labels)


def test_the_dashboard_is_whole():
    panels, source = DASHBOARD["panels"], settings("grafana/datasource.yaml")["datasources"][0]
    assert len({panel["id"] for panel in panels}) == len(panels)
    parts = [*panels, *(each for panel in panels for each in panel["targets"]), *DASHBOARD["templating"]["list"]]
    assert {json.dumps(each["datasource"]) for each in parts} == {
        json.dumps({"type": source["type"], "uid": source["uid"]})
    }
    variables = {each["name"] for each in DASHBOARD["templating"]["list"]} | {"__rate_interval"}
    assert set(re.findall(r"\$(\w+)", " ".join(expressions()))) - {"labels"} <= variables
    cells = [
        {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        for at in (panel["gridPos"] for panel in panels)
    ]
    assert all(0 <= x < 24 for each in cells for x, _ in each)
    assert not any(one & other for one, other in combinations(cells, 2))


def test_files_that_name_each_other_exist():
    compose = settings("container/compose.yaml")
    for service in compose["services"].values():
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            if source.startswith("."):
                assert (DEPLOY / "container" / source).exists() or source == "./palm.toml", source
            else:
                assert source in compose["volumes"]
        assert service["network_mode"] == "host"
    assert (DEPLOY.parent / compose["services"]["tactiled"]["build"]["dockerfile"]).exists()
    (folder,) = (each["options"]["path"] for each in settings("grafana/dashboards.yaml")["providers"])
    assert any(f":{folder}/tactiled.json" in each for each in compose["services"]["grafana"]["volumes"])
    prometheus = settings("prometheus/prometheus.yml")
    assert [(DEPLOY / "prometheus" / each).exists() for each in prometheus["rule_files"]] == [True]
    assert {each["job_name"] for each in prometheus["scrape_configs"]} == {"tactiled"}


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="this machine has no systemd-analyze")
def test_the_unit_has_few_rights_and_may_use_can():
    unit = DEPLOY / "systemd/tactiled.service"
    command = ["systemd-analyze", "security", "--offline=yes", "--threshold=20", unit]  # tenths; 0 is best
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "AF_CAN" in re.search(r"^RestrictAddressFamilies=(.*)$", unit.read_text(), re.MULTILINE)[1].split()
