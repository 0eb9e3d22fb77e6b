from __future__ import annotations

import copy
import json

import pytest
from jsonschema import Draft202012Validator

from dmframe.certify import verify
from dmframe.certify.schema import verdict_schema
from dmframe.certify.summary import summary
from dmframe.certify.uncertain import intervals
from dmframe.graph.graph import Graph

VALIDATOR = Draft202012Validator(verdict_schema())


def summary_of(name):
    graph = Graph.read(name)
    diagram = graph.diagram
    return summary(graph.name, verify(diagram, uncertain=intervals(diagram, graph.file.uncertain)))


def test_the_schema_is_one():
    Draft202012Validator.check_schema(verdict_schema())


@pytest.mark.parametrize("name", ["proved", "refuted", "failing", "silent"])
def test_every_kind_of_verdict_is_valid_alone_and_in_a_list(contents, name):
    data = json.loads(json.dumps(contents[name].summary, allow_nan=False))
    VALIDATOR.validate(data)
    VALIDATOR.validate([data, data])


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.pop("primes"),
        lambda data: data.update(verdict="true"),
        lambda data: data.update(extra=1),
        lambda data: data.update(log2_error_bound=3.0),
        lambda data: data["conditions"][0].update(holds=None),
        lambda data: data["storage"][0].update(weight="2"),
        lambda data: data["time"].pop("check"),
    ],
)
def test_what_no_verdict_states_is_not_valid(contents, change):
    data = copy.deepcopy(dict(contents["proved"].summary))
    change(data)
    assert not VALIDATOR.is_valid(data)
